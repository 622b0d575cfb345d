"""Files <-> Asset: one way in (`load`), and two out (`save` for a level, `save_combined` for all in one file)."""

from lodpipe.io.encode import encode_image
from lodpipe.io.images import decode_image
from lodpipe.io.limits import Limits
from lodpipe.io.pixels import pixels_of
from lodpipe.io.reading import FORMATS, is_asset, load
from lodpipe.io.writing import save, save_combined

__all__ = [
    "FORMATS",
    "Limits",
    "decode_image",
    "encode_image",
    "is_asset",
    "load",
    "pixels_of",
    "save",
    "save_combined",
]
