from collections.abc import Callable, Sequence
from typing import Annotated

import numpy
from numpy.typing import NDArray


def decimate(positions: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], faces: Annotated[NDArray[numpy.int32], dict(shape=(None, None), order='C', device='cpu', writable=False)], wedges: Annotated[NDArray[numpy.int32], dict(shape=(None, None), order='C', device='cpu', writable=False)], values: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], column_weights: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], importance: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)] | None, locked: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order='C', device='cpu', writable=False)] | None, targets: Sequence[int], progress: Callable[[int, int], bool], *, placement: int, weighting: int, boundary_weight: float, seam_weight: float, crease_weight: float, crease_cos: float, pair_distance: float, attribute_cost: bool, keep_topology: bool, may_relax: bool, flip_cos: float, round_share: float, max_error: float, threads: int, record: bool) -> dict: ...
