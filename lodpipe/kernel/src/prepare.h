#pragma once
#include "mesh_state.h"

namespace lodpipe {

// Fills the state from the input. Degenerate input faces (two equal corners) are left out.
void prepare(const Input& in, const Options& options, Pool& pool, State& s);

// Each vertex' list of its corners, from the faces, none of which is dead.
void list_corners(State& s);

}  // namespace lodpipe
