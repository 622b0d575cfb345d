"""The daemon's figures: `python tests/benchmarks/daemon.py [mass|kills|soak|all] …`, one table at the end.

mass   N small assets of different content with 2 workers: published once each, memory, idle CPU, pick-up, overhead
kills  kill -9 at random moments, and a known share while a result is being published, before and after its rename; with
       new and edited assets, and a reader that polls all results all the time
soak   random drops, edits, renames, deletes, touches and kills for some time, then a comparison of both folders

The checks share no code with the daemon: they read files, `/proc` and the log.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import os
import random
import re
import shutil
import signal
import sqlite3
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections import defaultdict
from pathlib import Path

REPO = Path(__file__).parents[2]
SETTLE = 0.3
CHAIN = {
    "lods": [{"ratio": 0.5}],
    "stages": ["decimate", "export"],
    "watch": {"settle_s": SETTLE, "workers": 2, "attempts": 1000, "rescan_s": 10},
}


def write_model(path: Path, seed: int, cells: int = 8) -> None:
    """An OBJ of a bumpy square, another one for each seed; written aside and renamed."""
    dice = random.Random(seed)
    lines = [f"# {seed}"]
    lines += [f"v {x} {y} {dice.random():.3f}" for y in range(cells + 1) for x in range(cells + 1)]
    for y in range(cells):
        for x in range(cells):
            a = y * (cells + 1) + x + 1
            lines += [f"f {a} {a + 1} {a + cells + 2}", f"f {a} {a + cells + 2} {a + cells + 1}"]
    path.parent.mkdir(parents=True, exist_ok=True)
    aside = path.with_name(path.name + ".part")
    aside.write_text("\n".join(lines) + "\n")
    aside.rename(path)


class Daemon:
    """`lodpipe watch` in a process of its own, its log in a file."""

    def __init__(self, root: Path, chain: dict = CHAIN, plugins: Path | None = None) -> None:
        self.root, self.drop, self.out = root, root / "drop", root / "out"
        self.options = ["--plugins", str(plugins)] if plugins else []
        self.drop.mkdir(parents=True, exist_ok=True)
        (root / "chain.yaml").write_text(json.dumps(chain))
        self.log = root / "log.jsonl"
        self.process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        command = [sys.executable, "-m", "lodpipe", "watch", str(self.drop), "-c", str(self.root / "chain.yaml")]
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(
                [*command, "-o", str(self.out), "--log", "json", *self.options],
                stderr=log,
                cwd=REPO,
                start_new_session=True,
            )

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()

    def stop(self) -> int:
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(timeout=60)

    def counts(self) -> dict[str, int]:
        return self._ask("SELECT state, count(*) FROM asset GROUP BY state")

    def states(self) -> dict[str, str]:
        return {os.fsdecode(key): state for key, state in self._ask("SELECT key, state FROM asset").items()}

    def revisions(self) -> dict[str, int]:
        return {os.fsdecode(key): number for key, number in self._ask("SELECT key, revision FROM asset").items()}

    def _ask(self, question: str) -> dict:
        try:
            base = sqlite3.connect(f"file:{self.out / '.lodpipe' / 'jobs.sqlite'}?mode=ro", uri=True, timeout=20)
            found = dict(base.execute(question).fetchall())
            base.close()
        except sqlite3.Error:
            return {}
        return found

    def wait_idle(self, seconds: float, total: int | None = None) -> dict[str, int]:
        """Until nothing is open any more, and `total` assets are known."""
        end, calm = time.monotonic() + seconds, 0
        while time.monotonic() < end and calm < 3:
            time.sleep(0.5)
            found = self.counts()
            still = any(found.get(state) for state in ("settling", "waiting", "queued", "running"))
            calm = 0 if still or (total and sum(found.values()) < total) or not found else calm + 1
        return self.counts()

    def lines(self) -> list[dict]:
        found = []
        for line in self.log.read_text().splitlines():
            try:
                found.append(json.loads(line))
            except ValueError:  # cut off by a kill
                continue
        return found

    def workers(self) -> list[int]:
        pids: list[int] = []
        with contextlib.suppress(OSError):
            for task in Path(f"/proc/{self.process.pid}/task").iterdir():
                with contextlib.suppress(OSError):  # threads come and go
                    pids += [int(pid) for pid in (task / "children").read_text().split()]
        return sorted(pid for pid in set(pids) if self._works(pid))

    @staticmethod
    def _works(pid: int) -> bool:
        """Whether a process does jobs: others read the configuration, or are calls of hooks."""
        with contextlib.suppress(OSError):
            return b"lodpipe.service.worker" in Path(f"/proc/{pid}/cmdline").read_bytes()
        return False


class Reader(threading.Thread):
    """Looks at every result again and again: each must be whole, and of one revision, whenever it can be seen."""

    def __init__(self, out: Path) -> None:
        super().__init__(daemon=True)
        self.out = out
        self.looks = 0
        self.broken: list[str] = []
        self.seen: dict[str, set[int]] = defaultdict(set)
        self.ended = threading.Event()

    def run(self) -> None:
        while not self.ended.is_set():
            for folder in self._folders():
                self.look(folder)
            time.sleep(0.005)

    def _folders(self) -> list[Path]:
        try:
            return [self.out / entry.name for entry in os.scandir(self.out) if not entry.name.startswith(".")]
        except OSError:
            return []

    def look(self, folder: Path) -> None:
        try:
            handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        except OSError:
            return
        problem = ""
        try:
            inode = os.fstat(handle).st_ino
            try:
                data = json.loads(_read(handle, "manifest.json"))
                for entry in data["files"]:
                    content = _read(handle, entry["path"])
                    if hashlib.sha256(content).hexdigest() != entry["sha256"]:
                        problem = f"{folder.name}/{entry['path']} is not as its manifest says"
            except (OSError, ValueError, KeyError) as error:
                problem = f"{folder.name}: {type(error).__name__} {error}"
            try:
                still = folder.stat().st_ino == inode
            except OSError:
                still = False
            if still:  # else it was replaced while we read, and the old one may go
                self.looks += 1
                self.seen[folder.name].add(inode)
                if problem:
                    self.broken.append(problem)
        finally:
            os.close(handle)

    def finish(self) -> None:
        self.ended.set()
        self.join()


def _read(folder: int, name: str) -> bytes:
    with os.fdopen(os.open(name, os.O_RDONLY, dir_fd=folder), "rb") as file:
        return file.read()


def resident_mb(pid: int) -> float:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def cpu_seconds(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def when(line: dict) -> float:
    stamp = re.sub(r"Z$", "+00:00", line["time"])
    from datetime import datetime

    return datetime.fromisoformat(stamp).timestamp()


def published_shas(out: Path) -> dict[str, str]:
    """SHA-256 of the own file of each published asset -> where."""
    found = {}
    for path in out.rglob("manifest.json"):
        if not any(part.startswith(".") for part in path.relative_to(out).parts):
            found[json.loads(path.read_text())["inputs"][0]["sha256"]] = str(path.parent.relative_to(out))
    return found


def sha(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def intact(daemon: Daemon) -> list[str]:
    """What is wrong with the state of a daemon that has stopped."""
    base = sqlite3.connect(daemon.out / ".lodpipe" / "jobs.sqlite")
    wrong = [row[0] for row in base.execute("PRAGMA integrity_check") if row[0] != "ok"]
    base.close()
    wrong += [path.name for path in (daemon.out / ".lodpipe").iterdir() if path.name.startswith(("tmp-", "old-"))]
    return wrong


def mass(root: Path, count: int) -> dict[str, object]:
    daemon = Daemon(root)
    daemon.start()
    while not daemon.log.exists() or "watching" not in daemon.log.read_text():
        time.sleep(0.05)
    begin = time.monotonic()
    for number in range(count):
        write_model(daemon.drop / f"asset{number:04}.obj", number)
    memory: list[float] = []
    reader = Reader(daemon.out)
    reader.start()
    while (done := daemon.counts().get("done", 0)) < count and time.monotonic() - begin < 30 + 20 * count:
        memory.append(resident_mb(daemon.process.pid))
        time.sleep(1.0)
    took = time.monotonic() - begin
    reader.finish()
    third = max(1, len(memory) // 3)
    # idle: after the waiting worker has been ended
    time.sleep(3)
    before, start = cpu_seconds(daemon.process.pid), time.monotonic()
    time.sleep(30)
    idle = 100 * (cpu_seconds(daemon.process.pid) - before) / (time.monotonic() - start)
    late = []
    for number in range(5):
        path = daemon.drop / f"late{number}.obj"
        write_model(path, 10**6 + number)
        dropped = time.time()
        daemon.wait_idle(60, count + number + 1)
        start_line = next(x for x in daemon.lines() if x["message"].startswith(f"late{number}.obj: start"))
        late.append(when(start_line) - dropped - SETTLE)
    base = sqlite3.connect(daemon.out / ".lodpipe" / "jobs.sqlite")
    found = base.execute("SELECT place, seconds FROM asset").fetchall()
    ours = [seconds for place, seconds in found if os.fsdecode(place).startswith("late")]
    base.close()
    plain = []
    for number in range(5):
        start = time.monotonic()
        asset, chain = daemon.drop / f"late{number}.obj", daemon.root / "chain.yaml"
        command = [sys.executable, "-m", "lodpipe", "run", asset, "-q", "-c", chain, "-o", root / "run"]
        subprocess.run(command, cwd=REPO, check=True)
        plain.append(time.monotonic() - start)
    code = daemon.stop()
    shas = published_shas(daemon.out)
    lost = [path.name for path in daemon.drop.glob("*.obj") if sha(path) not in shas]
    twice = [name for name, inodes in reader.seen.items() if len(inodes) > 1]
    return {
        "assets published": f"{done} of {count} in {took:.0f} s ({took / count:.2f} s each, 2 workers)",
        "lost / published twice / seen half": f"{len(lost)} / {len(twice)} / {len(reader.broken)}",
        "looks of the reader": reader.looks,
        "daemon's memory": f"{max(memory):.0f} MB at most; mean of first third {sum(memory[:third]) / third:.0f}, "
        f"of last {sum(memory[-third:]) / third:.0f}",
        "idle CPU": f"{idle:.2f} %",
        "picked up after settling": f"{max(late):.2f} s at most (of 5)",
        "a job alone (median of 5)": f"{statistics.median(ours):.2f} s; as run: {statistics.median(plain):.2f} s",
        "exit code": code,
        "state": intact(daemon) or "intact",
    }


SLOW_DISK = '''
import os, time
from lodpipe.core.asset import Asset
from lodpipe.stage import Context, Params, stage

fsync = os.fsync

def slow(handle):
    note = f"{NOTES}/{os.getpid()}"
    with open(note, "w") as file:
        file.write(os.readlink(f"/proc/self/fd/{handle}"))
    time.sleep(0.05)
    fsync(handle)
    os.unlink(note)

class SlowDiskParams(Params):
    """None."""

@stage("slow_disk")
def slow_disk(asset: Asset, params: SlowDiskParams, context: Context) -> Asset:
    """From now on what this worker has the disk hold takes a while, and is noted, so that a kill can be aimed."""
    os.fsync = slow
    return asset
'''


class Publishing:
    """Which workers are publishing this moment: the last thing before the rename, and the first after it, is fsync."""

    def __init__(self, root: Path, out: Path) -> None:
        self.plugins, self.notes, self.out = root / "plugins", root / "notes", out
        for folder in (self.plugins, self.notes):
            folder.mkdir(parents=True)
        (self.plugins / "slow_disk.py").write_text(SLOW_DISK.replace("{NOTES}", str(self.notes)))

    def wait(self, before: bool, seconds: float) -> int:
        """The process of a worker whose result is whole and not in its place yet, or just is; 0 if there is none."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for note in self.notes.iterdir():
                try:
                    path = note.read_text()
                    if path and (path != str(self.out)) == before and time.time() - note.stat().st_mtime < 0.04:
                        return int(note.name)
                except OSError:  # it goes on
                    continue
            time.sleep(0.002)
        return 0


