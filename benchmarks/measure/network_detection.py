"""Detection by a network in a recording of 640 x 480 frames against the network alone on the same frames.

The network costs 3.2 GFLOP a frame, about as much as a small YOLO; times are from start to end, on all cores.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any

import cv2
import numpy as np

from benchmarks.references import scene as scenes
from occlog.core.geometry.camera import rotation_from_angles
from occlog.io.files.provenance import Provenance
from occlog.io.recording.reader import open_recording
from occlog.io.recording.writer import RecordingWriter
from occlog.measure.detect.by_network import detect_by_network
from occlog.measure.networks.config import NetworkConfig
from occlog.measure.networks.detector import NetworkDetector, open_detector
from occlog.measure.networks.running.runtimes import load, opencv_threads
from occlog.records.scene import Camera, Scene

NAME = "network"
SUMMARY = "640x480 JPEG recording, 3.2 GFLOP network: detect --onnx to the network alone in OpenCV, time a frame"
LIMIT = 1.1
FRAMES = 40
STEP_NS = 100_000_000


def room() -> Scene:
    """One camera."""
    angles = rotation_from_angles(0.64, -0.2, 0.0)
    camera = Camera(
        "cam", np.array([0.2, 0.2, 2.4]), angles, np.array([380.0, 380.0]), np.array([319.5, 239.5]), (640, 480)
    )
    return Scene(cameras=(camera,))


def record(path: Path) -> None:
    """Smooth noise that changes from frame to frame."""
    rng = np.random.default_rng(0)
    with RecordingWriter(path, room(), Provenance("benchmark"), overwrite=True) as out:
        for k in range(FRAMES):
            image = cv2.GaussianBlur(rng.integers(0, 255, (480, 640, 3), dtype=np.uint8), (0, 0), 3)
            out.image("cam", k * STEP_NS, k, cv2.imencode(".jpg", image)[1].tobytes(), "jpeg")


def seconds(work: Any) -> float:
    """Time [s] of a call."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def run(repeats: int) -> dict[str, Any]:
    """Ratio of the medians of alternating repeats; times in ms a frame."""
    threads = os.cpu_count() or 1
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        stack.enter_context(opencv_threads(threads))
        record(folder / "r.mcap")
        model = scenes("small_networks").costly_network(folder / "c.onnx", side=416)
        detector = open_detector(model, NetworkConfig(head="yolo"), ("0",), None, 0.5, threads)
        frames = [frame.decode() for frame in open_recording(folder / "r.mcap").frames(("cam",))]
        inputs = [detector.prepare(image).numbers[None] for image in frames]
        network, name = load(detector.network.file, "opencv", threads), detector.network.image.name
        bare, whole = [], []
        for _ in range(repeats):
            bare.append(seconds(lambda: [network.run({name: each}) for each in inputs]))
            whole.append(seconds(lambda: detected(folder / "r.mcap", detector)))
    each = {"network alone [ms]": median(bare), "detect --onnx [ms]": median(whole)}
    parts = {name: value / FRAMES * 1e3 for name, value in each.items()}
    return {"ratio": median(whole) / median(bare), "limit": LIMIT, "parts": {**parts, "threads": threads}}


def detected(path: Path, detector: NetworkDetector) -> None:
    """Read, decode, bring to size, run, and make views and bearings."""
    for _ in detect_by_network(open_recording(path).frames(("cam",)), room(), detector):
        pass
