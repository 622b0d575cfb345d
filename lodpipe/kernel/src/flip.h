// FLIP: how different two pictures look when one takes the other's place.
#pragma once

namespace lodpipe {

// (height, width) errors 0…1 of two sRGB pictures (height, width, 3) 0…1, seen at `density` pixels a degree. Andersson,
// Nilsson, Akenine-Möller, Oskarsson, Åström & Fairchild 2020, "FLIP: a difference evaluator for alternating images".
void flip(const float* a, const float* b, int height, int width, double density, float* out);

}  // namespace lodpipe
