"""YOLO text of four cameras and a camera chain of Kalibr become tracks of everybody with two commands."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from people_boxes import PEOPLE, SIZE, STEP_NS, boxes, hall, place

from occlog.array_types import Floats
from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.tables.parquet import read_table
from occlog.io.recording.reader import open_recording
from occlog.records.scene import Scene
from occlog.records.tables import Boxes, PeopleTracks

SECONDS = 5.0


def write_yolo(folder: Path, found: Boxes) -> None:
    """Labels as Ultralytics writes them: people (0) cut at the border, a bench (13) as well, nothing for no one."""
    for row in range(len(found)):
        labels = folder / str(found.sensor[row]) / "labels"
        labels.mkdir(parents=True, exist_ok=True)
        if found.box[row] < 0:
            continue
        left, top = max(found.left_px[row], 0.0), max(found.top_px[row], 0.0)
        right = min(found.left_px[row] + found.width_px[row], SIZE[0])
        bottom = min(found.top_px[row] + found.height_px[row], SIZE[1])
        shares = ((left + right) / 2 / SIZE[0], (top + bottom) / 2 / SIZE[1])
        shares += ((right - left) / SIZE[0], (bottom - top) / SIZE[1])
        line = " ".join(f"{v:g}" for v in (0, *shares, found.confidence[row]))
        with (labels / f"walk_{found.frame[row] + 1}.txt").open("a") as file:
            file.write(f"{line}\n" + ("13 0.5 0.6 0.2 0.1 0.6\n" if found.box[row] == 0 else ""))


def write_chain(path: Path, scene: Scene) -> None:
    """The cameras as Kalibr has them: the world is the frame of the first one."""
    chain: dict[str, dict[str, object]] = {}
    before: Floats = np.eye(4)
    for n, camera in enumerate(scene.cameras):
        here = np.eye(4)
        here[:3, :3], here[:3, 3] = camera.rotation.T, -camera.rotation.T @ camera.position
        chain[f"cam{n}"] = {
            "camera_model": "pinhole",
            "distortion_model": "radtan",
            "distortion_coeffs": [0.0] * 4,
            "intrinsics": [*camera.focal_px.tolist(), *camera.principal_px.tolist()],
            "resolution": list(SIZE),
        }
        if n:
            chain[f"cam{n}"]["T_cn_cnm1"] = (here @ np.linalg.inv(before)).tolist()
        before = here
    path.write_text(yaml.safe_dump(chain))


def onto(from_: Floats, to: Floats) -> tuple[Floats, Floats]:
    """Rotation and shift of the plane that bring points nearest to others (Kabsch)."""
    u, _, vt = np.linalg.svd((from_ - from_.mean(axis=0)).T @ (to - to.mean(axis=0)))
    turn = vt.T @ np.diag([1.0, np.sign(np.linalg.det(vt.T @ u.T))]) @ u.T
    return turn, to.mean(axis=0) - turn @ from_.mean(axis=0)


@pytest.mark.jit
def test_two_commands_make_tracks_of_yolo_text_and_a_kalibr_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = hall("abcd")
    names = {c.name: f"cam{n}" for n, c in enumerate(scene.cameras)}
    found = boxes(scene, SECONDS)
    found = Boxes.of(**{
        c.name: getattr(found, c.name) if c.name != "sensor" else np.array([names[s] for s in found.sensor.tolist()])
        for c in Boxes.columns()
    })  # fmt: skip
    write_yolo(tmp_path / "yolo", found)
    write_chain(tmp_path / "camchain.yaml", scene)
    recording, tracks = tmp_path / "hall.mcap", tmp_path / "tracks.parquet"
    placed = ["--calibration", str(tmp_path / "camchain.yaml"), "--up", "auto", "--ground-height", "-3"]
    how = ["--boxes", str(tmp_path / "yolo"), "--class", "0", "--fps", "10", "--first-number", "1"]
    assert run(["ingest", "-o", str(recording), *how, *placed]) == ExitCode.DONE
    stderr = capsys.readouterr().err
    assert "kalibr, m, right-handed, 4 cameras" in stderr
    assert "skipped: class 13" in stderr
    assert run(["track", str(recording), "--method", "jipda", "-o", str(tracks)]) == ExitCode.DONE

    # The world is turned and shifted from the hall's: the cameras tell by how much.
    opened = open_recording(recording)
    assert opened.scene is not None
    assert [c.position[2] for c in opened.scene.cameras] == pytest.approx([3.0] * 4, abs=0.02)
    mine = np.array([c.position[:2] for c in opened.scene.cameras])
    turn, shift = onto(mine, np.array([c.position[:2] for c in scene.cameras]))
    rows = read_table(tracks, PeopleTracks)
    rows = rows.take(rows.t_ns >= 10 * STEP_NS)
    positions = np.column_stack([rows.x, rows.y]) @ turn.T + shift
    errors = []
    for t_ns in np.unique(rows.t_ns).tolist():
        true = np.array([place(k, t_ns * 1e-9) for k in range(PEOPLE)])
        off = np.linalg.norm(positions[rows.t_ns == t_ns][:, None] - true, axis=2)
        assert off.shape == (PEOPLE, PEOPLE)
        errors.append(off.min(axis=0))
    assert len(np.unique(rows.target_id)) == PEOPLE
    assert np.sqrt(np.mean(np.square(errors))) < 0.12
    assert np.max(errors) < 0.5


@pytest.mark.jit
def test_files_without_any_box_are_looks_of_all_cameras_at_no_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_chain(tmp_path / "chain.yaml", hall("abcd"))
    (tmp_path / "none.csv").write_text("frame,camera,x1,y1,x2,y2,score\n")
    recording, tracks = str(tmp_path / "r.mcap"), str(tmp_path / "t.parquet")
    boxes_of = ["--boxes", str(tmp_path / "none.csv"), "--calibration", str(tmp_path / "chain.yaml")]
    world = ["--up", "auto", "--ground-height", "-4", "--fps", "10", "--frames", "0:40"]
    assert run(["ingest", "-o", recording, *boxes_of, *world]) == ExitCode.DONE
    assert "every frame of cam0, cam1, cam2, cam3 is a frame without a person" in capsys.readouterr().err
    assert run(["track", recording, "--method", "jipda", "-o", tracks]) == ExitCode.DONE
    assert "no target was found, and the tracks are empty" in capsys.readouterr().err
    assert len(read_table(Path(tracks), PeopleTracks)) == 0
