"""Wavefront material libraries (.mtl), read as glTF materials and written from them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from lodpipe.core.errors import AssetError
from lodpipe.core.material import Image, Material, texture_ref
from lodpipe.io.clean import Warn
from lodpipe.io.images import find_image, read_header
from lodpipe.io.paths import Folder, shorten
from lodpipe.io.text import decode_name, plain_text

CLAMP_TO_EDGE = 33071
#: How many words may follow a map's option (the offsets take one to three numbers).
_OPTIONS = {"-blendu": 1, "-blendv": 1, "-boost": 1, "-mm": 2, "-o": 3, "-s": 3, "-t": 3, "-texres": 1, "-clamp": 1}
_OPTIONS |= {"-bm": 1, "-imfchan": 1, "-type": 1, "-cc": 1}
#: Maps that have a place in a glTF material, by their slot.
_SLOTS = {
    "map_kd": "baseColorTexture",
    "map_ke": "emissiveTexture",
    "norm": "normalTexture",
    "map_kn": "normalTexture",
    "map_bump": "normalTexture",
    "bump": "normalTexture",
}
_OTHER_MAPS = {"map_ka", "map_ks", "map_ns", "map_d", "map_tr", "map_pr", "map_pm", "map_ps", "disp", "map_disp"}
_OTHER_MAPS |= {"decal", "refl", "map_refl", "map_opacity"}
#: Figures without a place in a glTF material; kept in extras.mtl, and written back.
_KEPT = {"ka": "Ka", "ks": "Ks", "ni": "Ni", "illum": "illum", "tf": "Tf"}


@dataclass
class Library:
    """Images, textures, samplers and materials in glTF's form, as they are collected."""

    folder: Folder
    warn: Warn
    images: list[Image] = field(default_factory=list)
    textures: list[dict[str, Any]] = field(default_factory=list)
    samplers: list[dict[str, Any]] = field(default_factory=list)
    materials: list[dict[str, Any]] = field(default_factory=list)
    _image_rows: dict[str, int] = field(default_factory=dict)
    _rows: dict[str, int] = field(default_factory=dict)
    _known: int = 0

    def read(self, name: str) -> None:
        """Read a material library beside the asset; one that cannot be read is a warning."""
        try:
            data = plain_text(self.folder.read(name))
        except AssetError as error:
            self.warn(f"material library left out: {error.cause}")
            return
        base = name.replace("\\", "/").rpartition("/")[0]
        for title, statements in _blocks(data):
            self.materials.append(self._material(title, statements, base))

    def row(self, name: str) -> int:
        """The row of the material of that name; a name that no library has becomes a material without figures."""
        for i in range(self._known, len(self.materials)):
            self._rows.setdefault(self.materials[i]["name"], i)  # of two of a name the first counts
        self._known = len(self.materials)
        if name in self._rows:
            return self._rows[name]
        self.warn(f"material {shorten(name)} is in no material library; the default look is used")
        self.materials.append({"name": name})
        return len(self.materials) - 1

    def texture(self, name: str, base: str = "", clamp: bool = False) -> int:
        """The row of the texture for an image file of that name, looked for in `base` first."""
        texture: dict[str, Any] = {"source": self._image(name, base)}
        if clamp:
            sampler = {"wrapS": CLAMP_TO_EDGE, "wrapT": CLAMP_TO_EDGE}
            if sampler not in self.samplers:
                self.samplers.append(sampler)
            texture["sampler"] = self.samplers.index(sampler)
        if texture not in self.textures:
            self.textures.append(texture)
        return self.textures.index(texture)

    def document(self, nodes: list[dict[str, Any]]) -> dict[str, Any]:
        """A glTF document of these and of `nodes`, all of them in one scene."""
        tree: dict[str, Any] = {"scene": 0, "scenes": [{"nodes": list(range(len(nodes)))}], "nodes": nodes}
        if self.textures:
            tree["textures"] = self.textures
        if self.samplers:
            tree["samplers"] = self.samplers
        if any(KHR_TRANSFORM in str(material) for material in self.materials):
            tree["extensionsUsed"] = [KHR_TRANSFORM]
        return tree

    def _image(self, name: str, base: str) -> int:
        """The row of an image: as named, else a file of that name beside the asset (paths of another machine)."""
        tried = image_names(name, base)
        chosen = next((t for t in tried if self._exists(t)), tried[0])
        if chosen not in self._image_rows:
            self._image_rows[chosen] = len(self.images)
            self.images.append(find_image(self.folder, chosen))
        return self._image_rows[chosen]

    def _exists(self, name: str) -> bool:
        try:
            self.folder.find(name)
        except AssetError:
            return False
        return True

    def _material(self, name: str, said: Mapping[str, str], base: str) -> dict[str, Any]:
        place = f"material {shorten(name)}"
        pbr: dict[str, Any] = {"metallicFactor": 0.0}
        material: dict[str, Any] = {"name": name, "pbrMetallicRoughness": pbr}
        for key, slot in _SLOTS.items():
            holder = pbr if slot == "baseColorTexture" else material
            if said.get(key) and slot not in holder:
                info = self._map(said[key], base, place, height_map=key in ("map_bump", "bump"))
                if info is not None:
                    holder[slot] = info
        self._colours(material, pbr, said, place)
        for key in sorted(_OTHER_MAPS & set(said)):
            if key in ("map_d", "map_opacity") and said[key] == said.get("map_kd"):
                material["alphaMode"] = "BLEND"
            elif said[key]:
                self.warn(f"{place}: {key} {shorten(said[key])} has no place in a glTF material; left out")
        kept = {spelled: said[key] for key, spelled in _KEPT.items() if key in said}
        if kept:
            material["extras"] = {"mtl": kept}
        return material

    def _colours(self, material: dict[str, Any], pbr: dict[str, Any], said: Mapping[str, str], place: str) -> None:
        colour = _floats(said.get("kd", ""), 3) or [1.0, 1.0, 1.0]
        if "baseColorTexture" in pbr and not any(colour):
            self.warn(f"{place}: Kd is black and would hide its texture; white is used")
            colour = [1.0, 1.0, 1.0]
        alpha = 1.0
        if d := _floats(said.get("d", "").removeprefix("-halo"), 1):
            alpha = d[0]
        elif tr := _floats(said.get("tr", ""), 1):
            alpha = 1.0 - tr[0] or 1.0  # exporters that mean opacity write Tr 1; nobody makes what cannot be seen
        alpha = min(max(alpha, 0.0), 1.0)
        factor = [min(max(c, 0.0), 1.0) for c in colour] + [alpha]
        if factor != [1.0] * 4:
            pbr["baseColorFactor"] = factor
        if alpha < 1.0:
            material["alphaMode"] = "BLEND"
        if shine := _floats(said.get("ns", ""), 1):
            # Blinn-Phong's exponent as a GGX roughness (Walter et al., EGSR 2007: alpha² = 2 / (Ns + 2))
            pbr["roughnessFactor"] = round(math.sqrt(math.sqrt(2.0 / (max(shine[0], 0.0) + 2.0))), 6)
        for key, target in (("pr", "roughnessFactor"), ("pm", "metallicFactor")):
            if value := _floats(said.get(key, ""), 1):
                pbr[target] = min(max(value[0], 0.0), 1.0)
        if any(glow := _floats(said.get("ke", ""), 3)):
            material["emissiveFactor"] = [min(max(c, 0.0), 1.0) for c in glow]
        elif "emissiveTexture" in material:
            material["emissiveFactor"] = [1.0, 1.0, 1.0]

    def _map(self, text: str, base: str, place: str, *, height_map: bool) -> dict[str, Any] | None:
        """A glTF textureInfo of a map statement; None, with a warning, for a height map."""
        name, options = map_statement(text)
        if not name:
            return None
        row = self.texture(name, base, clamp=options.get("-clamp", [""])[0] == "on")
        image = self.images[self.textures[row]["source"]]
        if height_map and image.data and read_header(image.data).channels in (1, 2):
            self.warn(f"{place}: {shorten(name)} is a grey height map, which glTF has no place for; left out")
            return None
        info: dict[str, Any] = {"index": row}
        if height_map and "-bm" in options and (strength := _floats(options["-bm"][0], 1)):
            info["scale"] = strength[0]
        s, o = (
            [*_floats(" ".join(options.get(k, [])), 1, 2), *d][:2] for k, d in (("-s", (1.0, 1.0)), ("-o", (0.0, 0.0)))
        )
        if (s, o) != ([1.0, 1.0], [0.0, 0.0]):
            # v counts from the bottom here and from the top in glTF
            transform = {"offset": [o[0], 1.0 - s[1] - o[1]], "scale": s}
            info["extensions"] = {KHR_TRANSFORM: transform}
        return info


