"""Headless Chromium for tests of pages: opened from disk, and nothing but the page itself can be reached."""

from __future__ import annotations

import base64
import json
import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
MISSING = "" if CHROMIUM and DRIVER else "needs Chromium and its driver: apt-get install chromium chromium-driver"

FLAGS = (
    "--headless=new",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-extensions",
    "--disable-dev-shm-usage",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--hide-scrollbars",
    "--force-device-scale-factor=1",
    # every name leads nowhere: a request that the page made would fail, and be seen in the log
    "--host-resolver-rules=MAP * ~NOTFOUND",
)


class Page:
    """An open page."""

    def __init__(self, driver: Any) -> None:
        self.driver = driver

    def open(self, path: Path, width: int = 1280, height: int = 800, dark: bool = False) -> None:
        self.driver.get("about:blank")
        self.look(width, height, dark)
        self.requests()  # those of the browser's own first page
        self.driver.get(path.resolve().as_uri())

    def look(self, width: int, height: int, dark: bool = False) -> None:
        """Size of the window, and the theme that the system prefers."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        features = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})

    def run(self, script: str, *values: Any) -> Any:
        return self.driver.execute_script(script, *values)

    def wait(self, condition: str, seconds: float = 60) -> None:
        """Until the expression is true."""
        until = time.monotonic() + seconds
        while not self.run(f"return Boolean({condition})"):
            if time.monotonic() > until:
                raise TimeoutError(f"{condition}; the page said: {self.errors()}")
            time.sleep(0.1)

    def picture(self, full: bool = False) -> bytes:
        """What is seen, as PNG; `full`: the whole page."""
        settings: dict[str, Any] = {"format": "png", "captureBeyondViewport": full}
        if full:
            width, height = self.run(
                "const root = document.documentElement; return [root.clientWidth, root.scrollHeight]"
            )
            settings["clip"] = {"x": 0, "y": 0, "width": width, "height": height, "scale": 1}
        shot = self.driver.execute_cdp_cmd("Page.captureScreenshot", settings)
        return base64.b64decode(shot["data"])

    def errors(self) -> list[str]:
        """What the page's console has of errors, since this was last asked."""
        return [entry["message"] for entry in self.driver.get_log("browser") if entry["level"] == "SEVERE"]

    def requests(self) -> list[str]:
        """Addresses that the page has asked for, besides itself, since this was last asked."""
        found = []
        for entry in self.driver.get_log("performance"):
            message = json.loads(entry["message"])["message"]
            if message["method"] == "Network.requestWillBeSent":
                found.append(message["params"]["request"]["url"])
        return [url for url in found if not url.startswith(("file:", "data:", "blob:"))] + [
            url for url in found if url.startswith("file:") and url != self.driver.current_url.partition("#")[0]
        ]


@contextmanager
def browser(profile: Path, *flags: str) -> Iterator[Page]:
    """Chromium with a new, empty profile in the folder `profile`."""
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = str(CHROMIUM)
    for flag in (*FLAGS, *flags, f"--user-data-dir={profile}"):
        options.add_argument(flag)
    if os.geteuid() == 0:
        options.add_argument("--no-sandbox")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options, Service(DRIVER))
    try:
        yield Page(driver)
    finally:
        driver.quit()
