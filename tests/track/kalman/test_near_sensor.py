"""A target that stands next to a sensor."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from occlog.cli.main import run
from occlog.consistency.estimates import covariances
from occlog.core.geometry.camera import wrap_angle
from occlog.core.metrics.errors import normalised_squared_errors
from occlog.errors import ExitCode
from occlog.io.formats.scenes.scene import scene_from_yaml
from occlog.records.tables import Bearings, Tracks
from occlog.settings import configure
from occlog.track.catalogue import settings_of
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask

pytestmark = pytest.mark.jit
SCENE = scene_from_yaml(
    """occlog_scene: 1
length_unit: m
room: [[0, 0], [9, 0], [9, 7], [0, 7]]
microphone_arrays:
- {name: s0, position: [0.5, 0.5, 1.5], yaw_deg: 36.9, planar: true, sigma_deg: 4}
- {name: s1, position: [8.5, 1, 1.5], yaw_deg: 148.0, planar: true, sigma_deg: 4}
- {name: s2, position: [4, 6.8, 1.5], yaw_deg: -81.4, planar: true, sigma_deg: 4}
""",
    "three arrays",
)
SIGMA = np.radians(4.0)


def standing(at: np.ndarray, rng: np.random.Generator, T: int = 25) -> Bearings:
    """Clean bearings of all arrays at 5 Hz."""
    t_ns = np.arange(T, dtype=np.int64) * 200_000_000
    return Bearings.merge(
        Bearings.of(
            t_ns=t_ns,
            sensor=np.full(T, a.name),
            target_id=np.zeros(T, dtype=np.int32),
            seen=np.ones(T, dtype=np.bool_),
            score=np.full(T, np.nan),
            bearing=wrap_angle(
                np.arctan2(*(at - a.position[:2])[::-1]) + SIGMA * rng.standard_normal(T),
            ),
            sigma=np.full(T, SIGMA),
            u_px=np.full(T, np.nan),
            sigma_px=np.full(T, np.nan),
        )
        for a in SCENE.arrays
    )


def test_the_iterated_filter_goes_on_next_to_a_sensor_and_is_honest() -> None:
    """At 7 cm from one of three arrays: any seed, the same result for any seed, and the error within its covariance."""
    config = configure(settings_of("iekf").in_unit("m"), {})
    squares = []
    for seed in range(4):
        rng = np.random.default_rng([seed, 7])
        turn = rng.uniform(-np.pi, np.pi)
        at = np.array([0.5, 0.5]) + 0.07 * np.array([np.cos(turn), np.sin(turn)])
        bearings = standing(at, rng)
        found = Tracks.concat(p.tracks for p in track([bearings], SCENE, TrackingTask(config, 0, method="iekf")))
        if not seed:
            again = Tracks.concat(p.tracks for p in track([bearings], SCENE, TrackingTask(config, 9, method="iekf")))
            np.testing.assert_array_equal(found.x, again.x)
        away = np.column_stack([found.x, found.y]) - at
        squares.append(normalised_squared_errors(away, covariances(found)).mean())
    # Errors of one run are those of one draw for seconds: its mean square of two degrees of freedom is up to 5 or so
    assert np.median(squares) < 3.0
    assert np.max(squares) < 9.0


@pytest.mark.parametrize("method", ["ekf", "ukf", "iekf"])
@pytest.mark.parametrize("distance", [0.005, 0.07])
def test_a_target_that_stands_at_a_sensor_has_an_honest_covariance(method: str, distance: float) -> None:
    config = configure(settings_of(method).in_unit("m"), {})
    squares = []
    for seed in range(4):
        rng = np.random.default_rng([seed, 8])
        turn = rng.uniform(-np.pi, np.pi)
        at = SCENE.arrays[seed % 3].position[:2] + distance * np.array([np.cos(turn), np.sin(turn)])
        parts = track([standing(at, rng, 50)], SCENE, TrackingTask(config, 0, method=method))
        found = Tracks.concat(p.tracks for p in parts)
        away = np.column_stack([found.x, found.y]) - at
        squares.append(normalised_squared_errors(away, covariances(found)).mean())
    assert np.mean(squares) < 3.5


@pytest.mark.parametrize("method", ["ekf", "iekf"])
def test_the_command_believes_all_sensors_of_a_target_at_one_of_them(
    shared_cases: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], method: str
) -> None:
    words = [str(shared_cases / "iekf_crash.csv"), "--scene", str(shared_cases / "iekf_crash.yaml"), "--seed", "9"]
    out = ["-o", str(tmp_path / "x.parquet"), "--json", "-q"]
    assert run(["track", *words, "--method", method, *out]) == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    assert summary["plausible"]
    assert summary["warnings"] == []
