// The mesh while it is being simplified: flat arrays, and for each vertex the list of its corners.
#pragma once
#include <algorithm>
#include <atomic>
#include <cstdint>
#include <cstring>
#include <memory>
#include <vector>

#include "decimate.h"
#include "memory.h"
#include "order.h"
#include "parallel.h"
#include "quadric.h"

namespace lodpipe {

enum : uint8_t {  // State::flags; they change in prepare() and in collapses only
  kDead = 1,
  kLocked = 2,
  kMoved = 4,  // lies where no input vertex was
  kSeveralWedges = 8,
  kIrregular = 16,  // its faces do not form closed, consistently turning fans, or it has links
};
enum : uint8_t {  // Candidate::todo
  kDirty = 1,       // something near it changed: evaluate
  kRetry = 2,       // its best collapse was refused: evaluate the next best
  kPassedOver = 4,  // `skip` is not 0
  kVanish = 8,      // the candidate is to take out the whole component
};

struct Vertex {  // one cache line
  Vec3 p;
  Quadric q;
  int32_t first, count;  // its corners in State::corners, those of dead faces included
  float error;           // estimate of the deviation so far
};
static_assert(sizeof(Vertex) == 64);

struct Candidate {  // a vertex's best collapse
  float cost;       // infinite: none
  int32_t partner;  // with whom
  int32_t skip;     // so many of the cheapest were refused since the vertex was last dirty
  uint8_t todo;
};
static_assert(sizeof(Candidate) == 16);

// A triangle, or (v[2] = kNone) a link between two vertices that are near each other but share no edge.
struct Face {  // four to a cache line
  int32_t v[3];
  int32_t source;  // row of the input
  bool dead() const { return v[0] < 0; }
  bool link() const { return v[2] < 0; }
};
static_assert(sizeof(Face) == 16);

struct Wedges {  // of a face's corners
  int32_t w[3];
};

// A vector that is filled anew all the time: pushing is one comparison and one store.
template <class T>
class Buffer {
 public:
  void clear() { size_ = 0; }
  void push_back(const T& x) {
    if (size_ == items_.size()) items_.resize(2 * size_ + 32);
    items_[size_++] = x;
  }
  void resize(size_t size) {
    if (size > items_.size()) items_.resize(size);
    size_ = size;
  }
  // Room for `most` items from the start on; `end` then says how many were written.
  T* refill(size_t most) {
    if (most > items_.size()) items_.resize(most + 32);
    return items_.data();
  }
  // The same, after the items that are there.
  T* grow(size_t most) {
    if (size_ + most > items_.size()) items_.resize(2 * (size_ + most) + 32);
    return items_.data() + size_;
  }
  void end_at(const T* end) { size_ = static_cast<size_t>(end - items_.data()); }
  size_t size() const { return size_; }
  bool empty() const { return !size_; }
  T* data() { return items_.data(); }
  T& operator[](size_t i) { return items_[i]; }
  const T& operator[](size_t i) const { return items_[i]; }
  T* begin() { return items_.data(); }
  T* end() { return items_.data() + size_; }
  const T* begin() const { return items_.data(); }
  const T* end() const { return items_.data() + size_; }

 private:
  std::vector<T> items_;
  size_t size_ = 0;
};

constexpr int32_t kNone = -1;
constexpr int kNext[3] = {1, 2, 0};

inline int32_t corner(int32_t face, int k) { return face << 2 | k; }
inline int32_t face_of(int32_t corner) { return corner >> 2; }
inline int slot_of(int32_t corner) { return corner & 3; }

// The corners of all vertices, each vertex's in one piece. A merged vertex takes the place of one of the two if its list
// fits there, else a new one at the end.
class CornerLists {
 public:
  // Part of the free room that one thread has for itself.
  struct Room {
    int64_t next = 0, end = 0;
  };

