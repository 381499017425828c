"""A truth without rows says that no one is there: every track is false, and that is a result."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from people_boxes import hall, truth
from people_in_groups import walk

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.records.columns import ColumnTable
from occlog.records.tables import PeopleTracks, Truth


@pytest.fixture
def files(tmp_path: Path) -> dict[str, str]:
    """Tracks that are right, tracks of no one, and truths."""
    true = truth(1.0, people=1)
    tracks = walk(0, true.t_ns / 1e9, (0, 0), (0, 0))
    right = PeopleTracks(**{**{c.name: getattr(tracks, c.name) for c in tracks.columns()}, "x": true.x, "y": true.y})
    tables: dict[str, ColumnTable] = {
        "right": right,
        "none": PeopleTracks.empty(),
        "truth": true,
        "nobody": Truth.empty(),
    }
    for name, table in tables.items():
        write_table(tmp_path / f"{name}.parquet", table, Provenance("test"))
    (tmp_path / "hall.yaml").write_text(scene_to_yaml(hall()))
    return {path.stem: str(path) for path in tmp_path.iterdir()}


def figures(capsys: pytest.CaptureFixture[str], *args: str) -> dict[str, float | None]:
    assert run(["evaluate", *args, "--json", "-q"]) == ExitCode.DONE
    return json.loads(capsys.readouterr().out)


def test_tracks_where_no_one_is_are_false(files, capsys) -> None:
    got = figures(capsys, files["right"], "--truth", files["nobody"], "--scene", files["hall"])
    assert (got["fp"], got["precision"], got["frames"]) == (10.0, 0.0, 10.0)
    assert got["mota"] is None
    assert got["estimates_unmatched"] == 10.0


def test_no_one_where_no_one_is_has_nothing_false(files, capsys) -> None:
    got = figures(capsys, files["none"], "--truth", files["nobody"], "--scene", files["hall"])
    assert (got["fp"], got["frames"]) == (0.0, 0.0)


def test_false_tracks_of_one_recording_count_among_several(files, capsys) -> None:
    one = (files["right"], "--truth", files["truth"], "--scene", files["hall"])
    got = figures(capsys, *one, "--also", files["right"], files["nobody"], "--also", files["none"], files["nobody"])
    assert (got["objects"], got["fp"], got["mota"]) == (10.0, 10.0, 0.0)
