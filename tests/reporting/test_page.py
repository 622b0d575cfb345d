"""report.html as text: everything escaped, nothing from outside, every figure there."""

from __future__ import annotations

import dataclasses
import json
import re
from html.parser import HTMLParser

import pytest

from lodpipe.core.page import Layer, Page, Picture, Scale
from lodpipe.core.report import LevelReport, Measurement, Report, StageReport
from lodpipe.reporting import page as pages
from lodpipe.reporting.page import href, page_html, write_page

EVIL = """<script>alert('1')</script>"&--><img src=x onerror=alert(2)>"""


class Reader(HTMLParser):
    """Tags with their attributes, and the text between them."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))

    def handle_data(self, data):
        self.words.append(data)

    def all(self, tag):
        return [attributes for name, attributes in self.tags if name == tag]


def report(name: str = "duck", **more) -> Report:
    """Two levels, of which one was measured; `name` wherever a file or a stage may put text."""
    page = Page(
        files={"LOD0.gltf": b"{}", "LOD1.gltf": b"{}", "error_LOD1.gltf": b"{}"},
        models={0: "LOD0.gltf", 1: "LOD1.gltf"},
        layers=[Layer("error", name, name, Scale(("#ffffff", "#000000"), ((0.0, name),)), {1: "error_LOD1.gltf"})],
        pictures=[
            Picture("LOD0_front.webp", "shaded", name, b"picture", 4, 4, 0),
            Picture("LOD1_front.webp", "shaded", name, b"picture", 4, 4, 1),
            Picture("levels.png", "sheet", name, b"sheet", 8, 4),
        ],
        views=["front"],
        notes=[name],
    )
    source = {"format": "glb", "triangles": 12, "vertices": 24, "materials": 1, "textures": 0, "skins": 0}
    level = LevelReport(1, 6, 12, name, files=[f"LOD1/{name}.glb"], bytes=1234)
    level.error = {"mean": 0.0123, "rms": 0.0456, "max": 0.789, "normal_degrees": 3.21}
    level.gpu = {"vertex_bytes": 384, "index_bytes": 36, "texture_bytes": 0}
    stage = StageReport(name, {name: name}, 1.5, [Measurement(name, name, name)], [name])
    budget = {"level": 1, "figure": "triangles", "limit": 5, "value": 6, "ok": False}
    given = {
        "warnings": [name],
        "command": f"lodpipe run '{name}'",
        "config": {"lods": [name]},
        "versions": {"a": name},
    }
    return Report(
        name,
        outcome="over_budget",
        source={**source, "animations": 0},
        stages=[stage],
        lods=[LevelReport(0, 12, 24, "source"), level],
        budgets=[budget],
        page=page,
        **{**given, **more},
    )


def html(one: Report) -> Reader:
    return Reader(page_html(one, one.page))


def test_nothing_that_a_file_says_becomes_markup():
    harmless, evil = html(report("duck")), html(report(EVIL))
    assert [tag for tag, _ in evil.tags] == [tag for tag, _ in harmless.tags]
    assert [set(attributes) for _, attributes in evil.tags] == [set(attributes) for _, attributes in harmless.tags]
    assert EVIL in "".join(evil.words)
    data = next(text for text in evil.words if text.startswith('{"asset"'))
    assert "</script" not in data
    assert json.loads(data)["asset"] == EVIL


def test_nothing_comes_from_outside():
    text = page_html(report(), report().page)
    for _, attributes in Reader(text).tags:
        for name in ("src", "href", "data", "action", "poster", "srcset"):
            assert not re.match(r"(?:[a-z]+:)?//|https?:", attributes.get(name) or ""), attributes
    assert not re.search(r"url\(|@import", text)
    (policy,) = [a["content"] for a in Reader(text).all("meta") if "http-equiv" in a]
    assert policy.startswith("default-src 'none'")
    assert "http" not in policy


def test_the_figures_are_there():
    words = " ".join(" ".join(html(report()).words).split())
    for figure in ("12 triangles", "50 %", "1.2 kB", "0.0123 %", "0.789 %", "3.21°", "Over budget", "at most 5"):
        assert figure in words, figure


def test_figures_that_nobody_measured_have_no_column():
    assert "PSNR" not in " ".join(html(report()).words)
    one = report()
    one.lods[1].visual = {"psnr": 31.4159, "ssim": None}
    words = " ".join(html(one).words)
    assert "31.4 dB" in words
    assert "SSIM" not in words


@pytest.mark.parametrize("outcome", ["ok", "warnings", "over_budget", "something new"])
def test_every_outcome_has_a_verdict(outcome):
    one = report()
    one.outcome = outcome
    assert [a for a in html(one).all("p") if "verdict" in (a.get("class") or "")]


def test_pictures_and_controls_have_words():
    read = html(report())
    assert all(image["alt"] for image in read.all("img"))
    labelled = {a.get("for") for a in read.all("label")}
    (slider,) = [a for a in read.all("input") if a.get("type") == "range"]
    assert slider["id"] in labelled
    assert read.all("html")[0]["lang"] == "en"


def test_the_folder_gets_page_and_pictures(tmp_path):
    one = report()
    written = write_page(one, tmp_path)
    assert {path.relative_to(tmp_path).as_posix() for path in written} == {
        "report.html",
        "images/LOD0_front.webp",
        "images/LOD1_front.webp",
        "images/levels.png",
    }
    assert (tmp_path / "images" / "levels.png").read_bytes() == b"sheet"
    assert one.images == ["images/LOD0_front.webp", "images/LOD1_front.webp", "images/levels.png"]


def test_without_the_stage_there_is_no_page(tmp_path):
    assert write_page(Report("duck"), tmp_path) == []
    assert list(tmp_path.iterdir()) == []


def test_without_the_viewers_package_the_page_says_so(monkeypatch):
    monkeypatch.setattr(pages, "VIEWER", ("no_such_package", ""))
    read = html(report())
    assert "No 3-D view: the package dash-model-viewer is not installed." in read.words
    assert not [a for a in read.all("script") if "data-blob" in a]


def test_the_viewers_script_is_classic_and_whole():
    script = pages.viewer_script()
    assert not re.search(r"^\s*(?:import|export)\b", script, re.MULTILINE)
    assert "customElements.define" in script
    assert "Apache" in script


def test_an_empty_report_has_a_page_too():
    one = dataclasses.replace(report(), lods=[], stages=[], budgets=[], page=Page(notes=["nothing to see"]))
    assert "nothing to see" in " ".join(html(one).words)


def test_names_in_any_encoding_can_be_written_and_linked(tmp_path):
    one = report("ö 名前 #?% \udcff")
    write_page(one, tmp_path)
    assert "ö 名前" in (tmp_path / "report.html").read_text(encoding="utf-8")
    assert href("LOD1/a #?%é\udcff.glb") == "LOD1/a%20%23%3F%25%C3%A9%FF.glb"


def test_the_same_report_is_the_same_page():
    assert page_html(report(), report().page) == page_html(report(), report().page)
