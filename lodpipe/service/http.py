"""The status page, /healthz and /metrics, on the loopback interface alone, in a thread of the daemon."""

from __future__ import annotations

import json
import mimetypes
import os
import shutil
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import lodpipe.reporting
from lodpipe.core.errors import LodpipeError, OutputError
from lodpipe.reporting.daemon_status import metrics_text
from lodpipe.service import control
from lodpipe.service.discover import STATE
from lodpipe.service.memory import resident_gb

_PAGE = Path(lodpipe.reporting.__file__).parent / "status.html"
_HOSTS = ("127.0.0.1", "localhost", "[::1]")
_SECURITY = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "X-Frame-Options": "DENY",
    "Cache-Control": "no-store",
}


class StatusServer:
    """Serves until `close`. Reads the job table for itself, so that it shares nothing with the daemon's loop."""

    def __init__(self, state: Path, output: Path, port: int) -> None:
        """Listen on `port` of 127.0.0.1, 0 for any. Raises OutputError if it is taken."""

        class Handler(_Handler):
            pass

        Handler.state, Handler.root = state, output
        try:
            self._server = ThreadingHTTPServer(("127.0.0.1", port), Handler)
        except OSError as error:
            raise OutputError(
                f"port {port} cannot be used ({error.strerror})", advice="choose another watch.port"
            ) from error
        self._server.daemon_threads = True
        self.address = f"http://127.0.0.1:{self._server.server_address[1]}/"
        self._thread = threading.Thread(target=self._server.serve_forever, args=(1.0,), name="status", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End it."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join(timeout=5)


class _Handler(BaseHTTPRequestHandler):
    state: Path
    root: Path
    timeout = 30
    server_version, sys_version = "lodpipe", ""

    def do_GET(self) -> None:
        # a page of another site that has its name point to this machine must not read anything here
        if self.headers.get("Host", "").rpartition(":")[0] not in _HOSTS and self.headers.get("Host") not in _HOSTS:
            self._say(403, "text/plain", b"only for this machine\n")
            return
        path = unquote(urlsplit(self.path).path, errors="surrogateescape")
        try:
            if path == "/":
                self._say(200, "text/html; charset=utf-8", _PAGE.read_bytes(), script=True)
            elif path == "/healthz":
                self._health()
            elif path == "/metrics":
                memory = int(_resident_alone() * (1 << 30))
                text = metrics_text(control.status(self.state), memory)
                self._say(200, "text/plain; version=0.0.4; charset=utf-8", text.encode())
            elif path == "/api/status":
                status = control.status(self.state)
                for asset in status["assets"]:
                    self._links(asset)
                self._say(200, "application/json", json.dumps(status).encode())
            elif path.startswith("/files/"):
                self._file(path.removeprefix("/files/"))
            else:
                self._say(404, "text/plain", b"not found\n")
        except LodpipeError as error:
            self._say(503, "text/plain", f"{error}\n".encode("utf-8", "backslashreplace"))
        except (BrokenPipeError, ConnectionResetError):
            pass

    def do_HEAD(self) -> None:
        self.do_GET()

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing: the daemon's log is about assets."""

    def _health(self) -> None:
        status = control.status(self.state)
        problem = status["problem"]
        self._say(503 if problem else 200, "text/plain; charset=utf-8", f"{problem or 'ok'}\n".encode())

    def _links(self, asset: dict[str, Any]) -> None:
        """Add where the report and a picture of an asset are, as far as there are any."""
        if "folder" not in asset:
            return
        for name in ("report.html", "report.json", "error.json"):
            if (self.root / asset["folder"] / name).is_file():
                asset["report"] = f"{asset['folder']}/{name}"
                break
        images = self.root / asset["folder"] / "images"
        try:
            first = min((e.name for e in os.scandir(images) if e.name.endswith((".png", ".jpg", ".webp"))), default="")
        except OSError:
            return
        if first:
            asset["thumbnail"] = f"{asset['folder']}/images/{first}"

    def _file(self, name: str) -> None:
        """A published file: inside the output folder, not of its state, not through a link that leads out."""
        try:
            real = (self.root / name).resolve(strict=True)
        except (OSError, ValueError, RuntimeError):
            self._say(404, "text/plain", b"not found\n")
            return
        root = self.root.resolve()
        if not real.is_relative_to(root) or STATE in real.relative_to(root).parts or not real.is_file():
            self._say(404, "text/plain", b"not found\n")
            return
        kind = mimetypes.guess_type(real.name)[0] or "application/octet-stream"
        with real.open("rb") as file:
            self._head(200, kind, os.fstat(file.fileno()).st_size, script=kind == "text/html")
            if self.command != "HEAD":
                shutil.copyfileobj(file, self.wfile)

    def _say(self, code: int, kind: str, body: bytes, *, script: bool = False) -> None:
        self._head(code, kind, len(body), script=script)
        if self.command != "HEAD":
            self.wfile.write(body)

    def _head(self, code: int, kind: str, length: int, *, script: bool) -> None:
        self.send_response(code)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(length))
        for name, value in _SECURITY.items():
            self.send_header(name, value)
        source = "'self' 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval' data: blob:" if script else "'none'"
        self.send_header("Content-Security-Policy", f"default-src {source}")
        self.end_headers()


def _resident_alone() -> float:
    """GB of this process, its workers left out."""
    return resident_gb(os.getpid(), family=False)
