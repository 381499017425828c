"""`occlog ingest --clock-offset`: times of sensors whose clocks are off."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode, UsageError
from occlog.ingest.plan import MAX_S, frames_of, offsets_of, with_offsets
from occlog.io.recording.reader import open_recording
from occlog.records.scene import Clock, MicrophoneArray, Scene
from occlog.records.tables import Boxes, Doa, Truth

SCENE = """occlog_scene: 1
cameras:
- {name: cam1, position: [0, 0, 3], yaw_deg: 45, focal_px: 320, image_size_px: [640, 480],
     noise: {measurement_noise_px: 2}}
- {name: cam2, position: [9, 0, 3], yaw_deg: 135, focal_px: 320, image_size_px: [640, 480],
     noise: {measurement_noise_px: 2}}
microphone_arrays:
- {name: mic, position: [5, 5], yaw_deg: 90}
"""


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """A scene, boxes of two cameras at 10 frames a second, and directions."""
    (tmp_path / "scene.yaml").write_text(SCENE)
    rows = [f"{k},{name},10,20,30,60" for k in range(4) for name in ("cam1", "cam2")]
    (tmp_path / "b.csv").write_text("frame,camera,left,top,width,height\n" + "\n".join(rows) + "\n")
    (tmp_path / "d.csv").write_text("time,sensor,azimuth_deg\n1,mic,10\n3,mic,10\n")
    return tmp_path


def ingest(folder: Path, *offsets: str) -> int:
    given = ["--scene", str(folder / "scene.yaml"), "--boxes", str(folder / "b.csv"), "--fps", "10"]
    given += ["--start-time", "1"]
    given += ["--doa", str(folder / "d.csv"), *(word for text in offsets for word in ("--clock-offset", text))]
    return run(["ingest", "-o", str(folder / "out.mcap"), "--overwrite", "-q", *given])


def test_offsets_are_added_and_recorded(place: Path) -> None:
    assert ingest(place, "cam2=-0.4s", "mic=250ms") == ExitCode.DONE
    recording = open_recording(place / "out.mcap")
    boxes, doa = recording.read(Boxes), recording.read(Doa)
    assert np.unique(boxes.t_ns[boxes.sensor == "cam1"]).tolist() == [
        1_000_000_000,
        1_100_000_000,
        1_200_000_000,
        1_300_000_000,
    ]
    late = boxes.t_ns[boxes.sensor == "cam2"]
    assert np.unique(late).tolist() == [600_000_000, 700_000_000, 800_000_000, 900_000_000]
    assert doa.t_ns.tolist() == [2_250_000_000, 4_250_000_000]
    assert recording.provenance is not None
    assert recording.provenance.parameters["clock_offset"] == {"cam2": -0.4, "mic": 0.25}


def test_truth_that_counts_frames_is_not_moved_with_one_of_the_cameras(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whose frames it counts must be stated where these have other times than those of another camera."""
    truth = place / "t.csv"
    truth.write_text("frame,x,y\n0,1,2\n3,1,2\n")
    given = ["--scene", str(place / "scene.yaml"), "--boxes", str(place / "b.csv"), "--fps", "10", "--start-time", "1"]

    def times(*more: str) -> list[int]:
        args = ["ingest", "-o", str(place / "out.mcap"), "--overwrite", "-q", *given, *more]
        assert run(args) == ExitCode.DONE, capsys.readouterr().err
        return open_recording(place / "out.mcap").read(Truth).t_ns.tolist()

    for offsets in ((), ("--clock-offset", "cam1=-0.4s", "--clock-offset", "cam2=-0.4s")):
        moved = -400_000_000 if offsets else 0
        assert times("--truth", str(truth), *offsets) == [10**9 + moved, 1_300_000_000 + moved]
    for first, camera in (("cam1", "cam2"), ("cam2", "cam1")):
        one = ["--clock-offset", f"{first}=-0.4s"]
        args = ["ingest", "-o", str(place / "out.mcap"), "--overwrite", "-q", *given, "--truth", str(truth), *one]
        assert run(args) == ExitCode.USAGE
        assert (
            "frames, which have other times in each camera; state its camera: CAMERA=t.csv" in capsys.readouterr().err
        )
        assert times("--truth", f"{camera}={truth}", *one) == [10**9, 1_300_000_000]
        assert times("--truth", f"{first}={truth}", *one) == [600_000_000, 900_000_000]


def test_an_offset_adds_to_the_clock_of_the_scene() -> None:
    array = MicrophoneArray("mic", np.zeros(3), clock="late")
    scene = with_offsets(Scene(arrays=(array,), clocks=(Clock("late", 5, 7.0),)), {"mic": 20e-9})
    named = {clock.name: clock for clock in scene.clocks}
    own = named[str(scene.arrays[0].clock)]
    assert (own.offset_ns, own.drift_ppm) == (-15, 7.0)
    assert named["late"].offset_ns == 5


def test_an_offset_adds_to_one_that_the_scene_of_a_recording_has(place: Path) -> None:
    """The clock of the earlier offset had the same name, and it alone was taken out."""
    assert ingest(place, "cam2=-0.4s") == ExitCode.DONE
    given = ["--scene", str(place / "out.mcap"), "--boxes", str(place / "b.csv"), "--fps", "10", "--start-time", "1"]
    for name, offset, first in (("twice.mcap", "cam2=-0.1s", 500_000_000), ("third.mcap", "cam1=0.1s", 600_000_000)):
        assert run(["ingest", "-o", str(place / name), "-q", *given, "--clock-offset", offset]) == ExitCode.DONE
        boxes = open_recording(place / name).read(Boxes)
        assert boxes.t_ns[boxes.sensor == "cam2"][0] == first
    assert boxes.t_ns[boxes.sensor == "cam1"][0] == 1_100_000_000


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("a=1", 1.0), ("a=-.5", -0.5), ("a=2ms", 2e-3), ("a=3us", 3e-6), (f"a={MAX_S:g}", MAX_S)],
)
def test_units_of_time(text: str, seconds: float) -> None:
    assert offsets_of([text]) == {"a": pytest.approx(seconds, rel=1e-12)}


@pytest.mark.parametrize("text", ["a", "=1", "a=", "a=nan", "a=inf", "a=1h", "a=1.1e9", "1"])
def test_what_is_no_offset_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="expected SENSOR=SECONDS"):
        offsets_of([text])


def test_sensors_are_named_once_and_are_there(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert ingest(place, "cam1=1", "cam1=2") == ExitCode.USAGE
    assert "given twice" in capsys.readouterr().err
    assert ingest(place, "cam3=1") == ExitCode.USAGE
    assert "no sensor 'cam3'; did you mean 'cam" in capsys.readouterr().err
    assert not (place / "out.mcap").exists()


def test_times_before_1970_are_refused(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert ingest(place, "cam2=-1s") == ExitCode.DONE
    assert ingest(place, "cam2=-1001ms") == ExitCode.BAD_INPUT
    assert "a time of -0.001 s is before 1970, which a recording cannot hold" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("given", "common", "left"),
    [
        ((), None, None),
        (("0:40",), (0, 40), (0, 40)),
        (("0", "40"), (0, 40), (0, 40)),
        (("left=2:9", "0:40"), (0, 40), (2, 9)),
    ],
)
def test_frames_of_all_cameras_and_of_one(
    given: tuple[str, ...], common: tuple[int, int] | None, left: tuple[int, int] | None
) -> None:
    frames = frames_of(given)
    assert (frames.of("right"), frames.of("left"), bool(frames)) == (common, left, bool(given))
