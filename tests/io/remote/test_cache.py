"""The cache of fetched files: bounded, shared, and never older than what it was fetched from."""

from __future__ import annotations

import errno
import hashlib
import http.server
import multiprocessing
import os
import socket
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from occlog.errors import InputError, OutputError
from occlog.io.files.provenance import Provenance
from occlog.io.recording.writer import RecordingWriter
from occlog.io.remote import Cache, find

fsspec = pytest.importorskip("fsspec")
LARGE = b"x" * 1000


@pytest.fixture
def store() -> Iterator[object]:
    system = fsspec.filesystem("memory")
    yield system
    system.rm("/", recursive=True)


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.rglob("*") if path.is_file() and not path.name.endswith(".lock")}


def test_the_least_recently_used_goes_when_the_limit_is_reached(store: object, tmp_path: Path) -> None:
    cache = Cache(tmp_path, 2500)
    for name in ("a", "b", "a", "c"):
        store.pipe_file(f"/in/{name}.mcap", LARGE) if not store.exists(f"/in/{name}.mcap") else None  # type: ignore[attr-defined]
        with cache.holding(f"memory://in/{name}.mcap") as path:
            assert path.read_bytes() == LARGE
            assert path.name == f"{name}.mcap"
    assert names(tmp_path) == {"a.mcap", "c.mcap"}


def test_what_is_in_use_stays_and_what_is_larger_than_the_limit_is_refused(store: object, tmp_path: Path) -> None:
    for name in ("a", "b"):
        store.pipe_file(f"/in/{name}.mcap", LARGE)  # type: ignore[attr-defined]
    cache = Cache(tmp_path, 1500)
    with cache.holding("memory://in/a.mcap") as first, cache.holding("memory://in/b.mcap") as second:
        assert first.exists()
        assert second.exists()
    assert len(names(tmp_path)) == 1
    with pytest.raises(InputError, match=r"memory://in/b.mcap: has 1000 bytes, limit 999; raise --cache-limit"):
        Cache(tmp_path, 999).holding("memory://in/b.mcap").__enter__()


def test_a_file_that_changed_is_fetched_again(store: object, tmp_path: Path) -> None:
    cache = Cache(tmp_path, 5000)
    for content in (b"before", b"after!"):
        store.pipe_file("/in/a.mcap", content)  # type: ignore[attr-defined]
        with cache.holding("memory://in/a.mcap") as path:
            assert path.read_bytes() == content


def test_linked_videos_come_along_and_links_that_leave_the_folder_do_not(store: object, tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "hall.mcap", None, Provenance("test")) as out:
        for camera, path in (("a", "a.avi"), ("b", "../b.avi"), ("c", "/c.avi")):
            out.video(camera, path, hashlib.sha256(b"frames").hexdigest())
            out.video_frame(camera, 1, 0)
    store.pipe_file("/in/hall.mcap", (tmp_path / "hall.mcap").read_bytes())  # type: ignore[attr-defined]
    for name in ("/in/a.avi", "/b.avi", "/in/b.avi", "/c.avi"):
        store.pipe_file(name, b"frames")  # type: ignore[attr-defined]
    with Cache(tmp_path / "cache", 10**6).holding("memory://in/hall.mcap") as path:
        assert {each.name for each in path.parent.iterdir()} == {"hall.mcap", "a.avi"}
    store.pipe_file("/in/a.avi", b"fra")  # type: ignore[attr-defined]
    cache = Cache(tmp_path / "other", 10**6)
    with pytest.raises(InputError, match=r"memory://in/a.avi: its SHA-256 is not that of the video that hall"):
        cache.holding("memory://in/hall.mcap").__enter__()
    # It did not stay in the cache, from which the wrong one was taken ever after
    store.pipe_file("/in/a.avi", b"frames")  # type: ignore[attr-defined]
    with cache.holding("memory://in/hall.mcap") as path:
        assert (path.parent / "a.avi").read_bytes() == b"frames"


def test_a_name_with_brackets_is_no_pattern_where_it_is_there(store: object) -> None:
    for name in ("a[1].mcap", "b1.mcap"):
        store.pipe_file(f"/in/{name}", LARGE)  # type: ignore[attr-defined]
    assert find("memory://in/a[1].mcap") == ["memory://in/a[1].mcap"]
    assert find("memory://in/b[1].mcap") == ["memory:///in/b1.mcap"]
    assert find("memory://in/c[1].mcap") == []


