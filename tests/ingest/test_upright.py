"""Calibrations whose world is not upright, turned when they are ingested."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from occlog.cli.main import run
from occlog.core.geometry.camera import angles_from_rotation, is_upright, turn_upright
from occlog.errors import ExitCode, InputError, UsageError
from occlog.ingest.rig import axis_vector, pose_checks, scene_checks, world_checks
from occlog.ingest.scene import find_turn, read_up
from occlog.io.formats.calibration.common import CalibrationOptions, mirror_matrix
from occlog.io.formats.calibration.reader import read_calibration
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.io.open import open_input
from occlog.io.recording.reader import open_recording
from occlog.records.scene import Camera, Scene, camera_fov, camera_rotation
from occlog.records.tables import Bearings, Truth
from occlog.records.verdicts import Check

TRUTH = np.array([[1.0, 2.0, 0.9], [1.5, 2.5, 1.1], [2.0, 2.0, 0.8]])


def camera(name: str, x: float, y: float, z: float, yaw: float, pitch: float) -> Camera:
    rotation = camera_rotation(np.radians(yaw), np.radians(pitch), 0.0)
    focal, principal, none = np.full(2, 600.0), np.array([319.5, 239.5]), np.zeros(5)
    fov = camera_fov((640, 480), focal, principal, none, "brown", rotation)
    return Camera(name, np.array([x, y, z]), rotation, focal, principal, (640, 480), fov=fov)


CAMERAS = (
    camera("a", 0.0, 0.0, 2.5, 40.0, -20.0),
    camera("b", 5.0, 0.0, 2.2, 130.0, -15.0),
    camera("c", 2.0, 6.0, 2.8, 265.0, -30.0),
)


def as_seen_by(k: int) -> tuple[tuple[Camera, ...], np.ndarray]:
    """The cameras and the truth in the world of camera k, and its height above the ground along its up."""
    base = CAMERAS[k]
    R = base.rotation.T
    moved = tuple(
        Camera(c.name, R @ (c.position - base.position), R @ c.rotation, c.focal_px, c.principal_px, c.image_size)
        for c in CAMERAS
    )
    return moved, (TRUTH - base.position) @ R.T


def toml(cameras: tuple[Camera, ...]) -> str:
    """As caliscope writes it: camera-from-world rotation and translation."""
    parts = []
    for c in cameras:
        back = c.rotation.T
        matrix = [[c.focal_px[0], 0.0, c.principal_px[0]], [0.0, c.focal_px[1], c.principal_px[1]], [0.0, 0.0, 1.0]]
        values = {
            "size": list(c.image_size or ()),
            "matrix": matrix,
            "distortions": [0.0] * 5,
            "translation": (-back @ c.position).tolist(),
            "rotation": back.tolist(),
        }
        lines = "\n".join(f"{key} = {json.dumps(value)}" for key, value in values.items())
        parts.append(f'[cameras.{c.name}]\nname = "{c.name}"\n{lines}\n')
    return "\n".join(parts)


def checks(cameras: tuple[Camera, ...], up: str | None, ground: float | None) -> tuple[Check, ...]:
    """Checks of the world of cameras that are turned by the options."""
    turn = find_turn(cameras, up, ground, lambda _: None)
    turned = cameras if turn is None else tuple(turn.camera(c) for c in cameras)
    return world_checks(turned, up, ground_stated=ground is not None)


def ids(cameras: tuple[Camera, ...], up: str | None, ground: float | None) -> list[str]:
    """Ids of what is found."""
    return [check.id for check in checks(cameras, up, ground) if check.found]


def test_inverted_extrinsics_of_all_cameras_are_named_in_place_of_the_world() -> None:
    assert ids(CAMERAS, None, None) == []
    inverted = tuple(replace(c, rotation=c.rotation.T, position=-c.rotation.T @ c.position) for c in CAMERAS)
    assert ids(inverted, None, None) == ["extrinsics-fit-if"]


def distances(positions: np.ndarray) -> np.ndarray:
    return np.linalg.norm(positions[:, None] - positions, axis=2)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    cameras, truth = as_seen_by(1)
    (tmp_path / "rig.toml").write_text(toml(cameras))
    assert set(tomllib.loads((tmp_path / "rig.toml").read_text())["cameras"]) == {"a", "b", "c"}
    rows = "\n".join(f"{t},0,{x},{y},{z}" for t, (x, y, z) in enumerate(truth))
    (tmp_path / "truth.csv").write_text(f"time,target_id,x,y,z\n{rows}\n")
    (tmp_path / "boxes.csv").write_text(
        "frame,camera,left,top,width,height\n" + "".join(f"0,{c.name},10,10,20,60\n" for c in CAMERAS)
    )
    return tmp_path


def ingest(folder: Path, *more: str) -> int:
    source = ["--calibration", str(folder / "rig.toml"), "--boxes", str(folder / "boxes.csv"), "--fps", "1"]
    return run(["ingest", "-o", str(folder / "out.mcap"), "--overwrite", *source, *more])


def test_a_world_at_a_camera_is_noticed_and_stays(folder, capsys):
    assert ingest(folder) == ExitCode.DONE
    stderr = capsys.readouterr().err
    assert "warning: the world of the calibration seems not to be upright" in stderr
    assert "deg from z" in stderr
    np.testing.assert_allclose(open_recording(folder / "out.mcap").scene.camera("b").position, 0.0, atol=1e-9)


def test_a_world_that_is_not_upright_fails_the_verdict_here_and_of_later_commands(folder, capsys):
    assert ingest(folder, "--strict") == ExitCode.THRESHOLD
    capsys.readouterr()
    made = open_recording(folder / "out.mcap").provenance.judged
    assert [(v.stage, [c.id for c in v.checks if c.found]) for v in made] == [("ingest", ["world-not-upright"])]
    command = ["detect", str(folder / "out.mcap"), "-o", str(folder / "b.parquet"), "-q"]
    assert run(command) == ExitCode.DONE
    carried = open_input(folder / "b.parquet", Bearings).provenance.judged
    assert carried[0] == made[0]
    assert ingest(folder, "--up", "auto", "--ground-height", "-2.2", "--strict") == ExitCode.DONE


@pytest.mark.parametrize("up", ["auto", "vector"])
def test_a_world_at_a_camera_is_turned_with_its_truth_and_provenance_says_how(folder, capsys, up):
    z = CAMERAS[1].rotation.T @ [0.0, 0.0, 1.0]
    direction = up if up == "auto" else ",".join(str(v) for v in z)
    ground = -float(CAMERAS[1].position[2])
    options = ["--up", direction, "--ground-height", str(ground), "--truth", str(folder / "truth.csv")]
    assert ingest(folder, *options) == ExitCode.DONE
    stderr = capsys.readouterr().err
    assert "warning" not in stderr
    assert "world turned upright" in stderr
    recording = open_input(folder / "out.mcap", Truth)
    assert recording.scene is not None
    found = {c.name: c for c in recording.scene.cameras}
    truth = recording.read(Truth)
    for c in CAMERAS:
        assert found[c.name].position[2] == pytest.approx(c.position[2], abs=1e-6)
        assert found[c.name].fov == pytest.approx(c.fov, abs=1e-6)
    np.testing.assert_allclose(truth.z, TRUTH[:, 2], atol=1e-6)
    # The same world but for a turn about z and a shift on the ground
    ours = np.vstack([*(found[c.name].position for c in CAMERAS), np.column_stack([truth.x, truth.y, truth.z])])
    theirs = np.vstack([*(c.position for c in CAMERAS), TRUTH])
    np.testing.assert_allclose(distances(ours), distances(theirs), atol=1e-6)
    made = open_recording(folder / "out.mcap").provenance.parameters
    assert made["up"] == direction
    assert made["ground"] == ground
    np.testing.assert_allclose(np.array(made["turned_by"]) @ z, [0, 0, 1], atol=1e-6)


def test_a_truth_without_heights_is_refused(folder, capsys):
    text = (folder / "truth.csv").read_text().splitlines()
    (folder / "flat.csv").write_text("\n".join(",".join(line.split(",")[:4]) for line in text) + "\n")
    assert ingest(folder, "--up", "auto", "--truth", str(folder / "flat.csv")) == ExitCode.BAD_INPUT
    assert "has no heights" in capsys.readouterr().err


def test_an_unknown_ground_below_no_camera_is_reported(folder, capsys):
    assert ingest(folder, "--up", "auto") == ExitCode.DONE
    assert "state the height of the ground" in capsys.readouterr().err


def test_an_upright_world_is_left_alone():
    reported: list[str] = []
    assert find_turn(CAMERAS, None, None, reported.append) is None
    turn = find_turn(CAMERAS, None, 0.5, reported.append)
    assert not reported
    assert not ids(CAMERAS, None, None)
    assert turn is not None
    np.testing.assert_allclose(turn.camera(CAMERAS[0]).position, [0.0, 0.0, 2.0])


def test_cameras_that_look_the_same_way_are_reported_to_leave_the_pitch_open():
    assert ids(CAMERAS[:1], "auto", None) == ["vertical-uncertain"]


@pytest.mark.parametrize(
    ("text", "up"),
    [("x", (1, 0, 0)), ("-y", (0, -1, 0)), ("+z", (0, 0, 1)), ("0,-1,0.1", (0, -1, 0.1))],
)
def test_a_direction_is_an_axis_with_its_sign_or_three_numbers(text, up):
    np.testing.assert_array_equal(read_up(text), up)


@pytest.mark.parametrize("text", ["w", "", "1,2", "0,0,0", "nan,0,1", "-", "1,2,3,4"])
def test_anything_else_is_no_direction(text):
    with pytest.raises(UsageError, match="an axis with its sign"):
        read_up(text)


def test_up_without_a_calibration_is_refused(folder, capsys):
    (folder / "scene.yaml").write_text(scene_to_yaml(Scene(cameras=CAMERAS)))
    boxes = ["--boxes", str(folder / "boxes.csv"), "--scene", str(folder / "scene.yaml"), "--fps", "1"]
    assert run(["ingest", "-o", str(folder / "o.mcap"), *boxes, "--up", "auto"]) == ExitCode.USAGE
    assert "turn the world of a calibration" in capsys.readouterr().err


def test_truth_turns_only_with_heights(tmp_path):
    turn, same = (find_turn(CAMERAS, up, None, lambda _: None) for up in ("0.1,0,1", "z"))
    assert turn is not None
    assert same is not None
    truth = Truth.of(t_ns=[0], target_id=[0], role=["target"], x=[1.0], y=[2.0], z=[np.nan])
    with pytest.raises(InputError, match="add z"):
        turn.truth(truth, tmp_path / "t.csv")
    kept = same.truth(truth, tmp_path / "t.csv")
    assert (kept.x[0], kept.y[0], np.isnan(kept.z[0])) == (1.0, 2.0, True)


def projections(cameras: tuple[Camera, ...], axes: np.ndarray) -> dict[str, np.ndarray]:
    """3 x 4 matrices in the world with mirrored axes."""
    out = {}
    for c in cameras:
        k = np.array([[c.focal_px[0], 0, c.principal_px[0]], [0, c.focal_px[1], c.principal_px[1]], [0, 0, 1]])
        out[c.name] = k @ np.column_stack([c.rotation.T @ axes, -c.rotation.T @ c.position])
    return out


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_left_handed_world_is_reported_and_mirrored_with_the_truth(tmp_path, capsys, axis):
    """Matrices of a mirrored world: the cameras of the right-handed one come back, and so do true positions."""
    axes = mirror_matrix(axis)
    folder = tmp_path / "P"
    folder.mkdir()
    for name, matrix in projections(CAMERAS, axes).items():
        np.savetxt(folder / f"{name}.txt", matrix)
    left = TRUTH @ axes
    lines = [f"{k},0,{x},{y},{z}" for k, (x, y, z) in enumerate(left.tolist())]
    (tmp_path / "truth.csv").write_text("\n".join(["frame,id,x,y,z", *lines]) + "\n")
    for name in "abc":
        (tmp_path / f"{name}.csv").write_text("frame,left,top,width,height\n0,300,200,40,90\n")
    command = ["ingest", "-o", str(tmp_path / "r.mcap"), "--overwrite", "--calibration", str(folder), "--fps", "10"]
    command += ["--image-size", "640x480", "--truth", str(tmp_path / "truth.csv")]
    command += [part for name in "abc" for part in ("--boxes", f"{name}={tmp_path / name}.csv")]
    assert run(command) == ExitCode.DONE
    stderr = capsys.readouterr().err
    assert "seems left-handed" in stderr
    assert "--mirror y" in stderr
    assert "axes do not meet in front of any camera" in stderr
    assert "meet near" not in stderr
    assert run([*command, "--mirror", axis]) == ExitCode.DONE
    stderr = capsys.readouterr().err
    assert f"left-handed ({axis} is mirrored)" in stderr
    assert "warning" not in stderr
    recording = open_recording(tmp_path / "r.mcap")
    scene, truth = recording.scene, recording.read(Truth)
    assert scene is not None
    for found, true in zip(scene.cameras, CAMERAS, strict=True):
        np.testing.assert_allclose(found.position, true.position, atol=1e-9)
        np.testing.assert_allclose(found.rotation, true.rotation, atol=1e-9)
    np.testing.assert_allclose(np.column_stack([truth.x, truth.y, truth.z]), TRUTH, atol=1e-9)


def test_rotations_of_a_left_handed_world_are_refused_and_mirrored(tmp_path):
    """Unity: y up, z to the back; files with matrices of the determinant -1."""
    axes = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, 1.0, 0]])  # x, z, y: of determinant -1
    moved = tuple(
        Camera(c.name, axes @ c.position, axes @ c.rotation, c.focal_px, c.principal_px, c.image_size) for c in CAMERAS
    )
    (tmp_path / "c.toml").write_text(toml(moved))
    with pytest.raises(InputError, match=r"determinant -1.*left-handed"):
        read_calibration([tmp_path / "c.toml"])
    found = read_calibration([tmp_path / "c.toml"], options=CalibrationOptions(mirror="z")).cameras
    reported: list[str] = []
    turn = find_turn(found, "y", None, reported.append, "z")
    assert turn is not None
    assert not ids(tuple(turn.camera(c) for c in found), None, None)
    heights = [turn.camera(c).position[2] for c in found]
    np.testing.assert_allclose(heights, [c.position[2] for c in CAMERAS], atol=1e-9)
    for camera, true in zip(found, CAMERAS, strict=True):
        upright = turn.camera(camera)
        world = turn.positions(TRUTH @ axes.T)
        np.testing.assert_allclose(upright.project(world), true.project(TRUTH), atol=1e-6)


def test_a_rig_that_faces_outwards_is_not_left_handed():
    outwards = tuple(
        camera(n, np.cos(a), np.sin(a), 2.0, np.degrees(a), -10.0) for n, a in zip("abc", (0, 2, 4), strict=True)
    )
    assert not ids(outwards, None, None)


@pytest.mark.parametrize("up", ["auto", None])
def test_a_ground_of_the_wrong_sign_is_reported_with_the_cameras_that_are_below(up):
    (found,) = (check for check in checks(CAMERAS, up, 2.6) if check.found)
    assert (found.id, found.status, found.sensors) == ("camera-not-above-ground", "failed", ("a", "b"))
    assert "(the lowest has z = -0.40 m)" in found.text
    assert "negative below the origin" in found.text


def test_a_camera_at_the_height_of_the_ground_is_reported_and_one_just_above_is_not():
    (found,) = (check for check in checks(CAMERAS, None, 2.2) if check.found)
    assert found.text.startswith("camera b is not above the ground (the lowest has z = 0.00 m)")
    assert not ids(CAMERAS, None, 2.19)


@pytest.mark.parametrize("off", [-4e-10, 4e-10])
def test_rounding_of_the_calibration_gives_no_camera_a_height(off):
    turn = find_turn(CAMERAS, None, 2.2 + off, lambda _: None)
    assert turn is not None
    assert turn.camera(CAMERAS[1]).position[2] == 0.0
    assert turn.camera(CAMERAS[0]).position[2] == pytest.approx(0.3)


def misread(c: Camera, how: str) -> Camera:
    """The camera as it is read if its file states the extrinsics in another way."""
    back, opengl = c.rotation.T, np.diag([1.0, -1.0, -1.0])
    shift = -back @ c.position
    first = np.roll(Rotation.from_matrix(c.rotation).as_quat(), 1)  # w, x, y, z
    last = Rotation.from_quat(np.roll(Rotation.from_matrix(back).as_quat(), -1)).inv().as_matrix()
    body = np.column_stack([c.rotation[:, 2], -c.rotation[:, 0], -c.rotation[:, 1]])
    rotation, position = {
        "w first": (Rotation.from_quat(first).as_matrix(), c.position),
        "w last": (last, -last @ shift),
        "bodies": (body, c.position),
        "inverted": (back, -back @ c.position),
        "OpenGL": (opengl @ back, -opengl @ back @ c.position),
        "transposed": (back, -back @ shift),
        "centres": (c.rotation, -c.rotation @ c.position),
    }[how]
    return Camera(c.name, position, rotation, c.focal_px, c.principal_px, c.image_size)


@pytest.mark.parametrize("how", ["inverted", "OpenGL", "transposed", "centres", "w first", "w last", "bodies"])
def test_extrinsics_that_mean_something_else_are_named(how: str) -> None:
    (found,) = (c for c in checks(tuple(misread(c, how) for c in CAMERAS), None, None) if c.id == "extrinsics-fit-if")
    assert how in found.text
    assert len(found.text) < 160


@pytest.mark.parametrize("k", [0, 1, 2])
def test_the_world_of_a_camera_is_not_called_inverted(k: int) -> None:
    moved, _ = as_seen_by(k)
    assert "extrinsics-fit-if" not in {c.id for c in checks(moved, None, None)}


def test_a_left_handed_world_is_not_called_inverted() -> None:
    axes = np.diag([1.0, -1.0, 1.0])
    mirrored = [
        Camera(c.name, axes @ c.position, -axes @ c.rotation, c.focal_px, c.principal_px, c.image_size) for c in CAMERAS
    ]
    assert [c.id for c in world_checks(mirrored, None, ground_stated=False) if c.found] == ["world-left-handed"]


@pytest.mark.parametrize("how", ["inverted", "centres"])
@pytest.mark.parametrize("k", [0, 1, 2])
def test_a_single_camera_that_is_misread_is_named_with_its_cause(k: int, how: str) -> None:
    wrong = tuple(misread(c, how) if n == k else c for n, c in enumerate(CAMERAS))
    found = [c for c in checks(wrong, None, None) if c.found]
    if wrong[k].position[2] <= 0.0 or not is_upright(wrong[k].rotation[None]):
        assert [c.id for c in found] == ["camera-extrinsics-fit-if"]
        assert found[0].sensors == (CAMERAS[k].name,)
        assert how in found[0].text
        assert len(found[0].text) <= 160
    else:
        assert "camera-extrinsics-fit-if" not in [c.id for c in found]


@pytest.mark.parametrize("k", [0, 1])
def test_one_of_two_cameras_that_is_inverted_is_named_though_it_is_above_the_ground(k: int) -> None:
    pair = CAMERAS[:2]
    wrong = tuple(misread(c, "inverted") if n == k else c for n, c in enumerate(pair))
    assert wrong[k].position[2] > 0.0
    (found,) = (c for c in checks(wrong, None, None) if c.found)
    assert (found.id, found.sensors) == ("camera-extrinsics-fit-if", (pair[k].name,))
    assert "inverted" in found.text


def test_a_camera_below_the_ground_that_no_other_meaning_mends_is_only_low() -> None:
    low = replace(CAMERAS[1], position=np.array([60.0, 10.0, -2.2]))
    assert ids((CAMERAS[0], low, CAMERAS[2]), None, None) == ["camera-not-above-ground"]


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize(
    ("up", "axes"), [("y", [[1, 0, 0], [0, 0, 1], [0, -1, 0]]), ("-y", [[1, 0, 0], [0, 0, -1], [0, 1, 0]])]
)
def test_a_world_with_y_up_is_named_and_no_single_camera(n: int, up: str, axes: list[list[int]]) -> None:
    """Its origin is in the middle of the room, so that cameras have heights of both signs along z."""
    turn, middle = np.array(axes, dtype=np.float64), np.array([2.5, 3.0, 0.0])
    moved = tuple(replace(c, position=turn @ (c.position - middle), rotation=turn @ c.rotation) for c in CAMERAS[:n])
    (found,) = (c for c in checks(moved, None, None) if c.found)
    assert found.id == "world-not-upright"
    assert found.text.endswith(f"(ingest --up {up})")
    assert ids(moved, up, None) == []


@pytest.mark.parametrize("up", ["x", "-x", "y", "-y", "z", "-z"])
@pytest.mark.parametrize("mirrored", [None, "x", "y", "z"])
def test_the_advice_of_axes_leads_to_the_right_world(mirrored: str | None, up: str) -> None:
    """Each advice names the options given so far, too; from any first guess of `--mirror` and `--up`."""
    middle, axes = np.array([2.5, 3.0, 0.0]), mirror_matrix(mirrored) @ turn_upright(axis_vector(up)).T
    own = axis_vector(up) if up[-1] != mirrored else -axis_vector(up)
    handed = 1.0 if mirrored is None else -1.0  # everything is behind the cameras of a left-handed world
    world = tuple(
        replace(c, position=axes @ (c.position - middle), rotation=handed * axes @ c.rotation) for c in CAMERAS
    )
    for guess in ((None, None), (None, up), ("x", None), ("y", None), ("z", "y")):
        mirror, vertical = guess
        for _ in range(4):
            turn = find_turn(world, vertical, None, lambda _: None, mirror)
            placed = world if turn is None else tuple(turn.camera(c) for c in world)
            by = None if turn is None else turn.rotation
            found = [
                c for c in world_checks(placed, vertical, ground_stated=False, mirror=mirror, turned_by=by) if c.found
            ]
            if not found:
                break
            (check,) = found
            if check.id == "world-mirrored":
                mirror = None
            elif check.id == "world-left-handed":
                mirror = "y"
            else:
                assert check.id == "world-not-upright"
                assert (f"ingest --mirror {mirror} --up " in check.text) == (mirror is not None)
                vertical = check.text[check.text.index("--up ") + 5 : -1]
                np.testing.assert_array_equal(read_up(vertical), own)
        assert not found
        np.testing.assert_allclose([c.position[2] for c in placed], [c.position[2] for c in CAMERAS], atol=1e-9)
        seen = (TRUTH - middle) @ axes.T
        for camera, true in zip(placed, CAMERAS, strict=True):
            np.testing.assert_allclose(
                camera.project(seen if turn is None else turn.positions(seen)), true.project(TRUTH), atol=1e-6
            )


def as_stated(camera: Camera, how: str) -> Camera:
    """The camera as it is read from a scene that states its angles in another unit or sense."""
    yaw, pitch, roll = angles_from_rotation(camera.rotation)
    angles = {
        "yaw_deg, pitch_deg, roll_deg are in radians": tuple(np.radians([yaw, pitch, roll]).tolist()),
        "pitch is positive downwards": (yaw, -pitch, roll),
        "yaw is clockwise from north (+y)": (0.5 * np.pi - yaw, pitch, roll),
        "": (yaw, pitch, roll),
    }[how]
    return replace(camera, rotation=camera_rotation(*angles))


@pytest.mark.parametrize(
    "how",
    [
        "yaw_deg, pitch_deg, roll_deg are in radians",
        "pitch is positive downwards",
        "yaw is clockwise from north (+y)",
        "",
    ],
)
def test_angles_of_a_scene_in_another_unit_or_sense_are_named(how: str) -> None:
    corners = [(0.0, 0.0, 45.0), (8.0, 0.0, 135.0), (8.0, 6.0, 215.0)]
    rig = [camera(f"cam{n}", x, y, 2.8, yaw, -22.0) for n, (x, y, yaw) in enumerate(corners)]
    found = [check for check in scene_checks([as_stated(each, how) for each in rig]) if check.found]
    assert [check.id for check in found] == (["scene-angles-fit-if"] if how else [])
    assert all(how in check.text for check in found)


def test_a_copied_pose_is_named_with_both_cameras() -> None:
    copied = replace(CAMERAS[0], name="copy")
    (check,) = pose_checks([*CAMERAS, copied])
    assert (check.id, check.sensors) == ("cameras-same-pose", (CAMERAS[0].name, "copy"))
    assert not any(each.found for each in pose_checks(CAMERAS))
