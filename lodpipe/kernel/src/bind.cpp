// What knows of Python: this and bind_pictures.cpp convert and do nothing else.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/function.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/vector.h>

#include <memory>

#include "bind.h"
#include "decimate.h"
#include "fit.h"
#include "normals.h"
#include "raster.h"
#include "silhouette.h"
#include "similarity/similarity.h"
#include "tables.h"
#include "triangle_tree.h"
#include "uv.h"
#include "visibility.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using lodpipe::binding::Column;
using lodpipe::binding::give;
using lodpipe::binding::Table;

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
  d["vertex_to"] = give(l.vertex_to, 0);
  d["wedge_to"] = give(l.wedge_to, 0);
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

lodpipe::Input input(const Table<double>& positions, const Table<int32_t>& faces, const Table<int32_t>& wedges,
                     const Table<float>& values, const Column<float>& column_weights,
                     const std::optional<Column<float>>& importance, const std::optional<Column<uint8_t>>& locked,
                     const std::optional<Table<float>>& seam_scale = std::nullopt) {
  return {positions.data(),
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
          seam_scale ? seam_scale->data() : nullptr,
          {}};
}

nb::dict decimate(Table<double> positions, Table<int32_t> faces, Table<int32_t> wedges, Table<float> values,
                  Column<float> column_weights, std::optional<Column<float>> importance,
                  std::optional<Column<uint8_t>> locked, std::optional<Table<float>> seam_scale,
                  std::vector<int64_t> targets,
                  std::function<bool(int64_t, int64_t)> progress, const lodpipe::Options& options) {
  lodpipe::Input in = input(positions, faces, wedges, values, column_weights, importance, locked, seam_scale);
  in.targets = std::move(targets);
  lodpipe::Result result;
  {
    nb::gil_scoped_release release;
    result = lodpipe::decimate(in, options, [&](int64_t done, int64_t total) {
      nb::gil_scoped_acquire acquire;
      return progress(done, total);
    });
  }
  const size_t columns = in.columns;
  nb::list levels;
  for (lodpipe::Level& l : result.levels) levels.append(level(l, columns));
  nb::dict out;
  out["levels"] = levels;
  if (options.record) out["record"] = record(result.record, columns);
  return out;
}

nb::dict edge_costs(Table<double> positions, Table<int32_t> faces, Table<int32_t> wedges, Table<float> values,
                    Column<float> column_weights, std::optional<Column<float>> importance,
                    std::optional<Column<uint8_t>> locked, std::optional<Table<float>> seam_scale,
                    const lodpipe::Options& options) {
  const lodpipe::Input in = input(positions, faces, wedges, values, column_weights, importance, locked, seam_scale);
  lodpipe::EdgeCosts costs = lodpipe::edge_costs(in, options);
  nb::dict out;
  out["edges"] = give(costs.edges, 2);
  out["cost"] = give(costs.cost, 0);
  out["positions"] = give(costs.positions, 3);
  return out;
}

lodpipe::UvFaces uv_faces(const Table<double>& uv, const Column<int32_t>& chart, const Column<int32_t>& group) {
  return {uv.data(), chart.data(), group.data(), static_cast<int>(uv.shape(0))};
}

nb::object chart_labels(Table<int32_t> faces) {
  std::vector<int32_t> labels;
  {
    nb::gil_scoped_release release;
    labels = lodpipe::chart_labels(faces.data(), static_cast<int>(faces.shape(0)));
  }
  return give(labels, 0);
}

nb::object join_pairs(Table<int32_t> pairs, int nodes) {
  std::vector<int32_t> labels;
  {
    nb::gil_scoped_release release;
    labels = lodpipe::join_pairs(pairs.data(), static_cast<int>(pairs.shape(0)), nodes);
  }
  return give(labels, 0);
}