def kills(root: Path, count: int, seconds: float) -> dict[str, object]:
    publishing = Publishing(root, root / "out")
    daemon = Daemon(root, CHAIN | {"stages": ["slow_disk", *CHAIN["stages"]]}, publishing.plugins)
    daemon.start()
    reader = Reader(daemon.out)
    reader.start()
    dice = random.Random(7)
    contents, done = [], defaultdict(int)
    end = time.monotonic() + seconds
    while sum(done.values()) < count and time.monotonic() < end:
        if daemon.process.poll() is not None:
            raise SystemExit(f"the daemon has ended: {daemon.log.read_text()[-500:]}")
        # a few are always on their way: new ones, and edits of what is published
        states = daemon.states()
        for _ in range(6 - sum(state in ("settling", "queued", "running") for state in states.values())):
            number = dice.randrange(max(1, len(contents)))
            name = f"asset{number:04}.obj"
            if states.get(name) == "done" and dice.random() < 0.5:
                contents[number] += 1
                del states[name]
            else:
                number, name = len(contents), f"asset{len(contents):04}.obj"
                contents.append(1)
            write_model(daemon.drop / name, 10_000 * contents[number] + number, cells=dice.choice((6, 12, 40)))
        moment = dice.choice(("any time", "any time", "before the rename", "after the rename"))
        worker = 0
        if moment == "any time":
            time.sleep(dice.uniform(0.0, 2.5))
            worker = dice.choice(daemon.workers() or [0])
        elif not (worker := publishing.wait(moment == "before the rename", 10.0)):
            continue
        if dice.random() < 0.5 or not worker:
            daemon.kill()
            done[f"daemon, {moment}"] += 1
            daemon.start()
        else:
            try:
                os.kill(worker, signal.SIGKILL)
                done[f"worker, {moment}"] += 1
            except ProcessLookupError:
                continue
    counts = daemon.wait_idle(600, len(contents))
    reader.finish()
    code = daemon.stop()
    shas = published_shas(daemon.out)
    lost = [path.name for path in daemon.drop.glob("*.obj") if sha(path) not in shas]
    twice = [name for name, inodes in reader.seen.items() if len(inodes) > contents[int(name[-4:])]]
    revisions = daemon.revisions()
    miscounted = [f"asset{n:04}.obj" for n, times in enumerate(contents) if revisions.get(f"asset{n:04}.obj") != times]
    wrong = lost + twice + miscounted + reader.broken
    return {
        "kill -9": f"{sum(done.values())} ({', '.join(f'{n} {kind}' for kind, n in sorted(done.items()))})",
        "assets": f"{len(contents)}, {sum(contents)} contents; states {counts}",
        "lost / published twice / seen half": f"{len(lost)} / {len(twice)} / {len(reader.broken)}",
        "revisions that are not the contents": len(miscounted),
        "looks of the reader": reader.looks,
        "exit code": code,
        "state": intact(daemon) or "intact",
        **({"wrong": wrong[:5]} if wrong else {}),
    }


