"""Rays and closest points through Open3D's RaycastingScene (Embree). The only module that imports Open3D.

Importing it takes more than a second: its users import it where they need it. Arrays in, arrays out; no Open3D
object leaves this module. Results do not depend on the number of threads.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.errors import LodpipeError
from lodpipe.core.mesh import F32, I32
from lodpipe.core.rays import Hits

try:
    import open3d
except (ImportError, OSError) as error:  # OSError: a system library that the wheel needs is missing
    raise LodpipeError(
        f"Open3D cannot be loaded ({error})",
        advice="install the package open3d; on Debian and Ubuntu it needs libusb-1.0-0 libgl1 libgomp1 libx11-6",
    ) from error

VERSION: str = open3d.__version__


@dataclass(frozen=True)
class Crossings:
    """All triangles that N rays meet, a row for each: `rays` and `faces` (M,) int32, `distance` (M,) float32."""

    rays: I32
    faces: I32
    distance: F32


class RayScene:
    """Triangles made ready for questions about rays and closest points, in single precision.

    positions (V, 3) float32 and faces (F, 3) int32; centre them and scale them to about unit size first. Building
    takes about 0.6 s and 100 MB for a million triangles, at the first question. Ask in batches of 10,000 and
    more: a call costs 0.1 ms whatever its size. A batch whose points lie in the order of the surface takes half
    the time of a shuffled one. `threads` bounds the threads of every question, 0 for all cores.
    """

    def __init__(self, positions: F32, faces: I32, threads: int = 0) -> None:
        self.threads = threads
        self.empty = len(faces) == 0
        self._scene = open3d.t.geometry.RaycastingScene(nthreads=threads)
        if not self.empty:
            corners = np.ascontiguousarray(faces, np.int32).view(np.uint32)
            self._scene.add_triangles(_tensor(positions), open3d.core.Tensor.from_numpy(corners))

    def closest(self, points: F32) -> tuple[F32, I32]:
        """The closest point of the surface to each of `points` (N, 3): the points (N, 3) and their faces (N,).

        Quick near the surface (0.7 µs a point), slow where very many triangles are almost equally near (1 ms a
        point at the middle of a fine sphere). Raises ValueError for a scene without triangles.
        """
        if self.empty:
            raise ValueError("a scene without triangles has no closest points")
        found = self._scene.compute_closest_points(_tensor(points), nthreads=self.threads)
        return found["points"].numpy(), found["primitive_ids"].numpy().view(np.int32)

    def cast(self, origins: F32, directions: F32) -> Hits:
        """The first triangle met from each of `origins` (N, 3) along `directions` (N, 3)."""
        count = len(origins)
        if self.empty or count == 0:
            nothing = np.full(count, np.inf, np.float32), np.full(count, -1, np.int32)
            return Hits(*nothing, np.zeros((count, 2), np.float32))
        found = self._scene.cast_rays(_rays(origins, directions), nthreads=self.threads)
        # Open3D's mark for "no triangle" is the largest uint32, which is −1 as int32
        return Hits(
            found["t_hit"].numpy(), found["primitive_ids"].numpy().view(np.int32), found["primitive_uvs"].numpy()
        )

    def crossings(self, origins: F32, directions: F32) -> Crossings:
        """Every triangle met from each of `origins` (N, 3) along `directions` (N, 3), however many."""
        if self.empty or len(origins) == 0:
            return Crossings(np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros(0, np.float32))
        found = self._scene.list_intersections(_rays(origins, directions), nthreads=self.threads)
        return Crossings(
            found["ray_ids"].numpy().astype(np.int32),
            found["primitive_ids"].numpy().view(np.int32),
            found["t_hit"].numpy(),
        )


def _rays(origins: F32, directions: F32) -> Any:
    rays: NDArray[np.float32] = np.empty((len(origins), 6), np.float32)
    rays[:, :3] = origins
    rays[:, 3:] = directions
    return _tensor(rays)


def _tensor(values: F32) -> Any:
    """An Open3D tensor that shares the memory of a contiguous float32 array."""
    return open3d.core.Tensor.from_numpy(np.ascontiguousarray(values, np.float32))
