"""Places fed back to the detector: predicted directions, gates, and fewer false bearings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tracker_scenes import room100

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.io.open import open_input
from occlog.measure.detect.by_background.one_camera import TargetMemory, choose
from occlog.measure.detect.track_feedback import MAX_AGE_S, directions, inside_gate, limited, track_feedback
from occlog.measure.regions.regions import ForegroundRegions
from occlog.records.losses import Loss
from occlog.records.tables import Bearings, Tracks, Truth

ROOM = """
occlog_scene: 1
room: [[0, 0], [8, 0], [8, 8], [0, 8]]
cameras:
  - {name: a, position: [0, 0], yaw_deg: 45, focal_px: 300, fov_deg: 90, noise: {measurement_noise_px: 1}}
  - {name: b, position: [8, 0], yaw_deg: 135, focal_px: 300, fov_deg: 90, noise: {measurement_noise_px: 1}}
"""
SECOND = 1_000_000_000
ORIGIN = np.zeros(2)


def tracks() -> Tracks:
    """Target 0 at (0, 10), then at (1, 10), with 1 a second along x and variances 0.04 and 0.09."""
    two = np.ones(2)
    return Tracks.of(
        t_ns=np.array([0, SECOND]),
        target_id=np.zeros(2, dtype=np.int32),
        x=np.array([0.0, 1.0]),
        y=10.0 * two,
        vx=two,
        vy=0.0 * two,
        cov_xx=0.04 * two,
        cov_xy=0.0 * two,
        cov_yy=0.09 * two,
    )


def test_a_direction_is_predicted_from_the_last_place_before_the_frame() -> None:
    path = track_feedback(tracks(), 3.0).paths[0]
    half, last = directions(path, ORIGIN, np.array([SECOND // 2, SECOND])).azimuth
    assert half == pytest.approx(np.arctan2(10.0, 0.5))
    # At the time of a row the row before it counts, moved on for a second
    assert last == pytest.approx(np.arctan2(10.0, 1.0))
    found = directions(path, np.array([1.5, 0.0]), np.array([SECOND + SECOND // 2]))
    assert found.azimuth[0] == pytest.approx(np.pi / 2)
    assert found.sigma[0] == pytest.approx(np.sqrt(0.04 + 0.25) / 10.0)


def test_nothing_is_known_before_the_first_place_and_when_the_last_is_old() -> None:
    path = track_feedback(tracks(), 3.0).paths[0]
    limit = SECOND + round(MAX_AGE_S * SECOND)
    known = np.isfinite(directions(path, ORIGIN, np.array([0, 1, limit, limit + 1])).azimuth)
    assert known.tolist() == [False, True, True, False]
    assert inside_gate(track_feedback(tracks(), 3.0), 0, ORIGIN, np.array([0]), np.array([2.0]), np.array([0.1])).all()
    assert inside_gate(track_feedback(tracks(), 3.0), 7, ORIGIN, np.array([1]), np.array([-2.0]), np.array([0.1])).all()


def test_bearings_count_within_the_gate_and_not_beyond() -> None:
    near, t_ns = track_feedback(tracks(), 2.0), np.full(2, 1)
    sigma = np.hypot(0.02, 0.1)  # 0.2 of place over 10, and 0.1 of its own
    bearing = np.pi / 2 + 2.0 * sigma * np.array([0.999, 1.001])
    assert inside_gate(near, 0, ORIGIN, t_ns, bearing, np.full(2, 0.1)).tolist() == [True, False]
    table = Bearings.of(
        t_ns=np.full(3, 1),
        sensor=np.array(["a", "b", "c"]),
        target_id=np.array([0, 0, 5], dtype=np.int32),
        seen=np.ones(3, dtype=np.bool_),
        bearing=np.array([bearing[0], bearing[1], -1.0]),
        sigma=np.full(3, 0.1),
        u_px=np.ones(3),
        sigma_px=np.ones(3),
        score=np.full(3, np.nan),
    )
    left = limited(table, near, dict.fromkeys("abc", ORIGIN))
    assert left.seen.tolist() == [True, False, True]
    assert np.isnan(left.bearing).tolist() == [False, True, False]


def test_a_region_away_from_its_place_is_not_the_target_though_it_is_larger() -> None:
    mass = np.array([300.0, 500.0])
    two = ForegroundRegions(
        means=np.array([[10.0, 10.0], [50.0, 10.0]]),
        covs=np.ones((2, 3)),
        boxes=np.ones((2, 4)),
        mass=mass,
        person=np.ones((2, 2)),
        fill=np.ones(2),
        appearance=np.full((2, 72), np.nan),
    )
    nothing = np.empty((2, 0))
    assert choose(0, two, nothing, TargetMemory(), 0.6, np.ones((2, 1), dtype=np.bool_)).tolist() == [1]
    assert choose(0, two, nothing, TargetMemory(), 0.6, np.array([[True], [False]])).tolist() == [0]
    assert choose(0, two, nothing, TargetMemory(), 0.6, np.zeros((2, 1), dtype=np.bool_)).tolist() == [-1]
    like = np.array([[0.7], [0.9]])
    assert choose(0, two, like, TargetMemory(), 0.6, np.array([[True], [False]])).tolist() == [0]


@pytest.mark.jit
def test_false_bearings_fall_where_places_are_fed_back(tmp_path: Path, capsys) -> None:
    (tmp_path / "scene.yaml").write_text(scene_to_yaml(room100()), encoding="utf-8")
    walk, first, again, found = (str(tmp_path / n) for n in ("w.mcap", "first.parquet", "again.parquet", "t.parquet"))
    scene = str(tmp_path / "scene.yaml")
    how = ["--steps", "80", "--occluders", "0", "--false-alarm-probability", "0.3", "-o", walk, "-q"]
    assert run(["simulate", scene, *how]) == ExitCode.DONE
    assert run(["detect", walk, "-o", first, "-q"]) == ExitCode.DONE
    assert run(["track", first, "--scene", walk, "--method", "ekf", "-o", found, "-q"]) == ExitCode.DONE
    assert run(["detect", walk, "--track-feedback", found, "-o", again, "-q"]) == ExitCode.DONE
    before, after = read_table(Path(first), Bearings), read_table(Path(again), Bearings)
    assert len(after) == len(before)
    assert after.seen.sum() < 0.95 * before.seen.sum()
    assert run(["detect", walk, "--feedback-gate", "4", "-o", str(tmp_path / "x.parquet")]) == ExitCode.USAGE
    assert "--feedback-gate goes with --track-feedback" in capsys.readouterr().err


@pytest.mark.jit
def test_places_are_in_the_unit_of_the_scene_have_covariances_and_their_losses_are_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "scene.yaml").write_text(ROOM)
    walk, csv, found = (str(tmp_path / n) for n in ("w.mcap", "t.csv", "b.parquet"))
    assert run(["simulate", str(tmp_path / "scene.yaml"), "--seconds", "4", "-o", walk, "-q"]) == ExitCode.DONE
    truth = open_input(Path(walk)).read(Truth)
    truth = truth.take(truth.role == "target")

    def near(unit: str, scale: float, variance: float | None) -> int:
        spread = "" if variance is None else f"{variance * scale**2!r}"
        nothing = "" if variance is None else "0"
        rows = zip(truth.t_ns, truth.target_id, scale * truth.x, scale * truth.y, strict=True)
        text = "".join(f"{t},{k},{float(x)!r},{float(y)!r},{spread},{nothing},{spread}\n" for t, k, x, y in rows)
        Path(csv).write_text(f"t_ns,id,x_{unit},y_{unit},cov_xx_{unit}2,cov_xy_{unit}2,cov_yy_{unit}2\n{text}")
        return run(["detect", walk, "--track-feedback", csv, "-o", found, "-q", "--overwrite"])

    assert near("m", 1.0, 0.01) == ExitCode.DONE
    seen = read_table(Path(found), Bearings).seen
    assert seen.any()
    assert near("cm", 100.0, 0.01) == ExitCode.DONE
    np.testing.assert_array_equal(read_table(Path(found), Bearings).seen, seen)
    assert near("m", 1.0, None) == ExitCode.BAD_INPUT
    assert "has no covariance" in capsys.readouterr().err
    for unit, code in (("m", ExitCode.DONE), ("ft", ExitCode.BAD_INPUT)):
        lost = Provenance("track", inputs=(("b", "0" * 64),), losses=(Loss("b.mp4", "frame 3", "gone"),))
        write_table(tmp_path / "near.parquet", tracks(), lost, overwrite=True, length_unit=unit)
        args = ["detect", walk, "--track-feedback", str(tmp_path / "near.parquet"), "-o", found, "--overwrite"]
        assert run(args) == code
        assert ("frame 3: gone" if unit == "m" else "lengths are in ft") in capsys.readouterr().err