def soak(root: Path, seconds: float) -> dict[str, object]:
    daemon = Daemon(root)
    daemon.start()
    reader = Reader(daemon.out)
    reader.start()
    dice = random.Random(11)
    end, number, done, memory = time.monotonic() + seconds, 0, defaultdict(int), []
    while time.monotonic() < end:
        files = list(daemon.drop.glob("*.obj"))
        what = dice.choices(
            ("drop", "edit", "rename", "delete", "touch", "copy", "kill daemon", "kill worker", "rest"),
            (6, 4, 2, 2, 2, 1, 1, 1, 6),
        )[0]
        number += 1
        path = dice.choice(files) if files else None
        if what == "drop" and len(files) < 60:
            write_model(daemon.drop / f"s{number}.obj", number)
        elif what == "edit" and path:
            write_model(path, number)
        elif what == "rename" and path:
            path.rename(daemon.drop / f"r{number}.obj")
        elif what == "delete" and path and len(files) > 5:
            path.unlink()
        elif what == "touch" and path:
            os.utime(path)
        elif what == "copy" and path:
            aside = daemon.drop / f".c{number}"
            shutil.copyfile(path, aside)
            aside.rename(daemon.drop / f"c{number}.obj")
        elif what == "kill daemon":
            daemon.kill()
            daemon.start()
        elif what == "kill worker" and (victims := daemon.workers()):
            try:
                os.kill(dice.choice(victims), signal.SIGKILL)
            except ProcessLookupError:
                continue
        else:
            time.sleep(dice.uniform(0.1, 1.5))
            continue
        done[what] += 1
        try:
            memory.append(resident_mb(daemon.process.pid))
        except OSError:
            continue
    counts = daemon.wait_idle(600)
    reader.finish()
    code = daemon.stop()
    shas = published_shas(daemon.out)
    files = list(daemon.drop.glob("*.obj"))
    lost = [path.name for path in files if sha(path) not in shas]
    stale, third = [], max(1, len(memory) // 3)
    for path in files:
        own = daemon.out / path.stem / "manifest.json"
        if own.is_file() and json.loads(own.read_text())["inputs"][0]["sha256"] != sha(path):
            stale.append(path.name)
    return {
        "time": f"{seconds:.0f} s",
        "done to it": ", ".join(f"{n} {what}" for what, n in sorted(done.items())),
        "at the end": f"{len(files)} files; states {counts}",
        "lost / stale / seen half": f"{len(lost)} / {len(stale)} / {len(reader.broken)}",
        "looks of the reader": reader.looks,
        "daemon's memory": f"{max(memory):.0f} MB at most; mean of first third {statistics.mean(memory[:third]):.0f}, "
        f"of last {statistics.mean(memory[-third:]):.0f}",
        "exit code": code,
        "state": intact(daemon) or "intact",
        **({"wrong": (lost + stale + reader.broken)[:5]} if lost or stale or reader.broken else {}),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", choices=("mass", "kills", "soak", "all"), default="all")
    parser.add_argument("--assets", type=int, default=1000)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=1800, help="of the soak; the kills end then, too")
    parser.add_argument("--keep", type=Path, help="folder to work in, kept afterwards")
    options = parser.parse_args()
    root = options.keep or Path(tempfile.mkdtemp(prefix="lodpipe-daemon-"))
    parts = {
        "mass": lambda: mass(root / "mass", options.assets),
        "kills": lambda: kills(root / "kills", options.kills, options.seconds),
        "soak": lambda: soak(root / "soak", options.seconds),
    }
    failed = False
    try:
        for name in parts if options.what == "all" else [options.what]:
            print(f"{name}:", flush=True)
            for label, value in parts[name]().items():
                print(f"  {label:<36}{value}", flush=True)
                failed |= label == "wrong" or (label == "state" and value != "intact")
    finally:
        if not options.keep:
            shutil.rmtree(root, ignore_errors=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
