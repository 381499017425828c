"""Tracking from recorded detections on the command line."""

from __future__ import annotations

import json

import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.tables.parquet import read_table
from occlog.records.tables import Diagnostics

SCENE = "occlog_scene: 1\nroom: [[0, 0], [7.67, 0], [7.67, 3.41], [0, 3.41]]\n"


@pytest.mark.statistics
def test_a_person_among_others_is_followed_by_three_cameras_and_the_fourth_agrees(shared_data, tmp_path, capsys):
    """`cmc_detections`: boxes of several people with misses and false alarms, no labels, no appearance."""
    data = shared_data / "cmc_detections"
    (tmp_path / "room.yaml").write_text(SCENE)
    hall, boxes, tracks = (str(tmp_path / name) for name in ("hall.mcap", "boxes.parquet", "tracks.parquet"))
    diagnostics = tmp_path / "diagnostics.parquet"
    ingest = ["--calibration", str(data / "calibration"), "--image-size", "1920x1024", "--fps", "20"]
    source = ["--boxes", str(data / "CMC1_detections.csv"), "--scene", str(tmp_path / "room.yaml")]
    assert run(["ingest", "-o", hall, *ingest, *source, "-q"]) == ExitCode.DONE
    assert run(["detect", hall, "-o", boxes, "-q"]) == ExitCode.DONE
    options = ["--scene", hall, "--without", "cam4", "--start", "2.85,0.45,0.3", "--diagnostics", str(diagnostics)]
    assert run(["track", boxes, "-o", tracks, "-q", *options]) == ExitCode.DONE
    capsys.readouterr()
    assert run(["evaluate", tracks, "--bearings", boxes, "--scene", hall, "--held-out", "cam4", "--json"]) == 0
    metrics = json.loads(capsys.readouterr().out)
    assert metrics["held_out_median_px"] < 25.0  # 12 px; the centres of boxes of one person meet within 11-16 px
    assert metrics["held_out_share_within"] > 0.85
    assert metrics["held_out_share_within"] > metrics["held_out_share_within_chance"] + 0.3
    rows = read_table(diagnostics, Diagnostics)
    assert set(rows.fallback.tolist()) == {""}
    assert set(rows.cameras.tolist()) == {"cam1,cam2,cam3"}
    assert rows.n_detected.mean() > 2.5
