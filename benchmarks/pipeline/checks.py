"""Time to read tables and recordings with all check sums and limits, beside that of the libraries without any."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np
import pyarrow.parquet as pq
from mcap.reader import SeekingReader
from mcap.summary import Summary

from benchmarks.pipeline.flips import MADE, SCENE, bearings
from occlog.io.files.tables import parquet
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import read_scene
from occlog.io.frames.codec import decode_image
from occlog.io.recording import reader
from occlog.io.recording.writer import RecordingWriter
from occlog.records.frames import Image
from occlog.records.tables import Bearings

NAME = "checks"
SUMMARY = "time to read a table of 1 million rows, recordings of rows and of images, with all checks to without any"
LIMIT = 1.15
ROWS, MESSAGES, IMAGES = 1_000_000, 100_000, 300


@contextmanager
def plain_parquet(path: Path) -> Iterator[pq.ParquetFile]:
    """What reads a table with no check at all."""
    with pq.ParquetFile(path, page_checksum_verification=False) as file:
        yield file


@contextmanager
def plain_mcap(path: Path) -> Iterator[tuple[SeekingReader, Summary | None]]:
    """What reads a recording with no check at all."""
    with path.open("rb") as file:
        plain = SeekingReader(file, validate_crcs=False)
        yield plain, plain.get_summary()


def read_rows(path: Path) -> int:
    """All rows of the recording."""
    return len(reader.open_recording(path).read(Bearings))


def read_images(path: Path) -> int:
    """All images of the recording, decoded here: what the decoding process costs is measured apart."""
    return sum(len(frame.decode()) for frame in reader.open_recording(path).frames())


def copy_images(path: Path) -> int:
    """All images of the recording, as they lie there."""
    return sum(1 for _ in reader.open_recording(path).frames())


def plain_decode(data: bytes, where: str) -> Image:  # noqa: ARG001
    """What decodes an image with no check at all."""
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)


def make(folder: Path) -> tuple[Path, Path, Path]:
    """A table, a recording of rows and one of images (JPEG of noise, 320 x 240)."""
    table, rows, images = (folder / name for name in ("t.parquet", "rows.mcap", "images.mcap"))
    write_table(table, bearings(ROWS, 1), MADE)
    with RecordingWriter(rows, read_scene(SCENE), MADE) as writer:
        writer.table(bearings(MESSAGES, 2))
    rng = np.random.default_rng(3)
    with RecordingWriter(images, read_scene(SCENE), MADE) as writer:
        for number in range(IMAGES):
            image = cv2.imencode(".jpg", rng.integers(0, 255, (240, 320, 3), dtype=np.uint8))[1].tobytes()
            writer.image("southwest", (number + 1) * 40_000_000, number, image, "jpeg")
    return table, rows, images


def run(repeats: int) -> dict[str, Any]:
    """Ratios of processor times, medians of pairs taken in turn; the largest of those that the limit holds for.

    Images that are only copied are no way in which any command reads them.
    """
    here = patch("occlog.io.recording.reader.decode_apart", decode_image)
    with here, tempfile.TemporaryDirectory() as name:
        table, rows, images = make(Path(name))
        cases: dict[str, Callable[[], Any]] = {
            "table": lambda: read_table(table),
            "recording of rows": lambda: read_rows(rows),
            "recording of images": lambda: read_images(images),
            "images, not decoded": lambda: copy_images(images),
        }
        parts: dict[str, float] = {}
        for case, read in cases.items():
            ratios, times = [], []
            for _ in range(repeats):
                times.append(_cpu_s(read))
                with without_checks():
                    ratios.append(times[-1] / _cpu_s(read))
            parts |= {f"{case}: ratio": median(ratios), f"{case}: s": median(times)}
    return {"ratio": max(parts[f"{case}: ratio"] for case in list(cases)[:3]), "limit": LIMIT, "parts": parts}


@contextmanager
def without_checks() -> Iterator[None]:
    """Read with the libraries alone."""
    with (
        patch("occlog.io.files.tables.parquet.open_parquet", plain_parquet),
        patch("occlog.io.recording.reader.open_mcap", plain_mcap),
        patch("occlog.io.recording.reader.decode_apart", plain_decode),
    ):
        yield


def read_table(path: Path) -> int:
    """All rows of the table."""
    return len(parquet.read_table(path, Bearings))


def _cpu_s(read: Callable[[], Any]) -> float:
    start = time.process_time()
    read()
    return time.process_time() - start
