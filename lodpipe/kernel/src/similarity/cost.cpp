#include "cost.h"

namespace lodpipe::similarity {

CornerOf corner_of(const Mesh& mesh, const Collapse& c, const Face& face, int k, bool after) {
  CornerOf corner{mesh.p[face.v[k]], mesh.values(face.w[k]), nullptr};
  if (!after || (face.v[k] != c.gone && face.v[k] != c.kept)) return corner;
  corner.x = c.place;
  if (const Collapse::Wedge* w = c.find(face.w[k])) {
    if (w->row >= 0) corner.fresh = c.fresh.data() + static_cast<size_t>(w->row) * mesh.columns;
    else corner.values = mesh.values(w->to);
  }
  return corner;
}

void add_face(const Mesh& mesh, const Shading& shading, const Collapse& c, int32_t face, int look, bool after,
              Point center, double scale, Patch& out) {
  CornerOf corners[3];
  for (int k = 0; k < 3; ++k) corners[k] = corner_of(mesh, c, mesh.faces[face], k, after);
  const Point flat = cross(corners[1].x - corners[0].x, corners[2].x - corners[0].x);
  for (const CornerOf& at : corners) {
    const Point x = (at.x - center) * scale;
    out.x.push_back({static_cast<float>(x.x), static_cast<float>(x.y), static_cast<float>(x.z)});
    out.corners.push_back(at.fresh ? shading.corner(at.fresh, look, flat) : shading.corner(at.values, look, flat));
  }
  out.look.push_back(look);
}

}  // namespace lodpipe::similarity
