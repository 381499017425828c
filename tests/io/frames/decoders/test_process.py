"""The decoding process: what it delivers, how it stops, and what is left when it crashes."""

from __future__ import annotations

import os
import signal
import struct
import subprocess
import sys
import time
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest
from video_samples import FRAMES, avi, jpeg, number_shown, numbered, write_video

from occlog.errors import InputError
from occlog.io.frames.camera_source import video_source
from occlog.io.frames.decode import decode, examine
from occlog.io.frames.decoders.process import Decoder, start_decoder
from occlog.io.frames.streams import video_times
from occlog.io.video.container import MAX_FRAMES
from occlog.records.losses import Loss


def decoder(path: Path, **more: object) -> Decoder:
    job = {"kind": "video", "path": str(path), "start": 0, "stop": None, "store": "raw", "quality": 95, **more}
    return start_decoder(job)


def images(folder: Path, **more: object) -> Decoder:
    files = [(k, str(p)) for k, p in enumerate(sorted(folder.iterdir()))]
    return start_decoder(
        {"kind": "images", "path": str(folder), "files": files, "store": "keep", "quality": 95, **more}
    )


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_video(tmp_path_factory.mktemp("videos") / "ffv1.mkv")


def test_raw_frames_arrive_in_order_with_their_times(video: Path) -> None:
    with decoder(video) as running:
        assert running.size == (160, 120)
        assert running.frames == FRAMES
        assert running.rate_hz == 20
        frames = list(running.delivered())
    assert [f.index for f in frames] == list(range(FRAMES))
    assert [f.pos_ns for f in frames] == [50_000_000 * k for k in range(FRAMES)]
    assert [number_shown(f.image) for f in frames] == list(range(FRAMES))
    assert np.array_equal(frames[3].image, numbered(3))  # FFV1 is lossless
    assert running.losses == []
    assert running.process.returncode is not None


@pytest.mark.parametrize(("store", "exact"), [("png", True), ("jpeg", False)])
def test_frames_come_encoded(video: Path, store: str, exact: bool) -> None:
    with decoder(video, store=store, start=2, stop=6) as running:
        frames = list(running.delivered())
    assert [f.index for f in frames] == [2, 3, 4, 5]
    for frame in frames:
        assert frame.kind == store
        image = cv2.imdecode(np.frombuffer(frame.data, np.uint8), cv2.IMREAD_COLOR)
        assert number_shown(image) == frame.index
        assert np.array_equal(image, numbered(frame.index)) == exact


def test_times_only(video: Path) -> None:
    with decoder(video, store="none") as running:
        assert all(f.data == b"" and f.kind == "none" for f in running.delivered())


def test_leaving_early_ends_the_process(video: Path) -> None:
    with decoder(video) as running:
        next(running.delivered())
        assert running.process.poll() is None
    assert running.process.poll() is not None


def test_a_crash_on_the_way_is_a_loss(video: Path) -> None:
    with decoder(video) as running:
        frames = running.delivered()
        next(frames)
        os.kill(running.process.pid, signal.SIGSEGV)
        delivered = 1 + len(list(frames))
    assert delivered < FRAMES
    assert len(running.losses) == 1
    assert "crashed (SIGSEGV)" in running.losses[0].what


def test_a_crash_before_the_first_frame_is_an_error(video: Path) -> None:
    running = decoder(video)
    os.kill(running.process.pid, signal.SIGKILL)
    with pytest.raises(InputError, match=r"ffv1\.mkv: the decoder crashed \(SIGKILL\)"), running:
        pass


def test_errors_of_the_process_arrive_as_one_line(tmp_path: Path) -> None:
    path = tmp_path / "v.mp4"
    path.write_bytes(b"nothing" * 100)
    with pytest.raises(InputError, match="not a video file") as caught, decoder(path):
        pass
    assert "\n" not in str(caught.value)


def test_frames_of_another_size_are_listed(tmp_path: Path) -> None:
    path = tmp_path / "v.avi"
    path.write_bytes(avi([jpeg(k, (320, 240) if k in (4, 5) else (160, 120)) for k in range(10)]))
    with decoder(path, store="none") as running:
        assert [f.index for f in running.delivered()] == [0, 1, 2, 3, 6, 7, 8, 9]
    assert [(loss.place, loss.count) for loss in running.losses] == [("frames 4-5", 2)]


