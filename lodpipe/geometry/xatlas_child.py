"""Unfolds triangles with xatlas: a program of its own (``python -m``), because xatlas may hang or die.

Reads an .npz of `positions` (V, 3) float32 and `faces` (F, 3) uint32 from its standard input; writes one of `faces`
(G,) int32 (rows of the input that were unfolded) and `uv` (G, 3, 2) float32, `label` (G,) int32 to its standard output.
"""

from __future__ import annotations

import io
import sys

import numpy as np


def main() -> None:
    """Run xatlas over what the standard input holds."""
    import xatlas

    given = np.load(io.BytesIO(sys.stdin.buffer.read()))
    atlas = xatlas.Atlas()
    atlas.add_mesh(given["positions"], given["faces"])
    charts, packing = xatlas.ChartOptions(), xatlas.PackOptions()
    charts.max_cost = float(given["max_cost"])
    packing.resolution = 1024  # a page is put together only to see the charts: larger ones take minutes
    atlas.generate(charts, packing)
    _, corners, uv = atlas[0]
    # which page and chart a vertex lies in; −1 where xatlas has left it out
    page, chart = (column.view(np.int32) for column in atlas.get_mesh_vertex_assignment(0))
    if len(corners) != len(given["faces"]):
        raise SystemExit("xatlas gave back another number of faces")
    corners = corners.astype(np.int64)
    good = (chart[corners] >= 0).all(axis=1) & (page[corners] >= 0).all(axis=1)
    rows = np.flatnonzero(good)
    texels = uv * np.array([atlas.width, atlas.height], np.float32)
    out = io.BytesIO()
    label = chart[corners[rows, 0]].astype(np.int32)
    np.savez(out, faces=rows.astype(np.int32), uv=texels[corners[rows]].astype(np.float32), label=label)
    sys.stdout.buffer.write(out.getvalue())


if __name__ == "__main__":
    main()
