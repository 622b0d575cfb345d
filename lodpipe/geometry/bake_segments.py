"""Which faces of a segmented source may be baked onto which faces of a level: those of its segment and of the next."""

from __future__ import annotations

import numpy as np

from lodpipe.core.mesh import F64, I32, Mesh
from lodpipe.geometry.flatten import Bool

CORNERS = np.array([[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4]]) / np.array([[3], [6], [6], [6]])
"""Where on its faces a level is asked for the segment that lies nearest, as barycentric coordinates."""


class SegmentFilter:
    """The segments of one source mesh, by its faces.

    A level's face takes the segment that most of four points of it lie nearest to. It may show that segment and those
    that touch it: two fingers do not show each other, though a face between a finger and the hand shows both.
    """

    def __init__(self, mesh: Mesh, vertex_segment: I32) -> None:
        corners = vertex_segment[mesh.faces]
        self.of_face = _voted(corners)
        count = int(vertex_segment.max(initial=-1)) + 2  # 0 stands for faces without a segment, which any may show
        self._beside = np.eye(count, dtype=bool)
        for a, b in ((0, 1), (1, 2), (2, 0)):
            self._beside[corners[:, a] + 1, corners[:, b] + 1] = True
        self._beside |= self._beside.T
        self._beside[:, 0] = self._beside[0] = True

    def labels(self, nearest: I32) -> I32:
        """(F,) the segments of a level's faces, from the source's faces `nearest` (F, 4) to the points of `asked`."""
        return _voted(self.of_face[nearest])

    def allowed(self, segment: int) -> Bool:
        """(F,) which of the source's faces a face of `segment` may show."""
        allowed: Bool = self._beside[segment + 1][self.of_face + 1]
        return allowed


def asked(mesh: Mesh) -> F64:
    """(4F, 3) points of a level's faces, four for each."""
    points: F64 = np.einsum("pk,fkd->fpd", CORNERS, mesh.positions[mesh.faces].astype(np.float64))
    return points.reshape(-1, 3)


def _voted(labels: I32) -> I32:
    """(F,) the label that most of (F, K) have, the first of them where several do."""
    votes = (labels[:, :, None] == labels[:, None]).sum(axis=2)
    winners: I32 = np.take_along_axis(labels, votes.argmax(axis=1)[:, None], axis=1)[:, 0]
    return winners
