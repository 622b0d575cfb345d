"""The daemon's mind: what it sees in the watched folder, what it knows in the job table, and what follows from both.

`tick` looks once at everything and does what is due; it never waits. Threads, signals and the waiting are those of
`lodpipe.service.watch`, which calls it.
"""

from __future__ import annotations

import dataclasses
import logging
import os
from collections import deque
from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import Any

from lodpipe import io
from lodpipe.config.watch import Watch
from lodpipe.core.errors import LodpipeError
from lodpipe.io.needs import Needs
from lodpipe.service import dispose, manifest
from lodpipe.service.batch import job_of, threads_for
from lodpipe.service.clock import Clock
from lodpipe.service.discover import Found
from lodpipe.service.executors import Executor
from lodpipe.service.intake import Order, Taken, take_in
from lodpipe.service.job import AGAIN, INPUT, PASSING, Failure, Job, Outcome, fail, published_outcome
from lodpipe.service.ledger import LONGEST_PAUSE, Ledger, about
from lodpipe.service.lookout import Lookout
from lodpipe.service.pool import process_start
from lodpipe.service.priority import priority_of, rank
from lodpipe.service.publish import Output
from lodpipe.service.recipe import Recipe
from lodpipe.service.root import RootGuard
from lodpipe.service.scan import Tree
from lodpipe.service.settle import Signature, judge
from lodpipe.service.sight import Sight
from lodpipe.service.snapshot import member_path
from lodpipe.service.table import (
    AT_REST,
    DONE,
    FAILED,
    GONE,
    QUEUED,
    RUNNING,
    SAME,
    SETTLING,
    WAITING,
    JobTable,
    Row,
)

LEASE_SECONDS = 60.0
PROGRESS_SECONDS = 1.0
"""Shortest time between two notes of a running job's progress."""
DEATHS = 3
"""How often, for each attempt that an asset has, the daemon itself may die with it before it counts as poison."""
NEVER = float("inf")
INTERRUPTED = "interrupted"
_FORMATS = tuple(io.FORMATS)

Submit = Callable[[Callable[[], Taken], Callable[[Taken], None]], None]
"""Runs the first, perhaps in a thread, and gives what it returns to the second."""


