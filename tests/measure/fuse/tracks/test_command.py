"""`occlog fuse --with` on files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from people_in_groups import walk

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import read_provenance, read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.records.tables import Events, JoinedTracks, PeopleTracks, Tracks

TIMES = np.arange(40) / 10


def written(path: Path, tracks: PeopleTracks, unit: str = "m") -> str:
    write_table(path, tracks, Provenance("track", {}, None, {}, ()), length_unit=unit)
    return str(path)


def test_tracks_of_two_groups_become_tracks_that_every_command_reads(tmp_path, capsys) -> None:
    east = written(tmp_path / "east.parquet", walk(0, TIMES, (0, 0), (1, 0)))
    west = written(tmp_path / "west.parquet", walk(3, TIMES, (0.02, 0), (1, 0)))
    out, events = tmp_path / "hall.parquet", tmp_path / "events.parquet"
    given = ["fuse", east, "--with", west, "-o", str(out), "--events", str(events), "--gate", "3", "--json"]
    assert run(given) == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    assert (summary["people"], summary["rows"], summary["multi_group_share"]) == (1, 40, 1.0)
    assert summary["groups"]["west.parquet"] == {
        "people": 1,
        "matched_pairs": 40,
        "median_separation": pytest.approx(0.02),
    }
    assert set(read_table(out, JoinedTracks).source_ids.tolist()) == {"0,3"}
    assert len(read_table(out, Tracks)) == 40
    assert read_table(events, Events).kind.tolist() == ["initiated"]
    assert read_provenance(out).parameters["gate"] == 3.0


@pytest.mark.parametrize(
    ("tracks", "unit", "words"),
    [
        (
            walk(3, TIMES, (0.4, 0), (1, 0), sd=0.2),
            "m",
            "tracks are 0.4 m off those of the camera groups before it",
        ),
        (
            walk(3, TIMES + 100, (0, 0), (1, 0)),
            "m",
            "has no time in common with the tracks of the camera groups before it",
        ),
        (walk(3, TIMES, (0, 7), (1, 0)), "m", "no person matches the tracks of the camera groups before it"),
        (PeopleTracks.empty(), "m", "contains no tracks of people"),
    ],
)
def test_groups_that_do_not_agree_are_a_line(tmp_path, capsys, tracks, unit, words) -> None:
    east = written(tmp_path / "east.parquet", walk(0, TIMES, (0, 0), (1, 0), sd=0.2))
    west = written(tmp_path / "west.parquet", tracks, unit)
    assert run(["fuse", east, "--with", west, "-o", str(tmp_path / "hall.parquet")]) == ExitCode.DONE
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert words in lines[0]


def test_other_units_and_options_of_detections_are_refused(tmp_path, capsys) -> None:
    east = written(tmp_path / "east.parquet", walk(0, TIMES, (0, 0), (1, 0)))
    west = written(tmp_path / "west.parquet", walk(0, TIMES, (0, 0), (1, 0)), "cm")
    out = str(tmp_path / "hall.parquet")
    assert run(["fuse", east, "--with", west, "-o", out]) == ExitCode.BAD_INPUT
    assert "lengths are in cm" in capsys.readouterr().err
    assert run(["fuse", east, "--with", east, "-o", out, "--miss-probability", "0.1"]) == ExitCode.USAGE
    assert "--miss-probability is an option of fuse BEARINGS" in capsys.readouterr().err
    assert run(["fuse", east, "-o", out]) == ExitCode.USAGE
    assert "with --with" in capsys.readouterr().err
