"""`occlog ingest --positions` and `occlog track --method jipda` of what it makes, from the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import occlog
from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.tables.parquet import read_table
from occlog.io.recording.reader import open_recording
from occlog.records.tables import Associations, PeopleTracks, Positions

pytestmark = pytest.mark.jit
RATE, FRAMES = 4, 60
EAST, NORTH = 500_000.0, 5_000_000.0
"""Coordinates of a map: sums of squares of such numbers have few digits left."""


def people(k: int) -> np.ndarray:
    """(3, 2) positions in frame k."""
    t = k / RATE
    return np.array([[1.0 + 0.8 * t, 2.0], [12.0 - 0.7 * t, 6.0], [6.0, 1.0 + 0.5 * t]])


def log_of(folder: Path, sigma: float = 0.05, stated: float | None = None) -> Path:
    rng = np.random.default_rng(0)
    lines = ["frame,x,y,score" + (",sigma" if stated else "")]
    for k in range(FRAMES):
        at = people(k) + rng.normal(0.0, sigma, (3, 2))
        for x, y in at[rng.random(3) > 0.05]:
            lines.append(f"{k},{EAST + x:.3f},{NORTH + y:.3f},0.9" + (f",{stated}" if stated else ""))
    path = folder / "bev.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_positions_are_recorded_and_tracked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording, tracks, boxes = (str(tmp_path / name) for name in ("p.mcap", "tracks.parquet", "support.parquet"))
    assert run(["ingest", "-o", recording, "--positions", str(log_of(tmp_path)), "--fps", str(RATE)]) == ExitCode.DONE
    assert "no errors stated, jipda learns them" in capsys.readouterr().err
    found = open_recording(Path(recording))
    assert found.has(Positions)
    assert found.sensors_of(Positions) == ("bev",)
    # The method follows from the input
    assert run(["track", recording, "-o", tracks, "--associations", boxes, "--json"]) == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    assert summary["method"] == "jipda"
    assert summary["people"] == 3
    assert 0.02 < summary["position_sigma"]["bev"] < 0.12
    table = read_table(Path(tracks), PeopleTracks)
    late = table.take(table.t_ns >= 3 * 10**9)
    for t_ns in np.unique(late.t_ns).tolist():
        there = np.add(people(round(t_ns * RATE / 1e9)), (EAST, NORTH))
        rows = late.take(late.t_ns == t_ns)
        away = np.hypot(rows.x[:, None] - there[:, 0], rows.y[:, None] - there[:, 1])
        assert len(rows) == 3
        assert (away.min(axis=1) < 0.4).all()
    assert set(table.seen_by.tolist()) <= {"bev", ""}
    assert not any("single_view" in flags for flags in table.quality_flags.tolist())
    support = read_table(Path(boxes), Associations)
    assert set(support.sensor.tolist()) == {"bev"}
    assert len(support) > 150


def test_smoothed_positions_keep_three_identities(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording, tracks = str(tmp_path / "p.mcap"), str(tmp_path / "tracks.parquet")
    assert run(["ingest", "-o", recording, "--positions", str(log_of(tmp_path)), "--fps", str(RATE)]) == ExitCode.DONE
    assert run(["track", recording, "--smooth", "-o", tracks]) == ExitCode.DONE
    table = read_table(Path(tracks), PeopleTracks)
    assert len(np.unique(table.target_id)) == 3
    assert len(table) > 2.9 * FRAMES


def test_a_stated_error_that_innovations_contradict_is_found(tmp_path: Path) -> None:
    recording = occlog.ingest(positions={"radar": log_of(tmp_path, sigma=0.15, stated=0.05)}, fps=RATE)
    with pytest.warns(
        occlog.OcclogWarning, match=r"positions of radar are [2-4]\.\d times as far from the track as stated"
    ):
        result = occlog.track(recording, method="jipda")
    assert result.summary["position_sigma"] == {"radar": 0.05}
    assert result.plausible is False


def test_positions_given_for_boxes_or_tracks_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(log_of(tmp_path))
    out = str(tmp_path / "x.mcap")
    assert run(["ingest", "-o", out, "--boxes", path, "--fps", "4"]) == ExitCode.BAD_INPUT
    assert "give it as positions (--positions)" in capsys.readouterr().err
    assert run(["track", path, "--method", "jipda", "-o", str(tmp_path / "t.parquet")]) == ExitCode.BAD_INPUT
    assert "occlog ingest --positions bev.csv" in capsys.readouterr().err


def test_sources_have_names_of_their_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(log_of(tmp_path))
    arguments = ["ingest", "-o", str(tmp_path / "x.mcap"), "--positions", path, "--positions", path, "--fps", "4"]
    assert run(arguments) == ExitCode.USAGE
    assert "give them another name" in capsys.readouterr().err
    assert run(["ingest", "-o", str(tmp_path / "x.mcap"), "--truth", path, "--grid", "1,0,0"]) == ExitCode.USAGE
    assert "grid of positions" in capsys.readouterr().err


def test_a_configuration_takes_positions(tmp_path: Path) -> None:
    log_of(tmp_path)
    (tmp_path / "run.yaml").write_text(
        "occlog_run: 1\nseed: 1\ningest: {positions: {bev: bev.csv}, fps: 4}\ntrack: {method: jipda}\n"
    )
    assert run(["run", str(tmp_path / "run.yaml"), "-o", str(tmp_path / "out")]) == ExitCode.DONE
    (table,) = [read_table(path, PeopleTracks) for path in (tmp_path / "out").rglob("tracks.parquet")]
    assert len(np.unique(table.target_id)) == 3
