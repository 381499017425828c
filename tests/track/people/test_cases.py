"""Recordings of four cameras of which one is wrong, or sees pictures on a wall, by the command line."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from occlog.cli.main import run
from occlog.core.geometry.camera import array_rotation
from occlog.errors import ExitCode

CAMERAS = ("left", "right", "back", "side")


def tracked(case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], *more: str) -> dict[str, object]:
    """Summary of the tracks of a case."""
    words = [f"{option}" for name in CAMERAS for option in ("--boxes", f"{name}={case / name}.csv")]
    words += [option for name in CAMERAS for option in ("--calibration", f"{case / name}.yaml")]
    recording, tracks = str(tmp_path / "w.mcap"), str(tmp_path / "t.parquet")
    assert run(["ingest", "-o", recording, *words, "--fps", "10", "-q", *more]) == ExitCode.DONE
    capsys.readouterr()
    assert run(["track", recording, "--method", "jipda", "-o", tracks, "--json", "-q"]) == ExitCode.DONE
    return json.loads(capsys.readouterr().out)  # type: ignore[no-any-return]


@pytest.mark.jit
def test_a_camera_with_inverted_extrinsics_is_named_with_the_mistake(
    shared_cases: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = tracked(shared_cases / "v02-one-camera-inverted", tmp_path, capsys)
    reported = {warning["id"]: warning for warning in found["warnings"]}  # type: ignore[attr-defined]
    assert (found["plausible"], found["people"]) == (False, 3)
    assert reported.keys() == {"camera-extrinsics-fit-if", "camera-fits-if", "camera-unassociated"}
    assert all(warning["sensors"] == ["side"] for warning in reported.values())
    assert "extrinsics of side are inverted" in reported["camera-fits-if"]["message"]


def moved(case: Path, to: Path, name: str, yaw_deg: float, shift: tuple[float, float, float]) -> Path:
    """A copy of a case with one camera turned about the vertical and shifted [m]."""
    to.mkdir()
    for each in CAMERAS:
        (to / f"{each}.csv").write_bytes((case / f"{each}.csv").read_bytes())
        (to / f"{each}.yaml").write_bytes((case / f"{each}.yaml").read_bytes())
    text = (case / f"{name}.yaml").read_text()
    head, pose = text.split("R: !!", 1)
    rotation, translation = (
        np.array(values.split(","), dtype=float) for values in re.findall(r"data: \[(.*?)\]", pose, re.S)
    )
    camera = rotation.reshape(3, 3)
    centre = -camera.T @ translation + shift
    turned = camera @ array_rotation(np.radians(yaw_deg), 0.0, 0.0).T
    matrices = (("R", 3, turned), ("T", 1, -turned @ centre))
    for key, columns, matrix in matrices:
        head += (
            f"{key}: !!opencv-matrix\n   rows: 3\n   cols: {columns}\n   dt: d\n   data: {matrix.ravel().tolist()}\n"
        )
    (to / f"{name}.yaml").write_text(head)
    return to


@pytest.mark.jit
@pytest.mark.parametrize(
    ("name", "yaw_deg"), [("side", 180.0), pytest.param("back", -90.0, marks=pytest.mark.statistics)]
)
def test_a_camera_that_is_turned_is_named_with_the_angle(
    shared_cases: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, yaw_deg: float
) -> None:
    """It sees people where no other camera looks, so that nothing contradicts it."""
    case = moved(shared_cases / "v13-poster-outside-the-room", tmp_path / "case", name, yaw_deg, (0.0, 0.0, 0.0))
    found = tracked(case, tmp_path, capsys)
    (reported,) = (w for w in found["warnings"] if w["id"] == "camera-fits-if")  # type: ignore[attr-defined]
    assert (found["plausible"], reported["sensors"]) == (False, [name])
    assert f"{name} is turned by {abs(yaw_deg):.0f} degrees about the vertical" in reported["message"]


@pytest.mark.jit
def test_a_camera_that_looks_at_another_place_is_sound(
    shared_cases: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = moved(shared_cases / "v13-poster-outside-the-room", tmp_path / "case", "side", 0.0, (0.0, 60.0, 0.0))
    found = tracked(case, tmp_path, capsys)
    said = [w for w in found["warnings"] if w["id"] != "identity-switches-likely"]  # type: ignore[attr-defined]
    # The boxes of this case are those of images without the distortion that its calibration states, which may be found
    assert all(w["id"] == "camera-error" and "side" not in w["sensors"] for w in said)


@pytest.mark.jit
def test_pictures_outside_the_room_are_no_people(
    shared_cases: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = shared_cases / "v13-poster-outside-the-room"
    found = tracked(case, tmp_path, capsys, "--scene", str(case / "room.yaml"))
    assert found["people"] == 3
    # The boxes of this case are those of images without the distortion that its calibration states
    assert [w["id"] for w in found["warnings"]] == ["camera-error"]  # type: ignore[attr-defined]
    assert found["static_clutter"] == {"left": 1, "right": 1}
