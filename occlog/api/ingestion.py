"""`ingest` in Python: one recording of video, boxes, directions, tags, truth, calibration and bags."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

from occlog.errors import UsageError
from occlog.ingest.plan import is_name
from occlog.ingest.request import IngestRequest
from occlog.request import Form

from .call import record
from .keywords import Setting, names_of
from .recordings import Recording
from .sources import SceneSource

File: TypeAlias = "str | os.PathLike[str]"
Files: TypeAlias = "File | Sequence[File] | Mapping[str, File]"
"""A file or folder, several, or those of each camera or array by its name."""
Times: TypeAlias = "float | str | Mapping[str, float | str]"
"""One for all, or that of each camera or array by its name."""


def ingest(
    *bags: File,
    topic: Mapping[str, str | Sequence[str]] | None = None,
    topics: File | Sequence[File] = (),
    video: Mapping[str, File] | None = None,
    images: Mapping[str, File] | None = None,
    boxes: Files = (),
    mot: Mapping[str, File] | None = None,
    doa: Files = (),
    reads: File | Sequence[File] = (),
    truth: Files = (),
    timestamps: Files = (),
    calibration: File | Sequence[File] = (),
    image_size: tuple[int, int] | None = None,
    scene: SceneSource | None = None,
    arrays: Files = (),
    readers: File | None = None,
    start_time: Times | None = None,
    offset: Mapping[str, float | str] | None = None,
    fps: Times | None = None,
    frames: tuple[int, int] | None = None,
    output: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
    progress: bool = False,
    **settings: Setting,
) -> Recording:
    """Gather what cameras, microphone arrays and readers of tags have recorded, as `occlog ingest` does.

    Files of cameras and arrays are a path, several, or a dict with the path of each by its name.

    Args:
        *bags: bags of ROS 2 or MCAP files of other programs, parts of one; or WILDTRACK's folder.
        topic: topics of a bag by the name of the camera, array or target that each is of.
        topics: the same in YAML files.
        video: video of each camera.
        images: folder of images of each camera.
        boxes: boxes of a detector.
        mot: boxes in MOTChallenge text; the same as `boxes`.
        doa: logs of directions of arrival.
        reads: logs of tags that readers read.
        truth: true positions or boxes.
        timestamps: times of the frames.
        calibration: calibration of the cameras.
        image_size: width and height [px], for calibrations that do not state it.
        scene: room, occluders, arrays, and cameras that the calibration lacks.
        arrays: places of direction finders, or microphones of one array.
        readers: places and ranges of the readers of tags.
        start_time: date and time (ISO 8601) or seconds since 1970 of the origin of the times; None: 0.
        offset: added to the times of a sensor whose clock is off [s], or text with a unit: {"cam2": "-400ms"}.
        fps: frame rate, where nothing else gives times.
        frames: only frames first <= number < stop.
        output: where the recording is written; None: a folder that goes with the last reference to it.
        overwrite: an output that is there may be replaced.
        progress: show a bar on standard error, if it is a terminal.
        **settings: by the names of the options: `calibration_unit`, `up`, `store`, `classes`, `allow_uncalibrated` and
            the others.

    Returns:
        The recording. Its `summary` has `notes`: what calibration and tables were understood to say.

    Raises:
        UsageError: a setting that there is not, or arguments that contradict each other.
        InputError: an input is missing, damaged, or says something that cannot be.
        OutputExistsError: the output is there, and may not be replaced.

    Warns:
        OcclogWarning: input was lost, or seems to be other than it says.
    """
    if isinstance(settings.get("classes"), str | Sequence):
        settings["classes"] = names_of(settings["classes"])  # type: ignore[arg-type]
    of_sensors: dict[str, object] = {"video": video, "images": images, "boxes": boxes, "mot": mot, "doa": doa}
    of_sensors |= {"truth": truth, "timestamps": timestamps, "arrays": arrays}
    of_sensors |= {"start_time": start_time, "offset": offset, "fps": fps}
    of_topics = {n: [t] if isinstance(t, str) else t for n, t in (topic or {}).items()}
    arguments = {
        "bags": _paths(bags),
        "topics": _paths(topics),
        "reads": _paths(reads),
        "calibration": _paths(calibration),
        "image_size": _pair(image_size, "image_size", image_size is None or min(image_size) > 0),
        "scene": scene,
        "readers": readers,
        "frames": _pair(frames, "frames", frames is None or 0 <= frames[0] < frames[1]),
        "topic": tuple(text for n, each in of_topics.items() for t in each for text in _named({n: t}, "topic")),
        **{name: _named(value, name) for name, value in of_sensors.items()},
        "settings": settings,
        "output": output,
        "overwrite": overwrite,
        "progress": progress,
    }
    return record(Form(IngestRequest), arguments)


def _paths(value: File | Sequence[File]) -> tuple[Path, ...]:
    """One path or several."""
    return (Path(value),) if isinstance(value, str | os.PathLike) else tuple(Path(each) for each in value)


def _named(value: object, argument: str) -> tuple[str, ...]:
    """What the command takes: `VALUE` or `NAME=VALUE`; UsageError for a name that no sensor can have."""
    if value is None:
        return ()
    if isinstance(value, Mapping):
        wrong = next((name for name in value if not is_name(str(name))), None)
        if wrong is not None:
            raise UsageError(f"{argument}: {wrong!r} is no name: up to 64 characters without space, comma, / = and :")
        return tuple(f"{name}={_text(each, argument)}" for name, each in value.items())
    if isinstance(value, Sequence) and not isinstance(value, str):
        return tuple(_text(each, argument) for each in value)
    return (_text(value, argument),)


def _text(value: object, argument: str) -> str:
    """As it is typed: 10.0 is 10; UsageError for a table in memory."""
    if isinstance(value, float):
        return f"{value:.15g}"
    if getattr(value, "ndim", 0) or hasattr(value, "__arrow_c_stream__"):
        raise UsageError(f"{argument}: a {type(value).__name__} in memory; a path was expected, or give it to track")
    return os.fspath(value) if isinstance(value, os.PathLike) else str(value)


def _pair(value: tuple[int, int] | None, name: str, fits: bool) -> tuple[int, int] | None:
    """Two whole numbers, or None; UsageError for anything else."""
    if value is None:
        return None
    if len(value) != 2 or not fits:
        raise UsageError(f"{name}: {value}: want two numbers; (first, stop) of frames, (width, height) of images")
    return int(value[0]), int(value[1])
