"""What ingest states of videos, time stamps and boxes that do not fit each other."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from video_samples import numbered, write_video

from occlog.array_types import NS, Floats
from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.ingest.stated import StampedFrames, clock_faults
from occlog.io.files.inputs import verdicts_of_file
from occlog.records.verdicts import Check


def ingest(tmp_path: Path, *args: str) -> dict[str, Check]:
    """Findings by id of an ingest that succeeds."""
    out = tmp_path / "w.mcap"
    assert run(["ingest", "-o", str(out), "--overwrite", "--allow-uncalibrated", *args]) == ExitCode.DONE
    return {check.id: check for verdict in verdicts_of_file(out) for check in verdict.checks if check.found}


def boxes(path: Path, frames: int, step: int = 1) -> Path:
    rows = "".join(f"{n * step},{10 + n % 9},20,20,40\n" for n in range(frames))
    path.write_text(f"frame,left,top,width,height\n{rows}")
    return path


def test_an_ordinary_video_with_boxes_raises_nothing(tmp_path: Path) -> None:
    video = write_video(tmp_path / "mp4v.mp4")
    assert ingest(tmp_path, "--video", f"a={video}", "--boxes", f"a={boxes(tmp_path / 'a.csv', 40)}") == {}


@pytest.mark.parametrize(("first", "named"), [(26, True), (32, False)])
def test_a_camera_that_is_covered_for_three_seconds_is_named(tmp_path: Path, first: int, named: bool) -> None:
    folder = tmp_path / "images"
    folder.mkdir()
    for n in range(60):
        image = numbered(n, (64, 48))
        cv2.imwrite(str(folder / f"{n}.png"), image // 16 if n >= first else image)
    found = ingest(tmp_path, "--images", f"a={folder}", "--fps", "10")
    assert set(found) == ({"pictures-black-run"} if named else set())
    if named:
        check = found["pictures-black-run"]
        assert (check.sensors, check.figures["first"], check.figures["last"]) == (("a",), 26, 59)
        assert "black, for 3.3 s from 1970-01-01T00:00:02.600" in check.text


@pytest.mark.parametrize("stride", [2, 3])
def test_boxes_of_every_third_frame_that_are_counted_from_0(tmp_path: Path, stride: int) -> None:
    video, count = write_video(tmp_path / "mp4v.mp4", frames=60), 60 // stride
    found = ingest(tmp_path, "--video", f"a={video}", "--boxes", f"a={boxes(tmp_path / 'a.csv', count)}")
    assert set(found) == {"boxes-end-early"}
    assert f"end at frame {count - 1} of 60" in found["boxes-end-early"].text
    assert f"every frame in {stride}, number them so" in found["boxes-end-early"].text
    numbered_right = boxes(tmp_path / "a.csv", 60 // stride, stride)
    assert ingest(tmp_path, "--video", f"a={video}", "--boxes", f"a={numbered_right}") == {}


def test_videos_that_start_at_other_time_stamps(tmp_path: Path) -> None:
    first, later = write_video(tmp_path / "mp4v.mp4"), write_video(tmp_path / "b.ts", fourcc="MPG2")
    both = ["--video", f"a={first}", "--video", f"b={later}"]
    found = ingest(tmp_path, *both)
    assert set(found) == {"video-start"}
    assert found["video-start"].sensors == ("b",)
    assert found["video-start"].figures["start_s"] == pytest.approx(1.45, abs=0.06)
    assert "--start-time b=1.4" in found["video-start"].text
    assert ingest(tmp_path, *both, "--start-time", "b=1.45") == {}
    other = write_video(tmp_path / "c.ts", frames=39, fourcc="MPG2")
    assert ingest(tmp_path, "--video", f"a={later}", "--video", f"b={other}") == {}


def test_one_video_of_two_cameras_is_reported(tmp_path: Path) -> None:
    video = write_video(tmp_path / "mp4v.mp4")
    copy = tmp_path / "copy.mp4"
    copy.write_bytes(video.read_bytes())
    found = ingest(tmp_path, "--video", f"a={video}", "--video", f"b={copy}")
    assert found["videos-identical"].sensors == ("a", "b")


def sidecar(path: Path, times: np.ndarray, head: str = "") -> Path:
    path.write_text(head + "".join(f"{t:g}\n" for t in times))
    return path


def test_time_stamps_in_another_unit_than_seconds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """At 20 frames a second: 0, 50, 100, ... are ms; and 0, 0.05, 0.1, ... ms are 20,000 frames a second."""
    video, times = write_video(tmp_path / "mp4v.mp4"), np.arange(40) / 20
    args = ["ingest", "-o", str(tmp_path / "w.mcap"), "--allow-uncalibrated", "--video", f"a={video}", "--timestamps"]
    assert run([*args, str(sidecar(tmp_path / "t.txt", 1000 * times))]) == ExitCode.BAD_INPUT
    assert "times without a header: 50 s from frame to frame" in capsys.readouterr().err
    assert ingest(tmp_path, *args[4:], str(sidecar(tmp_path / "t.txt", 1000 * times, "t_ms\n"))) == {}
    for head, factor in (("t_s\n", 1000), ("t_ms\n", 1)):
        found = ingest(tmp_path, *args[4:], str(sidecar(tmp_path / "t.txt", factor * times, head)))
        assert set(found) == {"time-stamps-unit", "rate-implausible"}
    slow_motion = sidecar(tmp_path / "t.txt", 8 * times)
    assert ingest(tmp_path, *args[4:], str(slow_motion)) == {}


@pytest.mark.parametrize(
    ("fps", "id"), [("0.4", "rate-implausible"), ("0.6", ""), ("200", ""), ("300", "rate-implausible")]
)
def test_a_frame_rate_that_no_camera_has(tmp_path: Path, fps: str, id: str) -> None:
    found = ingest(tmp_path, "--boxes", f"a={boxes(tmp_path / 'a.csv', 40)}", "--fps", fps)
    assert set(found) == {id} - {""}


def test_a_camera_that_repeats_a_picture(tmp_path: Path) -> None:
    for name, frozen in (("a", 100), ("b", 40)):
        folder = tmp_path / name
        folder.mkdir()
        for n in range(100):
            cv2.imwrite(str(folder / f"{n:03d}.png"), numbered(min(n, frozen)))
    found = ingest(tmp_path, "--images", f"a={tmp_path / 'a'}", "--images", f"b={tmp_path / 'b'}", "--fps", "10")
    assert set(found) == {"camera-frozen"}
    assert found["camera-frozen"].sensors == ("b",)
    assert found["camera-frozen"].figures["count"] == 60


def test_info_lists_what_a_video_states(shared_cases: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = ingest(tmp_path, "--video", f"cam1={shared_cases / 'v23-turned-by-metadata' / 'rot180.mp4'}")
    assert set(found) == {"pictures-turned"}
    assert run(["info", str(tmp_path / "w.mcap")]) == ExitCode.DONE
    assert "note: ingest: camera cam1: its images were rotated by 180 deg" in capsys.readouterr().out


@pytest.mark.parametrize(("bits", "ids"), [(14, {"values-dim"}), (16, set())])
def test_images_of_16_bits_that_use_14_are_stated_to_be_dark(tmp_path: Path, bits: int, ids: set[str]) -> None:
    folder = tmp_path / "a"
    folder.mkdir()
    for n in range(3):
        grey = cv2.cvtColor(numbered(n), cv2.COLOR_BGR2GRAY).astype(np.float64)
        cv2.imwrite(str(folder / f"{n}.png"), np.round(grey * (2**bits - 1) / grey.max()).astype(np.uint16))
    assert set(ingest(tmp_path, "--images", f"a={folder}", "--fps", "10")) == ids


def test_images_that_are_turned_by_their_exif_data_say_so(tmp_path: Path) -> None:
    folder = tmp_path / "a"
    folder.mkdir()
    exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0"
    for n in range(3):
        data = cv2.imencode(".jpg", numbered(n))[1].tobytes()
        (folder / f"{n}.jpg").write_bytes(data[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + data[2:])
    found = ingest(tmp_path, "--images", f"a={folder}", "--fps", "10")
    assert set(found) == {"pictures-turned"}
    assert "rotated by 90 deg" in found["pictures-turned"].text


def test_frames_that_begin_again_within_a_file_are_named(tmp_path: Path) -> None:
    path = boxes(tmp_path / "a.csv", 40)
    rows = path.read_text().splitlines(keepends=True)
    path.write_text("".join([*rows, *rows[3:30]]).replace(",20,20,40", ",20,20,41", 40))
    given = ("--boxes", f"a={path}", "--fps", "10")
    found = ingest(tmp_path, *given)
    assert (set(found), found["boxes-restart"].sensors) == ({"boxes-restart"}, ("a",))
    assert {k: found["boxes-restart"].figures[k] for k in ("line", "before", "after")} == {
        "line": 42,
        "before": 39,
        "after": 2,
    }
    path.write_text("".join([rows[0], *rows[20:], *rows[1:20]]))  # in another order
    assert ingest(tmp_path, *given) == {}


@pytest.mark.parametrize("identities", [False, True])
def test_a_counter_of_frames_that_begins_again_is_named(tmp_path: Path, identities: bool) -> None:
    """65,336 frames without a detection were invented between the two parts, without a word."""
    path = tmp_path / "a.csv"
    numbers = [(k + 65_516) % 65_536 for k in range(40)]
    rows = "".join(f"{k},20,20,40,90{',3' * identities}\n" for k in numbers)
    path.write_text(f"frame,left,top,width,height{',id' * identities}\n{rows}")
    found = ingest(tmp_path, "--boxes", f"a={path}", "--fps", "10")["boxes-counter-restart"]
    assert {k: found.figures[k] for k in ("line", "before", "after", "bits")} == {
        "line": 22,
        "before": 65_535,
        "after": 0,
        "bits": 16,
    }


EVEN = np.arange(400) / 10.0


def stamped(times_s: Floats, first: int = 0, *, counted: bool = False) -> StampedFrames:
    return StampedFrames(first, np.round((1e9 + times_s) * NS).astype(np.int64), counted)


def faults(**cameras: StampedFrames) -> list[tuple[str, tuple[str, ...], float]]:
    figures = {"clock-rate-differs": "ppm", "clock-jump": "jump_s", "clock-drift": "ppm", "clock-offset": "offset_s"}
    return [(each.id, each.sensors, each.figures[figures[each.id]]) for each in clock_faults(cameras)]


def test_clocks_of_frames_of_the_same_numbers_are_compared() -> None:
    """A clock that is set, that drifts, and that counts from elsewhere, among three; with two, either may drift."""
    sound = {"a": stamped(EVEN), "b": stamped(EVEN + 0.03)}
    assert faults(**sound) == []
    ((id, sensors, jump_s),) = faults(**sound, c=stamped(EVEN + 0.9 * (EVEN > 12.0)))
    assert (id, sensors, jump_s) == ("clock-jump", ("c",), pytest.approx(0.9, rel=0.02))
    ((id, sensors, ppm),) = faults(**sound, c=stamped(1.01 * EVEN))
    assert (id, sensors, ppm) == ("clock-drift", ("c",), pytest.approx(1e4, rel=0.02))
    ((id, sensors, ppm),) = faults(**sound, c=stamped(EVEN / 8.0))
    assert (id, sensors, ppm) == ("clock-rate-differs", ("c",), pytest.approx(-875_000.0))
    (check,) = clock_faults({**sound, "c": stamped(EVEN / 8.0)})
    assert "advance at 1/8 of the rate of those of a, b" in check.text
    ((id, sensors, offset_s),) = faults(**sound, c=stamped(EVEN + 37.0))
    assert (id, sensors, offset_s) == ("clock-offset", ("c",), pytest.approx(37.0, rel=0.02))
    assert [id for id, *_ in faults(a=stamped(EVEN), c=stamped(1.01 * EVEN))] == ["clock-drift"]


def test_cameras_of_other_rates_with_missing_frames_or_pauses_are_not_named() -> None:
    sound = {"a": stamped(EVEN), "b": stamped(EVEN + 0.03)}
    assert faults(**sound, c=stamped(1.01 * EVEN[EVEN < 39.6])) == []  # another rate, for the same time
    assert faults(**sound, c=stamped(EVEN[(EVEN < 12.0) | (EVEN > 15.0)])) == []  # stored frames are numbered
    paused = EVEN + 5.0 * (EVEN > 20.0)
    assert faults(a=stamped(paused), b=stamped(paused), c=stamped(paused + 0.02)) == []
    ntsc = np.arange(9000) / 30.0
    assert faults(a=stamped(ntsc), b=stamped(ntsc), c=stamped(1.001 * ntsc)) == []


def test_numbers_that_a_file_states_need_not_end_alike() -> None:
    jumps = EVEN + 16.94 * (EVEN > 8.0)
    files = {"a": stamped(EVEN[7:380], 7, counted=True), "b": stamped(EVEN, counted=True)}
    ((id, sensors, jump_s),) = faults(**files, c=stamped(jumps[:390], counted=True))
    assert (id, sensors, jump_s) == ("clock-jump", ("c",), pytest.approx(16.94, rel=1e-3))
    assert faults(**files, c=stamped(jumps + 9.0 * (EVEN > 30.0), counted=True)) == []


@pytest.mark.parametrize(("step", "ids"), [(1.0, {"times-count-frames"}), (0.999, set()), (0.5, set())])
def test_numbers_of_frames_in_place_of_times_are_noted(tmp_path: Path, step: float, ids: set[str]) -> None:
    rows = "".join(f"{n},{step * n:g},{10 + n % 9},20,20,40\n" for n in range(1, 40))
    table = tmp_path / "a.csv"
    table.write_text(f"frame,time,left,top,width,height\n{rows}")
    assert set(ingest(tmp_path, "--boxes", f"a={table}", "--image-size", "100x100")) == ids
    assert ingest(tmp_path, "--boxes", f"a={table}", "--image-size", "100x100", "--fps", "25") == {}