nb::dict uv_overlaps(Table<double> uv, Column<int32_t> chart, Column<int32_t> group, double slack, int64_t limit) {
  lodpipe::UvOverlaps found;
  {
    nb::gil_scoped_release release;
    found = lodpipe::uv_overlaps(uv_faces(uv, chart, group), slack, limit);
  }
  nb::dict out;
  out["charts"] = give(found.charts, 2);
  out["area"] = give(found.area, 2);
  out["faces"] = give(found.faces, 0);
  out["complete"] = found.complete;
  return out;
}

nb::object uv_coverage(Table<double> uv, Column<int32_t> group, int groups, int lines) {
  std::vector<double> areas;
  {
    nb::gil_scoped_release release;
    areas = lodpipe::uv_coverage(uv_faces(uv, group, group), groups, lines);
  }
  return give(areas, 2);
}

nb::object uv_gaps(Table<double> segments, Column<int32_t> chart, Column<int32_t> group, int groups, double reach) {
  std::vector<double> gaps;
  {
    nb::gil_scoped_release release;
    gaps = lodpipe::uv_gaps(segments.data(), chart.data(), group.data(), static_cast<int>(segments.shape(0)), groups,
                            reach);
  }
  return give(gaps, 0);
}

nb::dict uv_raster(Table<double> uv, Table<int32_t> edges, int left, int top, int width, int height, double reach,
                   int threads) {
  lodpipe::UvRaster found;
  {
    nb::gil_scoped_release release;
    found = lodpipe::uv_raster(uv.data(), static_cast<int>(uv.shape(0)), edges.data(),
                               static_cast<int>(edges.shape(0)), left, top, width, height, reach, threads);
  }
  nb::dict out;
  out["faces"] = give(found.faces, width);
  out["weights"] = give(found.weights, 3);
  out["inside"] = give(found.inside, width);
  return out;
}

lodpipe::FitMesh fit_mesh(const Table<double>& positions, const Table<int32_t>& faces, const Table<int32_t>& wedges,
                          const Table<float>& values) {
  return {positions.data(), static_cast<int>(positions.shape(0)), faces.data(), wedges.data(),
          static_cast<int>(faces.shape(0)), values.data(), static_cast<int>(values.shape(0))};
}

nb::dict fit(Table<double> positions, Table<int32_t> faces, Table<int32_t> wedges, Table<float> values,
             Table<double> level_positions, Table<int32_t> level_faces, Table<int32_t> level_wedges,
             Table<float> level_values, std::optional<Column<float>> importance,
             std::optional<Column<float>> held, Column<int32_t> wedge_to, std::function<bool()> go_on, const lodpipe::FitOptions& options) {
  const lodpipe::FitInput in{fit_mesh(positions, faces, wedges, values),
                             fit_mesh(level_positions, level_faces, level_wedges, level_values),
                             static_cast<int>(values.shape(1)),
                             importance ? importance->data() : nullptr,
                             held ? held->data() : nullptr,
                             wedge_to.data()};
  lodpipe::FitResult result;
  {
    nb::gil_scoped_release release;
    result = lodpipe::fit(in, options, [&] {
      nb::gil_scoped_acquire acquire;
      return go_on();
    });
  }
  nb::dict out;
  out["positions"] = give(result.positions, 3);
  if (in.columns) out["values"] = give(result.values, in.columns);
  out["moved"] = give(result.moved, 0);
  return out;
}

nb::object vertex_visibility(Table<float> positions, Table<int32_t> faces, Column<uint8_t> hides, Table<double> views,
                             int side, int threads) {
  std::vector<float> seen;
  {
    nb::gil_scoped_release release;
    seen = lodpipe::vertex_visibility({positions.data(), static_cast<int>(positions.shape(0)), faces.data(),
                                       static_cast<int>(faces.shape(0)), hides.data(), views.data(),
                                       static_cast<int>(views.shape(0)), side, threads});
  }
  return give(seen, 0);
}

nb::dict uv_pack(Table<double> uv, Column<int32_t> chart, int charts, int width, int height, double padding, int cells,
                 double largest) {
  lodpipe::UvPacking found;
  {
    nb::gil_scoped_release release;
    found = lodpipe::uv_pack(uv_faces(uv, chart, chart), charts, width, height, padding, cells, largest);
  }
  nb::dict out;
  out["scale"] = found.scale;
  out["corner"] = give(found.corner, 2);
  out["turn"] = give(found.turn, 0);
  return out;
}

