"""What is wrong with a configuration: all of it, one line each, with the nearest right word."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass

from lodpipe.core.errors import ConfigError


@dataclass(frozen=True)
class Problem:
    """One line: ``place: subject: cause``."""

    place: str
    subject: str
    cause: str

    def __str__(self) -> str:
        return ": ".join(part for part in (self.place, self.subject, self.cause) if part)


class ConfigErrors(ConfigError):
    """Several problems of one configuration; shown one line each."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(problems)
        first = self.problems[0]
        super().__init__(first.cause, place=": ".join(part for part in (first.place, first.subject) if part))

    def __str__(self) -> str:
        return "\n".join(str(problem) for problem in self.problems)

    def at(self, place: str) -> ConfigErrors:
        """The same problems: each has its place already."""
        return self


class Problems:
    """A list of problems that becomes one exception."""

    def __init__(self) -> None:
        self.found: list[Problem] = []

    def add(self, problem: Problem) -> None:
        """Note `problem`, once."""
        if problem not in self.found:
            self.found.append(problem)

    def raise_all(self) -> None:
        """Raise ConfigErrors if there is any."""
        if self.found:
            raise ConfigErrors(self.found)


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """``; did you mean 'x'?`` for the nearest of `known`, else ``; known: a, b`` where they are few, else nothing."""
    names = sorted(known)
    near = difflib.get_close_matches(word, names, n=1, cutoff=0.6) or [
        name for name in names if name.casefold() == word.casefold()
    ]
    if near:
        return f"; did you mean '{near[0]}'?"
    return f"; known: {', '.join(names)}" if names and len(names) <= 12 else ""