def test_a_stream_without_a_container_has_the_given_rate(tmp_path: Path) -> None:
    path = tmp_path / "v.mjpeg"
    path.write_bytes(b"".join(jpeg(k, (80, 60) if k == 3 else (160, 120)) for k in range(10)))
    with pytest.raises(InputError) as refused:
        video_times(path, start_ns=7)
    assert refused.value.id == "missing-times"
    source = video_source(
        "cam", path, video_times(path, fps=Fraction(25), start_ns=7), start=0, stop=None, store="none", quality=95
    )
    with source.decoder:
        frames = [(t, f.index) for t, f in source.frames()]
    assert frames == [(40_000_000 * k + 7, k) for k in range(10) if k != 3]
    assert [(loss.place, loss.count) for loss in source.losses] == [("frame 3", 1)]


@pytest.mark.parametrize(("fps", "step"), [(None, 50_000_000), (Fraction(10), 100_000_000)])
def test_a_frame_that_an_avi_recorder_dropped_takes_its_time(tmp_path: Path, fps: Fraction | None, step: int) -> None:
    dropped = (3, 4, 9)
    path = tmp_path / "v.avi"
    path.write_bytes(avi([b"" if k in dropped else jpeg(k) for k in range(12)]))
    source = video_source("cam", path, video_times(path, fps=fps), start=0, stop=None, store="raw", quality=95)
    with source.decoder:
        frames = [(t, number_shown(f.image)) for t, f in source.frames()]
    assert frames == [(step * k, k) for k in range(12) if k not in dropped]
    assert source.losses == []


@pytest.mark.parametrize("start", [1, 10, 30, 72_000])
def test_a_stream_of_avi_that_begins_later_keeps_all_frames(tmp_path: Path, start: int) -> None:
    """FFmpeg counts packets from there: so many frames were reported lost, and others took their places."""
    path = tmp_path / "v.avi"
    path.write_bytes(avi([jpeg(k) for k in range(20)], start=start))
    with decoder(path) as running:
        assert [(f.index, number_shown(f.image)) for f in running.delivered()] == [(k, k) for k in range(20)]
    assert running.losses == []


@pytest.mark.parametrize("name", ["v.mkv", "v.avi"])
def test_frames_that_are_stored_in_another_order_are_all_there(tmp_path: Path, name: str) -> None:
    """MPEG-2 has B-frames: the decoder is one packet late, and slices resemble parameters of H.264."""
    path = write_video(tmp_path / name, fourcc="mpg2")
    with decoder(path) as running:
        assert [(f.index, number_shown(f.image)) for f in running.delivered()] == [(k, k) for k in range(FRAMES)]
    assert running.losses == []


def test_dropped_frames_among_those_in_another_order_are_reported(tmp_path: Path) -> None:
    """The decoder does not say which picture a dropped packet would have held back."""
    data = write_video(tmp_path / "v.avi", fourcc="mpg2").read_bytes()
    packets, at = [], data.index(b"movi") + 4
    while data[at : at + 4] == b"00dc":
        (size,) = struct.unpack_from("<I", data, at + 4)
        packets.append(data[at + 8 : at + 8 + size])
        at += 8 + size + size % 2
    for dropped, reported in (([], 0), ([b"", b""], 1)):
        path = tmp_path / "dropped.avi"
        path.write_bytes(avi([*packets[:8], *dropped, *packets[8:]], codec=b"mpg2"))
        with decoder(path) as running:
            assert len(list(running.delivered())) >= len(packets) - 1
        assert [loss.place for loss in running.losses] == ["dropped frames"] * reported


@pytest.mark.parametrize("rule", ["stamps", "table"])
def test_times_that_cannot_be_held_are_refused(tmp_path: Path, rule: str) -> None:
    """Those of a damaged file ended the command with an error of the writer, or were written."""
    path = write_video(tmp_path / "mjpg.mp4")
    data = bytearray(path.read_bytes())
    struct.pack_into(">I", data, data.index(b"stts") + 16, 2**31 - 1 if rule == "stamps" else 10**9)
    struct.pack_into(">I", data, data.index(b"mdhd") + 16, 1 if rule == "stamps" else 10)
    data[data.index(b"edts") : data.index(b"edts") + 4] = b"free"
    path.write_bytes(bytes(data))
    start = 0 if rule == "stamps" else 2**62 - 10**18
    source = video_source("cam", path, video_times(path, start_ns=start), start=0, stop=None, store="none", quality=95)
    with source.decoder, pytest.raises(InputError, match=r"mjpg\.mp4: frame \d+: a time of .* is out of range"):
        list(source.frames())