nb::tuple closest(const lodpipe::TriangleTree& tree, Table<float> points, int threads) {
  const size_t count = points.shape(0);
  std::vector<double> distance(count), found(3 * count);
  std::vector<int32_t> face(count);
  {
    nb::gil_scoped_release release;
    tree.closest(points.data(), static_cast<int>(count), threads, distance.data(), found.data(), face.data());
  }
  return nb::make_tuple(give(distance, 0), give(found, 3), give(face, 0));
}

nb::object facing(const lodpipe::TriangleTree& tree, Table<float> points, Table<double> normals, Column<double> reach,
                  int threads) {
  std::vector<int32_t> face(points.shape(0));
  {
    nb::gil_scoped_release release;
    tree.facing(points.data(), normals.data(), reach.data(), static_cast<int>(face.size()), threads, face.data());
  }
  return give(face, 0);
}

nb::object crease_normals(Table<double> positions, Table<int32_t> faces, double least, int threads) {
  std::vector<float> normals(9 * faces.shape(0));
  {
    nb::gil_scoped_release release;
    lodpipe::crease_normals(positions.data(), static_cast<int>(positions.shape(0)), faces.data(),
                            static_cast<int>(faces.shape(0)), least, threads, normals.data());
  }
  return give(normals, 9);
}

nb::object face_normals(Table<float> positions, Table<int32_t> faces) {
  std::vector<float> normals(3 * faces.shape(0));
  {
    nb::gil_scoped_release release;
    lodpipe::face_normals(positions.data(), faces.data(), static_cast<int>(faces.shape(0)), normals.data());
  }
  return give(normals, 3);
}

// view: eye, right, up and ahead in rows of three, then size.
nb::object raster(Table<float> positions, Table<int32_t> faces, Column<double> view, bool perspective, int width,
                  int height, int top, int bottom, std::optional<Column<float>> behind) {
  lodpipe::RasterView as{{}, {}, {}, {}, view.data()[12], perspective, width, height, top, bottom};
  double* const parts[4] = {as.eye, as.right, as.up, as.ahead};
  for (int i = 0; i < 4; ++i) std::copy_n(view.data() + 3 * i, 3, parts[i]);
  lodpipe::Raster found;
  {
    nb::gil_scoped_release release;
    found = lodpipe::raster(positions.data(), static_cast<int>(positions.shape(0)), faces.data(),
                            static_cast<int>(faces.shape(0)), as, behind ? behind->data() : nullptr);
  }
  if (!found.complete) return nb::none();
  return nb::make_tuple(give(found.distance, 0), give(found.face, 0), give(found.uv, 2));
}

nb::tuple text_lines(nb::bytes text) {
  lodpipe::TextLines found;
  {
    nb::gil_scoped_release release;
    found = lodpipe::text_lines(text.c_str(), static_cast<int64_t>(text.size()));
  }
  return nb::make_tuple(give(found.start, 0), give(found.end, 0), give(found.first, 0), give(found.words, 0),
                        give(found.head, 0));
}

nb::object text_numbers(nb::bytes text, Column<int64_t> at, Column<int64_t> end, int columns, int threads) {
  std::vector<double> values(at.size() * columns);
  bool good;
  {
    nb::gil_scoped_release release;
    good = lodpipe::text_numbers(text.c_str(), at.data(), end.data(), static_cast<int64_t>(at.size()), columns, threads,
                                 values.data());
  }
  return good ? give(values, columns) : nb::none();
}

