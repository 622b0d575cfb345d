// Vectors and plain memory for the large arrays: on huge pages where the system has them, because collapses jump about in them.
#pragma once
#include <cstdlib>
#include <new>
#include <utility>
#include <vector>
#ifdef __linux__
#include <sys/mman.h>
#endif

namespace lodpipe {

template <class T>
struct LargeAllocator {
  using value_type = T;
  static constexpr size_t kPage = size_t{1} << 21;
  LargeAllocator() = default;
  template <class U>
  LargeAllocator(const LargeAllocator<U>&) {}  // NOLINT: a conversion, as the standard wants it

  T* allocate(size_t count) {
    const size_t bytes = count * sizeof(T);
    const bool large = bytes >= 2 * kPage;
    const size_t align = large ? kPage : 64;
    void* p = std::aligned_alloc(align, (bytes + align - 1) / align * align);
    if (!p) throw std::bad_alloc();
#ifdef __linux__
    if (large) madvise(p, bytes / kPage * kPage, MADV_HUGEPAGE);  // a hint: refusal does no harm
#endif
    return static_cast<T*>(p);
  }
  void deallocate(T* p, size_t) { std::free(p); }
  template <class U>
  void construct(U* p) {  // plain numbers are not set to 0 before they are set: resize() leaves them as they are
    ::new (static_cast<void*>(p)) U;
  }
  template <class U, class... Args>
  void construct(U* p, Args&&... args) {
    ::new (static_cast<void*>(p)) U(std::forward<Args>(args)...);
  }
  bool operator==(const LargeAllocator&) const { return true; }
};

template <class T>
using Large = std::vector<T, LargeAllocator<T>>;

}  // namespace lodpipe