class Daemon:
    """One watched folder, one output folder, one job table. Not thread-safe, but for `progress`, `ended`, `dirty`."""

    def __init__(
        self,
        root: Path,
        output: Output,
        table: JobTable,
        recipe: Recipe,
        *,
        clock: Clock,
        submit: Submit,
        wake: Callable[[], None],
        log: logging.Logger,
        owner: str,
        once: bool = False,
    ) -> None:
        self.root, self.output, self.table, self.clock = root, output, table, clock
        self.log, self.owner, self.once = log, owner, once
        self.executor: Executor | None = None
        self.draining = False
        self._submit, self._wake = submit, wake
        self._lookout = Lookout(RootGuard(root, table), table, clock, wake, log)
        self._ledger = Ledger(table, clock, log, root, output.root)
        self._sight = Sight(Tree(root), io.Limits())
        self.paused = False
        self.apply(recipe)
        self._news: deque[Callable[[], None]] = deque()
        self._due: dict[str, float] = {}
        self._taking: set[str] = set()
        self._ready: dict[str, Taken] = {}
        self._running: dict[str, tuple[Taken, float]] = {}
        self._noted: dict[str, float] = {}
        self._changes = -1
        self.recover()

    # --- what others tell it, from any thread

    def dirty(self, folder: str | None, name: str = "", closed: bool = False) -> None:
        """Something has changed in a folder, relative to the watched one; None: nobody knows where.

        Of the file `name` in it, whether its writer has `closed` it.
        """
        self._lookout.tell(folder, name, closed)

    def progress(self, key: str, step: int, stage: str, share: float) -> None:
        """A job is on its way."""
        self._news.append(lambda: self._note_progress(key, step, stage, share))

    def ended(self, key: str, outcome: Outcome | None) -> None:
        """A job is through, or was stopped."""
        self._tell(lambda: self._finish(key, outcome))

    def _tell(self, news: Callable[[], None]) -> None:
        self._news.append(news)
        self._wake()

    # --- the cycle

    def apply(self, recipe: Recipe) -> None:
        """Go on with another configuration; assets that it makes other results of are queued again."""
        self.recipe = recipe
        self.watch = Watch.model_validate(recipe.config["watch"])
        limits = recipe.config["limits"]
        self.limits = io.Limits(**{name: limits[name] for name in ("triangles", "texture_pixels", "input_bytes")})
        self._ledger.watch = self.watch
        self._ledger.forgive([limits, self.watch.missing, self.watch.wait_s, self.watch.attempts])
        known = self._sight.tree.folders
        self._sight = Sight(Tree(self.root, (self.output.root.resolve(),), self.watch.ignore, known), self.limits)
        self._lookout.tell(None)

    def tick(self) -> float:
        """Do what is due; the monotonic time at which something will be due next."""
        self.last_news()
        if (changes := self.table.changes()) != self._changes:
            self._changes = changes
            self._requests()
        now = self.clock.monotonic()
        if self._lookout.look(now, self._sight.tree, self.watch):
            self._compare(now)
        for key in [key for key, due in self._due.items() if due <= now]:
            self._judge(key, now)
        self._dispatch()
        return min([self._lookout.due(self.watch), *self._due.values(), self._next_try()])

    def last_news(self) -> None:
        """Take in what has been told. What cannot be taken in now (a full disk) stays the first to be taken next."""
        while self._news:
            self._news[0]()
            self._news.popleft()

    @property
    def problem(self) -> str:
        """Why nothing is done although it is not paused: the watched folder is gone."""
        return self._lookout.problem

    def polls(self, yes: bool) -> None:
        """Whether no events come, so that the folder must be listed more often."""
        self._lookout.polling = yes

    @property
    def outcomes(self) -> int:
        """How often the output folder has changed since the start."""
        return self._ledger.outcomes

    @property
    def running(self) -> bool:
        """Whether a job runs."""
        return bool(self._running)

    @property
    def threads(self) -> int:
        """Most threads for each job, 0 for all cores."""
        return threads_for(self.recipe, self.watch.workers)

    @property
    def busy(self) -> bool:
        """Whether a job runs or is about to."""
        return bool(self._running or self._taking or self._ready)

    @property
    def finished(self) -> bool:
        """Whether, without new files, nothing more will be done."""
        return not self.busy and not any(
            row.state in (SETTLING, WAITING, RUNNING) or (row.state == QUEUED and row.trouble < 3 and not self.paused)
            for row in self._ledger.open.values()
        )

    def stop_jobs(self) -> None:
        """End the running jobs; they stay queued."""
        for key in self._running:
            self._executor.stop(key)

    def close(self) -> None:
        """Let go of the copies that were waiting for a job."""
        for taken in self._ready.values():
            taken.release()
        self._ready.clear()

    def recover(self) -> None:
        """Take from the table what is known: at the start, and after it could not be written for a while."""
        self._ledger.load()
        for row in self._ledger.rows.values():
            if row.state == RUNNING and row.key not in self._running:
                self._ledger.set(row, QUEUED, reason=INTERRUPTED)
                if row.attempts >= DEATHS * self.watch.attempts:
                    cause = f"the daemon has died {row.attempts} times while it was processed"
                    self._quarantine(
                        row, Failure(row.stage, cause, str(self.root / row.key), "`lodpipe retry`", "Crash")
                    )
        self._lookout.tell(None)

    @property
    def _executor(self) -> Executor:
        if self.executor is None:
            raise LodpipeError("the daemon has no executor")
        return self.executor

    def _requests(self) -> None:
        self.paused = bool(self.table.fact("paused", False))
        for number, data in self.table.requests():
            if data["what"] == "retry":
                for key in (os.fsdecode(bytes.fromhex(name)) for name in data["keys"]):
                    if (row := self._ledger.rows.get(key)) and row.state in (*AT_REST, QUEUED):
                        self._ledger.retry(row, force=bool(data.get("force")))
                        self._due[key] = 0.0
            elif data["what"] == "accept_root":
                self._lookout.accept()
            self.table.end_request(number)

    # --- looking

    def _compare(self, now: float) -> None:
        """Judge every asset that is not at rest or is another one than when it was taken."""
        found = {path for path in self._sight.tree if path.lower().endswith(_FORMATS)}
        for key in found:
            row = self._ledger.rows.get(key)
            if row is None or row.state not in AT_REST or not self._settled(row, now):
                self._judge(key, now)
        for key in [key for key in self._ledger.rows if key not in found]:
            self._vanished(self._ledger.rows[key])

    def _settled(self, row: Row, now: float) -> bool:
        """Whether a row at rest has nothing to be done."""
        return row.recipe == self.recipe.id and not row.force and self._sight.same(row.signature, now)

    def _judge(self, key: str, now: float) -> None:
        """Move one asset on: settling, waiting for members, queued."""
        self._due.pop(key, None)
        seen = self._sight.tree.get(key)
        if seen is None or key in self._running or key in self._taking or key in self._ready:
            return
        row = self._ledger.rows.get(key) or self._ledger.new(key)
        if row.state in AT_REST and self._settled(row, now):
            return
        if row.state == QUEUED and self._sight.same(row.signature, now):
            return
        if row.state in AT_REST or row.state == GONE:
            self._ledger.set(row, SETTLING, reason=self._why(row, now), disposed=0)
        if now < (quiet := seen.rests(self.watch.settle_s, self.watch.closed_s)):
            self._due[key] = quiet
            if row.state != SETTLING:
                self._ledger.set(row, SETTLING, message="", missing=[])
            if self.executor:
                self.executor.prepare()
            return
        needs = self._sight.needs(key, now)
        members = {}
        missing = list(needs.missing)
        for name, length in needs.members.items():
            member = self._sight.seen(member_path(key, name), now)
            if member is None:
                missing.append(name)
            else:
                members[name] = (member, length)
        wait_s = 0.0 if self.once else self.watch.wait_s
        watch = self.watch
        verdict = judge(seen, members, missing, now, settle_s=watch.settle_s, closed_s=watch.closed_s, wait_s=wait_s)
        signature: dict[str, list[int] | None] = {member_path(key, name): None for name in (*needs.wanted, *missing)}
        signature |= {member_path(key, name): list(member.signature) for name, (member, _) in members.items()}
        signature[key] = list(seen.signature)
        facts: dict[str, Any] = {
            "signature": signature,
            "members": [key, *(member_path(key, name) for name in members)],
            "size": seen.signature.size + sum(member.signature.size for member, _ in members.values()),
        }
        if verdict.ready or (verdict.given_up and self.watch.missing == "process"):
            again = row.state == QUEUED
            self._ledger.set(
                row,
                QUEUED,
                **facts,
                missing=[],
                message="",
                priority=priority_of(key, self.watch.priorities),
                queued_at=row.queued_at if again else self.clock.time(),
                not_before=row.not_before if again else 0.0,
                reason=row.reason or "new",
            )
        elif verdict.given_up:
            self._give_up(row, facts, verdict.missing)
        else:
            self._due[key] = verdict.due
            text = f"waits for {', '.join(verdict.missing)}" if verdict.missing else ""
            state = WAITING if verdict.missing else SETTLING
            if (row.state, row.missing) != (state, list(verdict.missing)):
                self._ledger.set(row, state, missing=list(verdict.missing), message=text, **facts)

    def _why(self, row: Row, now: float) -> str:
        if row.force:
            return "asked for"
        if changed := self._sight.changed(row.signature, now):
            return f"changed: {', '.join(changed)}"
        return row.reason if row.reason == "asked for" else "the configuration changed"

    def _vanished(self, row: Row) -> None:
        """An asset's file is not there any more. Its result stays."""
        if row.key in self._running or row.key in self._taking or row.key in self._ready:
            return
        self._due.pop(row.key, None)
        self._sight.forget(row.key)
        if row.state == GONE or row.disposed:
            return
        if row.state == FAILED:
            self.output.forget_failure(PurePosixPath(row.place))
        if row.revision:
            if self.watch.on_removed == "archive":
                dispose.archive(self.output, row.place)
            self._ledger.set(row, GONE, message="", missing=[])
        else:
            self._ledger.forget(row)
        self._ledger.outcomes += 1
        stays = "; its result stays" if row.revision else ""
        self.log.info("%s: gone%s", row.key, stays, extra=about(row))

    def _give_up(self, row: Row, facts: dict[str, Any], missing: tuple[str, ...]) -> None:
        failure = Failure(
            "wait",
            f"missing: {', '.join(missing)}",
            str(self.root / row.key),
            "put the files beside it and it is taken up again; `watch.missing: process` does without them",
            "AssetError",
        )
        self._quarantine(row, failure, **facts, missing=list(missing), content="", failed="")

    def _quarantine(self, row: Row, failure: Failure, **facts: Any) -> None:
        """Leave a record of what cannot even be begun."""
        job = dataclasses.replace(self._job(row, ""), records=(INPUT, AGAIN, PASSING))
        try:
            outcome = fail(job, self.output, failure)
        except LodpipeError as error:  # no space for the record: as long as that lasts, it waits
            self._ledger.put_off(row, str(error))
            return
        self._ledger.failed(row, outcome, self.recipe.id, **facts)

    # --- doing

    def _next_try(self) -> float:
        """When a queued asset that was put off is due, as monotonic time."""
        now = self.clock.time()
        ahead = [_ahead(row, now) for row in self._ledger.open.values() if row.state == QUEUED]
        return self.clock.monotonic() + min(filter(None, ahead), default=NEVER)

    def _dispatch(self) -> None:
        if self.draining or self.paused or self.problem:
            return
        for key in [*self._ready]:
            if len(self._running) < self._executor.slots:
                self._start(self._ready.pop(key))
        queued = [row for row in self._ledger.open.values() if row.state == QUEUED]
        if not queued:
            if not self.busy and not self._due:
                self._executor.rest()
            return
        now = self.clock.time()
        held = {self._ledger.rows[key].content for key in (*self._running, *self._ready)} - {""}
        waiting = sorted(
            (
                row
                for row in queued
                if not _ahead(row, now)
                and row.key not in self._taking
                and row.key not in self._ready
                and row.content not in held
            ),
            key=rank,
            reverse=True,
        )
        while waiting and len(self._running) + len(self._taking) + len(self._ready) <= self._executor.slots:
            self._take(waiting.pop())

    def _take(self, row: Row) -> None:
        known = self._sight.needs(row.key, self.clock.monotonic())
        expected = {path: Signature(*said) for path, said in row.signature.items() if said}
        members = {name: size for name, size in known.members.items() if member_path(row.key, name) in expected}
        order = Order(row.key, row.place, Needs(members), expected, self.recipe, self.limits)
        self._taking.add(row.key)
        self._executor.prepare()
        self._submit(
            lambda: take_in(order, self.output, self.root),
            lambda taken: self._tell(lambda: self._taken(taken)),
        )

    def _taken(self, taken: Taken) -> None:
        """An asset has been copied: start its job, unless there is no need to."""
        key = taken.order.key
        self._taking.discard(key)
        row = self._ledger.rows[key]
        if taken.changed:
            self._settle_again(row, taken)
        elif taken.error is not None:
            if taken.passing or not isinstance(taken.error, LodpipeError):
                self._ledger.put_off(row, str(taken.error))
            else:
                place = str(self.root / key)
                kind = type(taken.error).__name__
                failure = Failure("load", taken.error.cause, place, taken.error.advice, kind)
                self._quarantine(row, failure, content="", failed="")
        elif self._has_published(row, taken):
            taken.release()
            outcome = published_outcome(self._job(row, ""))
            row.seconds = outcome.seconds
            self._succeed(row, outcome)
        elif not row.force and taken.current:
            self._rest(row, taken, DONE, "unchanged", revision=max(1, row.revision), same_as="")
        elif not row.force and row.failed == taken.content:
            taken.release()
            self._ledger.set(row, FAILED, recipe=self.recipe.id, content=taken.content)
        elif not row.force and (other := self._published_elsewhere(row, taken.content)):
            self._rest(row, taken, SAME, f"the same content as {other}", same_as=other)
        elif taken.content in {self._ledger.rows[k].content for k in (*self._running, *self._ready)}:
            taken.release()  # the same content is being made under another name: wait for that
            self._ledger.set(row, QUEUED, content=taken.content)
        else:
            row.content = taken.content
            self._ready[key] = taken

    def _settle_again(self, row: Row, taken: Taken) -> None:
        """Its files, or the configuration, have changed since it was queued."""
        taken.release()
        self._ledger.set(row, SETTLING)
        self._due[row.key] = self.clock.monotonic()
        for path in row.members:
            self.dirty(_folder(path))

    def _published_elsewhere(self, row: Row, content: str) -> str:
        """Where another asset's result of the same content is, whole; empty if nowhere."""
        if self.watch.same_content != "skip" or row.revision:  # what is published at its own place is kept fresh
            return ""
        other = self.table.published(content)
        if other is None or other.key == row.key or manifest.read(self.output.root / other.place) is None:
            return ""
        return other.place

    def _rest(self, row: Row, taken: Taken, state: str, text: str, **facts: Any) -> None:
        """Nothing to do: the result is there."""
        taken.release()
        self.output.forget_failure(PurePosixPath(row.place))
        self._ledger.current(row, state, text, content=taken.content, recipe=taken.order.recipe.id, **facts)
        self._sight.forget(row.key)
        self._dispose(row)

    def _start(self, taken: Taken) -> None:
        row = self._ledger.rows[taken.order.key]
        if taken.snapshot is None:
            raise AssertionError("an asset that is ready has been copied")
        if taken.order.recipe.id != self.recipe.id or self._sight.stale(row.signature):
            self._settle_again(row, taken)
            return
        attempts = row.attempts + 1
        job = self._job(row, str(taken.snapshot.path), last=attempts >= self.watch.attempts)
        self._ledger.set(
            row,
            RUNNING,
            attempts=attempts,
            owner=self.owner,
            content=taken.content,
            recipe=taken.order.recipe.id,
            leased_until=self.clock.time() + LEASE_SECONDS,
            stage="start",
        )
        self._running[row.key] = (taken, self.clock.monotonic())
        self.log.info("%s: start (%s)", row.key, row.reason, extra=about(row))
        self._executor.start(row.key, job, taken.content)
        pid = self._executor.process_of(row.key)
        self._ledger.set(row, RUNNING, pid=pid, pid_start=process_start(pid))

    def _job(self, row: Row, copy: str, *, last: bool = True) -> Job:
        place = PurePosixPath(row.place)
        folder = str(place.parent)
        asset = Found(self.root / row.key, "" if folder == "." else folder, place.name)
        job = job_of(asset, self.output.root, self.recipe, self.watch.workers)
        records = (INPUT, AGAIN) if last else (INPUT,)
        return dataclasses.replace(job, read_from=copy, fresh=bool(row.force), records=records)

    def _note_progress(self, key: str, step: int, stage: str, share: float) -> None:
        row, now = self._ledger.rows.get(key), self.clock.monotonic()
        if row is None or key not in self._running:
            return
        new = row.stage != stage
        row.step, row.stage, row.share = step, stage, share
        if new or now - self._noted.get(key, -NEVER) >= PROGRESS_SECONDS:
            self._noted[key] = now
            self.table.progress(key, step, stage, share, self.clock.time() + LEASE_SECONDS)

    def _finish(self, key: str, outcome: Outcome | None) -> None:
        """A job has ended: note what became of it."""
        if key not in self._running:
            return
        taken, begin = self._running.pop(key)
        self._noted.pop(key, None)
        row = self._ledger.rows[key]
        row.seconds = self.clock.monotonic() - begin
        if outcome is not None and outcome.nature == AGAIN and taken.snapshot and not row.force:
            # it may have died between publishing and saying so
            place = self.output.root / row.place
            taken.current = manifest.current(place, taken.snapshot.path, taken.order.recipe)
            outcome = published_outcome(self._job(row, "")) if self._has_published(row, taken) else outcome
        taken.release()
        if outcome is None:
            self._ledger.set(row, QUEUED, attempts=row.attempts - 1, reason=INTERRUPTED)
        elif outcome.outcome not in ("failed", "bug"):
            self._succeed(row, outcome)
        elif outcome.nature == PASSING:
            row.attempts -= 1
            self._ledger.put_off(row, outcome.message)
        elif outcome.nature == AGAIN and row.attempts < self.watch.attempts:
            self._ledger.again(row, outcome.message)
        else:
            self._ledger.failed(row, outcome, self.recipe.id)
        # what happened to its files meanwhile was not looked at
        if self._sight.tree.get(key) is None:
            self._vanished(row)
        else:
            self._judge(key, self.clock.monotonic())

    @staticmethod
    def _has_published(row: Row, taken: Taken) -> bool:
        """Whether a job of the asset has published, and then something ended it before it could say so."""
        begun = row.attempts > 0 or row.reason == INTERRUPTED
        return bool(taken.current) and begun and not row.force and row.content == taken.content

    def _succeed(self, row: Row, outcome: Outcome) -> None:
        """A result has been published."""
        self.output.forget_failure(PurePosixPath(row.place))
        self._ledger.published(row, outcome)
        for other in self._ledger.rows.values():  # what counted as the same is not any more
            if other.state == SAME and other.same_as == row.place and other.content != row.content:
                self._ledger.set(other, SETTLING, recipe="", reason=f"{row.place} has another content now")
                self._due[other.key] = 0.0
        self._sight.forget(row.key)
        self._dispose(row)

    def _dispose(self, row: Row) -> None:
        """After success: what `on_success` asks, once the published result has been verified."""
        if self.watch.on_success == "keep" or row.disposed:
            return
        place = row.same_as or row.place
        shared = {
            path
            for other in self._ledger.rows.values()
            if other is not row and not other.disposed
            for path in other.members
        }
        kept = dispose.after_success(self.root, self.output, row, place, shared, self.watch.on_success)
        if kept:
            self.log.warning("%s: its files stay: %s", row.key, kept, extra=about(row))
        else:
            self._ledger.set(row, row.state, disposed=1)
            self.dirty(_folder(row.key))


def _folder(key: str) -> str:
    return key.rpartition("/")[0]


def _ahead(row: Row, now: float) -> float:
    """For how many seconds an asset is put off yet; a clock that was set back does not put it off for longer."""
    ahead = row.not_before - now
    return ahead if 0 < ahead <= 2 * LONGEST_PAUSE else 0.0