nb::object text_corners(nb::bytes text, Column<int64_t> at, Column<int64_t> end, Column<int64_t> begin, int64_t corners,
                        int threads) {
  std::vector<int32_t> parts[3];
  for (auto& part : parts) part.resize(corners);
  bool good;
  {
    nb::gil_scoped_release release;
    good = lodpipe::text_corners(text.c_str(), at.data(), end.data(), begin.data(), static_cast<int64_t>(at.size()),
                                 threads, parts[0].data(), parts[1].data(), parts[2].data());
  }
  if (!good) return nb::none();
  return nb::make_tuple(give(parts[0], 0), give(parts[1], 0), give(parts[2], 0));
}

nb::tuple unique_rows(Table<uint32_t> rows) {
  lodpipe::UniqueRows found;
  {
    nb::gil_scoped_release release;
    found = lodpipe::unique_rows(rows.data(), static_cast<int>(rows.shape(0)), static_cast<int>(rows.shape(1)));
  }
  return nb::make_tuple(give(found.first, 0), give(found.inverse, 0));
}

namespace similar = lodpipe::similarity;
using Texels = nb::ndarray<const uint8_t, nb::numpy, nb::ndim<3>, nb::c_contig, nb::device::cpu>;

// What a similarity run reads: the mesh, and what it looks like.
struct SimilarityInput {
  lodpipe::Input input;
  similar::Scene scene;
};

// looks: of each row, image, luminance, alpha, first UV column, 6 of the matrix, cutoff. wraps: of each image, along u,
// along v, nearest.
SimilarityInput similarity_input(const Table<double>& positions, const Table<int32_t>& faces,
                                 const Table<int32_t>& wedges, const Table<float>& values,
                                 const Column<float>& column_weights, const std::optional<Column<float>>& importance,
                                 const std::optional<Column<uint8_t>>& locked, const Column<int32_t>& face_look,
                                 const Table<float>& looks, const std::vector<Texels>& images,
                                 const Table<int32_t>& wraps, int shade_column, int uv_column) {
  SimilarityInput out{input(positions, faces, wedges, values, column_weights, importance, locked), {}};
  out.scene.face_look = face_look.data();
  out.scene.shade_column = shade_column;
  out.scene.uv_column = uv_column;
  for (size_t i = 0; i < looks.shape(0); ++i) {
    const float* row = looks.data() + i * looks.shape(1);
    similar::Look look;
    look.image = static_cast<int>(row[0]), look.luminance = row[1], look.alpha = row[2];
    look.uv_column = static_cast<int>(row[3]);
    std::copy_n(row + 4, 6, look.matrix);
    look.cutoff = row[10];
    out.scene.looks.push_back(look);
  }
  for (size_t i = 0; i < images.size(); ++i) {
    const int32_t* wrap = wraps.data() + 3 * i;
    out.scene.images.push_back({static_cast<int>(images[i].shape(1)), static_cast<int>(images[i].shape(0)),
                                images[i].data(), static_cast<lodpipe::Wrap>(wrap[0]), static_cast<lodpipe::Wrap>(wrap[1]), wrap[2] != 0});
  }
  return out;
}

nb::dict similarity_decimate(Table<double> positions, Table<int32_t> faces, Table<int32_t> wedges, Table<float> values,
                             Column<float> column_weights, std::optional<Column<float>> importance,
                             std::optional<Column<uint8_t>> locked, Column<int32_t> face_look, Table<float> looks,
                             std::vector<Texels> images, Table<int32_t> wraps, int shade_column, int uv_column,
                             std::vector<int64_t> targets, std::function<bool(int64_t, int64_t)> progress,
                             const similar::Options& options) {
  SimilarityInput in = similarity_input(positions, faces, wedges, values, column_weights, importance, locked, face_look,
                                        looks, images, wraps, shade_column, uv_column);
  in.input.targets = std::move(targets);
  similar::Outcome made;
  {
    nb::gil_scoped_release release;
    made = similar::simplify(in.input, in.scene, options, [&](int64_t done, int64_t total) {
      nb::gil_scoped_acquire acquire;
      return progress(done, total);
    });
  }
  const size_t columns = in.input.columns;
  nb::list levels;
  for (lodpipe::Level& l : made.result.levels) levels.append(level(l, columns));
  nb::dict out;
  out["levels"] = levels;
  if (options.record) out["record"] = record(made.result.record, columns);
  out["costs"] = give(made.costs, 0);
  out["evaluations"] = made.evaluations;
  return out;
}

