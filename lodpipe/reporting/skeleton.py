"""A skeleton and its segments as JSON and as text."""

from __future__ import annotations

from typing import Any

import numpy as np

from lodpipe.core.skeleton import NODE_TYPES, PARTS, Segments, Skeleton

MOST_LINES = 20


def skeleton_data(skeleton: Skeleton, segments: Segments, seconds: float) -> dict[str, Any]:
    """Plain data: for each component its nodes, links, counts and figures, and the segments; places in world space."""
    sizes = np.zeros(len(segments.names), np.int64)
    for vertices in segments.vertex_segment:
        sizes += np.bincount(vertices[vertices >= 0], minlength=len(sizes))
    components = []
    for index, part in enumerate(skeleton.components):
        rows = np.flatnonzero(skeleton.component == index)
        links = skeleton.edges[skeleton.component[skeleton.edges[:, 0]] == index]
        components.append(
            {
                "nodes": [
                    {
                        "position": skeleton.positions[row].tolist(),
                        "radius": float(skeleton.radius[row]),
                        "type": NODE_TYPES[skeleton.node_type[row]],
                        "segment": segments.names[segments.node_segment[row]],
                    }
                    for row in rows
                ],
                "edges": np.searchsorted(rows, links).tolist(),
                "ends": skeleton.count("end", index),
                "joints": skeleton.count("joint", index),
                "cycle_rank": part.cycle_rank,
                "genus": part.genus,
                "inside_share": part.inside_share,
                "segments": [
                    {"name": name, "kind": PARTS[kind], "vertices": int(size)}
                    for name, kind, owner, size in zip(
                        segments.names, segments.kind, segments.component, sizes, strict=True
                    )
                    if owner == index
                ],
                "notes": list(part.notes),
            }
        )
    return {"method": skeleton.method, "components": components, "seconds": seconds}


def skeleton_text(data: dict[str, Any]) -> list[str]:
    """Lines for a terminal."""
    lines = []
    for number, part in enumerate(data["components"][:MOST_LINES], 1):
        loops, genus, share = part["cycle_rank"], part["genus"], part["inside_share"]
        figures = [
            _count(part["ends"], "end"),
            _count(part["joints"], "joint"),
            f"{_count(loops, 'loop')} (genus {'unknown' if genus is None else genus})",
            _count(len(part["nodes"]), "node"),
        ]
        if share is not None:
            figures.append(f"{100 * share:.1f} % inside")
        lines.append(f"component {number}: " + ", ".join(figures))
        branches = [s for s in part["segments"] if s["kind"] == "branch"]
        lines.extend(f"  {s['name']}: {s['vertices']:,} vertices" for s in part["segments"] if branches)
        lines.extend(f"  note: {note}" for note in part["notes"])
    rest = len(data["components"]) - MOST_LINES
    if rest > 0:
        lines.append(f"… and {rest} more components")
    lines.append(f"{data['method']}, {data['seconds']:.2f} s")
    return lines


def _count(number: int, name: str) -> str:
    return f"{number} {name}" + ("" if number == 1 else "s")
