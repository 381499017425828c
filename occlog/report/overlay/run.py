"""Run of `occlog report --recording`: tracks and truth drawn over the frames of a recording."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace

from occlog.errors import InputError, UsageError, abridged, option
from occlog.io.files.atomic import write_bytes
from occlog.io.formats.models.motion_models import model_losses
from occlog.io.frames.codec import encode_image
from occlog.io.frames.writer import SHOWN, ShownVideo
from occlog.io.open import input_losses, load_scene, open_if_ours, open_input
from occlog.io.recording.reader import IMAGE_SCHEMA, McapRecording, open_recording
from occlog.io.recording.writer import VIDEO_FRAME
from occlog.records.losses import Loss
from occlog.records.tables import Tracks
from occlog.report.request import OverlayRequest
from occlog.runner import Job, JobResult
from occlog.track.methods.images.run.inputs import other_video

from .pictures import Pictures


def _previous_losses(asked: OverlayRequest) -> tuple[Loss, ...]:
    """Return the data losses recorded in the inputs, without duplicates."""
    tables = (asked.recording, asked.tracks, asked.ground_tracks, asked.diagnostics, asked.truth, asked.failures)
    found = input_losses(open_if_ours(path) for path in tables if path is not None)
    return tuple(dict.fromkeys((*found, *model_losses([asked.fundamental]))))


def run_overlay(request: OverlayRequest, job: Job) -> JobResult:
    """Draw tracks and truth over the frames, and write the video and the picture; return a summary and the losses."""
    asked = classify_inputs(request)
    _check(asked)
    recording = open_recording(asked.recording)
    names = _cameras(recording, asked.cameras)
    scene = load_scene(asked.scene, None, asked.scene) if asked.scene is not None else recording.scene
    pictures = Pictures(asked, recording, names, scene, job)
    rate = asked.fps or _rate(recording, names)
    shown = 0
    for line in other_video(asked.tracks or asked.ground_tracks, [asked.recording, asked.truth]):
        job.note(line)
    if asked.video is not None and asked.video.suffix.lower() == ".mp4":
        job.note(f"{asked.video}: MPEG-4, which browsers may not play; they play .webm")
    with ExitStack() as stack:
        video: ShownVideo | None = None
        png = b""
        for number, picture in job.progress(pictures, "draw"):
            if number == asked.frame:
                png = encode_image(picture, "png", 0)
                pictures.keep()
                if asked.video is None:
                    break
            if asked.video is not None and (asked.frames is None or asked.frames[0] <= number < asked.frames[1]):
                if video is None:
                    size = (picture.shape[1], picture.shape[0])
                    video = stack.enter_context(ShownVideo(asked.video, size, rate, overwrite=job.overwrite))
                video.write(picture)
                pictures.keep()
                shown += 1
        _check_shown(asked, shown, png, pictures)
    if asked.png is not None:
        write_bytes(asked.png, png, job.overwrite)
    return JobResult(_summary(asked, names, shown, rate, pictures), pictures.losses, _previous_losses(asked))


def _check(asked: OverlayRequest) -> None:
    """Raise UsageError if there is nothing to draw, no output, or options that do not go together."""
    if asked.tracks is None and asked.truth is None and asked.ground_tracks is None:
        raise UsageError(
            f"nothing to draw: give TRACKS (a table or a run folder), or true boxes with {option('truth')}, or both",
            id="missing-option",
        )
    if (asked.png is None) != (asked.frame is None):
        raise UsageError(
            f"{option('png')} and {option('frame')} belong together: the picture of one frame", id="conflicting-options"
        )
    if asked.video is None and asked.png is None:
        raise UsageError(
            f"no output: give {option('video')}, or {option('png')} with {option('frame')}", id="missing-option"
        )
    if asked.video is not None and asked.video.suffix.lower() not in SHOWN:
        raise UsageError(f"{asked.video}: a video can be {' or '.join(SHOWN)}; end its name in one of these")


def classify_inputs(asked: OverlayRequest) -> OverlayRequest:
    """Return the request with TRACKS resolved: files of a run folder, or tracks on the ground instead of in images."""
    given = asked.tracks
    if given is not None and given.is_dir():
        found = {name: given / f"{name}.parquet" for name in ("view_tracks", "tracks", "diagnostics")}
        found = {name: path for name, path in found.items() if path.is_file()}
        if not found.keys() & {"view_tracks", "tracks"}:
            raise InputError(
                f"{given}: holds no tracks, so it is not the folder of a finished run; name another", id="wrong-content"
            )
        world = asked.ground_tracks or found.get("tracks")
        return replace(
            asked,
            tracks=found.get("view_tracks"),
            ground_tracks=world,
            diagnostics=asked.diagnostics or found.get("diagnostics"),
        )
    if given is not None and asked.ground_tracks is None and open_input(given).has(Tracks):
        return replace(asked, tracks=None, ground_tracks=given)
    return asked


def _check_shown(asked: OverlayRequest, shown: int, png: bytes, pictures: Pictures) -> None:
    if asked.png is not None and not png:
        raise InputError(
            f"{asked.recording}: camera {pictures.first} has no frame {asked.frame} ({option('frame')})",
            id="disjoint-inputs",
        )
    if asked.video is not None and not shown:
        first, last = asked.frames or (0, 0)
        raise InputError(
            f"{asked.recording}: camera {pictures.first} has no frame in {first}:{last} ({option('frames')})",
            id="empty-input",
        )
    if asked.video is not None and pictures.strange():
        raise InputError(
            f"{asked.tracks}: no row matches a frame of {asked.recording} in time and camera; give the recording "
            "that these tracks are of",
            id="disjoint-inputs",
        )


def _summary(asked: OverlayRequest, names: list[str], shown: int, rate: float, pictures: Pictures) -> dict[str, object]:
    summary: dict[str, object] = {}
    if asked.video is not None:
        summary |= {"video": str(asked.video), "frames": shown, "fps": round(rate, 3)}
    if asked.png is not None:
        summary |= {"png": str(asked.png), "frame": asked.frame}
    return summary | {"cameras": names, "scale": round(pictures.scale, 3)} | pictures.used()


def _cameras(recording: McapRecording, asked: tuple[str, ...]) -> list[str]:
    if not recording.cameras:
        raise InputError(
            f"{recording.path}: holds no video to draw over; give a recording with video or images", id="wrong-content"
        )
    for name in asked:
        if name not in recording.cameras:
            raise InputError(
                f"{recording.path}: no video of camera {name!r}; it has: {abridged(recording.cameras)}",
                id="unknown-sensor",
            )
    return list(dict.fromkeys(asked)) or list(recording.cameras)


def _rate(recording: McapRecording, names: list[str]) -> float:
    """Return the frame rate [Hz] of the fastest of the cameras `names`; 25 for a recording with a single time."""
    first, last = recording.time_ns or (0, 0)
    topics = [t for t in recording.topics if t.schema in (IMAGE_SCHEMA, VIDEO_FRAME)]
    most = max((t.messages for t in topics if any(f"/{name}/" in t.name for name in names)), default=0)
    return (most - 1) / ((last - first) * 1e-9) if most > 1 and last > first else 25.0
