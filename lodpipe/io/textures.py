"""Images, textures and the slots that use them, made ready for a glTF that is being written."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import Any
from urllib.parse import quote

from lodpipe.core.errors import AssetError
from lodpipe.core.material import Image
from lodpipe.io.clean import Warn
from lodpipe.io.images import GLTF_TYPES, decode_image, encode_png
from lodpipe.io.limits import Limits
from lodpipe.io.pack import Packer

#: Formats beyond PNG and JPEG: a texture names them through an extension.
_BY_EXTENSION = {
    "image/webp": "EXT_texture_webp",
    "image/avif": "EXT_texture_avif",
    "image/ktx2": "KHR_texture_basisu",
    "image/vnd-ms.dds": "MSFT_texture_dds",
}
_RESERVED = re.compile(r"^(con|prn|aux|nul|com\d|lpt\d)(\.|$)", re.IGNORECASE)


def portable(images: Iterable[Image], warn: Warn) -> list[Image]:
    """The images in formats that glTF knows: others become PNG. One that cannot be turned into it has no data."""
    result = []
    for image in images:
        if image.data and image.mime_type not in GLTF_TYPES:
            try:
                data = encode_png(decode_image(image, Limits()))
            except AssetError as error:
                warn(f"{error.cause}; the texture is left out")
                data = b""
            name = image.uri.rpartition(".")[0] + ".png" if image.uri else ""
            image = Image(data, "image/png", image.name, name, image.width, image.height, image.problem)
        result.append(image)
    return result


def settle_textures(tree: dict[str, Any], images: list[Image], holders: list[Any]) -> list[Image]:
    """Take broken images out of `tree`, with their textures and the slots in `holders` that use these.

    `holders` are the JSON trees with texture slots (materials, primitives). Textures whose only source is of a
    format beyond PNG and JPEG name it through that format's extension. Returns the images that stay.
    """
    alive = _rows([bool(image.data) for image in images])
    textures: list[dict[str, Any]] = []
    kept: list[bool] = []
    for texture in tree.get("textures", ()):
        extensions = texture.get("extensions", {})
        sources = [(texture, None)] + [(said, name) for name, said in extensions.items() if "source" in said]
        broken = [(said, name) for said, name in sources if "source" in said and alive[said["source"]] is None]
        for said, name in broken:
            del said["source"]
            if name is not None:
                del extensions[name]
        for said, _ in sources:
            if "source" in said:
                said["source"] = alive[said["source"]]
        if "extensions" in texture and not extensions:
            del texture["extensions"]
        kept.append(not broken or "source" in texture or any("source" in e for e in extensions.values()))
        if kept[-1]:
            textures.append(texture)
    if not all(kept):
        rows = _rows(kept)
        for holder in holders:
            _renumber_slots(holder, rows)
    for light in tree.get("extensions", {}).get("EXT_lights_image_based", {}).get("lights", ()):
        light["specularImages"] = [[alive[i] for i in mip] for mip in light.get("specularImages", ())]
    rest = tree.get("images", [])
    tree["images"] = [dict(r) for r, image in zip(rest, images, strict=False) if image.data] if rest else []
    staying = [image for image in images if image.data]
    tree["images"] += [{} for _ in range(len(staying) - len(tree["images"]))]
    tree["textures"] = textures
    for texture in textures:
        row = texture.get("source")
        name = _BY_EXTENSION.get(staying[row].mime_type) if row is not None else None
        if name is not None:
            del texture["source"]
            texture.setdefault("extensions", {})[name] = {"source": row}
            tree["extensionsRequired"] = list(dict.fromkeys([*tree.get("extensionsRequired", ()), name]))
    return staying


def embed_images(tree: dict[str, Any], images: list[Image], pack: Packer) -> None:
    """Put the images into the buffer, bytes untouched and each once."""
    views: dict[bytes, int] = {}
    for said, image in zip(tree["images"], images, strict=True):
        if image.data not in views:
            views[image.data] = pack.view(image.data)
        said.update(bufferView=views[image.data], mimeType=image.mime_type)
        if image.name or image.uri:
            said.setdefault("name", image.name or image.uri.rpartition(".")[0])


def link_images(tree: dict[str, Any], images: list[Image], taken: Iterable[str]) -> list[tuple[str, bytes]]:
    """Name each image as a file beside the glTF. Returns the file names with their bytes."""
    names = file_names(images, taken)
    files: dict[str, bytes] = {}
    for said, image, name in zip(tree["images"], images, names, strict=True):
        said["uri"] = quote(name)
        if image.name:
            said.setdefault("name", image.name)
        files[name] = image.data
    return list(files.items())


def file_names(images: Iterable[Image], taken: Iterable[str]) -> list[str]:
    """A file name for each image: its own where it is safe and free; equal bytes share one. None is in `taken`."""
    used = {name.casefold() for name in taken}
    by_data: dict[bytes, str] = {}
    names = []
    for number, image in enumerate(images):
        if image.data not in by_data:
            ending = GLTF_TYPES.get(image.mime_type, ".bin")
            stem, dot, own = safe_name(image.uri or image.name or f"image{number}").rpartition(".")
            stem, ending = (stem, f".{own}") if dot and image.uri else (own if not dot else f"{stem}.{own}", ending)
            free = next(n for n in _candidates(stem, ending) if n.casefold() not in used)
            used.add(free.casefold())
            by_data[image.data] = free
        names.append(by_data[image.data])
    return names


def safe_name(name: str) -> str:
    """A file name without folders, control characters and what file systems reserve."""
    plain = re.sub(r'[<>:"|?*\x00-\x1f\x7f]', "_", name.replace("\\", "/").rpartition("/")[2]).strip(" .")
    plain = plain[:100] if len(plain) <= 100 else plain[:80] + plain[-20:]
    return f"_{plain}" if not plain or _RESERVED.match(plain) else plain


def _candidates(stem: str, ending: str) -> Iterator[str]:
    yield stem + ending
    number = 1
    while True:
        yield f"{stem}_{number}{ending}"
        number += 1


def _rows(kept: list[bool]) -> list[int | None]:
    """For each row its new number, None for one that goes."""
    rows: list[int | None] = []
    count = 0
    for stays in kept:
        rows.append(count if stays else None)
        count += stays
    return rows


def _renumber_slots(holder: Any, rows: list[int | None]) -> None:
    """Renumber the textures in all slots of a JSON tree; a slot whose texture goes, goes too."""
    stack = [holder]
    while stack:
        item = stack.pop()
        if isinstance(item, list):
            stack += item
        if not isinstance(item, dict):
            continue
        for key in list(item):
            slot = item[key]
            is_slot = isinstance(slot, dict) and isinstance(slot.get("index"), int)
            if is_slot and key.lower().endswith("texture") and slot["index"] < len(rows):
                if rows[slot["index"]] is None:
                    del item[key]
                    continue
                slot["index"] = rows[slot["index"]]
            if key != "extras":
                stack.append(slot)
