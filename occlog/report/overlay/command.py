"""`occlog report --video`: tracks and truth drawn over the frames of a recording."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from occlog.array_types import Bools, Ints
from occlog.cli import options
from occlog.errors import InputError, UsageError
from occlog.io.files.atomic import write_bytes
from occlog.io.files.parquet import read_provenance
from occlog.io.frames.codec import encode_image
from occlog.io.frames.writer import SHOWN, ShownVideo
from occlog.io.open import open_input
from occlog.io.recording.reader import IMAGE_SCHEMA, Recording, open_recording
from occlog.io.recording.writer import VIDEO_FRAME
from occlog.measure.epipolar.matrices import known_geometry
from occlog.measure.epipolar.views import View
from occlog.records.columns import Table
from occlog.records.frames import Frame, Image
from occlog.records.scene import Scene
from occlog.records.tables import TruthBoxes
from occlog.records.views import Failures, ViewTracks
from occlog.track.images.run.provenance import other_video

from .draw import draw_shot, tile
from .stage import FrameRows, Rig, frame_shot

T = TypeVar("T", bound=Table)
GOOD_HEIGHT = 480
"""Images lower than this are enlarged, by a whole number."""


@dataclass(frozen=True)
class Asked:
    """Options of the command; None where not given."""

    recording: Path
    tracks: Path | None = None
    truth: Path | None = None
    failures: Path | None = None
    fundamental: Path | None = None
    scene: Path | None = None
    video: Path | None = None
    png: Path | None = None
    frame: int | None = None
    frames: tuple[int, int] | None = None
    cameras: tuple[str, ...] = ()
    scale: float | None = None
    fps: float | None = None
    overwrite: bool = False

    def check(self) -> None:
        """UsageError for options that do not go together, and for outputs that exist."""
        if self.tracks is None and self.truth is None:
            raise UsageError("nothing to draw: give TRACKS (in images), or true boxes with --truth, or both")
        if (self.png is None) != (self.frame is None):
            raise UsageError("--png and --frame belong together: the picture of one frame")
        if self.video is None and self.png is None:
            raise UsageError("no output: give --video, or --png with --frame")
        if self.video is not None and self.video.suffix.lower() not in SHOWN:
            raise UsageError(f"{self.video}: video can be {' or '.join(SHOWN)}; name it so")
        inputs = (self.recording, self.tracks, self.truth, self.failures, self.fundamental, self.scene)
        options.check_outputs(inputs, (self.video, self.png), self.overwrite)


class Rows(Generic[T]):
    """Rows of a table sorted by time, chunk by chunk, taken by time and camera; earlier ones are let go."""

    def __init__(self, chunks: Iterable[T]) -> None:
        """`chunks` follow each other in time."""
        self._chunks = iter(chunks)
        self._held: T | None = None
        self.used = 0

    def at(self, t_ns: int, sensor: str) -> T | None:
        """Rows of one frame; times must not go back.  None at the end of a table without any rows."""
        while self._held is None or not len(self._held) or int(self._times(self._held)[-1]) <= t_ns:
            more = next(self._chunks, None)
            if more is None:
                break
            kept = self._held.take(self._times(self._held) >= t_ns) if self._held is not None else None
            self._held = more if kept is None else type(more).concat([kept, more])
        if self._held is None:
            return None
        own: Bools = (self._times(self._held) == t_ns) & (self._held.sensor == sensor)  # type: ignore[attr-defined]
        self.used += int(own.sum())
        return self._held.take(own)

    @staticmethod
    def _times(table: T) -> Ints:
        times: Ints = table.t_ns  # type: ignore[attr-defined]
        return times


def run_overlay(asked: Asked, *, quiet: bool = False) -> dict[str, object]:
    """Draw, write the video and the picture; what they show."""
    asked.check()
    recording = open_recording(asked.recording)
    names = _cameras(recording, asked.cameras)
    scene = options.load_scene(asked.scene, None, asked.scene) if asked.scene is not None else recording.scene
    pictures = _Pictures(asked, recording, names, scene, quiet)
    rate = asked.fps or _rate(recording, names)
    shown = 0
    for line in other_video(asked.tracks, [asked.recording, asked.truth]):
        options.note(line, quiet)
    with ExitStack() as stack:
        video: ShownVideo | None = None
        png = b""
        for number, picture in options.progress(pictures, "draw", quiet=quiet):
            if number == asked.frame:
                png = encode_image(picture, "png", 0)
                if asked.video is None:
                    break
            if asked.video is not None and (asked.frames is None or asked.frames[0] <= number < asked.frames[1]):
                if video is None:
                    size = (picture.shape[1], picture.shape[0])
                    video = stack.enter_context(ShownVideo(asked.video, size, rate, overwrite=asked.overwrite))
                video.write(picture)
                shown += 1
        _check_shown(asked, shown, png, pictures)
    if asked.png is not None:
        write_bytes(asked.png, png, asked.overwrite)
    return _summary(asked, names, shown, rate, pictures)


def _check_shown(asked: Asked, shown: int, png: bytes, pictures: _Pictures) -> None:
    if asked.png is not None and not png:
        raise InputError(f"{asked.recording}: camera {pictures.first} has no frame {asked.frame}")
    if asked.video is not None and not shown:
        first, last = asked.frames or (0, 0)
        raise InputError(f"{asked.recording}: camera {pictures.first} has no frame in {first}:{last}")
    if asked.video is not None and asked.tracks is not None and not pictures.used()["tracks"]:
        raise InputError(
            f"{asked.tracks}: no row is of a frame shown of {asked.recording} (time and camera must agree); "
            "are these the tracks of this recording?"
        )


def _summary(asked: Asked, names: list[str], shown: int, rate: float, pictures: _Pictures) -> dict[str, object]:
    summary: dict[str, object] = {}
    if asked.video is not None:
        summary |= {"video": str(asked.video), "frames": shown, "fps": round(rate, 3)}
    if asked.png is not None:
        summary |= {"png": str(asked.png), "frame": asked.frame}
    return summary | {"cameras": names} | pictures.used()


def _cameras(recording: Recording, asked: tuple[str, ...]) -> list[str]:
    if not recording.cameras:
        raise InputError(f"{recording.path}: holds no video to draw over")
    for name in asked:
        if name not in recording.cameras:
            raise InputError(f"{recording.path}: no video of camera {name!r}; it has: {', '.join(recording.cameras)}")
    return list(dict.fromkeys(asked)) or list(recording.cameras)


def _rate(recording: Recording, names: list[str]) -> float:
    """Frames a second of the fastest camera; 25 where a recording holds one time only."""
    first, last = recording.time_ns or (0, 0)
    topics = [t for t in recording.topics if t.schema in (IMAGE_SCHEMA, VIDEO_FRAME)]
    most = max((t.messages for t in topics if any(f"/{name}/" in t.name for name in names)), default=0)
    return (most - 1) / ((last - first) * 1e-9) if most > 1 and last > first else 25.0


class _Pictures:
    """Iterable of (number of the first camera's frame, picture of all views), one each time round.

    A picture shows the latest frame of every camera; the next one starts with the second
    frame of any of them.
    """

    def __init__(self, asked: Asked, recording: Recording, names: list[str], scene: Scene | None, quiet: bool) -> None:
        self._recording, self.names, self.first = recording, names, names[0]
        self._tracks = _rows(asked.tracks, ViewTracks)
        self._truth = _rows(asked.truth, TruthBoxes)
        self._failures = _rows(asked.failures, Failures)
        self._rig = _rig(asked, recording, names, scene, quiet)
        height = max(view.height for view in self._rig.views)
        self._scale = asked.scale or float(max(1, round(GOOD_HEIGHT / height)))

    def used(self) -> dict[str, int]:
        """Rows of each table that belong to the frames so far."""
        tables = {"tracks": self._tracks, "truth": self._truth, "failures": self._failures}
        return {name: rows.used for name, rows in tables.items() if rows is not None}

    def __iter__(self) -> Iterator[tuple[int, Image]]:
        images: list[Image] = [np.zeros((v.height, v.width, 3), dtype=np.uint8) for v in self._rig.views]
        numbers = [-1] * len(self.names)
        rows = [FrameRows(None, None, None)] * len(self.names)
        fresh: set[int] = set()
        for frame in self._recording.frames(self.names):
            view = self.names.index(frame.sensor)
            if view in fresh:
                yield numbers[0], self._drawn(images, numbers, rows)
                fresh.clear()
            images[view], numbers[view], rows[view] = frame.decode(), frame.index, self._rows_of(frame)
            fresh.add(view)
        if fresh:
            yield numbers[0], self._drawn(images, numbers, rows)

    def _rows_of(self, frame: Frame) -> FrameRows:
        """Rows of one frame of every table."""
        return FrameRows(_at(self._tracks, frame), _at(self._truth, frame), _at(self._failures, frame))

    def _drawn(self, images: list[Image], numbers: list[int], rows: list[FrameRows]) -> Image:
        shots = [frame_shot(view, number, rows, self._rig) for view, number in enumerate(numbers)]
        pictures = [draw_shot(image, shot, self._scale) for image, shot in zip(images, shots, strict=True)]
        return tile(pictures, len(pictures) if len(pictures) <= 3 else math.ceil(math.sqrt(len(pictures))))


def _rig(asked: Asked, recording: Recording, names: list[str], scene: Scene | None, quiet: bool) -> Rig:
    """The views, as large as their first images, and the geometry that the tracker had, as far as it is known."""
    cameras = [next((c for c in scene.cameras if c.name == name), None) if scene else None for name in names]
    sizes = [next(recording.frames([name])).decode().shape for name in names]
    views = [View(name, size[1], size[0]) for name, size in zip(names, sizes, strict=True)]
    if asked.tracks is None:
        return Rig(views, cameras, None)
    known = known_geometry(views, recording, scene if asked.scene is not None else None, asked.fundamental)
    for line in known.notes:
        options.note(line, quiet)
    bottom = read_provenance(asked.tracks).parameters.get("anchor") == "bottom"
    return Rig(views, cameras, known.geometry, _numbered(asked), bottom)


def _numbered(asked: Asked) -> bool:
    """Whether trackers have the numbers of their targets: not those that began with detections."""
    births = read_provenance(asked.tracks).parameters.get("births") if asked.tracks is not None else None
    failures = asked.failures
    own = read_provenance(failures).parameters.get("own") if failures is not None else None
    return births in (None, "initial") and own in (None, "label")


def _rows(path: Path | None, table: type[T]) -> Rows[T] | None:
    if path is None:
        return None
    return Rows(open_input(path).rows(table))


def _at(rows: Rows[T] | None, frame: Frame) -> T | None:
    return rows.at(frame.t_ns, frame.sensor) if rows is not None else None