def test_frames_that_are_not_in_the_file_are_not_waited_for(tmp_path: Path) -> None:
    """The decoder was asked for each of ten millions that a header of 100 kB announced, which took 20 s."""
    path = tmp_path / "v.avi"
    path.write_bytes(avi([jpeg(k) for k in range(5)], announced=MAX_FRAMES))
    begun = time.process_time()
    losses: list[Loss] = []
    assert len(list(decode(examine(path), 0, None, losses.append))) == 5
    assert time.process_time() - begun < 8
    assert losses[0].count == MAX_FRAMES - 5


def test_why_nothing_can_be_decoded_is_reported(tmp_path: Path) -> None:
    """A codec that FFmpeg was built without (AV1) looked like damage."""
    path = tmp_path / "v.avi"
    path.write_bytes(avi([b"no picture at all"] * 3))
    with pytest.raises(InputError, match=r"not one frame can be decoded; the decoder states: .*; copy"), decoder(path):
        pass


def test_black_bars_are_measured(tmp_path: Path) -> None:
    framed = np.zeros((140, 160, 3), np.uint8)
    framed[8:133] = 120
    path = tmp_path / "images"
    path.mkdir()
    (path / "0.png").write_bytes(cv2.imencode(".png", framed)[1].tobytes())
    with images(path) as running:
        assert running.bars == (0, 8, 0, 7)


def test_image_files_are_passed_on_as_they_are(tmp_path: Path) -> None:
    folder = tmp_path / "images"
    folder.mkdir()
    for k in range(4):
        (folder / f"{k}.jpg").write_bytes(jpeg(k))
    cv2.imwrite(str(folder / "4.bmp"), numbered(4))
    with images(folder) as running:
        frames = list(running.delivered())
    assert [f.data for f in frames[:4]] == [jpeg(k) for k in range(4)]
    assert [f.kind for f in frames] == ["jpeg"] * 4 + ["png"]
    with images(folder, store="png") as running:
        assert [f.kind for f in running.delivered()] == ["png"] * 5


def test_images_that_cannot_be_used_are_listed_one_by_one(tmp_path: Path) -> None:
    folder = tmp_path / "cam"
    folder.mkdir()
    whole = cv2.imencode(".png", numbered(1))[1].tobytes()
    changed = bytearray(whole)
    changed[len(whole) // 2] ^= 1
    wrong = jpeg(1)[: len(jpeg(1)) // 2] + bytes(200) + jpeg(1)[-200:]
    parts = {
        "0.png": whole,
        "1.png": whole[:-300],
        "2.png": bytes(changed),
        "3.jpg": jpeg(3)[:900],
        "4.jpg": jpeg(4),
        "5.jpg": b"",
        "6.jpg": jpeg(6, (80, 60)),
        "7.jpg": b"not an image",
        "8.jpg": wrong,
    }
    for name, data in parts.items():
        (folder / name).write_bytes(data)
    with images(folder) as running:
        delivered = [f.index for f in running.delivered()]
    assert delivered == [0, 4]
    reported = {loss.place: loss.what for loss in running.losses}
    assert list(reported) == ["1.png", "2.png", "3.jpg", "5.jpg", "6.jpg", "7.jpg", "8.jpg"]
    assert "cut short" in reported["1.png"]
    assert "check sum" in reported["2.png"]
    assert "cut short" in reported["3.jpg"]
    assert "80 x 60 px where 160 x 120" in reported["6.jpg"]
    assert "not an image" in reported["7.jpg"]
    assert "damage" in reported["8.jpg"]
    assert all(loss.count == 1 and loss.source == "cam" for loss in running.losses)


def test_a_folder_without_one_usable_image_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"x" * 50)
    with pytest.raises(InputError, match="none of its images can be decoded"), images(tmp_path):
        pass


def test_a_huge_image_is_refused_unread(tmp_path: Path) -> None:
    data = bytearray(cv2.imencode(".png", numbered(0))[1].tobytes())
    data[16:24] = (60000).to_bytes(4, "big") * 2
    (tmp_path / "a.png").write_bytes(bytes(data))
    with pytest.raises(InputError, match="60000 x 60000 px; the limit is"), images(tmp_path):
        pass


def test_the_process_loads_little() -> None:
    loaded = ("decoders.process_main", "decode", "streams")
    code = f"import sys, {', '.join(f'occlog.io.frames.{name}' for name in loaded)}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"numba", "scipy", "pyarrow", "mcap", "shapely", "occlog.records.scene"} & set(done.stdout.split())