nb::dict similarity_costs(Table<double> positions, Table<int32_t> faces, Table<int32_t> wedges, Table<float> values,
                          Column<float> column_weights, std::optional<Column<float>> importance,
                          std::optional<Column<uint8_t>> locked, Column<int32_t> face_look, Table<float> looks,
                          std::vector<Texels> images, Table<int32_t> wraps, int shade_column, int uv_column,
                          const similar::Options& options) {
  const SimilarityInput in = similarity_input(positions, faces, wedges, values, column_weights, importance, locked,
                                              face_look, looks, images, wraps, shade_column, uv_column);
  similar::Costs made = similar::costs(in.input, in.scene, options);
  nb::dict out;
  out["pairs"] = give(made.pairs, 2);
  out["cost"] = give(made.cost, 0);
  out["places"] = give(made.places, 3);
  return out;
}

template <class Options, class Enum>
auto as_int(Enum Options::*field) {
  return std::pair([field](const Options& o) { return static_cast<int>(o.*field); },
                   [field](Options& o, int value) { o.*field = static_cast<Enum>(value); });
}

lodpipe::SilhouetteViews silhouette_views(const Table<double>& axes, int size) {
  return {axes.data(), static_cast<int>(axes.shape(0)), size};
}

nb::object silhouettes(Table<double> points, Table<int32_t> faces, Table<double> axes, int size) {
  std::vector<uint64_t> bits;
  {
    nb::gil_scoped_release release;
    bits = lodpipe::silhouettes(points.data(), faces.data(), static_cast<int>(faces.shape(0)), silhouette_views(axes, size));
  }
  return give(bits, 0);
}

double silhouette_overlap(Table<double> points, Table<int32_t> faces, Table<double> axes, int size,
                          Column<uint64_t> wanted) {
  nb::gil_scoped_release release;
  return lodpipe::silhouette_overlap(points.data(), faces.data(), static_cast<int>(faces.shape(0)),
                                     silhouette_views(axes, size), wanted.data());
}

nb::object silhouette_moves(Table<double> points, Table<int32_t> faces, Column<int32_t> vertex, Table<double> places,
                            Table<double> axes, int size, Column<uint64_t> wanted, int threads) {
  std::vector<double> overlaps;
  {
    nb::gil_scoped_release release;
    overlaps = lodpipe::silhouette_moves(points.data(), static_cast<int>(points.shape(0)), faces.data(),
                                         static_cast<int>(faces.shape(0)), vertex.data(), places.data(),
                                         static_cast<int>(vertex.shape(0)), silhouette_views(axes, size),
                                         wanted.data(), threads);
  }
  return give(overlaps, 0);
}

}  // namespace

