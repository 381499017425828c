"""Opening of the videos and image folders of an ingest, and determination of their frame times.

Also removes duplicate directions and reads, from logs that were copied or exported twice.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from occlog.array_types import Bools, Ints, Strings, Uints
from occlog.console.text import counted
from occlog.errors import InputError, UsageError, abridged, option
from occlog.io.files.timing.frame_times import FrameTimes, as_rate
from occlog.io.files.timing.times import parse_start_time, read_sidecar
from occlog.io.formats.boxes.rows import fingerprints
from occlog.io.formats.truth import read_sync_times
from occlog.io.frames.camera_source import CameraSource, image_source, video_source
from occlog.io.frames.streams import ImageFolder, rate_times, read_folders, sidecar_times, video_times
from occlog.records.columns import ColumnTable
from occlog.records.losses import Loss
from occlog.records.scene import Clock, Scene
from occlog.records.verdicts import Check, finding

from .plan import IngestPlan, for_sensor

DUPLICATES = "duplicate rows"
"""Name of a check."""
Sidecars = dict[str, tuple[Ints, str]]
"""Times of frames and the name of the sidecar file, by camera."""


@dataclass
class IngestFailures:
    """Losses of an ingest (`losses`), and the errors of cameras that could not be used at all (`failures`)."""

    losses: list[Loss] = field(default_factory=list)
    failures: list[InputError] = field(default_factory=list)


def start_of(plan: IngestPlan, name: str) -> int:
    """Origin of the times of the sensor `name` [ns since the epoch]; 0 if not given."""
    text = for_sensor(plan.start_time, name)
    return 0 if text is None else parse_start_time(text)


def read_sidecars(plan: IngestPlan, cameras: list[str]) -> Sidecars:
    """Read the time stamp files (sidecars) of the plan: by camera its frame times [ns] and the name of the file.

    A file given without a camera can be of any of `cameras` (names).

    Raises:
        UsageError: a file is for an unknown camera, or a camera has times in two files.
    """
    out: Sidecars = {}
    for name, path in plan.timestamps:
        names = [name] if name is not None else cameras
        if name is not None and name not in cameras:
            raise UsageError(
                f"{path}: time stamps of camera {name}, which is not among the cameras: {abridged(cameras)}",
                id="unknown-sensor",
            )
        for camera, times in read_sidecar(path, names).items() if names else ():
            if camera in out:
                raise UsageError(
                    f"camera {camera}: has times in {out[camera][1]} and in {path.name}; give one",
                    id="conflicting-options",
                )
            out[camera] = (times, path.name)
    return out


def times_of(plan: IngestPlan, name: str, sidecars: Sidecars) -> FrameTimes | None:
    """Frame times of the camera `name` from its time stamp file in `sidecars`, or a given frame rate.

    None without either.

    Raises:
        UsageError: the camera has both.
    """
    rate = for_sensor(plan.fps, name)
    if name in sidecars:
        if any(key == name for key, _ in plan.fps):
            raise UsageError(
                f"camera {name}: has both time stamps ({option('timestamps')}) and a frame rate ({option('fps')}); "
                "give one",
                id="conflicting-options",
            )
        return sidecar_times(*sidecars[name], start_of(plan, name))
    return rate_times(as_rate(rate), "given", start_of(plan, name)) if rate is not None else None


def clock_of(scene: Scene, name: str) -> Clock | None:
    """Clock model of the sensor `name` in the scene; None if the sensor is unknown or runs by world time."""
    named = {s.name: s.clock for s in scene.sensors}.get(name)
    return next((clock for clock in scene.clocks if clock.name == named), None)


def open_sources(
    plan: IngestPlan, scene: Scene, cameras: list[str], stack: ExitStack, done: IngestFailures
) -> list[CameraSource]:
    """Open videos and image folders of the plan and start their decoders; a camera that cannot be opened is a loss.

    Args:
        plan: inputs and options.
        scene: has the clocks of the cameras.
        cameras: names of all cameras of the recording.
        stack: ends the decoders.
        done: losses and errors of cameras that cannot be opened are added.
    """
    sidecars = read_sidecars(plan, cameras)
    started = [*_videos(plan, scene, sidecars), *_folders(plan, scene, sidecars)]
    opened: list[CameraSource] = []
    for source in started:
        stack.callback(source.decoder.close)
    for source in started:
        try:
            stack.enter_context(source.decoder)
        except InputError as error:
            done.failures.append(error)
            done.losses.append(Loss(source.path.name, f"camera {source.name}", f"skipped: {error}"))
            continue
        opened.append(source)
    return opened


def _videos(plan: IngestPlan, scene: Scene, sidecars: Sidecars) -> list[CameraSource]:
    store = "none" if plan.store == "link" else (plan.store or "jpeg")
    out = []
    for name, path in plan.video.items():
        start, stop = plan.frames.of(name) or (0, None)
        given = for_sensor(plan.fps, name)
        times = times_of(plan, name, sidecars) if name in sidecars else None
        if times is None:
            fps = None if given is None else as_rate(given)
            times = video_times(path, fps=fps, start_ns=start_of(plan, name))
        times = times.by(clock_of(scene, name))
        out.append(video_source(name, path, times, start=start, stop=stop, store=store, quality=plan.jpeg_quality))
    return out


def _folders(plan: IngestPlan, scene: Scene, sidecars: Sidecars) -> list[CameraSource]:
    rates = {name: as_rate(rate) for name in plan.images if (rate := for_sensor(plan.fps, name)) is not None}
    starts = {name: start_of(plan, name) for name in plan.images}
    folders = read_folders(plan.images, sidecars, rates, starts, plan.first_number)
    store = plan.store or "keep"

    def timed(name: str, folder: ImageFolder) -> ImageFolder:
        return replace(folder, times=folder.times.by(clock_of(scene, name)))

    out = []
    for name, folder in folders.items():
        start, stop = plan.frames.of(name) or (0, None)
        out.append(
            image_source(name, timed(name, folder), start=start, stop=stop, store=store, quality=plan.jpeg_quality)
        )
    return out


def sync_times(plan: IngestPlan) -> dict[int, int] | None:
    """World time [ns] of each synchronisation index (`sync_index`) in a time stamp file; None if no file has them."""
    from occlog.io.files.texts.csv_rows import first_line

    for name, path in plan.timestamps:
        if name is None and "sync_index" in [cell.lower() for cell in first_line(path, "time stamps")]:
            start = start_of(plan, "")
            return {sync: int(np.int64(start) + t) for sync, t in read_sync_times(path).items()}
    return None


T = TypeVar("T", bound=ColumnTable)


def duplicates(path: Path, count: int, what: str) -> Check:
    """Finding that `count` exact duplicate rows of a file were skipped; `what` is the noun for a row, as `read`."""
    return finding(DUPLICATES, "rows-duplicated", file=path.name, what=counted(count, what))


class Copies:
    """Removes duplicate rows from logs of one kind (tables with a column `sensor`), and counts them.

    Rows are compared by hashes of 8 bytes. Those of all rows are kept for several logs; for one log only those of the
    last time.
    """

    def __init__(self, *, several: bool) -> None:
        """Start without logs; `several`: a row may occur in an earlier log, too."""
        self._several = several
        self._before: dict[str, list[Uints]] = {}

    def once(self, tables: Iterable[T], path: Path, found: list[Check], what: str) -> Iterator[T]:
        """Generate the tables of a log without rows that are exact copies of earlier ones, of this log or of another.

        Args:
            tables: parts of the log, in the order of time.
            path: the log, for the finding.
            found: if rows were removed, a finding is added to it at the end.
            what: noun for a row in the finding, as `read`.
        """
        here: dict[str, list[Uints]] = {}
        copies = 0
        for table in tables:
            fresh = np.ones(len(table), dtype=np.bool_)
            sensor: Strings = table.sensor  # type: ignore[attr-defined]
            for name in np.unique(sensor).tolist():
                own = np.flatnonzero(sensor == name)
                mine = table.take(own)
                t_ns: Ints = mine.t_ns  # type: ignore[attr-defined]
                marks = fingerprints([getattr(mine, c.name) for c in mine.columns() if c.kind != "U"])
                fresh[own] = _first(marks, [*self._before.get(name, ()), *here.get(name, ())])
                kept = marks if self._several else marks[t_ns == t_ns[-1]]
                # Equal times may be in two parts of a log
                here[name] = [*here.get(name, ()), kept] if self._several else [*here.get(name, ())[-1:], kept]
            copies += int((~fresh).sum())
            yield table if fresh.all() else table.take(fresh)
        for name, parts in here.items():
            self._before.setdefault(name, []).append(np.unique(np.concatenate(parts)))
        if copies:
            found.append(duplicates(path, copies, what))


def _first(marks: Uints, before: list[Uints]) -> Bools:
    """(n,) mask of row hashes `marks` (n,) that occur for the first time.

    They occur neither earlier in `marks` nor in the arrays `before`.
    """
    out = np.zeros(len(marks), dtype=np.bool_)
    out[np.unique(marks, return_index=True)[1]] = True
    for known in before:
        out &= ~np.isin(marks, known)
    return out
