"""Cameras that share no view: who passes from view to view, the poses that follow, and the command line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from occlog.array_types import Floats
from occlog.calibrate.kernels import expected_boxes
from occlog.calibrate.people import Tracklet
from occlog.calibrate.starts.handovers import Handovers, poses_of_handovers, walkers
from occlog.cli.main import run
from occlog.core.geometry.camera import rotation_from_angles
from occlog.errors import ExitCode
from occlog.io.formats.scenes.scene import read_scene, scene_to_yaml
from occlog.records.scene import Camera, Scene
from occlog.track.methods.jipda.kernels.body_box import pack_views

FPS, BAY, SIZE = 5.0, 2.75, (1280, 720)


def track(camera: int, begin: float, end: float) -> Tracklet:
    """A track without positions."""
    t: Floats = np.linspace(begin, end, 5)
    return Tracklet(camera, t, np.zeros((5, 4)), np.zeros(5, dtype=np.complex128))


def test_tracks_that_follow_one_another_are_of_one_person() -> None:
    """Two views 3 s apart; the next track begins 30 s later, and one in the same view is a new person."""
    person, ambiguous = walkers([track(0, 0, 4), track(1, 7, 10), track(2, 40, 44), track(2, 46, 50)], 10.0)
    assert person[0] == person[1]
    assert len(set(person.tolist())) == 3
    assert ambiguous == 0


def test_views_may_meet() -> None:
    """A person is seen by two cameras for 0.4 s, and by a third one 2 s later."""
    person, ambiguous = walkers([track(0, 0, 4), track(1, 3.6, 8), track(2, 10, 12)], 10.0)
    assert len(set(person.tolist())) == 1
    assert ambiguous == 0


def test_handovers_of_two_people_at_once_are_left_out() -> None:
    """While one person is not seen, another one is; and two people leave before one enters."""
    person, ambiguous = walkers([track(0, 0, 4), track(2, 2, 6), track(1, 7, 10)], 10.0)
    assert len(set(person.tolist())) == 3
    assert ambiguous == 1


YAW = np.array([0.0, 2.0, -1.0, 0.5])
AT = np.array([0.0, 8.0 + 1.0j, 3.0 + 9.0j, 12.0 + 7.0j])


def passages(count: int, turned: float, rng: np.random.Generator) -> Handovers:
    """Straight ways between four cameras, of which a share has a right angle half way."""
    camera = np.array([rng.choice(4, 2, replace=False) for _ in range(count)])
    away = AT[camera[:, 1]] - AT[camera[:, 0]]
    velocity = 1.2 * away / np.abs(away)
    seconds = (np.abs(away) - 3.0) / 1.2
    side = rng.uniform(-1.5, 1.5, count) * 1j * velocity
    ends = np.column_stack([AT[camera[:, 0]] + 1.5 / 1.2 * velocity, AT[camera[:, 1]] - 1.5 / 1.2 * velocity])
    ends += side[:, None]
    both = np.column_stack([velocity, velocity])
    bent = rng.random(count) < turned
    ends[bent, 1] += rng.choice([-3.0, 3.0], bent.sum()) * (1.0 + 1.0j)
    both[bent, 1] *= 1j
    back = np.exp(-1j * YAW[camera])
    return Handovers(camera, seconds, back * (ends - AT[camera]), back * both)


def test_poses_follow_from_straight_ways_though_some_turn() -> None:
    """A fifth of 60 people turns by a right angle where no camera sees them."""
    found = poses_of_handovers(passages(60, 0.2, np.random.default_rng(2)), 4, 1.0, np.random.default_rng(0))
    poses = [pose for pose in found if pose is not None]
    assert len(poses) == 4
    yaw, at = np.array([p.yaw for p in poses]), np.array([p.position for p in poses])
    np.testing.assert_allclose(np.exp(1j * (yaw - yaw[0])), np.exp(1j * YAW), atol=0.05)
    np.testing.assert_allclose(np.exp(-1j * yaw[0]) * (at - at[0]), AT, atol=0.4)


def test_a_camera_with_two_handovers_is_left_out() -> None:
    """Two do not decide which of them is false."""
    seen = passages(60, 0.0, np.random.default_rng(3))
    few = np.flatnonzero((seen.camera == 3).any(axis=1))[2:]
    part = Handovers(*(np.delete(values, few, axis=0) for values in seen))
    poses = poses_of_handovers(part, 4, 1.0, np.random.default_rng(0))
    assert [pose is None for pose in poses] == [False, False, False, True]


def cameras() -> list[Camera]:
    """Three cameras 8 m apart, in directions of their own."""
    poses = [((0.0, 0.0), 20.0), ((8.0, 1.0), 160.0), ((4.0, 7.0), -80.0)]
    out = []
    for k, (middle, yaw) in enumerate(poses):
        angle = np.radians(yaw)
        at = np.array([*middle, 3.0 - 0.1 * k]) - 4.5 * np.array([np.cos(angle), np.sin(angle), 0.0])
        rotation = rotation_from_angles(float(angle), np.radians(-20.0), 0.01 * k)
        out.append(Camera(f"cam{k}", at, rotation, np.full(2, 700.0), np.array([639.5, 359.5]), SIZE))
    return out


def middle_of_view(camera: Camera) -> Floats:
    """(2,) middle of the square that a camera sees."""
    return np.asarray(camera.position[:2] + 4.5 * np.array([np.cos(camera.yaw), np.sin(camera.yaw)]))


def write(folder: Path, walks: int) -> list[str]:
    """Boxes of people who walk straight from view to view, one by one, and a scene of lenses, heights and tilts."""
    rng = np.random.default_rng(6)
    middles = [middle_of_view(c) for c in cameras()]
    rows = ["camera,frame,left,top,right,bottom"]
    for walk in range(walks):
        views = [int(rng.integers(3))]
        while len(views) < 7:
            views.append(int(rng.choice([k for k in range(3) if k != views[-1]])))
        corners = np.array([middles[k] + rng.uniform(-0.8, 0.8, 2) for k in views])
        lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1)))
        way = np.arange(0.0, lengths[-1], 1.2 / FPS)
        at = np.column_stack([np.interp(way, lengths, corners[:, k]) for k in (0, 1)])
        n = len(at)
        state = np.column_stack([at, np.zeros((n, 2)), np.full((n, 1), rng.normal(1.7, 0.05)), np.full((n, 1), 0.5)])
        for camera in cameras():
            box = np.zeros((n, 4))
            expected_boxes(pack_views([camera]).lens, np.zeros(n, dtype=np.int64), state, np.zeros(n), box)
            box += rng.normal(0.0, 1.0, box.shape)
            seen = (np.abs(at - middle_of_view(camera)) < BAY).all(axis=1) & np.isfinite(box).all(axis=1)
            box = np.clip(box, 0.0, np.tile(np.array(SIZE) - 1.0, 2))
            rows += [
                f"{camera.name},{round(100.0 * FPS) * walk + k}," + ",".join(f"{v:.2f}" for v in box[k])
                for k in np.flatnonzero(seen)
            ]
    (folder / "boxes.csv").write_text("\n".join(rows) + "\n")
    # Heights and inclinations alone are known
    bare = [
        replace(c, position=c.position * [0, 0, 1], rotation=rotation_from_angles(0.0, np.radians(-20.0), 0.01 * k))
        for k, c in enumerate(cameras())
    ]
    (folder / "rough.yaml").write_text(scene_to_yaml(Scene(tuple(bare))))
    return ["--boxes", str(folder / "boxes.csv"), "--scene", str(folder / "rough.yaml"), "--fps", f"{FPS:g}"]


@pytest.mark.jit
def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Six walks calibrate three cameras; without passages it is refused."""
    assert run(["ingest", "-q", "-o", str(tmp_path / "walk.mcap"), *write(tmp_path, 6)]) == ExitCode.DONE
    asked = ["calibrate", str(tmp_path / "walk.mcap"), "-o", str(tmp_path / "scene.yaml"), "--ignore-poses", "--json"]
    asked += ["--set", "sigma_tilt=0.2", "--set", "sigma_height=0.02"]
    assert run([*asked, "--max-gap", "0.3"]) == ExitCode.BAD_INPUT
    capsys.readouterr()
    assert run(asked) == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    assert summary["passages"]["used"] >= 25
    found = list(read_scene(tmp_path / "scene.yaml").cameras)
    ours, true = (np.array([complex(*c.position[:2].tolist()) for c in each]) for each in (found, cameras()))
    turn = ((ours - ours.mean()) * np.conj(true - true.mean())).sum()
    turn /= abs(turn)
    assert np.abs(ours - ours.mean() - turn * (true - true.mean())).max() < 0.3
    yaw = [a.yaw - b.yaw - np.angle(turn) for a, b in zip(found, cameras(), strict=True)]
    assert np.abs(np.angle(np.exp(1j * np.array(yaw)))).max() < np.radians(1.5)
    for camera in found:
        assert camera.sigma_position > 0.0
        assert camera.sigma_yaw > 0.0
