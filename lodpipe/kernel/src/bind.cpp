// The only file that knows of Python: converts and nothing else.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/function.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/vector.h>

#include <memory>

#include "decimate.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

template <class T>
using Table = nb::ndarray<const T, nb::numpy, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
template <class T>
using Column = nb::ndarray<const T, nb::numpy, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

// A NumPy array that owns the vector's memory; `width` columns, or one-dimensional for 0.
template <class T>
nb::object give(std::vector<T>& values, size_t width) {
  auto* held = new std::vector<T>(std::move(values));
  nb::capsule owner(held, [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
  if (!width) return nb::cast(nb::ndarray<nb::numpy, T>(held->data(), {held->size()}, owner));
  return nb::cast(nb::ndarray<nb::numpy, T>(held->data(), {held->size() / width, width}, owner));
}

nb::dict level(lodpipe::Level& l, size_t columns) {
  nb::dict d;
  d["target"] = l.target;
  d["stop"] = static_cast<int>(l.stop);
  d["error"] = l.error;
  d["relaxed"] = l.relaxed;
  d["positions"] = give(l.positions, 3);
  d["vertex_source"] = give(l.vertex_source, 0);
  d["faces"] = give(l.faces, 3);
  d["wedges"] = give(l.wedges, 3);
  d["face_source"] = give(l.face_source, 0);
  if (columns) d["values"] = give(l.values, columns);
  d["wedge_source"] = give(l.wedge_source, 0);
  return d;
}

nb::dict record(lodpipe::Record& r, size_t columns) {
  nb::dict d;
  d["removed"] = give(r.removed, 0);
  d["kept"] = give(r.kept, 0);
  d["positions"] = give(r.positions, 3);
  d["triangles"] = give(r.triangles, 0);
  d["error"] = give(r.error, 0);
  d["wedge_event"] = give(r.wedge_event, 0);
  d["wedge_from"] = give(r.wedge_from, 0);
  d["wedge_to"] = give(r.wedge_to, 0);
  if (columns) d["wedge_values"] = give(r.wedge_values, columns);
  return d;
}

nb::dict decimate(Table<double> positions, Table<int32_t> faces, Table<int32_t> wedges, Table<float> values,
                  Column<float> column_weights, std::optional<Column<float>> importance,
                  std::optional<Column<uint8_t>> locked, std::vector<int64_t> targets,
                  std::function<bool(int64_t, int64_t)> progress, int placement, int weighting, float boundary_weight,
                  float seam_weight, float crease_weight, float crease_cos, double pair_distance, bool attribute_cost,
                  bool keep_topology, bool may_relax, float flip_cos, float round_share, double max_error, int threads,
                  bool want_record) {
  lodpipe::Input in{positions.data(),
                    static_cast<int>(positions.shape(0)),
                    faces.data(),
                    wedges.data(),
                    static_cast<int>(faces.shape(0)),
                    values.data(),
                    static_cast<int>(values.shape(0)),
                    static_cast<int>(values.shape(1)),
                    column_weights.data(),
                    importance ? importance->data() : nullptr,
                    locked ? locked->data() : nullptr,
                    std::move(targets)};
  lodpipe::Options o;
  o.placement = static_cast<lodpipe::Placement>(placement);
  o.weighting = static_cast<lodpipe::Weighting>(weighting);
  o.boundary_weight = boundary_weight, o.seam_weight = seam_weight, o.crease_weight = crease_weight;
  o.crease_cos = crease_cos;
  o.pair_distance = pair_distance;
  o.attribute_cost = attribute_cost, o.keep_topology = keep_topology, o.may_relax = may_relax;
  o.flip_cos = flip_cos, o.round_share = round_share, o.max_error = max_error;
  o.threads = threads, o.record = want_record;
  lodpipe::Result result;
  {
    nb::gil_scoped_release release;
    result = lodpipe::decimate(in, o, [&](int64_t done, int64_t total) {
      nb::gil_scoped_acquire acquire;
      return progress(done, total);
    });
  }
  const size_t columns = in.columns;
  nb::list levels;
  for (lodpipe::Level& l : result.levels) levels.append(level(l, columns));
  nb::dict out;
  out["levels"] = levels;
  if (want_record) out["record"] = record(result.record, columns);
  return out;
}

}  // namespace

NB_MODULE(_native, m) {
  m.def("decimate", &decimate, "positions"_a.noconvert(), "faces"_a.noconvert(), "wedges"_a.noconvert(),
        "values"_a.noconvert(), "column_weights"_a.noconvert(), "importance"_a.noconvert().none(),
        "locked"_a.noconvert().none(), "targets"_a, "progress"_a, nb::kw_only(), "placement"_a, "weighting"_a,
        "boundary_weight"_a, "seam_weight"_a, "crease_weight"_a, "crease_cos"_a, "pair_distance"_a, "attribute_cost"_a,
        "keep_topology"_a, "may_relax"_a, "flip_cos"_a, "round_share"_a, "max_error"_a, "threads"_a, "record"_a);
}
