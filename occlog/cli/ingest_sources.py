"""Opens the videos and image folders of an ingest, and finds out when their frames were taken."""

from __future__ import annotations

from contextlib import ExitStack

import numpy as np

from ..columns import Ints
from ..errors import InputError, UsageError
from ..io.camera_source import CameraSource, image_source, video_source
from ..io.frame_times import FrameTimes, as_rate
from ..io.images import read_folders
from ..io.timestamps import parse_time, read_sidecar
from ..io.truth_board import read_sync_times
from ..io.video import rate_times, sidecar_times, video_times
from ..losses import Loss
from .ingest_plan import IngestPlan, for_sensor

Clocks = dict[str, tuple[Ints, str]]
"""Times of frames and the name of the sidecar file, by camera."""


def start_of(plan: IngestPlan, name: str) -> int:
    """Time of the origin of a sensor's times [ns]; 0 where it is not given."""
    text = for_sensor(plan.start_time, name)
    return 0 if text is None else parse_time(text)


def read_clocks(plan: IngestPlan, cameras: list[str]) -> Clocks:
    """Sidecar times of each camera that has some."""
    out: Clocks = {}
    for name, path in plan.timestamps:
        names = [name] if name is not None else cameras
        if name is not None and name not in cameras:
            raise UsageError(f"--timestamps {name}={path}: there is no camera {name}; cameras: {', '.join(cameras)}")
        for camera, times in read_sidecar(path, names).items() if names else ():
            if camera in out:
                raise UsageError(f"camera {camera}: has times in {out[camera][1]} and in {path.name}; give one")
            out[camera] = (times, path.name)
    return out


def clock_of(plan: IngestPlan, name: str, clocks: Clocks) -> FrameTimes | None:
    """Times of a camera's frames from its sidecar or a given frame rate; None where neither is given."""
    rate = for_sensor(plan.fps, name)
    if name in clocks:
        if any(key == name for key, _ in plan.fps):
            raise UsageError(f"camera {name}: has both --timestamps and --fps; give one")
        return sidecar_times(*clocks[name], start_of(plan, name))
    return rate_times(as_rate(rate), "given", start_of(plan, name)) if rate is not None else None


def open_sources(
    plan: IngestPlan, cameras: list[str], stack: ExitStack, losses: list[Loss], failures: list[InputError]
) -> list[CameraSource]:
    """The cameras with images, decoders running; one that cannot be opened is told in `losses`.

    Args:
        plan: the options.
        cameras: every camera of the recording.
        stack: ends the decoders.
        losses: what was lost is added here.
        failures: errors of the cameras that cannot be opened are added here.
    """
    clocks = read_clocks(plan, cameras)
    started = [*_videos(plan, clocks), *_folders(plan, clocks)]
    opened: list[CameraSource] = []
    for source in started:
        stack.callback(source.decoder.close)
    for source in started:
        try:
            stack.enter_context(source.decoder)
        except InputError as error:
            failures.append(error)
            losses.append(Loss(source.path.name, f"camera {source.name}", f"left out: {error}"))
            continue
        opened.append(source)
    return opened


def _videos(plan: IngestPlan, clocks: Clocks) -> list[CameraSource]:
    start, stop = plan.frames or (0, None)
    store = "none" if plan.store == "link" else (plan.store or "jpeg")
    out = []
    for name, path in plan.video.items():
        times = clock_of(plan, name, clocks) or video_times(path, start_ns=start_of(plan, name))
        out.append(video_source(name, path, times, start=start, stop=stop, store=store, quality=plan.jpeg_quality))
    return out


def _folders(plan: IngestPlan, clocks: Clocks) -> list[CameraSource]:
    start, stop = plan.frames or (0, None)
    rates = {name: as_rate(rate) for name in plan.images if (rate := for_sensor(plan.fps, name)) is not None}
    starts = {name: start_of(plan, name) for name in plan.images}
    folders = read_folders(plan.images, clocks, rates, starts, plan.first_number)
    store = plan.store or "keep"
    return [
        image_source(name, folder, start=start, stop=stop, store=store, quality=plan.jpeg_quality)
        for name, folder in folders.items()
    ]


def sync_times(plan: IngestPlan) -> dict[int, int] | None:
    """Time of every synchronisation index, if a sidecar file has them."""
    from ..io.csv_rows import first_line

    for name, path in plan.timestamps:
        if name is None and "sync_index" in [cell.lower() for cell in first_line(path, "time stamps")]:
            start = start_of(plan, "")
            return {sync: int(np.int64(start) + t) for sync, t in read_sync_times(path).items()}
    return None
