"""The page over an output folder: every asset and failure, kept fresh, never half-written, never over somebody's."""

from __future__ import annotations

import json
import shutil
import threading
import time
from html.parser import HTMLParser

import pytest

import lodpipe
from chains import CHAIN, plugin_folder, write_obj
from lodpipe.service import index as indexes
from lodpipe.service.index import Index, asset_folders


def publish(root, place: str, **report):
    """A folder as a run leaves it, as far as the index looks."""
    folder = root / place
    (folder / "images").mkdir(parents=True)
    lods = [{"triangles": n, "bytes": 10 * n, "error": {"mean": 0.5}, "visual": None} for n in (1000, 10)]
    data = {"outcome": "ok", "source": {"triangles": 1000}, "lods": lods, "stages": [], "seconds": 1.5} | report
    (folder / "report.json").write_text(json.dumps(data))
    files = [{"path": name} for name in ("report.html", "report.json", "images/thumbnail.webp")]
    (folder / "manifest.json").write_text(json.dumps({"files": files}))
    return folder


@pytest.fixture
def root(tmp_path):
    (tmp_path / "out" / ".lodpipe").mkdir(parents=True)
    return tmp_path / "out"


class Rows(HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.words: list[str] = []
        self.tags: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        found = dict(attributes)
        if tag == "a" and "tabindex" not in found:
            self.links.append(found["href"])

    def handle_data(self, data):
        self.words += data.split()


def page(root) -> Rows:
    return Rows((root / "index.html").read_text(encoding="utf-8"))


def test_a_run_leaves_a_page_over_all_of_it(tmp_path):
    for name in ("b", "a"):
        write_obj(tmp_path / "in" / f"{name}.obj")
    chain = CHAIN | {"stages": ["thin", {"fail": {"only": "b"}}, "export"], "lods": [{"ratio": 0.5}]}
    lodpipe.run(tmp_path / "in", chain, tmp_path / "out", plugins=[plugin_folder(tmp_path)])
    found = page(tmp_path / "out")
    assert found.links == ["a/report.json", ".failed/b/error.json"]
    assert {"2", "assets", "OK", "Failed", "32", "16"} <= set(found.words)
    assert "five" in found.words  # why it failed


def test_rows_lead_to_the_pages(root):
    publish(root, "props/a b#1")
    publish(root, "z")
    Index(root).update()
    assert page(root).links == ["props/a%20b%231/report.html", "z/report.html"]
    assert "props/a%20b%231/images/thumbnail.webp" in (root / "index.html").read_text()


def test_what_a_report_says_is_text(root):
    evil = "<script>alert(1)</script>"
    publish(root, "a", outcome="warnings", warnings=[evil])
    publish(root, "b", outcome=evil)
    Index(root).update()
    assert page(root).tags.count("script") == 1
    assert evil in " ".join(page(root).words)


def test_only_what_has_changed_is_read_again(root, monkeypatch):
    publish(root, "a")
    publish(root, "b")
    Index(root).update()
    read = []
    monkeypatch.setattr(indexes, "entry_of", lambda *given: read.append(given[0]) or pytest.fail("read again"))
    Index(root).update()
    assert read == []
    monkeypatch.undo()
    shutil.rmtree(root / "a")
    publish(root, "c", source={"triangles": 77_777})
    Index(root).update()
    assert page(root).links == ["b/report.html", "c/report.html"]
    assert "77,777" in page(root).words


def test_a_damaged_report_or_cache_does_not_matter(root):
    publish(root, "a")
    (publish(root, "b") / "report.json").write_text("{")
    (root / ".lodpipe" / "index.json").write_text("[]")
    Index(root).update()
    assert page(root).links == ["a/report.html", "b/report.html"]


def test_somebody_elses_page_stays(root):
    (root / "index.html").write_text("<h1>mine</h1>")
    publish(root, "a")
    Index(root).update()
    assert (root / "index.html").read_text() == "<h1>mine</h1>"
    (root / "index.html").unlink()
    (root / "index.html").mkdir()
    Index(root).update()
    assert list((root / "index.html").iterdir()) == []


def test_updates_that_follow_each_other_are_put_together(root, monkeypatch):
    writes = []
    monkeypatch.setattr(indexes, "_replace", lambda path, *rest: writes.append(path.name))
    index = Index(root)
    for _ in range(50):
        index.changed()
    assert writes.count("index.html") == 1
    index.settle()
    assert writes.count("index.html") == 2
    index.settle()
    assert writes.count("index.html") == 2


def test_readers_never_see_half_a_page(root):
    for n in range(20):
        publish(root, f"asset{n}")
    Index(root).update()
    done = threading.Event()
    broken = []

    def read():
        while not done.is_set():
            if not (root / "index.html").read_text().rstrip().endswith("</html>"):
                broken.append(1)

    reader = threading.Thread(target=read)
    reader.start()
    writers = [threading.Thread(target=lambda: [Index(root).update() for _ in range(10)]) for _ in range(2)]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    done.set()
    reader.join()
    assert broken == []
    assert [path.name for path in (root / ".lodpipe").iterdir()] == ["index.json"]


def test_many_assets_are_quick_and_light(root):
    for n in range(500):
        publish(root, f"folder{n % 20}/asset{n}")
    Index(root).update()
    begin = time.process_time()
    Index(root).update()
    assert time.process_time() - begin < 2.0
    assert (root / "index.html").stat().st_size < 1_000_000
    assert len(page(root).links) == 500


def test_folders_inside_a_result_are_no_results(root):
    publish(root, "a")
    publish(root, "a/LOD0")
    publish(root, ".lodpipe/tmp-1")
    assert [path.relative_to(root).as_posix() for path in asset_folders(root)] == ["a"]
