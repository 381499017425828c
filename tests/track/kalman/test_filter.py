"""The Kalman filters on recordings: they follow, are honest, find a lost target, and refuse what they do not have."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tracker_scenes import SECOND, observe, room100, walk

from occlog.array_types import Floats
from occlog.cli.main import run
from occlog.consistency.estimates import covariances
from occlog.core.metrics.errors import normalised_squared_errors
from occlog.errors import ExitCode, InputError
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.records.tables import UNLABELLED, Bearings, Diagnostics, Tracks
from occlog.settings import configure
from occlog.track.catalogue import settings_of
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.methods.kalman.config import EkfConfig

pytestmark = pytest.mark.jit
METHODS = ("ekf", "ukf", "iekf")
QUICK = {"iekf": {"visibility_constraint": "none", "max_iterations": 3}}
"""Settings with which a search takes little time."""
SCENE = room100(pillar=False)
STEPS = 150
PATH = walk(STEPS, np.random.default_rng(1))
SEEN = observe(SCENE, PATH, np.random.default_rng(2))


def follow(bearings: Bearings, method: str, **settings: object) -> tuple[Floats, Floats, Diagnostics]:
    """Errors (T, 2), covariances and diagnostics."""
    config = configure(settings_of(method).in_unit("unit"), {**QUICK.get(method, {}), **settings})
    parts = list(track([bearings], SCENE, TrackingTask(config, 0, method=method)))
    tracks = Tracks.concat(p.tracks for p in parts)
    away = np.column_stack([tracks.x, tracks.y]) - PATH[np.rint(tracks.t_ns / SECOND).astype(int)]
    return away, covariances(tracks), Diagnostics.concat(p.diagnostics for p in parts)


def rmse(away: Floats) -> float:
    return float(np.sqrt(np.mean(np.sum(away**2, axis=1))))


@pytest.mark.parametrize("method", METHODS)
def test_a_target_is_followed_as_stated_and_smoothing_helps(method: str) -> None:
    away, covariance, notes = follow(SEEN, method)
    assert rmse(away) < 2.2
    assert 1.0 < normalised_squared_errors(away, covariance).mean() < 3.0
    assert set(notes.fallback.tolist()) <= {"", "infeasible"}
    assert np.isnan(notes.ess).all()
    smoothed, covariance, _ = follow(SEEN, method, smooth=True)
    assert rmse(smoothed) < 0.9 * rmse(away)
    assert 1.0 < normalised_squared_errors(smoothed, covariance).mean() < 3.0


@pytest.mark.parametrize("method", METHODS)
def test_candidates_without_a_label_among_false_ones_are_followed(method: str) -> None:
    rng = np.random.default_rng(3)
    u = np.where(SEEN.seen & (rng.random(len(SEEN)) < 0.1), rng.uniform(-70, 70, len(SEEN)), SEEN.u_px)
    bearings = replace(SEEN, target_id=np.full(len(SEEN), UNLABELLED, dtype=np.int32), u_px=u)
    away, _, _ = follow(bearings, method)
    assert rmse(away) < 3.5


def test_a_filter_that_begins_at_the_wrong_end_begins_again() -> None:
    start = tuple(100.0 - PATH[0])
    away, _, notes = follow(SEEN, "ekf", start=(*start, 1.0))
    assert "restart" in notes.fallback.tolist()[:8]
    assert rmse(away[8:]) < 2.2
    never, _, notes = follow(SEEN, "ekf", start=(*start, 1.0), track_loss_count=0)
    assert "restart" not in notes.fallback.tolist()
    assert np.hypot(*never[5]) > 10.0


def test_after_a_gap_a_filter_begins_again_and_no_earlier() -> None:
    late = replace(SEEN, t_ns=np.where(SEEN.t_ns >= 75 * SECOND, SEEN.t_ns + 60 * SECOND, SEEN.t_ns))
    config = configure(EkfConfig(), {"max_gap_s": 61.0})
    (part,) = track([late], SCENE, TrackingTask(config, 0, method="ekf"))
    assert "gap" not in part.diagnostics.fallback.tolist()
    (part,) = track([late], SCENE, TrackingTask(configure(EkfConfig(), {"max_gap_s": 60.0}), 0, method="ekf"))
    assert np.flatnonzero(part.diagnostics.fallback == "gap").tolist() == [75]


@pytest.fixture
def command(tmp_path: Path) -> list[str]:
    (tmp_path / "scene.yaml").write_text(scene_to_yaml(SCENE), encoding="utf-8")
    write_table(tmp_path / "seen.parquet", SEEN, Provenance("detect"))
    seen, scene, out = (str(tmp_path / name) for name in ("seen.parquet", "scene.yaml", "out.parquet"))
    return ["track", seen, "--scene", scene, "-o", out, "-q"]


def test_the_command_tracks_and_smooths(command: list[str]) -> None:
    assert run([*command, "--method", "ukf", "--lag", "3", "--start", "50,50,30"]) == ExitCode.DONE
    assert len(read_table(Path(command[5]), Tracks)) == STEPS


@pytest.mark.parametrize("method", METHODS)
def test_a_selection_is_refused_in_one_line_that_says_what_to_do(command: list[str], method: str, capsys) -> None:
    assert run([*command, "--method", method, "--select", "greedy"]) == ExitCode.USAGE
    (line,) = capsys.readouterr().err.splitlines()
    assert f"not of --method {method}; leave it out, or choose one that has it" in line
    assert "--method apf" in line
    assert not Path(command[5]).exists()


@pytest.mark.parametrize(
    ("option", "expected"),
    [
        (["--occluders", "seen.parquet"], "--occluders is an option of"),
        (["--particles", "100"], "--particles is an option of"),
        (["--set", "sigma_points=visible"], "points"),
    ],
)
def test_options_of_other_filters_are_refused(command: list[str], option: list[str], expected: str, capsys) -> None:
    assert run([*command, "--method", "ekf", *option]) == ExitCode.USAGE
    assert expected in capsys.readouterr().err
    assert not Path(command[5]).exists()


@pytest.mark.parametrize(
    ("name", "value"), [("start", (0.0, 0.0, 0.0)), ("velocity_time_constant_s", 0.0), ("gate", 0.0)]
)
def test_settings_without_a_width_are_refused(name: str, value: object) -> None:
    with pytest.raises(InputError, match=name):
        EkfConfig(**{name: value})
