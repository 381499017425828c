"""`occlog track --ground-tracks`: the tables in images and on the ground appear together, or neither does."""

from __future__ import annotations

from pathlib import Path

import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode, OutputError
from occlog.io.files.tables.table_writer import TableWriter
from occlog.records.tables import FusedTracks

pytestmark = pytest.mark.jit


def test_both_tables_appear_or_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The disk is full for one of them, whichever is completed last."""
    video, tracks, world = (tmp_path / name for name in ("b.mcap", "t.parquet", "w.parquet"))
    small = ["--frames", "4", "--size", "96x72", "--balls", "2", "--radius", "9"]
    assert run(["simulate", "--scene", "balls", *small, "-o", str(video), "-q"]) == ExitCode.DONE
    asked = [
        "track",
        str(video),
        "--method",
        "mipf",
        "--initial-ellipses",
        str(video),
        "-o",
        str(tracks),
        "--ground-tracks",
        str(world),
    ]
    flush = TableWriter._flush
    for ground in (True, False):

        def full(writer: TableWriter, ground: bool = ground) -> None:
            if (writer._table is FusedTracks) == ground:
                raise OutputError("the disk is full")
            flush(writer)

        monkeypatch.setattr(TableWriter, "_flush", full)
        assert run([*asked, "-q"]) == ExitCode.BAD_INPUT
        assert [p.name for p in tmp_path.iterdir()] == ["b.mcap"]
    monkeypatch.setattr(TableWriter, "_flush", flush)
    assert run([*asked, "-q"]) == ExitCode.DONE
    assert tracks.exists()
    assert world.exists()
