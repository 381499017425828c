"""Folders and texts of data sets as they ship: WILDTRACK's layout, VATIC text of CAMPUS."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from occlog.array_types import Floats
from occlog.cli.main import run
from occlog.core.geometry.camera import rotation_from_angles
from occlog.errors import ExitCode
from occlog.io.recording.reader import McapRecording, open_recording
from occlog.records.tables import Boxes, Truth, TruthBoxes

MATRIX = np.array([[900.0, 0, 960], [0, 900, 540], [0, 0, 1]])
NAMES = ("CVLab1", "IDIAP1")
FRAMES = (0, 5, 10, 15)
PLACES = {(k, f): (40 * k + f) + 480 * (300 + 30 * k) for k in range(6) for f in FRAMES}
"""Position on the grid of each person in each frame."""


def pose(n: int) -> tuple[Floats, Floats]:
    """Camera-from-world rotation and centre [m] of a camera."""
    return rotation_from_angles(np.radians(90.0 - 20 * n), np.radians(-15.0), 0.0).T, np.array([-3.0 + n, -9.0, 3.0])


def wildtrack(folder: Path, *, images: bool = False, shift: int = 0) -> Path:
    """The data set with two cameras; `shift` moves the positions on the grid away from the boxes."""
    for part in ("extrinsic", "intrinsic_zero"):
        (folder / "calibrations" / part).mkdir(parents=True)
    for n, name in enumerate(NAMES):
        rotation, centre = pose(n)
        rvec, tvec = cv2.Rodrigues(rotation)[0].ravel(), -rotation @ centre * 100
        vectors = {"rvec": rvec.tolist(), "tvec": tvec.tolist()}
        parts = "".join(f"<{key}>\n{' '.join(map(repr, value))}</{key}>\n" for key, value in vectors.items())
        text = f'<?xml version="1.0"?>\n<opencv_storage>\n{parts}</opencv_storage>\n'
        (folder / f"calibrations/extrinsic/extr_{name}.xml").write_text(text)
        data = " ".join(map(repr, MATRIX.ravel().tolist()))
        lens = f'<camera_matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt><data>{data}</data>'
        text = f'<?xml version="1.0"?>\n<opencv_storage>\n{lens}</camera_matrix>\n</opencv_storage>\n'
        (folder / f"calibrations/intrinsic_zero/intr_{name}.xml").write_text(text)
    (folder / "annotations_positions").mkdir()
    for frame in FRAMES:
        people = [annotated(k, PLACES[k, frame], shift) for k in range(6)]
        (folder / f"annotations_positions/{frame:08d}.json").write_text(json.dumps(people))
        for name in ("C1", "C5") if images else ():
            (folder / "Image_subsets" / name).mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(folder / f"Image_subsets/{name}/{frame:08d}.png"), np.zeros((1080, 1920), np.uint8))
    return folder


def annotated(person: int, position: int, shift: int) -> dict[str, object]:
    """A person with the boxes of both cameras; -1 where the feet are outside."""
    views = []
    x, y = -3 + 0.025 * (position % 480), -9 + 0.025 * (position // 480)
    for n, view in ((0, 0), (1, 4)):
        rotation, centre = pose(n)
        feet, head = (MATRIX @ rotation @ (np.array([x, y, z]) - centre) for z in (0.0, 1.75))
        (u, v), top = feet[:2] / feet[2], head[1] / head[2]
        seen = feet[2] > 0 and 0 < u < 1920 and 0 < v < 1080
        edges = (int(u - 40), int(top), int(u + 40), int(v)) if seen else (-1, -1, -1, -1)
        views.append({"viewNum": view, **dict(zip(("xmin", "ymin", "xmax", "ymax"), edges, strict=True))})
    return {"personID": 100 + person, "positionID": position + shift, "views": views}


def ingested(folder: Path, *args: str) -> McapRecording:
    assert run(["ingest", "-o", str(folder / "w.mcap"), "--overwrite", *args]) == ExitCode.DONE
    return open_recording(folder / "w.mcap")


def test_the_folder_of_wildtrack_is_ingested_as_it_ships(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = ingested(tmp_path, str(wildtrack(tmp_path / "W", images=True)))
    assert recording.scene is not None
    assert [c.name for c in recording.scene.cameras] == ["C1", "C5"]
    for n, camera in enumerate(recording.scene.cameras):
        assert camera.position == pytest.approx(pose(n)[1])
    assert [f.t_ns for f in recording.frames() if f.sensor == "C1"] == [f * 10**8 for f in FRAMES]
    truth = Truth.concat(recording.tables(Truth))
    assert len(truth) == len(PLACES)
    assert sorted(set(truth.t_ns.tolist())) == [f * 10**8 for f in FRAMES]
    first = truth.take((truth.target_id == 102) & (truth.t_ns == 5 * 10**8))
    assert (first.x[0], first.y[0]) == pytest.approx((-3 + 0.025 * 85, -9 + 0.025 * 360))
    boxes = TruthBoxes.concat(recording.tables(TruthBoxes))
    assert set(boxes.frame.tolist()) == set(FRAMES)
    stderr = capsys.readouterr().err
    assert "opencv-pairs, cm -> m, right-handed" in stderr
    assert "true positions, projected, are off the feet of true boxes" in stderr


def test_wildtrack_without_images_wants_boxes_and_takes_its_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = wildtrack(tmp_path / "W")
    assert run(["ingest", "-o", str(tmp_path / "w.mcap"), str(folder)]) == ExitCode.USAGE
    assert "has no images" in capsys.readouterr().err
    recording = ingested(tmp_path, str(folder), "--boxes", str(folder / "annotations_positions"))
    boxes = Boxes.concat(recording.tables(Boxes))
    assert set(boxes.frame.tolist()) == set(FRAMES)
    assert set(boxes.target_id[boxes.box >= 0].tolist()) == {100 + k for k in range(6)}
    assert "in steps of 5" in capsys.readouterr().err


def test_positions_that_are_not_where_the_boxes_are_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = wildtrack(tmp_path / "W", shift=480 * 200)
    given = [str(folder), "--boxes", str(folder / "annotations_positions")]
    assert run(["ingest", "-o", str(tmp_path / "w.mcap"), *given]) == ExitCode.BAD_INPUT
    assert "box heights off the feet of true boxes" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{}", "a list of people was expected"),
        ("[{]", "not valid JSON"),
        ('[{"personID": 1}]', "person 1: has no 'positionID'"),
        (
            '[{"personID": 1, "positionID": 691200, "views": []}]',
            "positionID 691200; WILDTRACK's grid has the points 0 to 691199",
        ),
    ],
)
def test_annotations_that_cannot_be_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, message: str
) -> None:
    folder = wildtrack(tmp_path / "W")
    (folder / "annotations_positions/00000005.json").write_text(text)
    given = [str(folder), "--boxes", str(folder / "annotations_positions")]
    assert run(["ingest", "-o", str(tmp_path / "w.mcap"), *given]) == ExitCode.BAD_INPUT
    assert message in capsys.readouterr().err


VATIC = """0 10 20 40 90 0 0 0 0 "PERSON"
0 12 20 42 90 1 0 1 1 "PERSON"
0 12 20 42 90 2 1 0 1 "PERSON"
7 100 20 140 90 1 0 0 0 "PERSON"
7 100 20 140 90 3 0 0 0 "PERSON"
"""


def test_vatic_text_is_truth_and_boxes_without_those_that_are_lost(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "view.txt").write_text(VATIC)
    given = [f"cam1={tmp_path / 'view.txt'}", "--fps", "10", "--allow-uncalibrated"]
    recording = ingested(tmp_path, "--boxes", *given, "--truth", f"cam1={tmp_path / 'view.txt'}")
    for table in (Boxes, TruthBoxes):
        boxes = table.concat(recording.tables(table))
        assert boxes.frame.tolist() == [0, 1, 1, 2, 3]
        assert boxes.target_id.tolist() == [0, 0, 7, -1, 7]
        assert boxes.left_px[boxes.box >= 0].tolist() == [10.0, 12.0, 100.0, 100.0]
    assert "class person (4)" in capsys.readouterr().err
    (tmp_path / "view.txt").write_text(VATIC + "8 1 2 3 4\n")
    assert run(["ingest", "-o", str(tmp_path / "x.mcap"), "--boxes", *given]) == ExitCode.BAD_INPUT
    assert "line 6: expected id xmin" in capsys.readouterr().err
