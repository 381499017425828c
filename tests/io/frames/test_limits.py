"""Each limit of a decoding process is met: what goes beyond it ends there, with one line."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import cv2
import pytest
from video_samples import numbered, write_video

from occlog.errors import InputError
from occlog.io.frames import limits
from occlog.io.frames.decoders.process import DecodingJob, start_decoder

if sys.platform != "linux":
    pytest.skip("limits as Linux has them", allow_module_level=True)
import resource

MB = 2**20
BEGIN = "import sys; from occlog.io.frames import limits; "


def ended(code: str) -> subprocess.CompletedProcess[str]:
    """What a process did that set its limits and went on with `code`."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.run([sys.executable, "-c", BEGIN + code], env=environment, capture_output=True, text=True)


def tried(code: str) -> str:
    """Name of what is raised by `code` under the limits, "" for nothing."""
    text = "\n    ".join(code.split("; "))
    found = ended(
        f"limits.lower_limits()\ntry:\n    {text}\nexcept Exception as e:\n    print(type(e).__name__, *e.args[:1])"
    )
    assert found.returncode == 0, found.stderr
    return found.stdout.strip()


def test_memory_ends_at_its_limit() -> None:
    room = f"import mmap; x = mmap.mmap(-1, limits.MEMORY - 200 * {MB}); x.close(); "
    assert tried(f"{room}x = bytearray(limits.MEMORY)") == "MemoryError"


def test_frames_raise_the_limit_of_memory_by_their_pixels() -> None:
    pixels = 200 * MB // limits.MEMORY_PER_PIXEL
    room = f"import mmap; limits.allow_pixels({pixels}); x = mmap.mmap(-1, limits.MEMORY); x.close(); "
    assert tried(f"{room}x = bytearray(limits.MEMORY + 200 * {MB})") == "MemoryError"


def test_files_are_counted(tmp_path: Path) -> None:
    opened = f"x = [open('/dev/null') for _ in range({{}})]; del x; open({str(tmp_path / 'f')!r}, 'w').close()"
    assert tried(opened.format(limits.FILES - 3)) == ""  # three are open: standard input, output, error
    assert tried(opened.format(limits.FILES - 2)).startswith("OSError 24")


def test_what_is_written_has_a_limit(tmp_path: Path) -> None:
    file = tmp_path / "log"
    written = f"x = open({str(file)!r}, 'wb', buffering=0); x.write(bytes(limits.WRITTEN)); x.write(b'1' * {{}})"
    assert tried(written.format(0)) == ""
    assert tried(written.format(1)).startswith("OSError 27")
    assert file.stat().st_size == limits.WRITTEN


def test_processor_time_ends_the_process_unless_frames_come() -> None:
    spin = "import time\ndef spin(s):\n    end = time.process_time() + s\n    while time.process_time() < end: pass\n"
    begun = f"limits.SECONDS = {{}}\n{spin}c = limits.CpuTimeLimit()\n"
    assert ended(f"{begun.format(0)}spin(3)").returncode == -signal.SIGXCPU
    assert ended(f"{begun.format(1)}for _ in range(3):\n    spin(.6)\n    c.go_on()").returncode == 0


def test_no_core_is_written() -> None:
    assert (
        ended("limits.lower_limits()\nimport resource\nprint(resource.getrlimit(resource.RLIMIT_CORE)[0])").stdout
        == "0\n"
    )


def video_job(path: Path) -> DecodingJob:
    return DecodingJob(kind="video", path=str(path), start=0, stop=None, store="raw", quality=95)


def test_a_frame_that_takes_too_long_ends_the_video_there(tmp_path: Path) -> None:
    with start_decoder(video_job(write_video(tmp_path / "ffv1.mkv", 200))) as running:
        frames = running.delivered()
        next(frames)
        os.kill(running.process.pid, signal.SIGXCPU)  # what the system does at the limit
        list(frames)
    (loss,) = running.losses
    assert loss.what == f"the decoder took more than {limits.SECONDS} s for one frame"


def test_an_image_beyond_the_memory_is_one_line() -> None:
    data = cv2.imencode(".png", cv2.resize(numbered(1), (6000, 6000)))[1].tobytes()
    with closing(start_decoder(DecodingJob(kind="messages", path="x", store="raw", quality=0))) as running:
        assert running.image_of(data, "camera 1").shape == (6000, 6000, 3)
        pages = int(Path(f"/proc/{running.process.pid}/statm").read_text().split()[0])
        limit = pages * resource.getpagesize() + 16 * MB
        resource.prlimit(running.process.pid, resource.RLIMIT_AS, (limit, limit))
        with pytest.raises(InputError, match=r"^camera 1: .*\bFailed to allocate\b"):
            running.image_of(data, "camera 1")
        assert running.image_of(cv2.imencode(".png", numbered(2))[1].tobytes(), "camera 1").shape == numbered(2).shape


@pytest.fixture
def segment(tmp_path: Path) -> Path:
    return write_video(tmp_path / "mp4v.mp4", 5)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("list.mp4", "ffconcat version 1.0\nfile mp4v.mp4\n"),
        ("list.m3u8", "#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nmp4v.mp4\n#EXT-X-ENDLIST\n"),
    ],
)
def test_lists_that_name_other_files_are_not_opened(segment: Path, name: str, text: str) -> None:
    path = segment.with_name(name)
    path.write_text(text)
    if name == "list.mp4":  # without the list of containers it is
        assert cv2.VideoCapture(str(path), cv2.CAP_FFMPEG).isOpened()
    with (
        pytest.raises(InputError, match=r"list\.\w+: not a video file that FFmpeg can read"),
        start_decoder(video_job(path)),
    ):
        pass


@pytest.mark.parametrize("name", ["list.m3u8", "list.mpd", "list.sdp", "{url}"])
def test_nothing_is_fetched(tmp_path: Path, name: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setblocking(False)
        url = f"http://127.0.0.1:{server.getsockname()[1]}/v.mp4"
        text = {
            "list.m3u8": f"#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n{url}\n#EXT-X-ENDLIST\n",
            "list.mpd": '<?xml version="1.0"?><MPD xmlns="urn:mpeg:dash:schema:mpd:2011" type="static" '
            'mediaPresentationDuration="PT1S"><Period><AdaptationSet mimeType="video/mp4"><Representation id="1" '
            f'bandwidth="1"><BaseURL>{url}</BaseURL><SegmentBase/></Representation></AdaptationSet></Period></MPD>',
            "list.sdp": "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\n"
            "m=video 5004 RTP/AVP 96\na=rtpmap:96 H264/90000\n",
        }.get(name)
        path = Path(name.format(url=url))
        if text is not None:
            path = tmp_path / name
            path.write_text(text)
        with pytest.raises(InputError), start_decoder(video_job(path)):
            pass
        with pytest.raises(BlockingIOError):  # no one called
            server.accept()
