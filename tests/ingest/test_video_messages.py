"""`occlog ingest` of video in messages (H.264 and H.265): the order of pictures, damage, missing messages, refusals."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from mcap.writer import Writer
from stream_samples import H264, H264B, H265, H265B

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.recording.reader import McapRecording, open_recording

START, STEP = 1_700_000_000_000_000_000, 50_000_000
STREAMS = {"h264": H264, "h265": H265}
N = len(H264)
Message = tuple[int, bytes]
"""Number of a picture, and its bytes."""


def write(folder: Path, form: str, messages: Sequence[Message], *, encoding: str = "protobuf") -> Path:
    path = folder / "video.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        language = "protobuf" if encoding == "protobuf" else "jsonschema"
        channel = writer.register_channel(
            "/cam/video", encoding, writer.register_schema("foxglove.CompressedVideo", language, b"{}")
        )
        for k, data in messages:
            t_ns = START + k * STEP
            if encoding == "json":
                stamp = {"sec": t_ns // 10**9, "nsec": t_ns % 10**9}
                text = {"timestamp": stamp, "frame_id": "c", "format": form, "data": base64.b64encode(data).decode()}
                payload = json.dumps(text).encode()
            else:
                message = CompressedVideo(frame_id="c", format=form, data=data)
                message.timestamp.FromNanoseconds(t_ns)
                payload = message.SerializeToString()
            writer.add_message(channel, t_ns, payload, t_ns)
        writer.finish()
    return path


def ingest(bag: Path, *options: str) -> tuple[int, Path]:
    out = bag.parent / "out.mcap"
    return run(["ingest", str(bag), "-o", str(out), "--overwrite", "--allow-uncalibrated", *options]), out


def made(bag: Path, *options: str, code: int = ExitCode.DONE) -> McapRecording:
    found, out = ingest(bag, *options)
    assert found == code
    return open_recording(out)


def shown(recording: McapRecording) -> list[tuple[int, int]]:
    """Number by the time, and by the picture (the left half of picture k is as bright as 10 k + 20), of each frame."""
    return [
        ((f.t_ns - START) // STEP, round((float(np.mean(f.decode()[:, :24])) - 20) / 10)) for f in recording.frames()
    ]


@pytest.mark.parametrize("form", ["h264", "h265"])
@pytest.mark.parametrize("encoding", ["protobuf", "json"])
def test_each_picture_has_the_time_of_its_message(tmp_path: Path, form: str, encoding: str) -> None:
    """Case c13, mcap#1198: video in messages was refused."""
    recording = made(write(tmp_path, form, list(enumerate(STREAMS[form])), encoding=encoding), "--store", "png")
    assert shown(recording) == [(k, k) for k in range(N)]
    assert not recording.losses
    assert recording.cameras == ("cam",)


@pytest.mark.parametrize("form", ["h264", "h265"])
def test_pictures_between_a_missing_message_and_the_next_key_frame_are_lost(tmp_path: Path, form: str) -> None:
    """A decoder shows them as if nothing was missing (H.264), or leaves them out (H.265)."""
    messages = [(k, data) for k, data in enumerate(STREAMS[form]) if k != 8]
    recording = made(write(tmp_path, form, messages), code=ExitCode.LOSSY)
    found = shown(recording)
    assert all(t == k for t, k in found)
    kept = [t for t, _ in found]
    assert kept[:8] == list(range(8))
    assert not set(kept) & {8, 9, 10, 11}
    assert sum(loss.count for loss in recording.losses) == N - 1 - len(kept)
    if form == "h264":
        assert kept == [*range(8), 12, 13]
        assert "message 8 is built on a picture that is missing" in recording.losses[0].what


@pytest.mark.parametrize("form", ["h264", "h265"])
@pytest.mark.parametrize("bad", range(1, 12))
def test_no_picture_has_the_time_of_another_after_damage(tmp_path: Path, form: str, bad: int) -> None:
    messages = list(enumerate(STREAMS[form]))
    data = messages[bad][1]
    half = len(data) // 2
    messages[bad] = (bad, data[:half] + bytes(b ^ 0x5A for b in data[half:]))
    code, out = ingest(write(tmp_path, form, messages))
    assert code in (ExitCode.DONE, ExitCode.LOSSY)
    recording = open_recording(out)
    found = shown(recording)
    following = 6 * (bad // 6 + 1)
    good = [(t, k) for t, k in found if not bad <= t < following]
    assert all(t == k for t, k in good)
    assert {t for t, _ in found} >= set(range(bad))
    assert sum(loss.count for loss in recording.losses) == N - len(found)


def test_a_recording_that_begins_between_key_frames_loses_what_is_before(tmp_path: Path) -> None:
    recording = made(write(tmp_path, "h264", list(enumerate(H264))[3:]), code=ExitCode.LOSSY)
    assert shown(recording) == [(k, k) for k in range(6, N)]
    (loss,) = recording.losses
    assert (loss.place, loss.count) == ("/cam/video", 3)
    assert "message 0 comes before the first key frame" in loss.what


def test_a_choice_of_frames_counts_messages(tmp_path: Path) -> None:
    recording = made(write(tmp_path, "h264", list(enumerate(H264))), "--frames", "3:9")
    assert shown(recording) == [(k, k) for k in range(3, 9)]
    assert [f.index for f in recording.frames()] == list(range(3, 9))


@pytest.mark.parametrize(
    ("form", "messages", "words"),
    [
        ("h264", H264B, "topic /cam/video: H.264 with B frames, which are stored in another order than shown"),
        ("h265", H265B, "topic /cam/video: H.265 with B frames, which are stored in another order than shown"),
        (
            "h264",
            [b"\xff\xd8\xff\xe0 a JPEG"] * 8,
            "video is stated to be h264, and its data are JPEG; record it as jpeg",
        ),
        ("h264", [b"12345678"] * 8, "video is stated to be h264, and its data have no start codes (Annex B)"),
        ("h264", H264[1:6], "no message of its video has a key frame"),
        ("h264", [H264[0] + H264[1]] * 8, "a message of h264 video has 2 pictures; exactly one"),
        ("av1", H264, "video as av1 is not read (h264 and h265 are); write it to a file"),
    ],
)
def test_streams_that_cannot_be_placed_are_refused(
    tmp_path: Path, form: str, messages: list[bytes], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write(tmp_path, form, list(enumerate(messages)))
    assert ingest(bag)[0] == ExitCode.BAD_INPUT
    (line,) = [each for each in capsys.readouterr().err.splitlines() if "error:" in each]
    assert words in line
