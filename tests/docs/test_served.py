"""Files over HTTP for programs in a browser: whole, in part, from several folders, and from nowhere else."""

from __future__ import annotations

import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

from docs.pictures.served import served

DATA = bytes(range(256)) * 40


@pytest.fixture
def address(tmp_path: Path) -> Iterator[str]:
    for folder in ("application", "shown"):
        (tmp_path / folder).mkdir()
    (tmp_path / "application/index.html").write_text("page")
    (tmp_path / "shown/run.mcap").write_bytes(DATA)
    (tmp_path / "secret").write_text("nobody's")
    with served(root=tmp_path / "application", shown=tmp_path / "shown") as at:
        yield at


def get(url: str, part: str | None = None) -> tuple[int, bytes, str | None]:
    """Status, body, and which part it is."""
    request = urllib.request.Request(url, headers={} if part is None else {"Range": part})
    with urllib.request.urlopen(request, timeout=10) as found:
        return found.status, found.read(), found.headers["Content-Range"]


def test_files_come_from_their_folders(address: str) -> None:
    assert get(f"{address}/?ds=remote-file") == (200, b"page", None)
    assert get(f"{address}/shown/run.mcap?x=1") == (200, DATA, None)


@pytest.mark.parametrize(
    ("part", "first", "last"),
    [("bytes=0-9", 0, 9), ("bytes=300-", 300, 10239), ("bytes=10000-99999", 10000, 10239)],
)
def test_a_part_is_what_was_asked_for(address: str, part: str, first: int, last: int) -> None:
    assert get(f"{address}/shown/run.mcap", part) == (206, DATA[first : last + 1], f"bytes {first}-{last}/10240")


@pytest.mark.parametrize("path", ["../secret", "shown/../../secret", "%2e%2e/secret", "shown/none"])
def test_other_files_are_not_there(address: str, path: str) -> None:
    with pytest.raises(urllib.error.HTTPError, match="404"):
        get(f"{address}/{path}")
