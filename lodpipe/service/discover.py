"""Files, folders and globs to a list of assets, each with the place of its output."""

from __future__ import annotations

import glob
import itertools
import os
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from lodpipe import io
from lodpipe.core.errors import AssetError, LodpipeError, OutputError
from lodpipe.io.paths import stem

STATE = ".lodpipe"
"""The folder in an output folder that marks it as one: temporary folders, the daemon's state."""

NAME_BYTES = 180
"""Longest name of a result: with `_LOD0`, the name of a texture and an ending it still has to be one (255 bytes)."""


@dataclass(frozen=True)
class Found:
    """An asset, and where its output goes: ``<output>/<folder>/<name>/``."""

    path: Path
    folder: str
    """Relative, with slashes; empty for none."""
    name: str

    @property
    def place(self) -> PurePosixPath:
        """Folder and name."""
        return PurePosixPath(self.folder, self.name)


def find_assets(inputs: Iterable[str | os.PathLike[str]], output: Path) -> tuple[list[Found], list[LodpipeError]]:
    """The assets that `inputs` name, in order, and what could not be found.

    A file stands for itself; a folder for every asset in and below it, whose relative folders the output keeps; a
    glob (``models/**/*.glb``) for what it matches, relative to its fixed part. Hidden files and folders, `output`
    and other output folders of lodpipe are left out of folders and globs. A file that is named twice counts once.
    """
    wanted: list[tuple[Path, str]] = []
    problems: list[LodpipeError] = []
    seen: set[Path] = set()
    for given in inputs:
        try:
            for path, folder in _expand(os.fspath(given), output.resolve()):
                if (real := path.resolve()) not in seen:
                    seen.add(real)
                    wanted.append((path, folder))
        except LodpipeError as error:
            problems.append(error)
    return _named(wanted), problems


def _expand(given: str, output: Path) -> list[tuple[Path, str]]:
    path = Path(given)
    if path.is_dir():
        _check_apart(path, output, given)
        found = [(file, _relative(file.parent, path)) for file in _walk(path, output)]
        if not found:
            raise AssetError("has no assets in it", place=given, advice=f"known formats: {', '.join(io.FORMATS)}")
        return found
    if path.exists():
        return [(path, "")]
    if glob.has_magic(given):
        root = _fixed_part(path)
        _check_apart(root, output, given)
        matches = sorted(Path(match) for match in glob.glob(given, recursive=True))  # noqa: PTH207 it takes whole paths
        files = dict.fromkeys(
            file for match in matches for file in (_walk(match, output) if match.is_dir() else [match])
        )
        found = [(file, _relative(file.parent, root)) for file in files if _is_free(file, root, output)]
        if not found:
            raise AssetError("matches no asset", place=given, advice=f"known formats: {', '.join(io.FORMATS)}")
        return found
    raise AssetError("there is no such file or folder", place=given, advice="check the path; quote globs")


def _check_apart(root: Path, output: Path, given: str) -> None:
    """Results must not become inputs of the next run."""
    if root.resolve().is_relative_to(output):
        raise OutputError(f"lies in the output folder {output}", place=given, advice="choose another output folder")


def _walk(top: Path, output: Path) -> Iterator[Path]:
    for folder, folders, files in os.walk(top):
        here = Path(folder)
        folders[:] = sorted(
            name
            for name in folders
            if not name.startswith(".") and not (here / name / STATE).is_dir() and (here / name).resolve() != output
        )
        yield from (path for path in (here / name for name in sorted(files)) if _is_candidate(path))


def _is_candidate(path: Path) -> bool:
    return not path.name.startswith((".", "~$")) and path.is_file() and io.is_asset(path)


def _is_free(path: Path, root: Path, output: Path) -> bool:
    """Whether a glob's match is an asset outside of `output` and of every other output folder below `root`."""
    folders = path.relative_to(root).parents[:-1]
    return (
        _is_candidate(path)
        and not path.resolve().is_relative_to(output)  # by a link
        and not any((root / folder / STATE).is_dir() for folder in folders)
    )


def _fixed_part(pattern: Path) -> Path:
    parts = []
    for part in pattern.parts[:-1]:
        if glob.has_magic(part):
            break
        parts.append(part)
    return Path(*parts)


def _relative(folder: Path, root: Path) -> str:
    text = folder.relative_to(root).as_posix()
    return "" if text == "." else text


def _named(wanted: list[tuple[Path, str]]) -> list[Found]:
    """A name of its own for each output, whatever the file system thinks of upper and lower case.

    The file's name without its ending; where that is taken, with the format after it (``duck_obj``), then with a
    number. Taken is also what other assets need as a folder. Formats go in the order of `io.FORMATS`, so that
    ``duck.glb`` keeps its name beside ``duck.obj``.
    """
    order = [suffix.lstrip(".") for suffix in io.FORMATS]
    rank = {
        index: order.index(_format(path)) if _format(path) in order else len(order)
        for index, (path, _) in enumerate(wanted)
    }
    taken = {
        str(parent).casefold()
        for _, folder in wanted
        for parent in (PurePosixPath(folder), *PurePosixPath(folder).parents)
    }
    names: dict[int, str] = {}
    for index in sorted(rank, key=lambda index: (rank[index], index)):
        path, folder = wanted[index]
        names[index] = next(name for name in _choices(path) if _fold(folder, name) not in taken)
        taken.add(_fold(folder, names[index]))
    return [Found(path, folder, names[index]) for index, (path, folder) in enumerate(wanted)]


def _choices(path: Path) -> Iterator[str]:
    """Names for the output of a file, the best first."""
    name = stem(path).rstrip(". ") or "asset"
    while len(os.fsencode(name)) > NAME_BYTES:
        name = name[:-1].rstrip(". ")
    name = f"_{name[1:]}" if name.startswith(".") else name
    yield name
    yield f"{name}_{_format(path)}"
    yield from (f"{name}_{_format(path)}_{number}" for number in itertools.count(2))


def _fold(folder: str, name: str) -> str:
    return str(PurePosixPath(folder, name)).casefold()


class Places:
    """The same for assets that turn up one by one: a place that was given stays, later ones step back."""

    def __init__(self, given: Iterable[str] = ()) -> None:
        self._assets: set[str] = set()
        self._folders: Counter[str] = Counter()
        for place in given:
            self._add(place)

    def give(self, path: PurePosixPath) -> str:
        """The place of the asset at a path relative to the watched folder."""
        folder = ""
        for part in path.parent.parts:
            here = str(PurePosixPath(folder, part))
            while here.casefold() in self._assets:
                here += "_"
            folder = here
        place = next(
            str(PurePosixPath(folder, name))
            for name in _choices(Path(path.name))
            if _fold(folder, name) not in self._assets and not self._folders[_fold(folder, name)]
        )
        self._add(place)
        return place

    def free(self, place: str) -> None:
        """The place is not needed any more."""
        self._assets.discard(place.casefold())
        self._folders.subtract(self._above(place))

    def _add(self, place: str) -> None:
        self._assets.add(place.casefold())
        self._folders.update(self._above(place))

    @staticmethod
    def _above(place: str) -> list[str]:
        return [str(parent) for parent in PurePosixPath(place.casefold()).parents]


def _format(path: Path) -> str:
    return path.suffix.lower().lstrip(".")
