"""Times that no 64 bits hold, or whose differences none hold: of messages, of images, of bags."""

from __future__ import annotations

import base64
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from mcap.writer import Writer

from occlog.cli.main import run
from occlog.errors import ExitCode, InputError
from occlog.io.messages.bag import open_bag
from occlog.io.recording.reader import check_recorded, open_recording, parse_image
from occlog.records.columns import MAX_NS, bounded_ns

PNG = bytes(cv2.imencode(".png", np.zeros((4, 6), np.uint8))[1])
S = 10**9


def message(encoding: str, seconds: int, rest: int) -> bytes:
    if encoding == "json":
        data = base64.b64encode(PNG).decode()
        stamp = {"sec": seconds, "nsec": rest}
        return json.dumps({"timestamp": stamp, "frame_id": "a", "format": "png", "data": data}).encode()
    image = CompressedImage(data=PNG, format="png", frame_id="a")
    image.timestamp.seconds, image.timestamp.nanos = seconds, rest
    return image.SerializeToString()


def bag(path: Path, encoding: str, seconds: list[int], recorded: list[int]) -> Path:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        kind = "jsonschema" if encoding == "json" else "protobuf"
        schema = writer.register_schema("foxglove.CompressedImage", kind, b"{}")
        channel = writer.register_channel("/camera/a/image", encoding, schema)
        for number, (second, log) in enumerate(zip(seconds, recorded, strict=True)):
            writer.add_message(channel, log, message(encoding, second, number), log)
        writer.finish()
    return path


def test_the_largest_time_is_in_range_and_the_next_one_is_not() -> None:
    assert bounded_ns(MAX_NS) - bounded_ns(-MAX_NS) < 2**63
    for far in (MAX_NS + 1, -MAX_NS - 1, 10**40):
        with pytest.raises(ValueError, match="out of range"):
            bounded_ns(far)
    check_recorded(MAX_NS, Path("r.mcap"), "/a", 3)
    with pytest.raises(InputError, match=r"^r\.mcap: /a: message 3: its time of \d+ ns is out of range"):
        check_recorded(MAX_NS + 1, Path("r.mcap"), "/a", 3)


@pytest.mark.parametrize("encoding", ["json", "protobuf"])
def test_the_time_of_an_image_is_in_range_or_refused(encoding: str) -> None:
    seconds, rest = divmod(MAX_NS, S)
    assert parse_image(encoding, message(encoding, seconds, rest), "r")[0] == MAX_NS
    assert parse_image(encoding, message(encoding, -seconds, -rest), "r")[0] == -MAX_NS
    for far in ((seconds, rest + 1), (2**62, 0), (-seconds - 1, 0)):
        with pytest.raises(InputError, match=r"^r: not a foxglove\.CompressedImage message.*out of range"):
            parse_image(encoding, message(encoding, *far), "r")


@pytest.mark.parametrize("encoding", ["json", "protobuf"])
def test_images_of_far_times_are_lost_and_the_others_taken(
    tmp_path: Path, encoding: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = bag(tmp_path / "b.mcap", encoding, [1, 2**60, 2, 3], [S, 2 * S, 2**64 - 1, 3 * S])
    with open_bag([path]) as opened:
        assert [m.log_ns for m in opened.messages({"/camera/a/image"})] == [S, 2 * S, 3 * S]
        assert [(each.place, each.count) for each in opened.losses] == [("time of recording", 1)]
    assert run(["doctor", str(path)]) == ExitCode.LOSSY
    stdout = capsys.readouterr().out
    assert stdout.count("out of range") == 2
    assert run(["ingest", str(path), "--allow-uncalibrated", "-o", str(tmp_path / "r.mcap")]) == ExitCode.LOSSY
    assert "out of range" in capsys.readouterr().err


def test_frames_up_to_one_of_a_far_time_come(tmp_path: Path) -> None:
    recording = open_recording(bag(tmp_path / "r.mcap", "json", [5, 6, 7], [1, 2, MAX_NS + 1]))
    frames = recording.frames(recording.cameras)
    assert [next(frames).t_ns, next(frames).t_ns] == [5 * S, 6 * S + 1]
    with pytest.raises(InputError, match=r"r\.mcap: /camera/a/image: message \d: its time of \d+ ns is out of range"):
        next(frames)
