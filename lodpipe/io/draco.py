"""KHR_draco_mesh_compression, decoded by DracoPy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.errors import AssetError

EXTENSION = "KHR_draco_mesh_compression"


def decode(data: bytes, attributes: Mapping[str, Any]) -> tuple[NDArray[Any], dict[str, NDArray[Any]]]:
    """Faces (F, 3) and each attribute (N, K) in its stored type.

    `attributes` gives the unique id of each in the Draco stream. Raises AssetError.
    """
    try:
        import DracoPy
    except ImportError as error:
        raise AssetError(
            f"{EXTENSION} needs the package DracoPy", advice="install it, or store the model without compression"
        ) from error
    try:
        mesh = DracoPy.decode(data)
    except Exception as error:  # DracoPy raises bare exceptions of several kinds
        raise AssetError(f"the {EXTENSION} data cannot be decoded ({error})") from error
    faces = getattr(mesh, "faces", None)
    if faces is None:
        raise AssetError(f"the {EXTENSION} data is a point cloud, not a mesh")
    found = {int(a["unique_id"]): a["data"] for a in mesh.attributes}
    missing = sorted(name for name, key in attributes.items() if key not in found)
    if missing:
        raise AssetError(f"the {EXTENSION} data lacks {', '.join(missing)}")
    columns = {name: np.asarray(found[int(key)]) for name, key in attributes.items()}
    return np.asarray(faces), {n: c.reshape(len(c), -1) for n, c in columns.items()}
