"""Everything that lodpipe raises on purpose. One class for each cause, one place that maps them to exit codes."""

from __future__ import annotations


class LodpipeError(Exception):
    """A problem that a user can understand and mend: shown as one line, never as a traceback.

    The line reads ``place: cause; advice``. `place` is a file, or a file with a position in it
    (``model.glb: meshes[2].primitives[0]``, ``chain.yaml:12:5``); `advice` says what to do.
    """

    exit_code = 1

    def __init__(self, cause: str, *, place: str = "", advice: str = "") -> None:
        self.cause = " ".join(cause.split())
        self.place = place
        self.advice = " ".join(advice.split())
        super().__init__(str(self))

    def __str__(self) -> str:
        text = f"{self.place}: {self.cause}" if self.place else self.cause
        return f"{text}; {self.advice}" if self.advice else text

    def at(self, place: str) -> LodpipeError:
        """The same error with `place` put before what is already known of the place."""
        joined = f"{place}: {self.place}" if self.place else place
        return type(self)(self.cause, place=joined, advice=self.advice)


class AssetError(LodpipeError):
    """A file that cannot be read: truncated, malformed, empty, unsafe or of an unknown format."""


class InvalidMesh(LodpipeError):
    """Arrays that do not form a mesh: wrong shape or type, an index out of range, a value that is not finite."""


class ConfigError(LodpipeError):
    """A chain, a preset or a ``--set`` that is not valid."""


class LimitError(LodpipeError):
    """A limit of the configuration (triangles, texture pixels, memory, minutes) would be exceeded."""


class OutputError(LodpipeError):
    """The result cannot be written: no space, no permission, a name already taken."""


class Cancelled(LodpipeError):
    """The user, or a service that is shutting down, asked for the work to stop."""

    exit_code = 130
