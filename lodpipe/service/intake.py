"""Between the queue and the worker: copy the asset, and see whether its result is there already."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lodpipe.core.errors import LodpipeError
from lodpipe.io.limits import Limits
from lodpipe.io.needs import Needs
from lodpipe.service import manifest
from lodpipe.service.job import PASSING, nature_of
from lodpipe.service.publish import Output
from lodpipe.service.recipe import Recipe
from lodpipe.service.settle import Signature
from lodpipe.service.snapshot import Changed, Snapshot, take


@dataclass(frozen=True)
class Order:
    """An asset to take in."""

    key: str
    place: str
    needs: Needs
    expected: Mapping[str, Signature]
    recipe: Recipe
    limits: Limits


@dataclass
class Taken:
    """What came of it. The copy stays until `release`."""

    order: Order
    content: str = ""
    snapshot: Snapshot | None = None
    current: dict[str, Any] | None = None
    """The manifest of the result, if it is there and whole."""
    changed: bool = False
    """Whether the asset changed meanwhile and must settle again."""
    error: LodpipeError | OSError | None = None
    hold: contextlib.ExitStack = field(default_factory=contextlib.ExitStack)

    @property
    def passing(self) -> bool:
        """Whether the error is trouble that goes away by itself."""
        return nature_of(self.error) == PASSING

    def release(self) -> None:
        """Remove the copy."""
        self.hold.close()


def take_in(order: Order, output: Output, root: Path) -> Taken:
    """Copy an asset into a workspace of its own and hash it. What goes wrong is in the answer, not raised."""
    taken = Taken(order)
    try:
        workspace = taken.hold.enter_context(output.workspace())
        taken.snapshot = take(root, order.key, order.needs, order.expected, workspace, order.limits)
        taken.content = manifest.fingerprint(taken.snapshot.entries, order.recipe)
        taken.current = manifest.current(output.root / order.place, taken.snapshot.path, order.recipe)
    except Changed:
        taken.changed = True
    except (LodpipeError, OSError) as error:
        taken.error = error
    if taken.snapshot is None:
        taken.release()
    return taken
