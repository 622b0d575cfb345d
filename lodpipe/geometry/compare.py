"""How different two models look, from pictures of both; docs/measuring.md has the definitions."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from lodpipe.core.asset import Asset, ErrorFigures, VisualFigures
from lodpipe.core.cache import Cache
from lodpipe.geometry.distance import distance_between
from lodpipe.geometry.metrics import SMALLEST, Sums, difference, facing_angles, flip_map
from lodpipe.geometry.palette import heat
from lodpipe.geometry.pictures import Gallery, Setup, Shot, framed, in_threads
from lodpipe.geometry.render import as_bytes, finished
from lodpipe.geometry.sheet import contact_sheet
from lodpipe.geometry.slip import Slip, texture_slip
from lodpipe.geometry.texture import U8, Textures
from lodpipe.geometry.visible import Sight
from lodpipe.kernel.pictures import shrunk

Progress = Callable[[float, float], None]


def _silent(done: float, total: float) -> None:
    pass


NAMES = ("a", "b", "difference")
EQUAL = "the pictures are equal"
BOUND = "at least: no difference is seen in the largest pictures that were taken"
NOTHING = "neither model shows anything"


@dataclass(frozen=True)
class Comparison:
    """Two models side by side. A figure that does not exist is None; `reasons` says why under its name."""

    visual: VisualFigures
    error: ErrorFigures | None
    """Distances in % of a's bounding-box diagonal."""
    texture: Slip | None
    by_size: tuple[dict[str, float | int | None], ...]
    """The pictures shrunk: `size`, `luminance_rms`, `psnr`, `ssim`."""
    reasons: Mapping[str, str]

    def data(self) -> dict[str, Any]:
        """As plain data, a reason beside each figure that does not exist."""
        error = None if self.error is None else {"unit": "percent_of_diagonal", **asdict(self.error)}
        reasons = {f"{name}_reason": reason for name, reason in self.reasons.items()}
        texture = None if self.texture is None else {"unit": "percent_of_diagonal", **asdict(self.texture)}
        sizes = list(self.by_size)
        return {"visual": self.visual.data(), "error": error, "texture": texture, "by_size": sizes, **reasons}


def galleries(
    a: Asset, b: Asset, textures: tuple[Textures, Textures], setup: Setup, threads: int = 0
) -> tuple[Gallery, Gallery]:
    """The pictures of two models with the same cameras, framed for `a`. `textures` are a's and b's."""
    first = Gallery(a, setup, textures[0], threads=threads)
    second = Gallery(b, setup, textures[1], threads=threads)
    first.frame = second.frame = framed(first.model, second.model)
    return first, second


def compare_models(
    a: Gallery, b: Gallery, *, samples: int = 100_000, seed: int = 0, progress: Progress = _silent
) -> Comparison:
    """How different `b` is from `a`, in pictures and in distance."""
    visual = compare_pictures(a, b, progress)
    sizes = tuple(_shrunk_figures(a, b, size) for size in _sizes(a.setup.size))
    soups = a.model.soup, b.model.soup
    if not all(len(soup.faces) for soup in soups):
        nothing = "a model without triangles has no distance"
        return Comparison(visual, None, None, sizes, {"error": nothing, "texture": nothing})
    error = distance_between(*soups, samples=samples, seed=seed, threads=a.threads)
    slip = texture_slip(a.model, b.model, samples, seed)
    if isinstance(slip, str):
        return Comparison(visual, error, None, sizes, {"texture": slip})
    return Comparison(visual, error, slip, sizes, {})


def _sizes(size: int) -> list[int]:
    """The set-up's size, and what halving makes of it down to 32 pixels."""
    return [size >> step for step in range(8) if step == 0 or size >> step >= 32]


def _shrunk_figures(a: Gallery, b: Gallery, size: int) -> dict[str, float | int | None]:
    """Figures of the pictures as they look from farther away, `size` pixels high."""

    def work(view: int) -> Sums:
        pair = [shrunk(gallery.shot(view).colours, size) for gallery in (a, b)]
        shown = (pair[0][..., 3] > 0) | (pair[1][..., 3] > 0)
        background, linear = a.setup.background(view), a.setup.lighting.linear
        x, y = (finished(colours, background, linear) for colours in pair)
        return difference(x, y, shown, scales=False)

    sums = Sums()
    for part in in_threads(work, a.setup.views, a.threads):
        sums += part
    return {"size": size, "luminance_rms": sums.luminance_rms, "psnr": sums.psnr, "ssim": _mean(sums.ssim)}


