// NumPy arrays on their way in and out; for the files that bind.
#pragma once
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <vector>

namespace lodpipe::binding {

template <class T>
using Table = nanobind::ndarray<const T, nanobind::numpy, nanobind::ndim<2>, nanobind::c_contig, nanobind::device::cpu>;
template <class T>
using Column = nanobind::ndarray<const T, nanobind::numpy, nanobind::ndim<1>, nanobind::c_contig, nanobind::device::cpu>;

// A NumPy array that owns the vector's memory; `width` columns, or one-dimensional for 0.
template <class T>
nanobind::object give(std::vector<T>& values, size_t width) {
  auto* held = new std::vector<T>(std::move(values));
  nanobind::capsule owner(held, [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
  if (!width) return nanobind::cast(nanobind::ndarray<nanobind::numpy, T>(held->data(), {held->size()}, owner));
  return nanobind::cast(nanobind::ndarray<nanobind::numpy, T>(held->data(), {held->size() / width, width}, owner));
}

void bind_pictures(nanobind::module_& m);

}  // namespace lodpipe::binding
