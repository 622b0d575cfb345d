// Image-driven (Lindstrom & Turk 2000): pictures from 20 viewpoints round the model, at twice the radius of its bounding
// sphere. The cost of a collapse is by how much the sum of squared luminance differences to the original's pictures would
// grow, which orders collapses as the root mean square does. Only pixels that the region covers are drawn anew.
#include <algorithm>

#include "cost.h"

namespace lodpipe::similarity {
namespace {

constexpr float kBackground = 0.5f;
constexpr float kTangent = 0.57735027f;  // of half the angle of view: the bounding sphere fills the picture
constexpr int kTile = 16;                // pixels

class ImageCost final : public Cost {
 public:
  ImageCost(const Mesh& mesh, const Scene& scene, const Options& options)
      : mesh_(mesh), scene_(scene), shading_(scene), size_(options.image_size),
        tiles_((options.image_size + kTile - 1) / kTile) {
    double radius = 0;
    for (const Face& f : mesh.faces)
      for (const int32_t v : f.v) radius = std::max(radius, length(mesh.p[v]));
    scale_ = radius > 0 ? 1 / radius : 1;
    const double a = (1 + std::sqrt(5.0)) / 2, b = 1 / a;
    const auto add = [&](Point p) { views_.emplace_back(p * (2 / length(p)), size_, tiles_); };
    for (const double i : {-1.0, 1.0})  // the corners of a dodecahedron
      for (const double j : {-1.0, 1.0}) {
        add({i, j, 1}), add({i, j, -1});
        add({0, i * b, j * a}), add({i * b, j * a, 0}), add({i * a, 0, j * b});
      }
    CostScratch scratch;
    for (View& view : views_) draw(view, scratch);
  }

  bool lasts() const override { return false; }  // another region may lie in front of the same pixels

  double evaluate(const Collapse& c, CostScratch& s) const override {
    double sum = 0;
    for (const View& view : views_)
      redraw(view, c, s, [&](size_t pixel, int32_t, float, float luminance) {
        const double now = luminance - view.original[pixel], was = view.luminance[pixel] - view.original[pixel];
        sum += now * now - was * was;
      });
    return sum;
  }

  void commit(const Collapse& c, CostScratch& s) override {
    for (View& view : views_) {
      changes_.clear();
      redraw(view, c, s, [&](size_t pixel, int32_t face, float inverse, float luminance) {
        changes_.push_back({pixel, face, inverse, luminance});
      });
      for (const Change& x : changes_)
        view.face[x.pixel] = x.face, view.inverse[x.pixel] = x.inverse, view.luminance[x.pixel] = x.luminance;
      for (const int32_t f : c.after) {
        Rect rect;
        for (int k = 0; k < 3; ++k) cover(view, corner_of(mesh_, c, mesh_.faces[f], k, true).x, rect);
        enlist(view, f, rect);
      }
    }
  }

 private:
  struct View {
    View(Point p, int size, int tiles)
        : from{static_cast<float>(p.x), static_cast<float>(p.y), static_cast<float>(p.z)},
          face(static_cast<size_t>(size) * size, kNone), inverse(face.size(), 0), luminance(face.size(), kBackground),
          list(static_cast<size_t>(tiles) * tiles) {
      rays.aim(from, {});
    }
    Vec3 from;
    Rays rays;  // for its frame alone
    std::vector<int32_t> face;  // what each pixel shows
    std::vector<float> inverse, luminance, original;
    std::vector<std::vector<int32_t>> list;  // of each tile: faces that may cover a part of it
  };
  struct Rect {
    int left = 1 << 20, right = -1, top = 1 << 20, bottom = -1;  // pixels, the last ones included
    bool empty() const { return right < left || bottom < top; }
  };
  struct Change {
    size_t pixel;
    int32_t face;
    float inverse, luminance;
  };

  Vec3 local(Point p) const {
    const Point x = p * scale_;
    return {static_cast<float>(x.x), static_cast<float>(x.y), static_cast<float>(x.z)};
  }

