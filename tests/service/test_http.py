"""The live page in Chromium: what it shows, that it keeps itself fresh, and that names are text to it."""

from __future__ import annotations

import numpy as np
import pytest

from browser import MISSING, browser
from chains import CHAIN, write_obj
from daemon_kit import World
from lodpipe.io.images import encode_png
from lodpipe.service.http import StatusServer

ONLY_HERE = "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"
EVIL = "<img src=x onerror='window.evil=1'>\n&.obj"

pytestmark = [
    pytest.mark.skipif(bool(MISSING), reason=MISSING),
    # Selenium leaves its sockets to the garbage collector
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
]


def test_the_live_page(tmp_path, tmp_path_factory):
    world = World(tmp_path, CHAIN | {"stages": [{"fail": {"only": "broken"}}, {"thin": {"say": "hm"}}, "export"]})
    for number, name in enumerate(("chair.obj", "broken.obj", EVIL)):
        write_obj(world.drop / name, cells=4 + number)
    (world.drop / "linked").symlink_to(tmp_path)
    world.work()
    picture = encode_png(np.full((64, 64, 3), (200, 80, 20), np.uint8))
    (world.out / "chair" / "images").mkdir()
    (world.out / "chair" / "images" / "levels.png").write_bytes(picture)
    write_obj(world.drop / "lamp.obj", cells=9)
    world.settle()
    world.daemon.progress("lamp.obj", 2, "thin", 0.5)
    world.daemon.tick()
    server = StatusServer(world.output.state, world.out, 0)
    try:
        with browser(tmp_path_factory.mktemp("profile"), ONLY_HERE) as page:
            page.driver.get(server.address)
            page.wait("document.querySelectorAll('#assets tr').length == 4")
            text = page.run("return document.body.innerText")
            assert "broken" in text
            assert "two and two is five; count again" in text
            assert "linked: it is a link to a folder" in text
            assert "1 warning in" in text
            assert "<img src=x" in text
            assert page.run("return window.evil === undefined")
            assert page.run("return document.querySelector('progress').value") == 0.5
            page.wait("document.querySelector('td.picture img').naturalWidth == 64")
            links = page.run("return [...document.querySelectorAll('td.name a')].map(a => a.getAttribute('href'))")
            assert "/files/.failed/broken/error.json" in links or "/files/.failed/broken/report.json" in links
            for dark, width, height in ((False, 1280, 800), (True, 390, 800)):
                page.look(width, height, dark)
                assert page.run("return document.documentElement.scrollWidth <= window.innerWidth")
                (tmp_path / f"page{width}.png").write_bytes(page.picture())
            page.run("[...document.querySelectorAll('#counts button')].find(b => /failed/.test(b.textContent)).click()")
            page.wait("document.querySelectorAll('#assets tr').length == 1")
            world.executor.finish("lamp.obj")
            world.daemon.tick()
            page.wait("/3 done/.test(document.getElementById('counts').textContent)")  # by itself
            assert page.errors() == []
            server.close()
            page.wait("/not answer/.test(document.getElementById('word').textContent)")
    finally:
        server.close()