def _blocks(data: bytes) -> list[tuple[str, dict[str, str]]]:
    """Each material of a library: its name, and the first statement of each kind."""
    current: dict[str, str] | None = None
    blocks: list[tuple[str, dict[str, str]]] = []
    for line in data.replace(b"\\\n", b" ").split(b"\n"):
        key, _, rest = line.strip().replace(b"\t", b" ").partition(b" ")
        if key.lower() == b"newmtl":
            current = {}
            blocks.append((decode_name(rest), current))
        elif current is not None and key and not key.startswith(b"#"):
            current.setdefault(decode_name(key).lower(), decode_name(rest))
    return blocks


def map_names(data: bytes) -> list[str]:
    """The image files that a library's materials name in statements that have a place in a glTF material."""
    names = [map_statement(said[key])[0] for _, said in _blocks(data) for key in _SLOTS if said.get(key)]
    return list(dict.fromkeys(filter(None, names)))


def image_names(name: str, base: str) -> list[str]:
    """Where an image is looked for, in order: as named, from the library's folder `base`; by its last part alone."""
    plain = name.replace("\\", "/")
    last = plain.rpartition("/")[2]
    return list(dict.fromkeys([f"{base}/{plain}" if base else plain, plain, f"{base}/{last}" if base else last, last]))


