"""Flipped bits in tables and recordings: is any of them read as data, or as what the file says of itself?

`python -m benchmarks.pipeline.flips COUNT [SEED]` flips COUNT bits of each format, one at a time.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from occlog.errors import InputError
from occlog.io.external.source import find_source
from occlog.io.files.limits import Content, content_of
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import describe, read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import read_scene, scene_to_yaml
from occlog.io.recording.mcap_errors import open_mcap
from occlog.io.recording.reader import open_recording
from occlog.io.recording.writer import RecordingWriter
from occlog.records.losses import Loss
from occlog.records.tables import Bearings

NAME = "flips"
SUMMARY = "flipped bits that pass as data or metadata, of 200 a repeat in each format"
LIMIT = 0.0
SCENE = Path(__file__).resolve().parents[2] / "examples" / "room.yaml"
MADE = Provenance("detect", {"method": "em"}, 7, (("a.mcap", "0" * 64),), (Loss("cam1", "frame 3", "lost", 1),))
Read = tuple[object, object]
"""What is read of a file: its data, and what it says of itself."""


def bearings(rows: int, seed: int) -> Bearings:
    """Bearings of four cameras to one target, some of them missing."""
    rng, nan = np.random.default_rng(seed), np.full(rows, np.nan)
    seen = rng.random(rows) > 0.1
    return Bearings.of(
        t_ns=np.repeat(np.arange(-(-rows // 4)), 4)[:rows] * 40_000_000,
        sensor=np.resize(["northeast", "northwest", "southeast", "southwest"], rows),
        target_id=np.zeros(rows, np.int32),
        seen=seen,
        bearing=np.where(seen, rng.uniform(-3, 3, rows), np.nan),
        sigma=np.where(seen, 0.01, np.nan),
        u_px=nan,
        sigma_px=nan,
        score=nan,
    )


def make_table(path: Path) -> None:
    """A table of 600 rows."""
    write_table(path, bearings(600, 1), MADE)


def make_recording(path: Path) -> None:
    """A recording with a scene, images, rows, frames of a linked video and a loss."""
    scene, rng = read_scene(SCENE), np.random.default_rng(2)
    with RecordingWriter(path, scene, MADE) as writer:
        for number in range(6):
            image = rng.integers(0, 255, (12, 16, 3), dtype=np.uint8)
            writer.image("southwest", number * 40_000_000, number, cv2.imencode(".png", image)[1].tobytes(), "png")
            writer.video_frame("southeast", number * 40_000_000, number)
        writer.table(bearings(40, 3))
        writer.video("southeast", "southeast.avi", "0" * 64)


def read_parquet(path: Path) -> Read:
    """Rows and metadata of a table, as commands read it."""
    if content_of(path) is not Content.TABLE or find_source(path) is not None:
        raise InputError(f"{path}: not read as a table of occlog")
    table, statement = read_table(path, Bearings), describe(path)
    del statement["columns"]  # units and meanings of columns, which no command takes from the file
    return [np.asarray(getattr(table, c.name)).tobytes() for c in table.columns()], json.dumps(
        statement, sort_keys=True
    )


def read_mcap(path: Path) -> Read:
    """Messages and metadata of a recording, as commands read it."""
    if content_of(path) is not Content.RECORDING:
        raise InputError(f"{path}: not read as a recording")
    recording = open_recording(path)
    with open_mcap(path) as (reader, _):
        data = [(c.topic, m.log_time, m.sequence, m.data) for _, c, m in reader.iter_messages()]
    scene = recording.scene and scene_to_yaml(recording.scene)
    return data, (scene, recording.topics, recording.provenance.json(), recording.videos, recording.time_ns)


FORMATS: dict[str, tuple[Callable[[Path], None], Callable[[Path], Read]]] = {
    "Parquet": (make_table, read_parquet),
    "MCAP": (make_recording, read_mcap),
}


def flip(name: str, count: int, seed: int) -> Counter[str]:
    """Flip `count` bits of a file of a format, each in a copy; how many were refused or changed what is read.

    All bits are flipped once if `count` is more than there are.
    """
    make, read = FORMATS[name]
    outcomes: Counter[str] = Counter(refused=0, same=0, data=0, metadata=0)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "file"
        make(path)
        raw, good = path.read_bytes(), read(path)
        for bit in np.random.default_rng(seed).permutation(8 * len(raw))[:count].tolist():
            flipped = bytearray(raw)
            flipped[bit // 8] ^= 1 << bit % 8
            path.write_bytes(flipped)
            outcomes[_outcome(partial(read, path), good)] += 1
    return outcomes


def _outcome(read: Callable[[], Read], good: Read) -> str:
    try:
        data, reported = read()
    except InputError:
        return "refused"
    return "data" if data != good[0] else "metadata" if reported != good[1] else "same"


def run(repeats: int) -> dict[str, Any]:
    """Share of the flips that changed what is read."""
    found = {name: flip(name, 200 * repeats, 1) for name in FORMATS}
    parts = {f"{name}: {outcome}": n for name, outcomes in found.items() for outcome, n in outcomes.items()}
    silent = sum(outcomes["data"] + outcomes["metadata"] for outcomes in found.values())
    return {"ratio": silent / sum(map(sum, (o.values() for o in found.values()))), "limit": LIMIT, "parts": parts}


if __name__ == "__main__":
    for each in FORMATS:
        print(each, dict(flip(each, int(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 0)))
