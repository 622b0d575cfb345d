"""What report.html shows besides the report's figures: previews of the models and pictures, as bytes in memory."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Picture:
    """A picture for the page and for the folder `images`."""

    name: str
    """File name."""
    kind: str
    """shaded, difference, thumbnail or sheet."""
    alt: str
    """What is on it, in words."""
    data: bytes
    width: int
    height: int
    level: int | None = None
    view: int = 0
    """Number of the direction that it was taken from."""


@dataclass(frozen=True)
class Scale:
    """What a layer's colours mean: `colors` (sRGB, ``#rrggbb``) spread evenly from 0 to 1, or one for each label."""

    colors: tuple[str, ...]
    ticks: tuple[tuple[float, str], ...] = ()
    """Place on the scale, 0…1, and what stands there."""
    labels: tuple[str, ...] = ()
    """What each colour stands for, where they are no scale."""


@dataclass(frozen=True)
class Layer:
    """A property of the surface as colours: errors, segments, weights."""

    name: str
    title: str
    about: str
    """What is seen, in a sentence."""
    scale: Scale
    models: dict[int, str]
    """For each level that has it the preview's name in `Page.files`. Without one for level 0 its textured model stands
    beside the others."""


@dataclass
class Page:
    """Material of the page of one asset. Models have their centre at the origin and a radius of 1."""

    files: dict[str, bytes] = field(default_factory=dict)
    """Previews: glTF files and what these name (buffers, images), by name. Never compressed but for their images."""
    models: dict[int, str] = field(default_factory=dict)
    """For each level that can be shown in 3-D its glTF in `files`."""
    stand_ins: dict[int, int] = field(default_factory=dict)
    """Levels too large for a page, and the triangles of what is shown in their place."""
    layers: list[Layer] = field(default_factory=list)
    pictures: list[Picture] = field(default_factory=list)
    views: list[str] = field(default_factory=list)
    """What each direction is called."""
    notes: list[str] = field(default_factory=list)
    """What was left out of the page, and why."""