KHR_TRANSFORM = "KHR_texture_transform"


def map_statement(text: str) -> tuple[str, dict[str, list[str]]]:
    """The file name, which may hold spaces, and the options of a map statement: `-s 2 2 -o 0 0 wood 1.png`."""
    options: dict[str, list[str]] = {}
    rest = text.strip()
    while match := re.match(r"(-[a-z]+)\s+", rest):
        option = match[1]
        if option not in _OPTIONS:
            break
        rest = rest[match.end() :]
        values: list[str] = []
        for i in range(_OPTIONS[option]):
            word, _, after = rest.partition(" ")
            if i > 0 and not _is_float(word):
                break
            values.append(word)
            rest = after.lstrip()
        options[option] = values
    if len(rest) > 2 and rest[0] == rest[-1] == '"':
        rest = rest[1:-1]
    return rest, options


def _floats(text: str, *counts: int) -> list[float]:
    """The leading numbers of `text`: as many as the largest of `counts` that is there, else none."""
    values = []
    for word in text.split():
        if not _is_float(word):
            break
        values.append(float(word))
    return next((values[:n] for n in sorted(counts, reverse=True) if len(values) >= n), [])


def _is_float(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False


def format_material(material: Material, name: str, file_name: Callable[[int], str | None]) -> str:
    """The statements of one material. `file_name` gives the file of a texture row, None where it has none."""
    r, g, b, a = material.base_color_factor
    tree: Mapping[str, Any] = material.gltf
    pbr: Mapping[str, Any] = tree.get("pbrMetallicRoughness", {})
    lines = [f"newmtl {name}"]
    extras = tree.get("extras")
    kept: Mapping[str, Any] = extras.get("mtl", {}) if isinstance(extras, dict) else {}
    lines += [f"{key} {value}" for key, value in kept.items()]
    lines += [f"Kd {r:.6g} {g:.6g} {b:.6g}", f"d {a:.6g}"]
    lines += [f"Pr {pbr.get('roughnessFactor', 1.0):.6g}", f"Pm {pbr.get('metallicFactor', 1.0):.6g}"]
    glow = tree.get("emissiveFactor", (0, 0, 0))
    if any(glow):
        lines.append("Ke {:.6g} {:.6g} {:.6g}".format(*glow))
    for word, info in (
        ("map_Kd", pbr.get("baseColorTexture")),
        ("norm", tree.get("normalTexture")),
        ("map_Ke", tree.get("emissiveTexture")),
    ):
        ref = texture_ref(info)
        target = None if ref is None else file_name(ref.texture)
        if ref is None or target is None:
            continue
        options = ""
        if ref.scale != (1.0, 1.0) or ref.offset != (0.0, 0.0):
            options = f"-s {ref.scale[0]:.9g} {ref.scale[1]:.9g} 1 "
            options += f"-o {ref.offset[0]:.9g} {1.0 - ref.scale[1] - ref.offset[1]:.9g} 0 "
        lines.append(f"{word} {options}{target}")
        if word == "map_Kd" and tree.get("alphaMode", "OPAQUE") != "OPAQUE":
            lines.append(f"map_d {options}{target}")
    return "\n".join(lines) + "\n\n"