def test_a_full_disk_is_no_fault_of_the_store(store: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    store.pipe_file("/in/a.mcap", LARGE)  # type: ignore[attr-defined]
    monkeypatch.setattr(type(store), "get_file", full)
    with pytest.raises(OutputError, match=r"cannot store the download of memory://in/a.mcap: No space left on device"):
        Cache(tmp_path, 10**6).holding("memory://in/a.mcap").__enter__()


def test_scratch_folders_of_killed_processes_are_removed(tmp_path: Path) -> None:
    cache = Cache(tmp_path, 10**6)
    (tmp_path / "scratch-dead").mkdir(parents=True)
    (tmp_path / "scratch-dead" / "x").write_bytes(LARGE)
    (tmp_path / "scratch-dead.lock").touch()
    with cache.scratch() as mine, cache.scratch() as other:
        assert mine != other
        assert mine.is_dir()
    assert names(tmp_path) == set()
    assert not list(tmp_path.glob("scratch-*"))


def _use_scratch(folder: Path) -> None:
    cache = Cache(folder, 10**6)
    for _ in range(150):
        with cache.scratch() as mine:
            (mine / "run").mkdir()
            for number in range(12):
                (mine / "run" / str(number)).write_bytes(b"x")


def test_folders_that_go_while_another_process_looks_at_them_do_no_harm(tmp_path: Path) -> None:
    """One in a hundred ended a recording."""
    with ProcessPoolExecutor(4, multiprocessing.get_context("forkserver")) as pool:
        assert list(pool.map(_use_scratch, [tmp_path] * 4)) == [None] * 4


class Quiet(http.server.SimpleHTTPRequestHandler):
    """Files of a folder; what is not in it is not there, and `/503` has an answer of its own."""

    def send_head(self) -> Any:
        number = self.path.strip("/").partition("?")[0]
        return self.send_error(int(number)) if number.isdecimal() else super().send_head()

    def log_message(self, *_: object) -> None:
        pass


class Odd(Quiet):
    """What a query asks for, without marks; `part` comes in part, and `stall` never."""

    def do_GET(self) -> None:
        asked = self.path.partition("?")[2].encode()
        self.send_response(200)
        self.send_header("Content-Length", str(len(asked) if asked != b"part" else 100))
        self.end_headers()
        self.wfile.write(b"" if asked == b"stall" else asked)
        self.wfile.flush()
        if asked == b"stall":
            time.sleep(2)

    def do_HEAD(self) -> None:
        self.send_error(405)


def test_two_files_of_one_path_and_answers_that_stop_are_distinguished(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever worked on the first got the bytes of the second."""
    pytest.importorskip("aiohttp")
    monkeypatch.setattr("occlog.io.remote.SILENCE", 0.5)
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Odd)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    url, cache = f"http://127.0.0.1:{server.server_port}/get", Cache(tmp_path, 10**6)
    try:
        with cache.holding(f"{url}?a") as first, cache.holding(f"{url}?b") as second:
            assert (first.read_bytes(), second.read_bytes()) == (b"a", b"b")
        for fault, words in (("part", "not enough data|came with|PayloadError"), ("stall", "Timeout")):
            with pytest.raises(InputError, match=words):
                cache.holding(f"{url}?{fault}").__enter__()
        assert names(tmp_path) == set()
    finally:
        server.shutdown()
        server.server_close()


def test_a_web_server_is_read_and_its_signature_is_not_stated(tmp_path: Path) -> None:
    pytest.importorskip("aiohttp")
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.mcap").write_bytes(LARGE)
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(tmp_path / "in")))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    url = f"http://127.0.0.1:{server.server_port}"
    try:
        with Cache(tmp_path / "cache", 10**6).holding(f"{url}/a.mcap?signature=s3cret") as path:
            assert path.name == "a.mcap"
            assert path.read_bytes() == LARGE
        with pytest.raises(InputError, match=r"b\.mcap: no such file") as raised:
            Cache(tmp_path / "cache", 10**6).holding(f"{url}/b.mcap?signature=s3cret").__enter__()
        assert "s3cret" not in str(raised.value)
        for answer in (401, 403, 503):
            with pytest.raises(InputError, match=f"cannot be reached: {answer}, .*; try again") as raised:
                Cache(tmp_path / "cache", 10**6).holding(f"{url}/{answer}?signature=s3cret").__enter__()
            assert "s3cret" not in str(raised.value)
    finally:
        server.shutdown()
        server.server_close()


def test_a_server_that_does_not_answer_does_not_say_that_a_file_is_not_there(tmp_path: Path) -> None:
    pytest.importorskip("aiohttp")
    with socket.create_server(("127.0.0.1", 0)) as absent:
        url = f"http://127.0.0.1:{absent.getsockname()[1]}/a.mcap"
    with pytest.raises(InputError, match=r"a\.mcap: cannot be reached: Cannot connect to host .*; try again"):
        Cache(tmp_path / "cache", 10**6).holding(url).__enter__()
