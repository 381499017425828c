"""Recordings of four cameras of which one is wrong, or sees pictures on a wall, by the command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from occlog.cli.main import run
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
    said = {warning["id"]: warning for warning in found["warnings"]}  # type: ignore[attr-defined]
    assert (found["plausible"], found["people"]) == (False, 3)
    assert said.keys() == {"camera-fits-if", "camera-unassociated"}
    assert all(warning["sensors"] == ["side"] for warning in said.values())
    assert "extrinsics of side are inverted" in said["camera-fits-if"]["message"]


@pytest.mark.jit
def test_pictures_outside_the_room_are_no_people(
    shared_cases: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = shared_cases / "v13-poster-outside-the-room"
    found = tracked(case, tmp_path, capsys, "--scene", str(case / "room.yaml"))
    assert (found["plausible"], found["people"]) == (True, 3)
    assert found["static_clutter"] == {"left": 1, "right": 1}
