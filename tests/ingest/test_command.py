"""`occlog ingest` from files to a recording: times, losses, refusals, exit codes."""

from __future__ import annotations

import json
import os
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from video_samples import FRAMES, avi, jpeg, number_shown, numbered, write_video

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.recording.reader import McapRecording, open_recording
from occlog.records.tables import Boxes, Doa, Reads, Truth, TruthBoxes

SCENE = """occlog_scene: 1
room: [[0, 0], [4, 0], [4, 3], [0, 3]]
cameras:
- {name: cam1, position: [0, 0, 2], yaw_deg: 30, focal_px: 150, image_size_px: [160, 120]}
- {name: cam2, position: [4, 0, 2], yaw_deg: 150, focal_px: 150, image_size_px: [160, 120]}
microphone_arrays:
- {name: mic, position: [2, 3], yaw_deg: 90}
"""


@pytest.fixture(scope="module")
def videos(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("videos")
    return {name: write_video(folder / name) for name in ("ffv1.mkv", "mjpg.avi", "mp4v.mp4")}


@pytest.fixture
def place(tmp_path: Path) -> Path:
    (tmp_path / "scene.yaml").write_text(SCENE)
    return tmp_path


def ingest(folder: Path, *args: str, scene: bool = True, output: str = "out.mcap") -> int:
    given = ["--scene", str(folder / "scene.yaml")] if scene else []
    return run(["ingest", "-o", str(folder / output), *given, "-q", *args])


def shown(recording: McapRecording) -> list[tuple[str, int, int, int]]:
    """(camera, time, number given, number shown) of every frame, in the order of time."""
    return [(f.sensor, f.t_ns, f.index, number_shown(f.decode())) for f in recording.frames()]


def test_two_videos_become_one_recording_in_the_order_of_time(place: Path, videos: dict[str, Path]) -> None:
    code = ingest(
        place,
        "--video",
        f"cam1={videos['ffv1.mkv']}",
        "--video",
        f"cam2={videos['mjpg.avi']}",
        "--start-time",
        "cam2=0.01",
        "--store",
        "png",
    )
    assert code == ExitCode.DONE
    recording = open_recording(place / "out.mcap")
    frames = shown(recording)
    assert [t for _, t, _, _ in frames] == sorted(t for _, t, _, _ in frames)
    for name, offset in (("cam1", 0), ("cam2", 10_000_000)):
        mine = [(t, i, n) for c, t, i, n in frames if c == name]
        assert mine == [(50_000_000 * k + offset, k, k) for k in range(FRAMES)]
    assert recording.provenance.parameters["time_sources"] == {
        "cam1": "container time stamps",
        "cam2": "frame rate 20 fps (stated by the file)",
    }
    assert recording.losses == ()
    assert recording.scene is not None
    assert [c.name for c in recording.scene.cameras] == ["cam1", "cam2"]


def test_the_same_input_gives_the_same_bytes(place: Path, videos: dict[str, Path]) -> None:
    args = ("--video", f"cam1={videos['ffv1.mkv']}", "--video", f"cam2={videos['mp4v.mp4']}")
    assert ingest(place, *args, output="a.mcap") == ingest(place, *args, output="b.mcap") == ExitCode.DONE
    assert (place / "a.mcap").read_bytes() == (place / "b.mcap").read_bytes()


def test_a_linked_video_keeps_numbers_although_frames_are_lost(place: Path) -> None:
    data = bytearray(avi([jpeg(k) for k in range(FRAMES)]))
    start = data.index(b"00dc", len(data) // 2)
    data[start : start + 8] = bytes(8)
    path = place / "v.avi"
    path.write_bytes(bytes(data))
    assert ingest(place, "--video", f"cam1={path}", "--store", "link", "--frames", "3:30") == ExitCode.LOSSY
    recording = open_recording(place / "out.mcap")
    frames = shown(recording)
    assert len(frames) == 26
    assert all(given == number == t // 50_000_000 for _, t, given, number in frames)
    assert recording.losses[-1].count == 1
    assert recording.videos["cam1"]["path"] == "v.avi"
    path.write_bytes(bytes(data) + b"x")
    with pytest.raises(Exception, match="content changed"):
        shown(recording)


def test_a_sidecar_comes_before_the_container(place: Path, videos: dict[str, Path]) -> None:
    rows = [f"{k},1,{1700000000 + k * 0.04 + 0.001 * (k % 3):.4f}" for k in range(FRAMES)]
    rows += [f"{k},2,{1700000000.5 + k * 0.04:.4f}" for k in range(FRAMES)]
    (place / "ts.csv").write_text("frame,camera,time\n" + "\n".join(rows))
    code = ingest(
        place,
        "--video",
        f"cam1={videos['ffv1.mkv']}",
        "--video",
        f"cam2={videos['mp4v.mp4']}",
        "--timestamps",
        str(place / "ts.csv"),
    )
    assert code == ExitCode.DONE
    times = [t for c, t, _, _ in shown(open_recording(place / "out.mcap")) if c == "cam1"]
    assert times[:3] == [1_700_000_000_000_000_000, 1_700_000_000_041_000_000, 1_700_000_000_082_000_000]


def test_the_error_of_a_clock_is_taken_out(place: Path, videos: dict[str, Path]) -> None:
    text = SCENE.replace("yaw_deg: 30,", "yaw_deg: 30, clock: late,").replace(
        "yaw_deg: 90}", "yaw_deg: 90, clock: late}"
    )
    (place / "scene.yaml").write_text(text + "clocks: [{name: late, offset_ns: 5000000, drift_ppm: 1000}]\n")
    (place / "d.csv").write_text("time,sensor,azimuth_deg\n1,mic,10\n3,mic,10\n")
    args = ("--video", f"cam1={videos['ffv1.mkv']}", "--video", f"cam2={videos['ffv1.mkv']}", "--start-time", "7")
    assert ingest(place, *args, "--store", "link", "--doa", str(place / "d.csv")) == ExitCode.DONE
    recording = open_recording(place / "out.mcap")
    found = {(f.sensor, f.index): f.t_ns for f in recording.frames()}
    assert found["cam2", 20] == 8_000_000_000
    assert found["cam1", 20] == 8_000_000_000 - 5_000_000 - 1_000_000
    assert recording.read(Doa).t_ns.tolist() == [8 * 10**9 - 5 * 10**6, 10 * 10**9 - 5 * 10**6 - 2 * 10**6]
    parameters = recording.provenance.parameters["time_sources"]["cam1"]
    assert parameters == "container time stamps; clock late taken out (5000000 ns, 1000 ppm)"


@pytest.mark.parametrize(("rows", "lost"), [(FRAMES - 5, "5 lost"), (FRAMES + 3, "3 lost")])
def test_a_sidecar_of_another_length_is_noticed(
    place: Path, videos: dict[str, Path], capsys: pytest.CaptureFixture[str], rows: int, lost: str
) -> None:
    (place / "ts.csv").write_text("\n".join(str(0.1 * k) for k in range(rows)))
    code = ingest(place, "--video", f"cam1={videos['ffv1.mkv']}", "--timestamps", f"cam1={place / 'ts.csv'}")
    assert code == ExitCode.LOSSY
    assert lost in capsys.readouterr().err
    assert len(shown(open_recording(place / "out.mcap"))) == min(rows, FRAMES)


def test_a_cut_video_gives_exit_code_3_and_says_what_is_gone(
    place: Path, videos: dict[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    data = videos["ffv1.mkv"].read_bytes()
    (place / "cut.mkv").write_bytes(data[: len(data) // 2])
    code = ingest(place, "--video", f"cam1={place / 'cut.mkv'}", "--video", f"cam2={videos['mp4v.mp4']}", "--json")
    assert code == ExitCode.LOSSY
    out, err = capsys.readouterr()
    summary = json.loads(out)
    gone = FRAMES - summary["frames"]["cam1"]
    assert 0 < gone < FRAMES
    assert sum(loss["count"] for loss in summary["losses"]) == gone
    assert f"({gone} lost)" in err
    assert "Traceback" not in err
    assert summary["frames"]["cam2"] == FRAMES
    assert sum(loss.count for loss in open_recording(place / "out.mcap").losses) == gone


def test_one_unreadable_camera_does_not_lose_the_others(
    place: Path, videos: dict[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    (place / "bad.mp4").write_bytes(videos["mp4v.mp4"].read_bytes()[:3000])
    args = ("--video", f"cam1={place / 'bad.mp4'}", "--video", f"cam2={videos['mp4v.mp4']}")
    assert ingest(place, *args) == ExitCode.LOSSY
    err = capsys.readouterr().err
    assert "camera cam1: skipped" in err
    assert "moov" in err
    assert {c for c, *_ in shown(open_recording(place / "out.mcap"))} == {"cam2"}
    assert ingest(place, *args[:2], output="two.mcap") == ExitCode.BAD_INPUT
    assert not (place / "two.mcap").exists()


def test_images_keep_their_bytes_and_bad_ones_are_listed(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = place / "images"
    folder.mkdir()
    for k in (5, 6, 7, 9, 10, 11):
        (folder / f"img_{k}.jpg").write_bytes(jpeg(k))
    (folder / "img_7.jpg").write_bytes(jpeg(7)[:500])
    (folder / "img_11.jpg").write_bytes(jpeg(11, (80, 60)))
    assert ingest(place, "--images", f"cam1={folder}", "--fps", "10") == ExitCode.LOSSY
    frames = shown(open_recording(place / "out.mcap"))
    assert [(t // 10**8, i, n) for _, t, i, n in frames] == [(0, 0, 5), (1, 1, 6), (4, 4, 9), (5, 5, 10)]
    err = capsys.readouterr().err
    assert "img_7.jpg: cut short" in err
    assert "img_11.jpg: 80 x 60 px where 160 x 120" in err


def test_boxes_doa_and_truth_without_video(place: Path) -> None:
    (place / "b.csv").write_text("frame,camera,left,top,right,bottom,confidence\n0,1,1,1,5,9,0.5\n2,2,1,1,5,9,0.5\n")
    (place / "d.csv").write_text("time,sensor,azimuth_deg\n0.05,mic,10\n")
    (place / "t.csv").write_text("frame,id,x,y\n0,1,2,1\n2,1,2.5,1\n")
    (place / "tb.txt").write_text("1,1,10,20,30,40,1,-1,-1,-1\n")
    tables = ("--boxes", str(place / "b.csv"), "--doa", str(place / "d.csv"), "--truth", str(place / "t.csv"))
    boxes_of_cam2 = ("--truth", f"cam2={place / 'tb.txt'}")
    times = ("--fps", "20", "--start-time", "2024-01-01T00:00:00Z")
    code = ingest(place, *tables, *boxes_of_cam2, *times, "--doa-convention", "array")
    assert code == ExitCode.DONE
    recording = open_recording(place / "out.mcap")
    start = 1_704_067_200_000_000_000
    boxes = recording.read(Boxes)
    assert sorted(zip(boxes.sensor.tolist(), boxes.frame.tolist(), boxes.box.tolist(), strict=True)) == [
        ("cam1", 0, 0),
        ("cam1", 1, -1),
        ("cam1", 2, -1),
        ("cam2", 0, -1),
        ("cam2", 1, -1),
        ("cam2", 2, 0),
    ]
    assert boxes.t_ns.min() == start
    assert recording.read(Truth).t_ns.tolist() == [start, start + 10**8]
    assert recording.read(TruthBoxes).sensor.tolist() == ["cam2"]
    doa = recording.read(Doa)
    assert np.degrees(doa.azimuth[0]) == pytest.approx(100)
    assert doa.t_ns[0] == start + 50_000_000


def test_frames_of_another_size_than_calibrated(
    place: Path, videos: dict[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    def calibrated_for(size: str, output: str) -> tuple[int, str]:
        text = SCENE.replace("[160, 120]}\n- {name: cam2", f"[{size}]}}\n- {{name: cam2")
        (place / "scene.yaml").write_text(text)
        args = ["--scene", str(place / "scene.yaml"), "--video", f"cam1={videos['ffv1.mkv']}"]
        return run(["ingest", "-o", str(place / output), *args]), capsys.readouterr().err

    code, err = calibrated_for("320, 240", "s.mcap")
    assert code == ExitCode.DONE
    assert "assumed to be scaled by 0.5" in err
    camera = open_recording(place / "s.mcap").scene.camera("cam1")  # type: ignore[union-attr]
    assert camera.focal_px.tolist() == [75, 75]
    assert camera.principal_px.tolist() == [79.5, 59.5]
    code, err = calibrated_for("168, 128", "c.mcap")
    assert code == ExitCode.DONE
    assert "assumed to be cropped or padded at the right and lower edge" in err
    camera = open_recording(place / "c.mcap").scene.camera("cam1")  # type: ignore[union-attr]
    assert camera.principal_px.tolist() == [83.5, 63.5]
    code, err = calibrated_for("300, 120", "e.mcap")
    assert code == ExitCode.BAD_INPUT
    assert "differ in aspect ratio" in err


def test_frames_that_metadata_turn_and_a_calibration_of_the_raw_ones(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The calibration has the size of the raw frames: the cause is named, and the command that removes the rotation."""
    video = with_display(write_video(place / "mp4v.mp4"), (0, 1, -1, 0))
    assert ingest(place, "--video", f"cam1={video}") == ExitCode.BAD_INPUT
    assert "ffmpeg -display_rotation 0 -i mp4v.mp4 -c copy" in capsys.readouterr().err
    (place / "images").mkdir()
    for index in range(3):
        (place / "images" / f"{index}.jpg").write_bytes(exif_turned(jpeg(index)))
    assert ingest(place, "--images", f"cam1={place / 'images'}", "--fps", "10") == ExitCode.BAD_INPUT
    assert "exiftool -Orientation= images" in capsys.readouterr().err
    turned = SCENE.replace("[160, 120]}\n- {name: cam2", "[120, 160]}\n- {name: cam2")
    (place / "scene.yaml").write_text(turned)
    assert ingest(place, "--video", f"cam1={video}") == ExitCode.DONE
    upright = with_display(write_video(place / "mp4v.mp4"), (1, 0, 0, 1))
    assert ingest(place, "--video", f"cam1={upright}", output="other.mcap") == ExitCode.BAD_INPUT
    assert "of images rotated by 90 degrees" in capsys.readouterr().err


def test_pixels_that_are_not_square_and_a_calibration_of_stretched_frames(place: Path) -> None:
    video = with_display(write_video(place / "mp4v.mp4"), (1.5, 0, 0, 1))
    (place / "scene.yaml").write_text(SCENE.replace("[160, 120]}\n- {name: cam2", "[240, 120]}\n- {name: cam2"))
    assert ingest(place, "--video", f"cam1={video}") == ExitCode.DONE
    camera = open_recording(place / "out.mcap").scene.camera("cam1")  # type: ignore[union-attr]
    assert camera.focal_px == pytest.approx([100, 150])
    assert camera.image_size == (160, 120)


def with_display(path: Path, matrix: tuple[float, float, float, float]) -> Path:
    """An MP4 file with a, b, c, d of its display matrix replaced."""
    data = bytearray(path.read_bytes())
    a, b, c, d = (round(each * 65536) for each in matrix)
    struct.pack_into(">5i", data, data.find(b"tkhd") + 44, a, b, 0, c, d)
    path.write_bytes(bytes(data))
    return path


def exif_turned(data: bytes) -> bytes:
    """A JPEG image with the Exif orientation 6: turned by 90 degrees clockwise."""
    entry = struct.pack(">HHHIHH", 1, 0x0112, 3, 1, 6, 0)
    exif = b"Exif\0\0MM\0*" + struct.pack(">I", 8) + entry + bytes(4)
    return data[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + data[2:]


def test_black_bars_tell_that_frames_were_scaled(place: Path) -> None:
    (place / "scene.yaml").write_text(SCENE.replace("[160, 120]}\n- {name: cam2", "[168, 120]}\n- {name: cam2"))
    folder = place / "images"
    folder.mkdir()
    framed = np.zeros((120, 160, 3), np.uint8)
    framed[3:117] = cv2.resize(numbered(255), (160, 114))
    cv2.imwrite(str(folder / "0.png"), framed)
    assert ingest(place, "--images", f"cam1={folder}", "--fps", "1") == ExitCode.DONE
    camera = open_recording(place / "out.mcap").scene.camera("cam1")  # type: ignore[union-attr]
    assert camera.focal_px[0] == pytest.approx(150 * 160 / 168)
    assert camera.principal_px == pytest.approx([79.5, 59.5], abs=0.01)


@pytest.mark.parametrize(
    ("args", "code", "message"),
    [
        (["--video", "cam1={tmp}/none.mp4"], 4, "none.mp4: no such file"),
        (["--video", "cam1={tmp}"], 4, "is a folder; a video file was expected"),
        (["--video", "cam9={video}"], 4, "camera cam9: has no calibration (calibrated: cam1, cam2)"),
        (["--video", "{video}"], 2, "lacks the name of its camera; give CAMERA="),
        (["--video", "cam1={video}", "--video", "cam1={video}"], 2, "camera cam1 is given twice"),
        (["--video", "cam1={video}", "--images", "cam1={tmp}"], 2, "both video and images"),
        ([], 2, "nothing to ingest"),
        (["--images", "cam1={tmp}", "--store", "link"], 2, "only videos can be linked"),
        (["--video", "cam1={video}", "--frames", "9:9"], 2, "A:B with A < B"),
        (["--video", "cam1={video}", "--frames", "100:200"], 4, "has only 40"),
        (["--video", "cam1={video}", "--frames", "cam1=100:200"], 4, "has only 40"),
        (["--video", "cam1={video}", "--frames", "cam2=1:3"], 2, "--frames cam2=1:3: no camera"),
        (["--video", "cam1={video}", "--frames", "0:9", "--frames", "1:2"], 2, "--frames is given twice"),
        (["--video", "cam1={video}", "--fps", "fast"], 4, "frame rate 'fast'"),
        (["--video", "cam1={video}", "--start-time", "noon"], 4, "--start-time: time 'noon'"),
        (
            ["--video", "cam1={video}", "--timestamps", "cam1={tmp}/back.csv"],
            4,
            "back.csv: line 3: time stamp goes back",
        ),
        (["--video", "cam1={video}", "--timestamps", "cam1={tmp}/repeat.csv"], 4, "line 2: time stamp repeats"),
        (["--video", "cam1={video}", "--truth", "{tmp}/nan.csv"], 4, "nan.csv: line 2: x is missing"),
        (["--boxes", "{tmp}/b.csv"], 2, "its frames have no times; give --fps or --timestamps"),
        (["--doa", "{tmp}/d.csv"], 4, "'mike' is none of mic"),
        (["--video", "cam1={video}", "--calibration", "{tmp}/b.csv"], 4, "not a calibration of a known format"),
        (["--video", "cam1={video}", "-o", "{video}"], 2, "is an input too"),
        (["--video", "cam1={video}", "-o", "{tmp}/scene.yaml", "--overwrite"], 2, "is an input too"),
        (["--video", "cam1={video}", "-o", "{tmp}/b.csv"], 7, "exists; give --overwrite"),
        (["--vidoe", "cam1={video}"], 2, "No such option"),
    ],
)
def test_bad_input_is_one_clear_line_with_its_exit_code(
    place: Path, videos: dict[str, Path], capsys: pytest.CaptureFixture[str], args: list[str], code: int, message: str
) -> None:
    (place / "back.csv").write_text("1\n2\n1.5\n")
    (place / "repeat.csv").write_text("1\n1\n")
    (place / "nan.csv").write_text("time,x,y\n1,nan,2\n")
    (place / "b.csv").write_text("frame,camera,left,top,w,h\n0,1,1,1,1,1\n")
    (place / "d.csv").write_text("time,sensor,azimuth_deg\n0,mike,1\n")
    before = sorted(p.name for p in place.iterdir())
    filled = [a.format(tmp=place, video=videos["ffv1.mkv"]) for a in args]
    assert ingest(place, *filled) == code
    out, err = capsys.readouterr()
    assert out == ""
    assert message in err
    assert "Traceback" not in err
    lines = [line for line in err.splitlines() if "rror" in line]
    assert len(lines) == 1
    assert sorted(p.name for p in place.iterdir()) == before


def test_a_camera_without_calibration_is_taken_when_asked(place: Path, videos: dict[str, Path]) -> None:
    code = ingest(place, "--video", f"cam9={videos['mp4v.mp4']}", "--allow-uncalibrated", scene=False)
    assert code == ExitCode.DONE
    scene = open_recording(place / "out.mcap").scene
    assert scene is not None
    assert not scene.camera("cam9").placed
    assert scene.camera("cam9").image_size == (160, 120)


def children(pid: int) -> list[int]:
    return [int(each) for each in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def started(folder: Path, video: Path) -> tuple[subprocess.Popen[bytes], list[int]]:
    """An ingest of long videos, running, and its decoders with the process that forked them."""
    args = [sys.executable, "-m", "occlog", "ingest", "-o", str(folder / "out.mcap"), "--allow-uncalibrated"]
    args += [text for k in range(3) for text in ("--video", f"c{k}={video}")]
    process = subprocess.Popen([*args, "--store", "png"], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    deadline = time.monotonic() + 20
    found: list[int] = []
    while len(found) < 4 and time.monotonic() < deadline:
        time.sleep(0.05)
        found = children(process.pid)
        found += [each for pid in found for each in children(pid)]
    time.sleep(0.3)
    assert len(found) == 4
    assert process.poll() is None
    return process, found


@pytest.fixture(scope="module")
def long_video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_video(tmp_path_factory.mktemp("long") / "mp4v.mp4", frames=3000)


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="looks for processes in /proc")
@pytest.mark.parametrize(("how", "code"), [(signal.SIGINT, 130), (signal.SIGKILL, -9)])
def test_a_stopped_ingest_leaves_neither_output_nor_decoders(
    tmp_path: Path, long_video: Path, how: signal.Signals, code: int
) -> None:
    process, decoders = started(tmp_path, long_video)
    os.kill(process.pid, how)
    _, err = process.communicate(timeout=30)
    assert process.returncode == code
    assert b"Traceback" not in err
    assert list(tmp_path.iterdir()) == []
    deadline = time.monotonic() + 10
    while any(Path(f"/proc/{pid}").exists() for pid in decoders) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not [pid for pid in decoders if Path(f"/proc/{pid}").exists()]


def test_folders_of_yolo_text_become_boxes_of_the_calibrated_cameras(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, line in (
        ("cam1", "0 0.5 0.5 0.25 0.5 0.75 4\n2 0.5 0.5 0.1 0.1 0.5\n"),
        ("cam2", "0 0.5 0.5 0.1 0.5 0.5 4\n"),
    ):
        folder = place / "yolo" / name / "labels"
        folder.mkdir(parents=True)
        for frame in (3, 5):
            (folder / f"walk_{frame}.txt").write_text(line)
    given = ("--boxes", str(place / "yolo"), "--fps", "10")
    assert ingest(place, *given) == ExitCode.BAD_INPUT
    assert "choose that of people (--class NAME)" in capsys.readouterr().err
    assert ingest(place, *given, "--class", "0") == ExitCode.DONE
    boxes = Boxes.concat(open_recording(place / "out.mcap").tables(Boxes))
    assert boxes.frame.tolist() == [3, 3, 4, 4, 5, 5]
    assert boxes.left_px[:2].tolist() == [60.0, 72.0]
    assert boxes.target_id.tolist() == [4, 4, -1, -1, 4, 4]


def test_boxes_outside_the_image_are_lost_and_those_over_its_border_are_reported(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = place / "boxes.csv"
    table.write_text("frame,left,top,width,height\n0,-40,10,30,40\n0,-5,10,30,40\n1,160,10,30,40\n2,5,5,9,9\n")
    given = ["--scene", str(place / "scene.yaml"), "--fps", "5", "--boxes", f"cam1={table}"]
    code = run(["ingest", "-o", str(place / "o.mcap"), *given])
    assert code == ExitCode.LOSSY
    assert "over the border of the image, by up to 5 px: cam1 1; kept" in capsys.readouterr().err
    recording = open_recording(place / "o.mcap")
    boxes = Boxes.concat(recording.tables(Boxes))
    assert boxes.frame.tolist() == [0, 1, 2]
    assert boxes.box.tolist() == [1, -1, 0]
    assert [(loss.source, loss.count) for loss in recording.losses] == [("cam1", 2)]


def test_a_choice_of_frames_cuts_true_positions_and_counts_the_boxes_that_are_taken(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = [f"{k},cam1,10,10,20,60" for k in range(30) if k != 5]
    (place / "b.csv").write_text("frame,camera,left,top,width,height\n" + "\n".join(lines) + "\n")
    rows = [f"{0.05 * k:.2f},1,2.0,3.0,0.0" for k in range(200)]
    (place / "t.csv").write_text("time,id,x,y,z\n" + "\n".join(rows) + "\n")
    given = ["--scene", str(place / "scene.yaml"), "--boxes", str(place / "b.csv"), "--fps", "10"]
    given += ["--truth", str(place / "t.csv")]
    assert run(["ingest", "-o", str(place / "out.mcap"), *given, "--frames", "2:10"]) == ExitCode.DONE
    stderr = capsys.readouterr().err
    assert "7 boxes of 1 camera, skipped: 22 boxes of other frames; frames 2 to 9" in stderr
    assert "boxes: 7; 1 more row is of frames in which a camera saw no person" in stderr
    # Frames 2 to 9 are at 0.2 to 0.9 s; half a frame more belongs to the first and the last one.
    assert "truth: 183 of 200 true positions are of other frames than 2:10, and skipped" in stderr
    truth = open_recording(place / "out.mcap").read(Truth)
    assert (truth.t_ns[0], truth.t_ns[-1], len(truth)) == (150_000_000, 950_000_000, 17)
    assert run(["ingest", "-o", str(place / "all.mcap"), *given]) == ExitCode.DONE
    stderr = capsys.readouterr().err
    assert "true positions go on 7 s after the last frame with boxes; people at these times count as missed" in stderr
    assert len(open_recording(place / "all.mcap").read(Truth)) == 200


def test_folders_of_other_names_than_the_cameras_are_all_named_and_taken_without_calibration(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("cam1", "back", "front"):
        (place / "yolo" / name).mkdir(parents=True)
        (place / "yolo" / name / "000000.txt").write_text("0 0.5 0.5 0.25 0.5 0.75\n")
    given = ("--boxes", str(place / "yolo"), "--fps", "10", "--image-size", "160x120")
    assert ingest(place, *given) == ExitCode.BAD_INPUT
    stderr = capsys.readouterr().err
    assert "cameras 'back', 'front' are none of cam1, cam2; give each folder with its camera (CAMERA=" in stderr
    assert ingest(place, *given, "--allow-uncalibrated") == ExitCode.DONE
    recording = open_recording(place / "out.mcap")
    assert {c.name: c.placed for c in recording.scene.cameras} == {
        "cam1": True,
        "cam2": True,
        "back": False,
        "front": False,
    }
    assert sorted(recording.read(Boxes).sensor.tolist()) == ["back", "cam1", "front"]


def test_a_folder_of_boxes_given_as_calibration_is_named(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (place / "yolo" / "cam1").mkdir(parents=True)
    given = ("--boxes", str(place / "scene.yaml"), "--calibration", str(place / "yolo"))
    assert ingest(place, *given, scene=False) == ExitCode.USAGE
    assert "yolo: a folder without a calibration file; name the file" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "text", "expected"),
    [
        ("--boxes", "frame,camera,left,top,w,h\n0,cam1,1,1,9,9\n0,cam01,50,1,9,9\n", "cameras 'cam01' and 'cam1'"),
        ("--doa", "time,sensor,azimuth_deg\n0,mic1,10\n1,mic01,20\n", "arrays 'mic01' and 'mic1'"),
    ],
)
def test_two_labels_of_a_file_are_not_one_sensor(
    place: Path, capsys: pytest.CaptureFixture[str], option: str, text: str, expected: str
) -> None:
    (place / "scene.yaml").write_text(SCENE.replace("name: mic", "name: mic1"))
    (place / "t.csv").write_text(text)
    assert ingest(place, option, str(place / "t.csv"), "--fps", "10") == ExitCode.BAD_INPUT
    assert expected in capsys.readouterr().err


def test_two_labels_of_a_sidecar_are_not_one_camera(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The times of the last one counted."""
    (place / "boxes.csv").write_text("frame,left,top,w,h\n0,1,1,9,9\n1,50,1,9,9\n")
    (place / "times.csv").write_text("camera,time\ncam1,0\ncam1,1\ncam01,100\ncam01,101\n")
    inputs = ("--boxes", f"cam1={place / 'boxes.csv'}", "--timestamps", str(place / "times.csv"))
    assert ingest(place, *inputs) == ExitCode.BAD_INPUT
    assert "cameras 'cam1' and 'cam01' would both be taken for cam1" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ("--boxes cam1=", "frame,camera,left,top,w,h\n0,cam1,1,1,9,9\n0,cam2,50,1,9,9\n"),
        ("--doa mic=", "time,sensor,azimuth_deg\n0,mic,10\n1,other,20\n"),
    ],
)
def test_a_file_of_several_sensors_is_not_given_as_that_of_one(
    place: Path, capsys: pytest.CaptureFixture[str], given: str, text: str
) -> None:
    """All rows were taken for those of the one."""
    (place / "t.csv").write_text(text)
    option, name = given.split()
    assert ingest(place, option, f"{name}{place / 't.csv'}", "--fps", "10") == ExitCode.BAD_INPUT
    assert f"line 3: {'camera' if name == 'cam1=' else 'sensor'} is " in capsys.readouterr().err


def test_a_camera_does_not_take_the_calibration_of_one_that_has_its_very_name(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whichever was named first took it: the other one became a camera without a place."""
    (place / "boxes.csv").write_text("frame,left,top,w,h\n0,1,1,9,9\n")
    boxes = place / "boxes.csv"
    inputs = ("--boxes", f"thermal1={boxes}", "--boxes", f"cam1={boxes}", "--fps", "10", "--allow-uncalibrated")
    assert ingest(place, *inputs) == ExitCode.DONE
    scene = open_recording(place / "out.mcap").scene
    assert scene is not None
    assert {c.name: c.placed for c in scene.cameras} == {"thermal1": False, "cam1": True, "cam2": True}
    inputs = ("--boxes", f"thermal1={boxes}", "--boxes", f"rgb1={boxes}", "--fps", "10", "--allow-uncalibrated")
    assert ingest(place, *inputs, output="two.mcap") == ExitCode.BAD_INPUT
    assert "cameras 'thermal1' and 'rgb1' would both be taken for cam1" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (
            ("--start-time", "cma1=5"),
            "--start-time cma1=5: no camera, array or source of positions has this name; did you mean 'cam1'",
        ),
        (("--fps", "cma1=5"), "--fps cma1=5: no camera"),
        (("--fps", "5"), "--fps is given twice; keep one"),
        (("--start-time", "cam1=5", "--start-time", "cam1=6"), "--start-time is given twice for cam1; keep one"),
    ],
)
def test_times_that_no_sensor_takes_are_refused(
    place: Path, capsys: pytest.CaptureFixture[str], options: tuple[str, ...], expected: str
) -> None:
    (place / "boxes.csv").write_text("frame,left,top,w,h\n0,1,1,9,9\n")
    assert ingest(place, "--boxes", f"cam1={place / 'boxes.csv'}", "--fps", "10", *options) == ExitCode.USAGE
    assert expected in capsys.readouterr().err


def test_a_start_time_holds_for_a_column_of_times_too(place: Path) -> None:
    (place / "boxes.csv").write_text("frame,time,left,top,w,h\n0,0.5,1,1,9,9\n1,1.5,1,1,9,9\n")
    inputs = ("--boxes", f"cam1={place / 'boxes.csv'}", "--start-time", "1000")
    assert ingest(place, *inputs) == ExitCode.DONE
    assert open_recording(place / "out.mcap").read(Boxes).t_ns.tolist() == [1_000_500_000_000, 1_001_500_000_000]


def test_a_truth_of_other_times_than_the_measurements_is_doubted(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (place / "boxes.csv").write_text("frame,left,top,w,h\n0,1,1,9,9\n1,1,1,9,9\n")
    (place / "truth.csv").write_text("time,x,y\n0,1,1\n0.1,1,1\n")
    inputs = ["--boxes", f"cam1={place / 'boxes.csv'}", "--fps", "10", "--truth", str(place / "truth.csv")]
    scene = ["--scene", str(place / "scene.yaml")]
    assert run(["ingest", "-o", str(place / "a.mcap"), *scene, *inputs]) == ExitCode.DONE
    assert "no time in common" not in capsys.readouterr().err
    assert run(["ingest", "-o", str(place / "b.mcap"), *scene, *inputs, "--start-time", "1000"]) == ExitCode.DONE
    assert "warning: the truth and the measurements have no time in common: " in capsys.readouterr().err


def test_a_target_of_two_files_is_not_at_two_places_at_once(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (place / "a.csv").write_text("time,x,y\n0,1,1\n1,1,1\n")
    (place / "b.csv").write_text("time,x,y\n1,5,5\n2,5,5\n")
    (place / "c.csv").write_text("time,x,y\n2,5,5\n3,5,5\n")
    truth = [f"--truth={place / name}.csv" for name in "abc"]
    assert ingest(place, truth[0], truth[2]) == ExitCode.DONE
    assert ingest(place, truth[0], truth[1], output="two.mcap") == ExitCode.BAD_INPUT
    assert "b.csv: target 0 has positions in" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "text"),
    [("--truth", "time,x_m,y_m\n0,1,1\n"), ("--readers", "reader,x_m,y_m\nr,1,1\n"), ("--arrays", "0,0,1\n1,0,1\n")],
)
def test_metres_are_not_taken_for_feet(place: Path, capsys: pytest.CaptureFixture[str], option: str, text: str) -> None:
    (place / "scene.yaml").write_text(SCENE.replace("occlog_scene: 1", "occlog_scene: 1\nlength_unit: ft"))
    (place / "t.csv").write_text(text)
    (place / "boxes.csv").write_text("frame,left,top,w,h\n0,1,1,9,9\n")
    inputs = ("--boxes", f"cam1={place / 'boxes.csv'}", "--fps", "10", option, str(place / "t.csv"))
    assert ingest(place, *inputs) == ExitCode.BAD_INPUT
    assert "t.csv: lengths are in m, but those of" in capsys.readouterr().err


def test_true_boxes_of_a_camera_in_two_files_are_refused(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Both were taken: an identity twice in a frame, and frames without anybody where the other file has somebody."""
    for name, frames in (("a", "01"), ("b", "12"), ("c", "23"), ("all", "0123")):
        rows = "".join(f"{frame},7,1,1,9,9\n" for frame in frames)
        (place / f"{name}.csv").write_text(f"frame,id,left,top,w,h\n{rows}")
    found = ["--boxes", f"cam1={place / 'all.csv'}", "--fps", "10"]
    truth = [f"--truth=cam1={place / name}.csv" for name in "abc"]
    assert ingest(place, *found, truth[0], truth[2]) == ExitCode.DONE
    assert open_recording(place / "out.mcap").read(TruthBoxes).frame.tolist() == [0, 1, 2, 3]
    for second, name in ((truth[1], "b"), (truth[0], "a")):
        assert ingest(place, *found, truth[0], second, output="two.mcap") == ExitCode.BAD_INPUT
        assert f"{name}.csv: camera cam1: has true boxes in" in capsys.readouterr().err


def test_a_file_of_truth_that_is_given_twice_is_refused(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its rows counted twice."""
    (place / "a.csv").write_text("time,x,y\n0,1,1\n1,1,1\n")
    assert ingest(place, *[f"--truth={place / 'a.csv'}"] * 2) == ExitCode.BAD_INPUT
    assert "a.csv: target 0 has positions in" in capsys.readouterr().err


def test_directions_that_stand_in_logs_twice_count_once(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A copied log, or one that was exported twice, counted each bearing twice."""
    rows = [f"{time},mic,{angle}\n" for time in (0, 1) for angle in (10, 20)]
    for name, lines in (("a", rows), ("b", [*rows[2:], "2,mic,10\n"]), ("c", [row for row in rows for _ in "ab"])):
        (place / f"{name}.csv").write_text("time,sensor,azimuth_deg\n" + "".join(lines))
    assert run(["ingest", "-o", str(place / "o.mcap"), "--scene", str(place / "scene.yaml"),
                *[f"--doa={place / name}.csv" for name in "aba"]]) == ExitCode.DONE  # fmt: skip
    stderr = capsys.readouterr().err
    assert "note: b.csv: 2 directions skipped, as exact duplicates of rows of this file or an earlier one" in stderr
    assert "note: a.csv: 4 directions skipped, as exact duplicates" in stderr
    assert open_recording(place / "o.mcap").read(Doa).t_ns.tolist() == [0, 0, 10**9, 10**9, 2 * 10**9]
    assert run(["ingest", "-o", str(place / "c.mcap"), "--scene", str(place / "scene.yaml"),
                f"--doa={place / 'c.csv'}"]) == ExitCode.DONE  # fmt: skip
    assert "note: c.csv: 4 directions skipped, as exact duplicates" in capsys.readouterr().err
    assert len(open_recording(place / "c.mcap").read(Doa)) == 4


def test_reads_that_stand_in_two_logs_count_once(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The recording had them twice, and every later command refused it."""
    (place / "readers.csv").write_text("name,x,y\nr,0,0\n")
    (place / "a.csv").write_text("t,reader,tag,rssi\n0,r,a,-50\n1,r,a,-50\n")
    (place / "b.csv").write_text("t,reader,tag,rssi\n1,r,a,-50\n2,r,a,-50\n")
    logs = [f"--reads={place / name}.csv" for name in "ab"]
    assert run(["ingest", "-o", str(place / "o.mcap"), "--readers", str(place / "readers.csv"), *logs]) == ExitCode.DONE
    assert "note: b.csv: 1 read skipped, as exact duplicates" in capsys.readouterr().err
    assert open_recording(place / "o.mcap").read(Reads).t_ns.tolist() == [0, 10**9, 2 * 10**9]


def test_true_places_without_their_last_digits_are_refused(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """So MATLAB writes northings, to 100 m, and they were taken."""
    (place / "t.csv").write_text("time,x,y\n0,500310.25,5.5003e+06\n")
    assert ingest(place, f"--truth={place / 't.csv'}") == ExitCode.BAD_INPUT
    assert "t.csv: line 2: y is '5.5003e+06': known to 100 only; write all digits" in capsys.readouterr().err