NB_MODULE(_native, m) {
  using lodpipe::Options;
  const auto [get_placement, set_placement] = as_int(&Options::placement);
  const auto [get_weighting, set_weighting] = as_int(&Options::weighting);
  nb::class_<Options>(m, "Options")
      .def(nb::init<>())
      .def_prop_rw("placement", get_placement, set_placement)
      .def_prop_rw("weighting", get_weighting, set_weighting)
      .def_rw("boundary_weight", &Options::boundary_weight)
      .def_rw("seam_weight", &Options::seam_weight)
      .def_rw("crease_weight", &Options::crease_weight)
      .def_rw("crease_cos", &Options::crease_cos)
      .def_rw("pair_distance", &Options::pair_distance)
      .def_rw("attribute_cost", &Options::attribute_cost)
      .def_rw("keep_topology", &Options::keep_topology)
      .def_rw("may_relax", &Options::may_relax)
      .def_rw("flip_cos", &Options::flip_cos)
      .def_rw("round_share", &Options::round_share)
      .def_rw("max_error", &Options::max_error)
      .def_rw("keep_last", &Options::keep_last)
      .def_rw("chart_column", &Options::chart_column)
      .def_rw("threads", &Options::threads)
      .def_rw("record", &Options::record)
      .def_rw("follow", &Options::follow);
  m.def("crease_normals", &crease_normals, "positions"_a.noconvert(), "faces"_a.noconvert(), "least"_a, "threads"_a);
  m.def("face_normals", &face_normals, "positions"_a.noconvert(), "faces"_a.noconvert());
  m.def("raster", &raster, "positions"_a.noconvert(), "faces"_a.noconvert(), "view"_a.noconvert(), "perspective"_a,
        "width"_a, "height"_a, "top"_a, "bottom"_a, "behind"_a.noconvert().none());
  m.def("text_lines", &text_lines, "text"_a);
  m.def("text_numbers", &text_numbers, "text"_a, "at"_a.noconvert(), "end"_a.noconvert(), "columns"_a, "threads"_a);
  m.def("text_corners", &text_corners, "text"_a, "at"_a.noconvert(), "end"_a.noconvert(), "begin"_a.noconvert(),
        "corners"_a, "threads"_a);
  m.def("unique_rows", &unique_rows, "rows"_a.noconvert());
  m.def("silhouettes", &silhouettes, "points"_a.noconvert(), "faces"_a.noconvert(), "axes"_a.noconvert(), "size"_a);
  m.def("silhouette_overlap", &silhouette_overlap, "points"_a.noconvert(), "faces"_a.noconvert(),
        "axes"_a.noconvert(), "size"_a, "wanted"_a.noconvert());
  m.def("silhouette_moves", &silhouette_moves, "points"_a.noconvert(), "faces"_a.noconvert(), "vertex"_a.noconvert(),
        "places"_a.noconvert(), "axes"_a.noconvert(), "size"_a, "wanted"_a.noconvert(), "threads"_a);
  using lodpipe::TriangleTree;
  nb::class_<TriangleTree>(m, "TriangleTree")
      .def("__init__",
           [](TriangleTree* tree, Table<float> positions, Table<int32_t> faces) {
             nb::gil_scoped_release release;
             new (tree) TriangleTree(positions.data(), faces.data(), static_cast<int>(faces.shape(0)));
           },
           "positions"_a.noconvert(), "faces"_a.noconvert())
      .def("closest", &closest, "points"_a.noconvert(), "threads"_a)
      .def("facing", &facing, "points"_a.noconvert(), "normals"_a.noconvert(), "reach"_a.noconvert(), "threads"_a);
  using lodpipe::FitOptions;
  nb::class_<FitOptions>(m, "FitOptions")
      .def(nb::init<>())
      .def_rw("samples", &FitOptions::samples)
      .def_rw("moves", &FitOptions::moves)
      .def_rw("fit_values", &FitOptions::fit_values)
      .def_rw("chart_column", &FitOptions::chart_column)
      .def_rw("flip_cos", &FitOptions::flip_cos)
      .def_rw("threads", &FitOptions::threads);
  m.def("decimate", &decimate, "positions"_a.noconvert(), "faces"_a.noconvert(), "wedges"_a.noconvert(),
        "values"_a.noconvert(), "column_weights"_a.noconvert(), "importance"_a.noconvert().none(),
        "locked"_a.noconvert().none(), "seam_scale"_a.noconvert().none(), "targets"_a, "progress"_a, "options"_a);
  m.def("edge_costs", &edge_costs, "positions"_a.noconvert(), "faces"_a.noconvert(), "wedges"_a.noconvert(),
        "values"_a.noconvert(), "column_weights"_a.noconvert(), "importance"_a.noconvert().none(),
        "locked"_a.noconvert().none(), "seam_scale"_a.noconvert().none(), "options"_a);
  m.def("chart_labels", &chart_labels, "faces"_a.noconvert());
  m.def("join_pairs", &join_pairs, "pairs"_a.noconvert(), "nodes"_a);
  m.def("uv_overlaps", &uv_overlaps, "uv"_a.noconvert(), "chart"_a.noconvert(), "group"_a.noconvert(), "slack"_a,
        "limit"_a);
  m.def("uv_coverage", &uv_coverage, "uv"_a.noconvert(), "group"_a.noconvert(), "groups"_a, "lines"_a);
  m.def("uv_gaps", &uv_gaps, "segments"_a.noconvert(), "chart"_a.noconvert(), "group"_a.noconvert(), "groups"_a,
        "reach"_a);
  m.def("uv_pack", &uv_pack, "uv"_a.noconvert(), "chart"_a.noconvert(), "charts"_a, "width"_a, "height"_a, "padding"_a,
        "cells"_a, "largest"_a);
  m.def("uv_raster", &uv_raster, "uv"_a.noconvert(), "edges"_a.noconvert(), "left"_a, "top"_a, "width"_a, "height"_a,
        "reach"_a, "threads"_a);
  m.def("fit", &fit, "positions"_a.noconvert(), "faces"_a.noconvert(), "wedges"_a.noconvert(), "values"_a.noconvert(),
        "level_positions"_a.noconvert(), "level_faces"_a.noconvert(), "level_wedges"_a.noconvert(),
        "level_values"_a.noconvert(), "importance"_a.noconvert().none(), "held"_a.noconvert().none(),
        "wedge_to"_a.noconvert(), "go_on"_a, "options"_a);
  m.def("vertex_visibility", &vertex_visibility, "positions"_a.noconvert(), "faces"_a.noconvert(), "hides"_a.noconvert(),
        "views"_a.noconvert(), "side"_a, "threads"_a);

  const auto [get_metric, set_metric] = as_int(&similar::Options::metric);
  const auto [get_reference, set_reference] = as_int(&similar::Options::reference);
  const auto [get_correspondence, set_correspondence] = as_int(&similar::Options::correspondence);
  const auto [get_penalty, set_penalty] = as_int(&similar::Options::penalty);
  nb::class_<similar::Options>(m, "SimilarityOptions")
      .def(nb::init<>())
      .def_prop_rw("metric", get_metric, set_metric)
      .def_rw("full", &similar::Options::full)
      .def_prop_rw("reference", get_reference, set_reference)
      .def_prop_rw("correspondence", get_correspondence, set_correspondence)
      .def_rw("views", &similar::Options::views)
      .def_rw("spacing", &similar::Options::spacing)
      .def_prop_rw("penalty", get_penalty, set_penalty)
      .def_rw("image_size", &similar::Options::image_size)
      .def_rw("flip_cos", &similar::Options::flip_cos)
      .def_rw("keep_topology", &similar::Options::keep_topology)
      .def_rw("may_relax", &similar::Options::may_relax)
      .def_rw("cross_seams", &similar::Options::cross_seams)
      .def_rw("keep_last", &similar::Options::keep_last)
      .def_rw("threads", &similar::Options::threads)
      .def_rw("record", &similar::Options::record);
  m.def("similarity_decimate", &similarity_decimate, "positions"_a.noconvert(), "faces"_a.noconvert(),
        "wedges"_a.noconvert(), "values"_a.noconvert(), "column_weights"_a.noconvert(), "importance"_a.noconvert().none(),
        "locked"_a.noconvert().none(), "face_look"_a.noconvert(), "looks"_a.noconvert(), "images"_a, "wraps"_a.noconvert(),
        "shade_column"_a, "uv_column"_a, "targets"_a, "progress"_a, "options"_a);
  m.def("similarity_costs", &similarity_costs, "positions"_a.noconvert(), "faces"_a.noconvert(), "wedges"_a.noconvert(),
        "values"_a.noconvert(), "column_weights"_a.noconvert(), "importance"_a.noconvert().none(),
        "locked"_a.noconvert().none(), "face_look"_a.noconvert(), "looks"_a.noconvert(), "images"_a, "wraps"_a.noconvert(),
        "shade_column"_a, "uv_column"_a, "options"_a);
  lodpipe::binding::bind_pictures(m);
}
