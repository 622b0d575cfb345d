"""The pixels of an asset's images, for whoever makes textures of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.asset import Asset
from lodpipe.core.errors import AssetError, LimitError
from lodpipe.io.images import decode_image
from lodpipe.io.limits import DEFAULT, Limits


def pixels_of(
    asset: Asset, warn: Callable[[str], None] = lambda text: None, limits: Limits = DEFAULT
) -> Callable[[int], NDArray[np.uint8] | None]:
    """A function that decodes an image of `asset` by its index; see `decode_image` for the pixels.

    It gives None for an image that is missing, broken, too large or of a format without a decoder, and tells `warn`
    why, unless the reader has told already.
    """

    def pixels(index: int) -> NDArray[np.uint8] | None:
        image = asset.images[index]
        try:
            return decode_image(image, limits)
        except (AssetError, LimitError) as error:
            if not image.problem:
                label = image.uri or image.name or f"images[{index}]"
                why = str(error) if label in str(error) else f"{label}: {error}"
                warn(f"pictures are made without a texture: {why}")
            return None

    return pixels