  void start(int64_t filled) {
    if (2 * filled + 4096 > capacity_) {
      capacity_ = 2 * filled + 4096;
      items_.reset(LargeAllocator<int32_t>().allocate(static_cast<size_t>(capacity_)));
    }
    used_ = filled;
  }
  int32_t* items() { return items_.get(); }
  int32_t* at(const Vertex& v) { return items_.get() + v.first; }
  const int32_t* begin(const Vertex& v) const { return items_.get() + v.first; }
  const int32_t* end(const Vertex& v) const { return items_.get() + v.first + v.count; }

  // Where a list of `count` corners can go that replaces those of a and b; kNone if there is no room left.
  int32_t place(const Vertex& a, const Vertex& b, int32_t count, Room& room) {
    if (count <= a.count) return a.first;
    if (count <= b.count) return b.first;
    if (room.end - room.next < count) {
      const int64_t size = std::max<int64_t>(count, kRoom);
      const int64_t from = used_.fetch_add(size);
      if (from + size > capacity_) return kNone;
      room = {from, from + size};
    }
    room.next += count;
    return static_cast<int32_t>(room.next - count);
  }
  bool nearly_full() const { return used_ > capacity_ - capacity_ / 4; }

 private:
  static constexpr int64_t kRoom = 1024;
  struct Free {
    void operator()(int32_t* p) const { LargeAllocator<int32_t>().deallocate(p, 0); }
  };
  std::unique_ptr<int32_t[], Free> items_;
  int64_t capacity_ = 0;
  std::atomic<int64_t> used_{0};
};

// Sum over faces of area · (gradient, offset) of one attribute: offset is taken at the vertex, less the wedge's value.
struct alignas(16) Slope {
  float x = 0, y = 0, z = 0, d = 0;
  float at(Vec3 t) const { return x * t.x + y * t.y + z * t.z + d; }
  Slope& operator+=(const Slope& o) {
    Lanes a, b;
    std::memcpy(&a, this, 16);
    std::memcpy(&b, &o, 16);
    a += b;
    std::memcpy(this, &a, 16);
    return *this;
  }
};

struct State {
  Large<Vertex> vertices;
  Large<uint8_t> flags;
  Large<Face> faces;     // triangles first, then links
  Large<Wedges> wedges;  // of the triangles
  CornerLists corners;
  Large<Candidate> candidates;  // of the vertices
  std::vector<int32_t> live;
  std::vector<int32_t> vertex_source, wedge_source;
  // wedges, row-major with `columns`
  int columns = 0, steering = 0;  // the first `steering` columns have a share in the cost
  bool late = false;                // values are taken from the input when a level is emitted; wedges have no rows
  bool fitted = false;              // wedges have slopes and a weight
  size_t row = 0;                   // floats a wedge
  int chart_column = -1;            // first of the two UV columns that must stay in their charts
  std::vector<int32_t> column_source;
  std::vector<float> column_scale;
  Large<float> rows;  // of the wedges: slopes of the columns, values of the columns, weight; all that a merge needs
  std::vector<uint8_t> wedge_moved;
  std::vector<int32_t> vertex_into, wedge_into;  // with `follow`, wedges with `late`, too: what each was merged into;
                                                 // itself while it lives

  Slope* slopes(int32_t wedge) { return reinterpret_cast<Slope*>(&rows[static_cast<size_t>(wedge) * row]); }
  const Slope* slopes(int32_t wedge) const {
    return reinterpret_cast<const Slope*>(&rows[static_cast<size_t>(wedge) * row]);
  }
  float* values(int32_t wedge) { return &rows[static_cast<size_t>(wedge) * row + (fitted ? 4 * columns : 0)]; }
  const float* values(int32_t wedge) const {
    return &rows[static_cast<size_t>(wedge) * row + (fitted ? 4 * columns : 0)];
  }
  float& weight(int32_t wedge) { return values(wedge)[columns]; }
  float weight(int32_t wedge) const { return values(wedge)[columns]; }

  double center[3] = {0, 0, 0};
  double scale = 1;  // input units → unit diagonal
  int64_t triangles = 0;
  bool has_links = false;
};

}  // namespace lodpipe
