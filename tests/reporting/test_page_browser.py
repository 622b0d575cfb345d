"""report.html in Chromium, from disk and without a network: it draws, it obeys, it asks for nothing."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import PIL.Image
import pytest

import lodpipe
from browser import MISSING, browser

SAMPLE = Path(__file__).parent.parent.parent / "sample_assets" / "mug.glb"
CHAIN = {
    "lods": [{"ratio": 0.3}, {"ratio": 0.05}],
    "stages": [
        "skeleton",
        "segment",
        "decimate",
        {"report": {"samples": 500, "views": 1, "size": 64, "pictures": 1, "texture_size": 256}},
        "export",
    ],
    "budgets": {"levels": {"1": {"triangles": 10}}},
}
WINDOW = 700, 620
SLIDE = "const s = document.getElementById('level'); s.value = arguments[0]; s.dispatchEvent(new Event('input'))"
EVIL = """<img src=x onerror='window.evil=1'>"&"""

pytestmark = [
    pytest.mark.skipif(bool(MISSING), reason=MISSING),
    pytest.mark.skipif(not SAMPLE.is_file(), reason="needs the sample models: make demo"),
    # Selenium leaves its sockets to the garbage collector
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A published mug whose name is a trap."""
    place = tmp_path_factory.mktemp("report")
    source = place / f"{EVIL}.glb"
    source.write_bytes(SAMPLE.read_bytes())
    batch = lodpipe.run(str(source), CHAIN, place / "out")
    assert [outcome.outcome for outcome in batch.outcomes] == ["over_budget"]
    return Path(batch.outcomes[0].folder)


@pytest.fixture(scope="module")
def opened(tmp_path_factory, folder):
    """The report in a window: starting takes seconds where everything is drawn by software."""
    with browser(tmp_path_factory.mktemp("profile")) as page:
        page.open(folder / "report.html", *WINDOW)
        page.wait(loaded("textured", 0, 2))
        yield page


@pytest.fixture
def page(opened):
    """The report as it is after opening; whatever is done to it, it asks for nothing and complains of nothing."""
    opened.look(*WINDOW)
    opened.run("document.getElementById('wire').checked && document.getElementById('wire').click()")
    opened.run("document.querySelector('input[name=look][value=textured]').click()")
    opened.run(SLIDE, 2)
    opened.run("document.getElementById('reset').click()")
    opened.wait(loaded("textured", 0, 2))
    yield opened
    assert opened.errors() == []
    assert opened.requests() == []


def loaded(look: str, left: int, right: int) -> str:
    """Whether these models are shown."""
    wanted = {"left": f"{look} {left}", "right": f"{look} {right}"}
    return (
        f"Object.entries({json.dumps(wanted)}).every(([id, it]) => document.getElementById(id).dataset.loaded === it)"
    )


def pane(page, side: str) -> np.ndarray:
    """What a viewer shows, (H, W, 3), below its words."""
    page.run("return new Promise((done) => setTimeout(done, 400))")  # two frames, drawn by software
    box = page.run(
        "const r = document.querySelector(`#${arguments[0]} .stage`).getBoundingClientRect();"
        "return [r.left, r.top, r.right, r.bottom]",
        side,
    )
    picture = PIL.Image.open(io.BytesIO(page.picture())).convert("RGB")
    left, top, right, bottom = (round(value) for value in box)
    return np.array(picture.crop((left, top + 70, right, bottom))).astype(int)


def changed(before: np.ndarray, after: np.ndarray) -> float:
    """The share of pixels that look different."""
    return float((np.abs(before - after).max(axis=2) > 24).mean())


def drawn(picture: np.ndarray) -> float:
    """The share of pixels that are not the background's, which is a faint gradient."""
    return float((np.abs(picture - picture[-1, 0]).max(axis=2) > 60).mean())


def test_both_viewers_draw_the_model(page):
    for side in ("left", "right"):
        picture = pane(page, side)
        assert 0.05 < drawn(picture) < 0.8
        assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 300
    assert page.run("return window.evil") is None
    assert page.run("return document.querySelector('h1').textContent") == EVIL


def test_the_slider_changes_the_level_and_nothing_else(page):
    before = {side: pane(page, side) for side in ("left", "right")}
    page.run(SLIDE, 1)
    page.wait(loaded("textured", 0, 1))
    after = {side: pane(page, side) for side in ("left", "right")}
    assert changed(before["left"], after["left"]) < 0.002
    assert changed(before["right"], after["right"]) > 0.005
    assert "LOD1" in page.run("return document.querySelector('#right figcaption').textContent")
    assert page.run("return document.querySelector('#levels tr.chosen').dataset.level") == "1"
    shown = page.run(
        "return [...document.querySelectorAll('.pictures figure:not([hidden])')].map((f) => f.dataset.level)"
    )
    assert shown == ["0", "1", "1"]
    assert page.run("return document.getElementById('level').getAttribute('aria-valuetext')").startswith("LOD1, ")


def test_the_slider_is_moved_by_keys(page):
    from selenium.webdriver.common.by import By
    from selenium.webdriver.common.keys import Keys

    slider = page.driver.find_element(By.ID, "level")
    slider.send_keys(Keys.ARROW_LEFT)
    page.wait(loaded("textured", 0, 1))
    slider.send_keys(Keys.HOME)
    page.wait(loaded("textured", 0, 0))
    assert changed(pane(page, "left"), pane(page, "right")) < 0.002


def test_turning_one_turns_the_other(page):
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.by import By

    before = pane(page, "right")
    viewer = page.driver.find_element(By.CSS_SELECTOR, "#left model-viewer")
    ActionChains(page.driver).drag_and_drop_by_offset(viewer, 80, 0).perform()
    page.wait(
        "(() => { const [a, b] = ['left', 'right'].map((id) =>"
        " document.querySelector(`#${id} model-viewer`).getCameraOrbit().theta);"
        " return Math.abs(a - 0.6435) > 0.05 && Math.abs(a - b) < 0.02; })()"
    )
    assert changed(before, pane(page, "right")) > 0.01


@pytest.mark.parametrize("look", ["clay", "checker", "error", "segments"])
def test_other_looks_are_drawn_too(page, look):
    before = pane(page, "right")
    page.run("document.querySelector(`input[name=look][value=${arguments[0]}]`).click()", look)
    left = "textured" if look == "error" else look
    page.wait(f"document.getElementById('left').dataset.loaded === '{left} 0'")
    page.wait(f"document.getElementById('right').dataset.loaded === '{look} 2'")
    after = pane(page, "right")
    assert drawn(after) > 0.05
    assert changed(before, after) > 0.02
    assert page.run("return [...document.querySelectorAll('.legend:not([hidden])')].length") == (
        look in ("error", "segments")
    )


def test_wires_are_drawn_over_the_surface(page):
    page.run("document.querySelector('input[name=look][value=clay]').click()")
    page.wait(loaded("clay", 0, 2))
    before = pane(page, "right")
    page.run("document.getElementById('wire').click()")
    wired = pane(page, "right")
    assert 0.005 < changed(before, wired) < drawn(before)
    page.run("document.getElementById('wire').click()")
    assert changed(before, pane(page, "right")) < 0.002


def test_the_uv_layouts_are_drawn(page):
    page.wait(
        "!document.getElementById('uv').hidden && /right LOD2/.test(document.getElementById('uv-about').textContent)"
    )
    ink = page.run(
        "return ['uv-source', 'uv-level'].map((id) => { const c = document.getElementById(id);"
        "const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data; let n = 0;"
        "for (let i = 3; i < d.length; i += 4) n += d[i] > 200; return n; })"
    )
    assert ink[0] > ink[1] > 1000


@pytest.mark.parametrize(("width", "height"), [(1280, 800), (390, 844)])
@pytest.mark.parametrize("dark", [False, True])
def test_the_first_screen_shows_levels_verdict_and_figures(page, width, height, dark):
    page.look(width, height, dark)
    assert page.run("return document.documentElement.scrollWidth <= document.documentElement.clientWidth")
    places = page.run(
        "return ['h1', '.verdict', '#left', '#right', '#level', '#levels tbody tr'].map((s) =>"
        "document.querySelector(s).getBoundingClientRect()).map((r) => [r.left, r.right, r.bottom])"
    )
    for left, right, bottom in places[:-1]:
        assert 0 <= left < right <= width
        assert bottom <= height
    assert places[-1][2] <= height
    paper = page.run("return getComputedStyle(document.body).backgroundColor")
    assert (max(map(int, paper[4:-1].split(","))) < 60) is dark


def test_without_webgl_the_pictures_remain(folder, tmp_path):
    with browser(tmp_path, "--disable-3d-apis", "--disable-gpu") as page:
        page.open(folder / "report.html")
        page.wait("!document.getElementById('trouble').hidden")
        assert "no WebGL" in page.run("return document.getElementById('trouble').textContent")
        assert drawn(pane(page, "right")) > 0.05
        before = pane(page, "right")
        page.run(SLIDE, 1)
        assert changed(before, pane(page, "right")) > 0.002
        assert page.errors() == []
        assert page.requests() == []


def test_the_folders_page_searches_and_sorts(opened, folder):
    opened.open(folder.parent / "index.html", *WINDOW)
    shown = "return [...document.querySelectorAll('#assets tbody tr:not([hidden])')].length"
    type_in = "const s = document.getElementById('search'); s.value = arguments[0]; s.dispatchEvent(new Event('input'))"
    opened.wait("document.querySelector('#assets img').naturalWidth > 0")
    assert opened.run(shown) == 1
    opened.run(type_in, "onerror IMG")
    assert opened.run(shown) == 1
    opened.run(type_in, "giraffe")
    assert opened.run(shown) == 0
    assert opened.run("return document.getElementById('found').textContent") == "0 of 1"
    opened.run("document.querySelector('#assets thead [data-kind=number]').click()")
    assert opened.run("return document.querySelector('[aria-sort]').getAttribute('aria-sort')") == "ascending"
    assert opened.run("return window.evil") is None
    assert opened.errors() == []
    assert all(url.startswith(folder.parent.as_uri()) for url in opened.requests())


def test_the_folder_lists_all_that_the_page_names(folder):
    listed = {entry["path"] for entry in json.loads((folder / "manifest.json").read_text())["files"]}
    report = json.loads((folder / "report.json").read_text())
    assert {"report.html", "report.json", "images/levels.png", *report["images"]} <= listed
    assert "page" not in report
    assert (folder / "report.html").stat().st_size < 15_000_000
