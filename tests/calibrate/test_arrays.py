"""Microphone arrays that are placed by people who walk and speak."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from walking_people import cameras, people, write

from occlog.array_types import Floats
from occlog.calibrate.kernels import expected_boxes
from occlog.calibrate.microphones.array_outputs import array_checks, with_arrays
from occlog.calibrate.microphones.arrays import (
    AMBIGUOUS,
    FEW,
    LATE,
    LOOSE,
    PARAMETERS,
    ArrayPrior,
    Directions,
    _late_precision,
    _normal,
    _Problem,
    _terms,
    _weighed,
    place_array,
)
from occlog.calibrate.microphones.arrays import Path as WalkedPath
from occlog.cli.main import run
from occlog.core.geometry.camera import wrap_angle
from occlog.errors import ExitCode
from occlog.io.formats.scenes.scene import read_scene, scene_to_yaml
from occlog.io.open import open_input
from occlog.records.scene import MicrophoneArray, Scene
from occlog.records.tables import Bearings, Doa, Truth
from occlog.scans.sources import bearings_of_doa
from occlog.track.methods.jipda.kernels.body_box import pack_views

MOUTH = 1.5
TRUE = MicrophoneArray("mic", np.array([1.0, 7.0, 2.2]), np.radians(-35.0), sigma=np.radians(3.0))
STATED = replace(TRUE, position=np.array([3.0, 5.0, 2.0]), yaw=np.radians(80.0))
PRIOR = ArrayPrior(STATED.yaw, 1.0, MOUTH, 0.1, 1.0)


def walks(seconds: float = 60.0, count: int = 4) -> list[WalkedPath]:
    """Paths of people at 5 Hz."""
    t = np.arange(0.0, seconds, 0.2)
    at = people(t, count)
    return [WalkedPath(t, at[:, p, 0] + 1j * at[:, p, 1]) for p in range(count)]


def directions(
    late: float, rng: np.random.Generator, seconds: float = 60.0, clutter: float = 0.2, *, still: bool = False
) -> Directions:
    """Directions in the world by the stated yaw, 5 a second: of one person who speaks at a time, or of no person."""
    t = np.arange(0.0, seconds, 0.2)
    speaker = (t // 4.0).astype(np.int64) % 2  # two of four people speak, in turn
    at = people(np.zeros_like(t) if still else t)[np.arange(len(t)), 0 if still else speaker]
    to = np.column_stack([at, np.full(len(t), MOUTH)]) - TRUE.position
    azimuth = np.arctan2(to[:, 1], to[:, 0]) + rng.normal(0.0, TRUE.sigma, len(t))
    elevation = np.arctan2(to[:, 2], np.hypot(to[:, 0], to[:, 1])) + rng.normal(0.0, TRUE.sigma, len(t))
    false = rng.random(len(t)) < clutter
    azimuth[false] = rng.uniform(-np.pi, np.pi, int(false.sum()))
    elevation[false] = np.arcsin(rng.uniform(-1.0, 1.0, int(false.sum())))
    sigma = np.full(len(t), TRUE.sigma)
    return Directions(t + late, wrap_angle(azimuth + STATED.yaw - TRUE.yaw), elevation, sigma, sigma)


def test_pose_and_clock_are_found() -> None:
    """Nothing is known of the pose; directions are of two of four people, and a fifth of them of no person."""
    off = []
    for seed in range(6):
        found = place_array(STATED, directions(0.4, np.random.default_rng(seed)), walks(), PRIOR)
        assert found.reason == ""
        turned = float(wrap_angle(np.array(found.array.yaw - TRUE.yaw)))
        error = np.array([*(found.array.position - TRUE.position), turned, found.late_s - 0.4])
        assert np.all(np.abs(error) < [0.25, 0.25, 0.15, 0.06, 0.2]), error
        assert found.is_late
        assert found.share == pytest.approx(0.8, abs=0.06)
        off.append(error / found.sigma)
    # The height of mouths is right here, so that z is nearer than its standard deviation; 24 errors of unit variance
    # have a mean square below 1.8 with probability 0.99
    assert np.mean(np.square(off)[:, [0, 1, 3, 4]]) < 1.8


def test_without_elevations_the_height_is_as_stated() -> None:
    """A planar array."""
    heard = directions(0.0, np.random.default_rng(1))._replace(elevation=np.full(300, np.nan))
    found = place_array(STATED, heard, walks(), PRIOR)
    assert found.reason == ""
    assert found.array.position[2] == STATED.position[2]
    assert np.isnan(found.sigma[2])
    assert np.abs(found.array.position - TRUE.position)[:2].max() < 0.3


def test_one_speaker_who_stands_is_refused() -> None:
    """One direction leaves a curve of poses."""
    still = [WalkedPath(p.t_s, np.full(len(p.t_s), p.xy[0])) for p in walks()[:1]]
    heard = directions(0.0, np.random.default_rng(2), clutter=0.0, still=True)
    found = place_array(STATED, heard, still, PRIOR)
    assert found.reason in (LOOSE, AMBIGUOUS)
    assert found.array is STATED
    assert np.isnan(found.sigma).all()


def test_directions_of_no_person_are_refused() -> None:
    """Directions that are even, and times without people."""
    heard = directions(0.0, np.random.default_rng(3), clutter=1.0)
    assert place_array(STATED, heard, walks(), PRIOR).reason in (FEW, LOOSE, AMBIGUOUS)
    later = heard._replace(t_s=heard.t_s + 1e4)
    assert place_array(STATED, later, walks(), PRIOR).reason == FEW
    assert place_array(STATED, heard, [], PRIOR).reason == FEW


def test_score_is_the_slope_of_the_likelihood(monkeypatch: pytest.MonkeyPatch) -> None:
    """By difference quotients, with the prior of the clock, for mouths in the axes of bodies."""
    monkeypatch.setattr("occlog.calibrate.microphones.arrays.MOUTH_OFF", 0.0)
    problem = _Problem.of(directions(0.3, np.random.default_rng(4)), walks(), PRIOR)
    values = np.array([1.3, 6.8, TRUE.yaw - STATED.yaw + 0.05, 0.21, 0.5])

    def log_posterior(at: Floats) -> float:
        gain = _weighed(problem, _terms(problem, at), 1.0, 0.2).gain
        return gain - 0.5 * _late_precision(problem) * float(at[LATE]) ** 2

    terms = _terms(problem, values)
    right = _normal(terms, _weighed(problem, terms, 1.0, 0.2), _late_precision(problem), values).right
    for k in range(PARAMETERS):
        step = np.zeros(PARAMETERS)
        step[k] = 1e-6
        slope = (log_posterior(values + step) - log_posterior(values - step)) / 2e-6
        assert right[k] == pytest.approx(slope, rel=1e-4, abs=1e-3)


def test_findings_of_arrays() -> None:
    """One that was placed and is late, and one that was left."""
    found = place_array(STATED, directions(0.4, np.random.default_rng(0)), walks(), PRIOR)
    left = replace(STATED, name="other")
    scene = Scene(tuple(cameras()), arrays=(STATED, left))
    checks = array_checks([found, found._replace(array=left, reason=FEW)], scene, placed=True)
    assert [each.id for each in checks] == ["array-placed", "clock-offset-found", "array-not-calibrated"]
    assert array_checks([], scene, placed=True)[0].status == "not applicable"
    # In a frame of the cameras' own the pose of an array that was left is not known
    changed = with_arrays(replace(scene, arrays=()), scene, [found])
    assert [array.name for array in changed.arrays] == ["mic"]


@pytest.mark.jit
def test_cameras_and_an_array_in_one_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Boxes and a log of directions of one recording: the scene has the array, and a log is read by it."""
    scene = Scene(tuple(cameras()), arrays=(STATED,))
    (tmp_path / "hall.yaml").write_text(scene_to_yaml(scene))
    heard = directions(0.4, np.random.default_rng(5), 30.0)
    own = np.degrees(wrap_angle(heard.azimuth - STATED.yaw))
    rows = [
        f"{t:.3f},mic,{a:.3f},{e:.3f}"
        for t, a, e in zip(heard.t_s, own, np.degrees(heard.elevation), strict=True)
    ]  # fmt: skip
    (tmp_path / "doa.csv").write_text("\n".join(["time,array,azimuth_deg,elevation_deg", *rows]) + "\n")
    boxes = write(tmp_path, cameras())[:2]
    asked = ["ingest", "-q", "-o", str(tmp_path / "walk.mcap"), *boxes, "--scene", str(tmp_path / "hall.yaml")]
    log = ["--doa", str(tmp_path / "doa.csv"), "--doa-convention", "array", "--fps", "5"]
    assert run([*asked, *log]) == ExitCode.DONE
    asked = ["calibrate", str(tmp_path / "walk.mcap"), "-o", str(tmp_path / "scene.yaml"), "--set", "rounds=0"]
    capsys.readouterr()
    assert run([*asked, "--json"]) == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    found = read_scene(tmp_path / "scene.yaml")
    (array,) = found.arrays
    sigma = summary["microphone_arrays"]["mic"]
    # Cameras and arrays may turn and move together, by 3 degrees and 0.5 m of each camera
    assert np.abs(array.position - TRUE.position).max() < 0.4
    assert np.degrees(abs(wrap_angle(np.array(array.yaw - TRUE.yaw)))) < 6.0
    assert sigma["clock_offset_s"] == pytest.approx(0.4, abs=4.0 * sigma["sigma_clock_s"])
    assert sigma["sigma_clock_s"] < 0.15
    assert 0.0 < sigma["sigma_yaw_deg"] < 3.0
    assert summary["plausible"] is True
    (clock,) = [clock for clock in found.clocks if clock.name == array.clock]
    assert clock.offset_ns * 1e-9 == pytest.approx(sigma["clock_offset_s"], abs=1e-3)
    # Directions are turned to the new yaw, from the yaw with which they were recorded
    opened = open_input(tmp_path / "walk.mcap")
    before = Doa.concat(opened.rows(Doa))
    after = Bearings.concat(bearings_of_doa(opened.rows(Doa), found, recorded=opened.scene))
    turned = wrap_angle(after.bearing - before.azimuth)
    np.testing.assert_allclose(turned, wrap_angle(np.array(array.yaw - STATED.yaw)), atol=1e-9)