  void cover(const View& view, Point p, Rect& rect) const {
    const Vec3 d = local(p) - view.from;
    const float depth = std::max(-dot(d, view.rays.back), 1e-3f);
    const auto pixel = [&](float x) {
      const float at = (x / depth / kTangent * 0.5f + 0.5f) * static_cast<float>(size_);
      return static_cast<int>(std::clamp(at, -1.0f, static_cast<float>(size_)));
    };
    const int x = pixel(dot(d, view.rays.right)), y = pixel(dot(d, view.rays.up));
    rect.left = std::min(rect.left, std::max(x - 1, 0)), rect.right = std::max(rect.right, std::min(x + 1, size_ - 1));
    rect.top = std::min(rect.top, std::max(y - 1, 0)), rect.bottom = std::max(rect.bottom, std::min(y + 1, size_ - 1));
  }

  void enlist(View& view, int32_t face, const Rect& rect) const {
    if (rect.empty()) return;
    for (int y = rect.top / kTile; y <= rect.bottom / kTile; ++y)
      for (int x = rect.left / kTile; x <= rect.right / kTile; ++x) {
        auto& list = view.list[static_cast<size_t>(y) * tiles_ + x];
        if (std::find(list.begin(), list.end(), face) == list.end()) list.push_back(face);
      }
  }

  void aim(const View& view, const Rect& rect, CostScratch& s) const {
    s.samples.clear();
    const auto across = [&](int pixel) {
      return ((static_cast<float>(pixel) + 0.5f) / static_cast<float>(size_) * 2 - 1) * kTangent;
    };
    for (int y = rect.top; y <= rect.bottom; ++y)
      for (int x = rect.left; x <= rect.right; ++x)
        s.samples.push_back(view.from + view.rays.right * across(x) + view.rays.up * across(y) - view.rays.back);
    s.rays.aim(view.from, s.samples);
  }

  void draw(View& view, CostScratch& s) {
    for (size_t f = 0; f < mesh_.faces.size(); ++f) {
      Rect rect;
      for (const int32_t v : mesh_.faces[f].v) cover(view, mesh_.p[v], rect);
      if (rect.empty()) continue;
      for (int y = rect.top / kTile; y <= rect.bottom / kTile; ++y)
        for (int x = rect.left / kTile; x <= rect.right / kTile; ++x)
          view.list[static_cast<size_t>(y) * tiles_ + x].push_back(static_cast<int32_t>(f));
    }
    const Collapse none;
    for (int row = 0; row < tiles_; ++row)
      for (int column = 0; column < tiles_; ++column) {
        const Rect rect{column * kTile, std::min((column + 1) * kTile, size_) - 1, row * kTile,
                        std::min((row + 1) * kTile, size_) - 1};
        const auto& list = view.list[static_cast<size_t>(row) * tiles_ + column];
        s.original.clear();
        for (const int32_t f : list) add(none, f, false, s.original);
        aim(view, rect, s);
        s.first.cast(s.rays, s.original);
        int ray = 0;
        for (int y = rect.top; y <= rect.bottom; ++y)
          for (int x = rect.left; x <= rect.right; ++x, ++ray) {
            const Hit hit = s.first.hit(s.rays, s.original, ray);
            if (hit.triangle < 0) continue;
            const size_t pixel = static_cast<size_t>(y) * size_ + x;
            view.face[pixel] = list[hit.triangle];
            view.inverse[pixel] = hit.inverse;
            view.luminance[pixel] = seen(s, s.original, hit, ray);
          }
      }
    view.original = view.luminance;
  }

  void add(const Collapse& c, int32_t face, bool after, Patch& out) const {
    add_face(mesh_, shading_, c, face, scene_.face_look[mesh_.faces[face].source], after, {}, scale_, out);
  }

  float seen(const CostScratch& s, const Patch& patch, const Hit& hit, int ray) const {
    return colour(shading_, patch, hit, {s.rays.x[ray], s.rays.y[ray], s.rays.z[ray]}, kBackground);
  }

