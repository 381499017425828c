"""`occlog simulate --scene balls`: from a request's settings to a recording with video."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path

from occlog.console.notes import threads_by_default
from occlog.errors import InputError, UsageError, option
from occlog.io.files.atomic import OutputGroup, check_outputs
from occlog.io.files.provenance import Provenance
from occlog.io.frames.codec import encode_image
from occlog.io.frames.writer import LosslessVideo
from occlog.io.recording.writer import RecordingWriter
from occlog.records.frames import Image
from occlog.records.scene import Scene
from occlog.runner import Job, JobResult
from occlog.settings import configure
from occlog.simulate.config import START_NS, StoreConfig
from occlog.simulate.render.surfaces import grey
from occlog.simulate.request import BallsRequest
from occlog.simulate.world.scripted_paths import step_times

from .config import BallsConfig
from .motion import VIEWS, BallPaths, ball_paths
from .video import BallsFrame, balls_boxes, balls_scene, balls_truth, render_balls


@dataclass(frozen=True)
class BallsSetup:
    """Settings of a recording of balls without the seed: balls, scene, frame rate, video format, number of threads."""

    config: BallsConfig
    scene: Scene
    rate_hz: float
    store: StoreConfig
    workers: int


def balls_setup(request: BallsRequest) -> BallsSetup:
    """Resolve the settings of a request; 25 frames/s without `fps`."""
    size = {} if request.size is None else dict(zip(("width", "height"), request.size, strict=True))
    config, rate_hz = configure(BallsConfig(), {**request.balls, **size}), request.fps or 25.0
    return BallsSetup(
        config=config,
        scene=balls_scene(config, rate_hz),
        rate_hz=rate_hz,
        store=configure(StoreConfig(), request.store),
        workers=request.workers or threads_by_default(),
    )


def _paths(config: BallsConfig, seed: int) -> BallPaths:
    """True paths of the balls; UsageError for balls without sufficient room."""
    try:
        return ball_paths(config, seed)
    except InputError as error:
        raise UsageError(f"{option('scene')} {error}") from error


def balls_videos(setup: BallsSetup, output: Path) -> dict[str, Path]:
    """Video file of each view by camera name, next to the recording `output`; empty if images are stored in it."""
    if setup.store.store != "ffv1":
        return {}
    return {c.name: output.with_name(f"{output.stem}.{c.name}.avi") for c in setup.scene.cameras}


def run_balls(request: BallsRequest, job: Job) -> JobResult:
    """Simulate a recording of balls with video, write it, and return the summary."""
    setup, output, seed, overwrite = balls_setup(request), request.output, request.seed, job.overwrite
    videos = balls_videos(setup, output)
    check_outputs([], [output, *videos.values()], overwrite)
    paths = _paths(setup.config, seed)
    counts: Counter[str] = Counter()
    frames = job.progress(render_balls(setup.config, seed, setup.workers, paths), "render", setup.config.frames)
    with (
        OutputGroup() as together,
        RecordingWriter(output, setup.scene, _made(setup, job, seed), overwrite=overwrite, together=together) as writer,
    ):
        if setup.store.store == "ffv1":
            _write_files(writer, setup, videos, paths, frames=frames, counts=counts, overwrite=overwrite)
        else:
            _write_images(writer, setup, paths, frames=frames, counts=counts)
    summary: dict[str, object] = {
        "recording": str(output),
        "seed": seed,
        "seconds": (setup.config.frames - 1) / setup.rate_hz,
        "targets": setup.config.balls,
        "cameras": len(setup.scene.cameras),
    }
    return JobResult(summary | {n: counts[n] for n in ("frames", "boxes", "hidden", "video_bytes")})


def _made(setup: BallsSetup, job: Job, seed: int) -> Provenance:
    """Provenance of the recording: its settings, frame rate and seed, and the views as yaw and pitch [deg]."""
    values = asdict(setup.config)
    values["views"] = [list(view) for view in VIEWS[: setup.config.views]]
    made = {"balls": values, "rate_hz": setup.rate_hz, "store": setup.store.store, "grey": setup.store.grey}
    return job.provenance(made, seed=seed)


def _write_truth(
    writer: RecordingWriter, setup: BallsSetup, paths: BallPaths, frame: BallsFrame, counts: Counter[str]
) -> int:
    """Write the true positions of one frame, and the true boxes in all views, to the recording.

    Args:
        writer: writer of the recording.
        setup: settings and scene.
        paths: true paths of the balls.
        frame: ellipses, visible shares and number of the frame.
        counts: numbers of frames, boxes and hidden balls, increased in place.

    Returns:
        Time of the frame [ns].
    """
    t_ns = START_NS + int(step_times(frame.frame, 1, 1.0 / setup.rate_hz)[0])
    writer.table(balls_truth(paths.centres[frame.frame], t_ns))
    for boxes in balls_boxes(frame, setup.scene.cameras, t_ns):
        writer.table(boxes)
        counts.update(frames=1, boxes=int((boxes.box >= 0).sum()), hidden=int((boxes.visible == 0).sum()))
    return t_ns


def _delivered(setup: BallsSetup, frame: BallsFrame) -> tuple[Image, ...]:
    """Images of all views of a frame, grey if requested."""
    return tuple(map(grey, frame.images)) if setup.store.grey else frame.images


def _write_images(
    writer: RecordingWriter,
    setup: BallsSetup,
    paths: BallPaths,
    frames: Iterator[BallsFrame],
    counts: Counter[str],
) -> None:
    """Write truth and PNG images of all frames to the recording, and update `counts` in place.

    Images are compressed in parallel with rendering.
    """

    def write(frame: BallsFrame, coded: list[Future[bytes]]) -> None:
        t_ns = _write_truth(writer, setup, paths, frame, counts=counts)
        for camera, future in zip(setup.scene.cameras, coded, strict=True):
            writer.image(camera.name, t_ns, frame.frame, future.result(), "png")
            counts["video_bytes"] += len(future.result())

    waiting: deque[tuple[BallsFrame, list[Future[bytes]]]] = deque()
    with ThreadPoolExecutor(setup.workers) as pool:
        for frame in frames:
            coded = [pool.submit(encode_image, image, "png", 0) for image in _delivered(setup, frame)]
            waiting.append((frame, coded))
            if len(waiting) > 2 * setup.workers:
                write(*waiting.popleft())
        for frame, coded in waiting:
            write(frame, coded)


def _write_files(
    writer: RecordingWriter,
    setup: BallsSetup,
    videos: dict[str, Path],
    paths: BallPaths,
    frames: Iterator[BallsFrame],
    counts: Counter[str],
    overwrite: bool,
) -> None:
    """Write the truth of all frames to the recording, and the images to FFV1 files next to it.

    `videos` has the file of each camera by name; `counts` is updated in place.
    """
    size = (setup.config.width, setup.config.height)
    with ExitStack() as stack:
        open_videos = {
            name: stack.enter_context(
                LosslessVideo(path, size, setup.rate_hz, overwrite=overwrite, together=writer.together)
            )
            for name, path in videos.items()
        }
        for frame in frames:
            t_ns = _write_truth(writer, setup, paths, frame, counts=counts)
            for (name, video), image in zip(open_videos.items(), _delivered(setup, frame), strict=True):
                video.write(image)
                writer.video_frame(name, t_ns, frame.frame)
    for name, video in open_videos.items():
        writer.video(name, video.path.name, video.sha256)
        counts["video_bytes"] += video.bytes
