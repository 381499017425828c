"""Folders over HTTP on this machine, with parts of files, as programs in a browser read recordings."""

from __future__ import annotations

import http.server
import re
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, ClassVar
from urllib.parse import unquote, urlsplit

RANGE = re.compile(r"bytes=(\d+)-(\d*)$")


class Handler(http.server.SimpleHTTPRequestHandler):
    """Serves files of folders by the first part of their paths, the last folder without one."""

    folders: ClassVar[Mapping[str, Path]] = {}

    def translate_path(self, path: str) -> str:
        """The file of a path."""
        parts = [part for part in unquote(urlsplit(path).path).split("/") if part not in ("", ".", "..")]
        if parts and parts[0] in self.folders:
            return str(self.folders[parts[0]].joinpath(*parts[1:]))
        return str(self.folders[""].joinpath(*parts))

    def do_GET(self) -> None:
        """A file, or the part of it that was asked for; a browser may leave before all of it is sent."""
        with suppress(ConnectionError):
            self.send_asked()

    def send_asked(self) -> None:
        """Send a file or a part of it."""
        found, file = RANGE.match(self.headers.get("Range", "")), Path(self.translate_path(self.path))
        if found is None or not file.is_file():
            super().do_GET()
            return
        size = file.stat().st_size
        first, last = int(found[1]), min(int(found[2] or size - 1), size - 1)
        self.send_response(206)
        self.send_header("Content-Range", f"bytes {first}-{last}/{size}")
        self.send_header("Content-Length", str(last - first + 1))
        self.end_headers()
        with file.open("rb") as stream:
            stream.seek(first)
            self.wfile.write(stream.read(last - first + 1))

    def end_headers(self) -> None:
        """Say that parts of files can be had."""
        self.send_header("Accept-Ranges", "bytes")
        super().end_headers()

    def log_message(self, *args: Any) -> None:
        """Nothing is said of requests."""


@contextmanager
def served(**folders: Path) -> Iterator[str]:
    """The address of folders while they are served: files of `root` at the top, of others under their names."""
    named = {"" if name == "root" else name: folder for name, folder in folders.items()}
    kind = type("Served", (Handler,), {"folders": named})
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), kind) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
