#include "placement.h"

#include <algorithm>
#include <map>

namespace lodpipe::similarity {
namespace {

constexpr double kDamping = 1e-9;  // share of the trace that pulls the optimum to the edge's middle
constexpr double kReach = 2;       // edge lengths from the edge's middle within which it must lie
constexpr double kBorder = 0.5;    // weight of the planes that hold open borders, × squared edge length
constexpr double kSeam = 0.03;     // the same at seams and edges of more than two faces

using Vector5 = std::array<double, 5>;
double dot(const Vector5& a, const Vector5& b) {
  double sum = 0;
  for (int i = 0; i < 5; ++i) sum += a[i] * b[i];
  return sum;
}

// GH98: A = I − e₁e₁ᵀ − e₂e₂ᵀ, b = (p·e₁)e₁ + (p·e₂)e₂ − p, c = p·p − (p·e₁)² − (p·e₂)², times the weight.
bool fundamental(const Vector5& p, const Vector5& q, const Vector5& r, double weight, Quadric5& out) {
  Vector5 e1, e2;
  for (int i = 0; i < 5; ++i) e1[i] = q[i] - p[i], e2[i] = r[i] - p[i];
  const double first = std::sqrt(dot(e1, e1));
  if (!(first > 0)) return false;
  for (double& x : e1) x /= first;
  const double along = dot(e1, e2);
  for (int i = 0; i < 5; ++i) e2[i] -= along * e1[i];
  const double second = std::sqrt(dot(e2, e2));
  if (!(second > 1e-12 * first)) return false;
  for (double& x : e2) x /= second;
  const double p1 = dot(p, e1), p2 = dot(p, e2);
  for (int i = 0; i < 5; ++i) {
    for (int j = i; j < 5; ++j) out.a[Quadric5::at(i, j)] = weight * ((i == j) - e1[i] * e1[j] - e2[i] * e2[j]);
    out.b[i] = weight * (p1 * e1[i] + p2 * e2[i] - p[i]);
  }
  out.c = weight * (dot(p, p) - p1 * p1 - p2 * p2);
  return true;
}

struct Solved {
  bool free = false;               // whether the UV can follow the place
  double back[2][3] = {}, at[2];   // uv = at − back · x
};

// Takes the UV out of q: what is left of it, and how the UV follows from the place.
Quadric3 eliminate(const Quadric5& q, std::array<double, 2> fixed, Solved& solved) {
  Quadric3 out{q.get(0, 0), q.get(0, 1), q.get(0, 2), q.get(1, 1), q.get(1, 2), q.get(2, 2), q.b[0], q.b[1], q.b[2], q.c};
  const double aa = q.get(3, 3), ab = q.get(3, 4), bb = q.get(4, 4), det = aa * bb - ab * ab;
  solved.free = det > 1e-12 * (aa + bb) * (aa + bb);
  if (!solved.free) {
    solved.at[0] = fixed[0], solved.at[1] = fixed[1];
    return out;
  }
  const double inv[2][2] = {{bb / det, -ab / det}, {-ab / det, aa / det}};
  double cross[2][3];
  for (int i = 0; i < 2; ++i)
    for (int j = 0; j < 3; ++j) cross[i][j] = q.get(j, 3 + i);
  for (int i = 0; i < 2; ++i) {
    for (int j = 0; j < 3; ++j) solved.back[i][j] = inv[i][0] * cross[0][j] + inv[i][1] * cross[1][j];
    solved.at[i] = -(inv[i][0] * q.b[3] + inv[i][1] * q.b[4]);
  }
  const auto less = [&](int i, int j) { return cross[0][i] * solved.back[0][j] + cross[1][i] * solved.back[1][j]; };
  out.xx -= less(0, 0), out.xy -= less(0, 1), out.xz -= less(0, 2);
  out.yy -= less(1, 1), out.yz -= less(1, 2), out.zz -= less(2, 2);
  double* b[3] = {&out.bx, &out.by, &out.bz};
  for (int j = 0; j < 3; ++j) *b[j] += cross[0][j] * solved.at[0] + cross[1][j] * solved.at[1];
  out.c += q.b[3] * solved.at[0] + q.b[4] * solved.at[1];
  return out;
}

bool minimise(const Quadric3& q, Point toward, Point* x) {
  const double damping = kDamping * q.trace();
  const double a = q.xx + damping, d = q.yy + damping, f = q.zz + damping;
  const double rx = damping * toward.x - q.bx, ry = damping * toward.y - q.by, rz = damping * toward.z - q.bz;
  const double cxx = d * f - q.yz * q.yz, cxy = q.xz * q.yz - q.xy * f, cxz = q.xy * q.yz - q.xz * d;
  const double cyy = a * f - q.xz * q.xz, cyz = q.xy * q.xz - a * q.yz, czz = a * d - q.xy * q.xy;
  const double det = a * cxx + q.xy * cxy + q.xz * cxz;
  if (!(det > 0)) return false;
  *x = {(cxx * rx + cxy * ry + cxz * rz) / det, (cxy * rx + cyy * ry + cyz * rz) / det,
        (cxz * rx + cyz * ry + czz * rz) / det};
  return true;
}

}  // namespace

Placement::Placement(const Mesh& mesh, int uv_column) : uv_column_(uv_column) {
  wedge_.resize(mesh.wedge_moved.size());
  planes_.resize(mesh.p.size());
  hold_.resize(mesh.p.size());
  if (uv_column_ >= 0) uv_scale_ = mesh.input.column_weights[uv_column_] * mesh.scale;
  std::map<std::pair<int32_t, int32_t>, std::vector<int32_t>> edges;
  for (size_t i = 0; i < mesh.faces.size(); ++i) {
    const Face& f = mesh.faces[i];
    const Point n = mesh.area_vector(f);
    const double area = length(n);
    Vector5 corner[3];
    for (int k = 0; k < 3; ++k) {
      const Point x = mesh.p[f.v[k]];
      corner[k] = {x.x, x.y, x.z, 0, 0};
      if (uv_scale_ > 0)
        for (int j = 0; j < 2; ++j) corner[k][3 + j] = uv_scale_ * mesh.values(f.w[k])[uv_column_ + j];
      edges[std::minmax(f.v[k], f.v[(k + 1) % 3])].push_back(static_cast<int32_t>(i));
    }
    Quadric5 q;
    if (fundamental(corner[0], corner[1], corner[2], area / 3, q))
      for (const int32_t w : f.w) wedge_[w] += q;
    if (!(area > 0)) continue;
    const Point unit = n * (1 / area);
    for (const int32_t v : f.v) planes_[v].add_plane(unit, -similarity::dot(unit, mesh.p[f.v[0]]), area / 3);
  }
  for (const auto& [edge, faces] : edges) {
    const auto wedge = [&](int32_t f, int32_t v) { return mesh.faces[f].w[mesh.faces[f].slot(v)]; };
    const bool border = faces.size() == 1;
    bool seam = faces.size() > 2;
    for (const int32_t f : faces)
      for (const int32_t v : {edge.first, edge.second}) seam |= wedge(f, v) != wedge(faces[0], v);
    if (!border && !seam) continue;
    const Point along = mesh.p[edge.second] - mesh.p[edge.first];
    for (const int32_t f : faces) {
      const Point across = cross(mesh.area_vector(mesh.faces[f]), along);
      const double size = length(across);
      if (!(size > 0)) continue;
      const Point n = across * (1 / size);
      const double weight = (border ? kBorder : kSeam) * similarity::dot(along, along);
      for (const int32_t v : {edge.first, edge.second}) hold_[v].add_plane(n, -similarity::dot(n, mesh.p[edge.first]), weight);
    }
  }
}

double Placement::deviation(int32_t v, int32_t u, Point x) const {
  Quadric3 q = planes_[v];
  q += planes_[u];
  return q.trace() > 0 ? std::sqrt(std::max(q.at(x), 0.0) / q.trace()) : 0;
}

Point Placement::best(const Mesh& mesh, int32_t v, int32_t u, const std::vector<std::vector<int32_t>>& groups,
                      std::vector<std::array<double, 2>>& uv) const {
  const Point p = mesh.p[v], q = mesh.p[u], middle = (p + q) * 0.5;
  Quadric3 total = hold_[v];
  total += hold_[u];
  std::vector<Solved> solved(groups.size());
  for (size_t g = 0; g < groups.size(); ++g) {
    Quadric5 sum;
    std::array<double, 2> mean{};
    for (const int32_t w : groups[g]) {
      sum += wedge_[w];
      if (uv_scale_ > 0)
        for (int j = 0; j < 2; ++j)
          mean[j] += uv_scale_ * mesh.values(w)[uv_column_ + j] / static_cast<double>(groups[g].size());
    }
    total += eliminate(sum, mean, solved[g]);
  }
  Point x;
  const double edge = length(q - p);
  if (!minimise(total, middle, &x) || length(x - middle) > kReach * edge) {
    x = middle;
    for (const Point end : {p, q})
      if (total.at(end) < total.at(x)) x = end;
  }
  uv.resize(groups.size());
  for (size_t g = 0; g < groups.size(); ++g)
    for (int j = 0; j < 2; ++j) {
      const double* back = solved[g].back[j];
      const double scaled = solved[g].at[j] - (back[0] * x.x + back[1] * x.y + back[2] * x.z);
      uv[g][j] = uv_scale_ > 0 ? scaled / uv_scale_ : 0;
    }
  return x;
}

void Placement::merge(const Collapse& c) {
  planes_[c.kept] += planes_[c.gone];
  hold_[c.kept] += hold_[c.gone];
  for (const Collapse::Wedge& w : c.wedges) {
    if (w.from == w.to) continue;
    wedge_[w.to] += wedge_[w.from];
    wedge_[w.from] = {};
  }
}

}  // namespace lodpipe::similarity