@pytest.mark.jit
def test_arrays_of_a_simulated_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Cameras and arrays of one simulated scene: directions are of `simulate`, boxes of its true paths."""
    arrays = (TRUE, replace(TRUE, name="table", position=np.array([5.5, 3.5, 0.8]), yaw=2.0, planar=True))
    arrays = tuple(replace(array, rate_hz=5.0) for array in arrays)
    room = np.array([[0.5, 0.5], [9.5, 0.5], [9.5, 7.5], [0.5, 7.5]])
    (tmp_path / "true.yaml").write_text(scene_to_yaml(Scene(tuple(cameras()), room=room, arrays=arrays)))
    asked = ["simulate", str(tmp_path / "true.yaml"), "-q", "-o", str(tmp_path / "sim.mcap"), "--seconds", "40"]
    asked += ["--rate", "5", "--targets", "4", "--silence", "3,6", "--false-alarm-rate", "0.5", "--no-bearings"]
    assert run([*asked, "--object-height", f"{MOUTH}", "--seed", "3"]) == ExitCode.DONE
    _write_boxes(tmp_path / "sim.mcap", tmp_path / "boxes.csv")
    rough = tuple(replace(array, position=np.array([2.0, 2.0, 1.0]), yaw=0.0) for array in arrays)
    (tmp_path / "rough.yaml").write_text(scene_to_yaml(Scene(tuple(cameras()), arrays=rough)))
    asked = ["ingest", "-q", "-o", str(tmp_path / "walk.mcap"), "--boxes", str(tmp_path / "boxes.csv"), "--fps", "5"]
    asked += ["--scene", str(tmp_path / "rough.yaml"), "--start-time", "2020-01-01T00:00:00Z"]
    assert run(asked) == ExitCode.DONE
    capsys.readouterr()
    asked = ["calibrate", str(tmp_path / "walk.mcap"), "--doa", str(tmp_path / "sim.mcap"), "--set", "rounds=0"]
    assert run([*asked, "-o", str(tmp_path / "scene.yaml"), "--sigma-position", "0.02", "--json"]) == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)["microphone_arrays"]
    for found, true in zip(read_scene(tmp_path / "scene.yaml").arrays, arrays, strict=True):
        figures = summary[true.name]
        x, y, _ = figures["sigma_position"]
        # Cameras as a whole are within 0.05 m
        assert np.all(np.abs(found.position - true.position)[:2] < 0.05 + 4.0 * np.array([x, y]))
        turned = abs(np.degrees(wrap_angle(np.array(found.yaw - true.yaw))))
        assert turned < 0.5 + 4.0 * figures["sigma_yaw_deg"]
        assert max(x, y) < 0.2
        assert figures["sigma_yaw_deg"] < 3.0
        assert abs(figures["clock_offset_s"]) < 0.02 + 4.0 * figures["sigma_clock_s"]
        assert figures["of_people"] > 0.7
    assert summary["mic"]["sigma_position"][2] == pytest.approx(0.1, abs=0.02)
    assert summary["table"]["sigma_position"][2] is None


def _write_boxes(recording: Path, path: Path) -> None:
    """Boxes of the true paths of a recording, with errors of 2 px."""
    truth = Truth.concat(open_input(recording).rows(Truth))
    frame = np.unique(truth.t_ns, return_inverse=True)[1]
    state = np.zeros((len(truth), 6))
    state[:, 0], state[:, 1], state[:, 5] = truth.x, truth.y, 0.5
    state[:, 4] = 1.66 + 0.03 * truth.target_id
    rng, rows = np.random.default_rng(6), ["camera,frame,left,top,right,bottom"]
    for camera in cameras():
        box = np.zeros((len(state), 4))
        expected_boxes(pack_views([camera]).lens, np.zeros(len(state), np.int64), state, np.zeros(len(state)), box)
        box += rng.normal(0.0, 2.0, box.shape)
        inside = np.isfinite(box).all(axis=1) & (box[:, :2] > 0.0).all(axis=1) & (box[:, 2:] < [1279, 719]).all(axis=1)
        rows += [
            f"{camera.name},{k}," + ",".join(f"{v:.2f}" for v in own)
            for k, own in zip(frame[inside].tolist(), box[inside], strict=True)
        ]
    path.write_text("\n".join(rows) + "\n")
