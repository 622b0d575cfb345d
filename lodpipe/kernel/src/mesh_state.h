// The mesh while it is being simplified: flat arrays, faces in linked lists round their vertices.
#pragma once
#include <algorithm>
#include <cstdint>
#include <cstring>
#include <vector>

#include "decimate.h"
#include "memory.h"
#include "order.h"
#include "parallel.h"
#include "quadric.h"

namespace lodpipe {

enum : uint8_t {
  kDirty = 1,    // something near it changed: evaluate
  kRetry = 2,    // its best collapse was refused: evaluate the next best
  kDead = 4,
  kLocked = 8,
  kMoved = 16,   // lies where no input vertex was
  kSeveralWedges = 32,
  kVanish = 64,  // its candidate is to take out the whole component
  kIrregular = 128,  // its faces do not form closed, consistently turning fans, or it has links
};

struct Vertex {  // one cache line
  Vec3 p;
  Quadric q;
  int32_t head;  // first corner of its list, −1: none
  int32_t skip;  // so many of its cheapest collapses were refused since it was last dirty
  float error;   // estimate of the deviation so far
};
static_assert(sizeof(Vertex) == 64);

// A triangle, or (v[2] = kNone) a link between two vertices that are near each other but share no edge.
struct Face {  // half a cache line
  int32_t v[3];
  int32_t next[3];  // next corner in the list round v[k]
  int32_t source;   // row of the input
  int32_t unused;
  bool dead() const { return v[0] < 0; }
  bool link() const { return v[2] < 0; }
};
static_assert(sizeof(Face) == 32);

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
constexpr int kVanishFaces = 4;  // a component of so few faces goes as a whole

inline int32_t corner(int32_t face, int k) { return face << 2 | k; }
inline int32_t face_of(int32_t corner) { return corner >> 2; }
inline int slot_of(int32_t corner) { return corner & 3; }

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
  Large<float> cost;  // of the vertex's best collapse, and with whom
  Large<int32_t> partner;
  Large<int32_t> stamp;  // round in which the vertex was last touched
  std::vector<int32_t> live;
  std::vector<int32_t> vertex_source, wedge_source;
  // wedges, row-major with `columns`
  int columns = 0, steering = 0;  // the first `steering` columns have a share in the cost
  int chart_column = -1;            // first of the two UV columns that must stay in their charts
  std::vector<int32_t> column_source;
  std::vector<float> column_scale;
  Large<float> value, weight;
  Large<Slope> slope;
  std::vector<uint8_t> wedge_moved;
  std::vector<int32_t> vertex_into, wedge_into;  // with `follow`: what each was merged into; itself while it lives

  double center[3] = {0, 0, 0};
  double scale = 1;  // input units → unit diagonal
  int64_t triangles = 0;
  bool has_links = false;
};

}  // namespace lodpipe