def pictures(a: Gallery, b: Gallery) -> Iterator[tuple[str, U8]]:
    """For each view both pictures and FLIP's map of where they differ (`heat`), and last a sheet of them all: names
    without ending, and pixels (H, W, 3)."""
    rows: list[U8] = []
    for view in range(a.setup.views):
        pair = [gallery.picture(gallery.shot(view), view) for gallery in (a, b)]
        images = [as_bytes(picture) for picture in (*pair, heat(flip_map(*pair)))]
        rows += images
        yield from ((f"view{view + 1:02d}_{name}", image) for name, image in zip(NAMES, images, strict=True))
    yield "all", contact_sheet(rows, [*NAMES, *("" for _ in rows[len(NAMES) :])], columns=len(NAMES))


def look_at_levels(
    asset: Asset,
    textures: Callable[[Asset], Textures],
    setup: Setup,
    *,
    threads: int = 0,
    cache: Cache | None = None,
    progress: Progress = _silent,
) -> list[VisualFigures]:
    """The visual figures of each of `asset.lods` against `asset` itself, whose pictures are kept in `cache`.

    `textures` makes those of an asset; levels that have no materials of their own share the source's.
    """
    shared = textures(asset)
    source = Gallery(asset, setup, shared, threads=threads, cache=cache or Cache())
    result = []
    for number, level in enumerate(asset.lods):
        if level.own is None and all(x is y for x, y in zip(level.meshes, asset.meshes, strict=True)):
            other = source
        else:
            at = asset.at(level)
            other = Gallery(at, setup, shared if level.own is None else textures(at), source.sphere, threads)

        def share(done: float, total: float, number: int = number) -> None:
            progress(number * total + done, len(asset.lods) * total)

        result.append(compare_pictures(source, other, share))
    return result


def compare_pictures(a: Gallery, b: Gallery, progress: Progress = _silent) -> VisualFigures:
    """The figures of `b` against `a`, over all views of a's set-up. Both must have the same frame and set-up."""
    sums = Sums()
    for gallery in (a, b):
        gallery.model.prepare()
    shots = in_threads(lambda view: compare_shots(a, view, a.shot(view), b.shot(view)), a.setup.views, a.threads)
    for done, part in enumerate(shots, 1):
        sums += part
        progress(done, a.setup.views)
    result = figures(sums, a.setup.views, a.setup.size)
    if not sums.shown:
        return result
    height, seen = Sight(a).unseen_height(b)
    bound = {} if seen else {"unseen_height": BOUND}
    return replace(result, unseen_height=height, reasons={**result.reasons, **bound})


def compare_shots(gallery: Gallery, view: int, a: Shot, b: Shot) -> Sums:
    """What two shots from the direction `view` differ by."""
    flip = view % gallery.setup.flip_every == 0
    sums = difference(gallery.picture(a, view), gallery.picture(b, view), a.hit | b.hit, flip=flip)
    both = a.hit & b.hit
    sums.both = int(both.sum())
    sums.angle = facing_angles(a.facing[both], b.facing[both])
    return sums


def figures(sums: Sums, views: int, size: int) -> VisualFigures:
    """The figures that `sums` over `views` pictures amount to."""
    reasons = {}
    if not sums.shown:
        missing = ("psnr", "ssim", "ms_ssim", "flip", "silhouette_iou", "normal_degrees", "unseen_height")
        reasons = dict.fromkeys(missing, NOTHING)
    else:
        if sums.psnr is None:
            reasons["psnr"] = EQUAL
        if not sums.ssim:
            small = f"the pictures are smaller than {SMALLEST} pixels"
            reasons |= {"ssim": small, "ms_ssim": small}
        if not sums.both:
            reasons["normal_degrees"] = "there is no place where both are seen"
    return VisualFigures(
        luminance_rms=sums.luminance_rms,
        psnr=sums.psnr,
        ssim=_mean(sums.ssim),
        ms_ssim=_mean(sums.ms_ssim),
        flip=_mean(sums.flip),
        silhouette_iou=sums.silhouette_iou,
        normal_degrees=sums.normal_degrees,
        unseen_height=None,
        views=views,
        size=size,
        reasons=reasons,
    )


def _mean(values: Sequence[float]) -> float | None:
    return sum(values) / len(values) if values else None
