"""Tracks against bearings by the command: recordings, tracks without covariances, numbers below 0."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from bearing_scenes import hand_made, simulated

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.stage import evaluate
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.io.recording.writer import RecordingWriter
from occlog.records.tables import Bearings, Tracks

MADE = Provenance("track", {"method": "apf", "sensors": ["a", "b", "c", "ear"], "window_ns": 40_000_000})


def test_bearings_and_directions_in_a_recording_give_the_same(tmp_path: Path) -> None:
    case = simulated(2)
    with RecordingWriter(tmp_path / "run.mcap", case.place, Provenance("ingest")) as out:
        out.table(case.truth)
        out.table(case.bearings)
    write_table(tmp_path / "tracks.parquet", case.tracks, MADE, length_unit="m")
    recording = str(tmp_path / "run.mcap")
    args = ["evaluate", str(tmp_path / "tracks.parquet"), "--truth", recording, "--bearings", recording]
    assert run([*args, "-o", str(tmp_path / "m.json")]) == ExitCode.DONE
    found = json.loads((tmp_path / "m.json").read_text())
    whole = evaluate(case.tracks, case.truth, case.bearings, case.place)
    findings = {n: np.nan if found[n] is None else found[n] for n in whole.metrics}
    assert findings == pytest.approx(whole.metrics, rel=1e-10, abs=1e-13, nan_ok=True)


def test_tracks_without_covariances_are_compared_with_bearings(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = hand_made(3)
    for name in ("cov_xx", "cov_xy", "cov_yy"):
        getattr(case.tracks, name)[::2] = np.nan
    for name, table in (("tracks", case.tracks), ("bearings", case.bearings), ("truth", case.truth)):
        write_table(tmp_path / f"{name}.parquet", table, Provenance("x"))
    (tmp_path / "scene.yaml").write_text(scene_to_yaml(case.place))
    args = [f"--{name}={tmp_path / name}.parquet" for name in ("bearings", "truth")]
    args += [f"--scene={tmp_path / 'scene.yaml'}", "-o", str(tmp_path / "m.json")]
    assert run(["evaluate", str(tmp_path / "tracks.parquet"), *args]) == ExitCode.DONE
    found = json.loads((tmp_path / "m.json").read_text())
    assert found["detected"] > 0 < found["rmse_m"]
    assert not any(name.startswith("nees") for name in found)
    assert "estimates have no covariance" in capsys.readouterr().err


def test_candidates_are_not_of_a_track_whose_number_is_below_0(tmp_path: Path) -> None:
    case = hand_made(3)
    free = np.where(case.bearings.seen, -1, case.bearings.target_id).astype(np.int32)
    free = Bearings.of(**{c.name: getattr(case.bearings, c.name) for c in Bearings.columns()} | {"target_id": free})
    (tmp_path / "scene.yaml").write_text(scene_to_yaml(case.place))
    first, found = int(case.tracks.target_id[0]), []
    for number in (1000, -1):
        names = np.where(case.tracks.target_id == first, number, case.tracks.target_id).astype(np.int32)
        ours = Tracks.of(**{c.name: getattr(case.tracks, c.name) for c in Tracks.columns()} | {"target_id": names})
        whole = evaluate(ours.sorted(), case.truth, free.sorted(), case.place, EvaluateConfig(match="optimal")).metrics
        for name, table in (("tracks", ours), ("bearings", free), ("truth", case.truth)):
            write_table(tmp_path / f"{name}.parquet", table, Provenance("x"), overwrite=True)
        args = [f"--{name}={tmp_path / name}.parquet" for name in ("bearings", "truth")]
        args += [f"--scene={tmp_path / 'scene.yaml'}", "-o", str(tmp_path / f"{number}.json"), "--match", "optimal"]
        assert run(["evaluate", str(tmp_path / "tracks.parquet"), *args]) == ExitCode.DONE
        found += [whole, json.loads((tmp_path / f"{number}.json").read_text())]
    names_of = [name for name, value in found[0].items() if np.isfinite(value)]
    assert {"detected", "missed", "false_alarms", "bound_rmse_m"} <= set(names_of)
    for other in found[1:]:
        assert [other[name] for name in names_of] == pytest.approx([found[0][name] for name in names_of], rel=1e-9)
