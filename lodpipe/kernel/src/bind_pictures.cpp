// Bindings of what measuring and drawing pictures takes: converts and nothing else.
#include <nanobind/stl/optional.h>

#include <algorithm>

#include "bind.h"
#include "flip.h"
#include "pictures.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace lodpipe::binding {

namespace {

template <class T>
using Cube = nb::ndarray<const T, nb::numpy, nb::ndim<3>, nb::c_contig, nb::device::cpu>;

Ground ground(const Column<float>& colour, bool linear) {
  return {{colour.data()[0], colour.data()[1], colour.data()[2]}, linear};
}

// Of glTF's number; what is unknown repeats, as glTF's default.
Wrap wrap(int number) { return number == 33071 ? Wrap::clamp : number == 33648 ? Wrap::mirror : Wrap::repeat; }

nb::object srgb(Column<float> linear) {
  std::vector<float> out(linear.size());
  {
    nb::gil_scoped_release release;
    to_srgb(linear.data(), static_cast<int64_t>(linear.size()), out.data());
  }
  return give(out, 0);
}

nb::object finished(Table<float> rgba, Column<float> colour, bool linear) {
  std::vector<float> out(3 * rgba.shape(0));
  {
    nb::gil_scoped_release release;
    finish(rgba.data(), static_cast<int64_t>(rgba.shape(0)), ground(colour, linear), out.data());
  }
  return give(out, 3);
}

nb::object shrunk(Cube<float> rgba, int size) {
  std::vector<float> out(static_cast<size_t>(size) * size * 4);
  {
    nb::gil_scoped_release release;
    shrink(rgba.data(), static_cast<int>(rgba.shape(0)), size, out.data());
  }
  return give(out, 4);
}

nb::tuple ssim(Table<float> a, Table<float> b, Table<uint8_t> shown, Column<float> taps) {
  Similarity found;
  {
    nb::gil_scoped_release release;
    found = similarity(a.data(), b.data(), shown.data(), static_cast<int>(a.shape(0)), static_cast<int>(a.shape(1)),
                       taps.data(), static_cast<int>(taps.size()) - 1);
  }
  return nb::make_tuple(found.whole, found.structure);
}

nb::tuple seen_apart(Cube<float> a, Cube<float> b, int height, Column<float> colour, bool linear, float noticed) {
  Differing found;
  {
    nb::gil_scoped_release release;
    found = differing(a.data(), b.data(), static_cast<int>(a.shape(0)), height, ground(colour, linear), noticed);
  }
  return nb::make_tuple(found.shown, found.differ);
}

nb::object flip_errors(Cube<float> a, Cube<float> b, double density) {
  std::vector<float> out(a.shape(0) * a.shape(1));
  {
    nb::gil_scoped_release release;
    flip(a.data(), b.data(), static_cast<int>(a.shape(0)), static_cast<int>(a.shape(1)), density, out.data());
  }
  return give(out, a.shape(1));
}

nb::object blended(Table<float> values, std::optional<Table<int32_t>> corners, Column<int32_t> faces,
                   Table<float> weights) {
  const size_t columns = values.shape(1);
  std::vector<float> out(faces.size() * columns);
  bool inside;
  {
    nb::gil_scoped_release release;
    inside = blend(values.data(), static_cast<int64_t>(values.shape(0)), static_cast<int>(columns),
                   corners ? corners->data() : nullptr, faces.data(), weights.data(), static_cast<int64_t>(faces.size()),
                   out.data());
  }
  return inside ? give(out, columns) : nb::none();
}

nb::object sampled(Table<uint8_t> texels, Column<int64_t> start, Column<int32_t> width, Column<int32_t> height,
                   Column<float> meaning, Table<float> uv, std::optional<Column<float>> footprint, int wrap_u, int wrap_v,
                   bool nearest) {
  std::vector<float> out(4 * uv.shape(0));
  {
    nb::gil_scoped_release release;
    const MipTexels texture{texels.data(),  start.data(), width.data(), height.data(), static_cast<int>(start.size()),
                            meaning.data(), wrap(wrap_u), wrap(wrap_v), nearest};
    sample(texture, uv.data(), footprint ? footprint->data() : nullptr, static_cast<int64_t>(uv.shape(0)), out.data());
  }
  return give(out, 4);
}

}  // namespace

void bind_pictures(nb::module_& m) {
  m.def("srgb", &srgb, "linear"_a.noconvert());
  m.def("finished", &finished, "rgba"_a.noconvert(), "colour"_a.noconvert(), "linear"_a);
  m.def("shrunk", &shrunk, "rgba"_a.noconvert(), "size"_a);
  m.def("ssim", &ssim, "a"_a.noconvert(), "b"_a.noconvert(), "shown"_a.noconvert(), "taps"_a.noconvert());
  m.def("seen_apart", &seen_apart, "a"_a.noconvert(), "b"_a.noconvert(), "height"_a, "colour"_a.noconvert(), "linear"_a,
        "noticed"_a);
  m.def("flip", &flip_errors, "a"_a.noconvert(), "b"_a.noconvert(), "density"_a);
  m.def("blended", &blended, "values"_a.noconvert(), "corners"_a.noconvert().none(), "faces"_a.noconvert(),
        "weights"_a.noconvert());
  m.def("sampled", &sampled, "texels"_a.noconvert(), "start"_a.noconvert(), "width"_a.noconvert(),
        "height"_a.noconvert(), "meaning"_a.noconvert(), "uv"_a.noconvert(), "footprint"_a.noconvert().none(), "wrap_u"_a,
        "wrap_v"_a, "nearest"_a);
}

}  // namespace lodpipe::binding
