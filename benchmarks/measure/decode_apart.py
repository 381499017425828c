"""Processor time of `detect` where videos are decoded in processes of their own, beside that of decoding in its own."""

from __future__ import annotations

import os
import sys
import tempfile
from itertools import product
from pathlib import Path
from statistics import median
from typing import Any

import cv2
import numpy as np

from occlog.io.files.provenance import Provenance, hash_file
from occlog.io.formats.scenes.scene import scene_from_yaml
from occlog.io.recording.writer import RecordingWriter

NAME = "decode-apart"
SUMMARY = (
    "processor time of detect with videos decoded in other processes to that with them decoded in its own, the worst"
)
LIMIT = 1.10
SIZES = {(256, 128): (100, 400), (640, 480): (100,), (1920, 1080): (100,)}
"""Size of the frames of four cameras, and how many of each camera: 10 s at 10 a second, and for small ones 40 s."""
CODES = ("FFV1", "MJPG")
ALONE = """
import sys
import cv2
from occlog.io.recording import reader

class Here:
    death = ""
    def __init__(self, path):
        self.video, self.at = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1]), 0
    def read(self, index):
        while True:
            good, image = self.video.read()
            self.at += 1
            if not good or self.at > index:
                return image if good else None
    def close(self):
        self.video.release()

if sys.argv.pop(1) == "here":
    reader.VideoApart = Here
from occlog.__main__ import main
sys.exit(main())
"""


def make(folder: Path, size: tuple[int, int], code: str, frames: int) -> Path:
    """A recording with the videos of four cameras: somebody walks in front of noise that stays."""
    width, height = size
    names = [f"cam{k}" for k in range(4)]
    cameras = ", ".join(
        f"{{name: {name}, position: [{3 * k}, 0], yaw_deg: 90, focal_px: {width}, image_size_px: [{width}, {height}]}}"
        for k, name in enumerate(names)
    )
    rng = np.random.default_rng(0)
    wall = cv2.resize(rng.integers(40, 200, (height // 8, width // 8, 3), dtype=np.uint8), size)
    with RecordingWriter(
        folder / "r.mcap", scene_from_yaml(f"occlog_scene: 1\ncameras: [{cameras}]", "s"), Provenance("t")
    ) as out:
        for name in names:
            path = folder / f"{name}.avi"
            video = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*code), 10.0, size)
            for k in range(frames):
                image = wall.copy()
                left = (k * width // 100) % width
                image[height // 4 : height // 4 + height // 2, left : left + width // 12] = 255
                video.write(image)
            video.release()
            out.video(name, path.name, hash_file(path))
        for k in range(frames):
            for name in names:
                out.video_frame(name, k * 10**8, k)
    return folder / "r.mcap"


def seconds(recording: Path, where: str) -> float:
    """Processor time of `detect` and all that it starts."""
    command = [
        sys.executable,
        "-c",
        ALONE,
        where,
        "detect",
        str(recording),
        "-o",
        str(recording.with_name(f"{where}.parquet")),
        "--overwrite",
        "-q",
    ]
    quiet = [(os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0)]
    pid = os.posix_spawn(sys.executable, command, os.environ, file_actions=quiet)
    _, status, usage = os.wait4(pid, 0)
    if os.waitstatus_to_exitcode(status) != 0:
        raise RuntimeError(f"detect ended with {os.waitstatus_to_exitcode(status)}")
    return usage.ru_utime + usage.ru_stime


def run(repeats: int) -> dict[str, Any]:
    """Ratio of the processor times, in turn."""
    parts: dict[str, float] = {}
    ratios = []
    for (size, counts), code in product(SIZES.items(), CODES):
        for frames in counts:
            with tempfile.TemporaryDirectory() as name:
                recording = make(Path(name), size, code, frames)
                seconds(recording, "here"), seconds(recording, "apart")  # what is compiled is kept
                pairs = [(seconds(recording, "apart"), seconds(recording, "here")) for _ in range(repeats)]
                tables = {recording.with_name(f"{where}.parquet").read_bytes() for where in ("here", "apart")}
                if len(tables) > 1:
                    raise RuntimeError("the tables differ")
            of = f"{size[0]}x{size[1]} {code}, {frames} frames of each camera"
            ratios.append(median(a / b for a, b in pairs))
            parts |= {of: ratios[-1], f"{of}: s in its own": median(b for _, b in pairs)}
            print(f"{of}: {ratios[-1]:.3f}", file=sys.stderr, flush=True)  # all of them take long
    return {"ratio": max(ratios), "limit": LIMIT, "parts": parts}