  // Calls change(pixel, face, 1 / distance, luminance) for the pixels of the view that would show something else.
  template <class Visitor>
  void redraw(const View& view, const Collapse& c, CostScratch& s, const Visitor& change) const {
    Rect rect;
    for (const int32_t f : c.before)
      for (int k = 0; k < 3; ++k) {
        cover(view, mesh_.p[mesh_.faces[f].v[k]], rect);
      }
    if (c.moves) cover(view, c.place, rect);
    if (rect.empty()) return;
    bool shown = false;
    float farthest = 1e30f;  // least 1 / depth of what the rectangle shows
    for (int y = rect.top; y <= rect.bottom; ++y)
      for (int x = rect.left; x <= rect.right; ++x) {
        const size_t pixel = static_cast<size_t>(y) * size_ + x;
        shown |= in_region(view, c, pixel);
        farthest = std::min(farthest, view.inverse[pixel]);
      }
    if (!shown && nearest(view, c) < farthest) return;  // hidden before and after
    aim(view, rect, s);
    s.after.clear();
    for (const int32_t f : c.after) add(c, f, true, s.after);
    s.second.cast(s.rays, s.after);
    s.unmark(mesh_.faces.size());
    for (const int32_t f : c.before) s.take(f);
    // what would be uncovered: only where the region was shown, and what replaces it is not nearer
    s.faces.clear();
    int ray = 0;
    for (int y = rect.top; y <= rect.bottom; ++y)
      for (int x = rect.left; x <= rect.right; ++x, ++ray) {
        const size_t pixel = static_cast<size_t>(y) * size_ + x;
        if (!in_region(view, c, pixel) || s.second.nearer(ray, view.inverse[pixel])) continue;
        for (const int32_t f : view.list[static_cast<size_t>(y / kTile) * tiles_ + x / kTile])
          if (!mesh_.faces[f].dead && s.take(f)) s.faces.push_back(f);
        x |= kTile - 1;  // the tile's other pixels of this row have the same list
        ray += std::min(x, rect.right) - static_cast<int>(pixel % static_cast<size_t>(size_));
      }
    s.original.clear();
    for (const int32_t f : s.faces) add(c, f, false, s.original);
    s.first.cast(s.rays, s.original);
    ray = 0;
    for (int y = rect.top; y <= rect.bottom; ++y)
      for (int x = rect.left; x <= rect.right; ++x, ++ray) {
        const size_t pixel = static_cast<size_t>(y) * size_ + x;
        const Hit after = s.second.hit(s.rays, s.after, ray);
        if (!in_region(view, c, pixel)) {
          if (after.triangle >= 0 && after.inverse > view.inverse[pixel])
            change(pixel, c.after[after.triangle], after.inverse, seen(s, s.after, after, ray));
          continue;
        }
        const Hit other = s.first.hit(s.rays, s.original, ray);
        if (after.triangle >= 0 && (other.triangle < 0 || after.inverse >= other.inverse))
          change(pixel, c.after[after.triangle], after.inverse, seen(s, s.after, after, ray));
        else if (other.triangle >= 0)
          change(pixel, s.faces[other.triangle], other.inverse, seen(s, s.original, other, ray));
        else change(pixel, kNone, 0, kBackground);
      }
  }

  // Greatest 1 / depth of the corners that the new faces have.
  float nearest(const View& view, const Collapse& c) const {
    float most = 0;
    for (const int32_t f : c.after)
      for (int k = 0; k < 3; ++k) {
        const Vec3 d = local(corner_of(mesh_, c, mesh_.faces[f], k, true).x) - view.from;
        most = std::max(most, 1 / std::max(-dot(d, view.rays.back), 1e-3f));
      }
    return most * (1 + 1e-5f);
  }

  bool in_region(const View& view, const Collapse& c, size_t pixel) const {
    const int32_t face = view.face[pixel];
    return face != kNone && std::find(c.before.begin(), c.before.end(), face) != c.before.end();
  }

  const Mesh& mesh_;
  const Scene& scene_;
  Shading shading_;
  int size_, tiles_;
  double scale_ = 1;
  std::vector<View> views_;
  std::vector<Change> changes_;
};

}  // namespace

std::unique_ptr<Cost> make_image_cost(const Mesh& mesh, const Scene& scene, const Options& options) {
  return std::make_unique<ImageCost>(mesh, scene, options);
}

}  // namespace lodpipe::similarity
