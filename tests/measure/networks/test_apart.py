"""Networks run in processes of their own, which may crash, and of which nothing is left."""

from __future__ import annotations

import gc
import io
import os
import signal
from pathlib import Path

import cv2
import numpy as np
import pytest
from detect_scenes import camera, picture, scene
from numpy.testing import assert_array_equal
from small_networks import colour_network, helper, save

from occlog.cli.main import run
from occlog.errors import ExitCode, InputError
from occlog.io.files.provenance import Provenance
from occlog.io.formats.models.onnx_file import read_onnx
from occlog.io.recording.writer import RecordingWriter
from occlog.measure.networks.running.messages import receive, send
from occlog.measure.networks.running.runtimes import load
from occlog.measure.networks.running.subprocess_runtime import SubprocessRuntime

RNG = np.random.default_rng(5)


def crashing_network(path: Path, place: int = 10**8) -> Path:
    """A network that reads a place far behind its array, which OpenCV does not point at."""
    nodes = [
        helper.make_node("Reshape", ["images", "flat"], ["row"]),
        helper.make_node("GatherND", ["row", "places"], ["found"]),
        helper.make_node("Reshape", ["found", "shape"], ["output0"]),
    ]
    constants = {"flat": [-1], "places": [[place]], "shape": [1, 1, 1]}
    arrays = {name: np.array(values, np.int64) for name, values in constants.items()}
    return save(path, nodes, arrays, {"output0": [1, 1, 1]})


@pytest.mark.parametrize("option", ["--onnx", "--embed"])
def test_a_network_that_crashes_is_one_line(tmp_path: Path, option: str, capfd: pytest.CaptureFixture[str]) -> None:
    room = scene(camera("a", 0.0, 0.0, 45.0))
    with RecordingWriter(tmp_path / "r.mcap", room, Provenance("test"), overwrite=True) as out:
        out.image("a", 0, 0, cv2.imencode(".png", picture(room.cameras[0], [], 0))[1].tobytes(), "png")
    good, bad = colour_network(tmp_path / "good.onnx"), crashing_network(tmp_path / "bad.onnx")
    networks = ["--onnx", str(bad if option == "--onnx" else good), "--min-confidence", "0.9", "--head", "yolo"]
    extra = ["--embed", str(bad)] if option == "--embed" else []
    command = ["detect", str(tmp_path / "r.mcap"), *networks, *extra, "-o", str(tmp_path / "v.parquet"), "-q"]
    assert run(command) == ExitCode.BAD_INPUT
    (line,) = capfd.readouterr().err.splitlines()
    assert f"{bad}: opencv " in line
    assert "crashed (SIG" in line
    assert not (tmp_path / "v.parquet").exists()


def test_outputs_are_those_of_the_program_in_this_process(tmp_path: Path) -> None:
    model = read_onnx(colour_network(tmp_path / "red.onnx", image=("n", 3, 64, 64)))
    apart, here = SubprocessRuntime(model, "opencv", 1), load(model, "opencv", 1)
    assert apart.called == here.called
    for images in (1, 3):
        feeds = {"images": RNG.random((images, 3, 64, 64), dtype=np.float32)}
        assert_array_equal(apart.run(feeds)["output0"], here.run(feeds)["output0"], strict=True)


def test_a_process_that_is_killed_is_reported_and_none_is_left(tmp_path: Path) -> None:
    apart = SubprocessRuntime(read_onnx(colour_network(tmp_path / "red.onnx")), "opencv", 1)
    pid = apart._process.pid
    os.kill(pid, signal.SIGKILL)
    with pytest.raises(InputError, match=r"red\.onnx: opencv .* crashed \(SIGKILL\) on running this network"):
        apart.run({"images": np.zeros((1, 3, 64, 64), np.float32)})
    other = SubprocessRuntime(read_onnx(tmp_path / "red.onnx"), "opencv", 1)
    pid = other._process.pid
    del other
    gc.collect()
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_a_network_that_fails_once_can_be_run_again(tmp_path: Path) -> None:
    apart = SubprocessRuntime(read_onnx(colour_network(tmp_path / "red.onnx")), "opencv", 1)
    with pytest.raises(InputError, match="cannot run this network"):
        apart.run({"other": np.zeros((1, 3, 64, 64), np.float32)})
    assert apart.run({"images": np.zeros((1, 3, 64, 64), np.float32)})["output0"].shape == (1, 5, 4096)


@pytest.mark.parametrize("kind", ["<f4", ">f8", "i8", "u1", "?", "f2"])
@pytest.mark.parametrize("shape", [(), (0, 4), (2, 3), (5,)])
def test_messages_come_as_they_went(kind: str, shape: tuple[int, ...]) -> None:
    pipe = io.BytesIO()
    sent = {"a": (100 * RNG.random(shape)).astype(kind), "b": np.asfortranarray(RNG.random((3, 4)))}
    send(pipe, {"called": "x"}, sent)
    pipe.seek(0)
    header, arrays = receive(pipe, sum(each.nbytes for each in sent.values()))
    assert header == {"called": "x"}
    for name, values in sent.items():
        assert_array_equal(arrays[name], values, strict=True)
    pipe.seek(0)
    with pytest.raises(ValueError, match="an array of"):
        receive(pipe, sum(each.nbytes for each in sent.values()) - 1)
    for end in range(len(pipe.getvalue())):
        with pytest.raises(EOFError):
            receive(io.BytesIO(pipe.getvalue()[:end]))


@pytest.mark.parametrize(
    "text",
    ["[]", "1", "{}", "[" * 100_000]
    + [f'{{"arrays": [{each}]}}' for each in ("1", '["a", "O", [1]]', '["a", "<f4", [-1, -1]]', '["a", "x", [1]]')],
)  # fmt: skip
def test_what_is_no_message_is_not_taken(text: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        receive(io.BytesIO(len(text).to_bytes(4, "big") + text.encode() + bytes(100)))
