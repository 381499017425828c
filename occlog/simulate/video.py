"""The video of `occlog simulate --render`: drawn, compressed and written frame by frame."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from occlog import console
from occlog.core.navigation.obstacles import MovingObstacleTracks
from occlog.core.numerics.interpolate import TimeGrid
from occlog.io.frames.codec import encode_image
from occlog.io.frames.writer import LosslessVideo
from occlog.io.recording.writer import RecordingWriter
from occlog.records.losses import Loss
from occlog.records.scene import Camera, MotionScript, Scene
from occlog.records.tables import Truth
from occlog.simulate.render.people import Rendered, render
from occlog.simulate.render.surfaces import grey

from .config import (
    FieldConfig,
    MeasureConfig,
    ObserveConfig,
    ReadConfig,
    RenderConfig,
    SoundConfig,
    StoreConfig,
    WorldConfig,
)


@dataclass(frozen=True)
class Setup:
    """All settings that determine a simulated recording, except the seed.

    Attributes:
        scene: room, occluders and sensors.
        world: numbers, motion and times of objects.
        observe: measurements of cameras; None: no simulated bearings.
        render: appearance of the video; None: no video.
        store: format of the video.
        sound: sound of sources, and false directions of arrays.
        script: scripted paths of targets; None: random walkers.
        separate: no occlusion between people in the first frame.
        field: obstacle avoidance of walkers, for motion `field`; None: another motion.
        people: recorded walkers, which are avoided; None: none.
        reads: measurements of tag readers.
        measure: ranges, differences and strengths measured by cameras and arrays.
        losses: losses recorded in the file of the people to avoid.
    """

    scene: Scene
    world: WorldConfig
    observe: ObserveConfig | None
    render: RenderConfig | None
    store: StoreConfig
    sound: SoundConfig
    script: MotionScript | None = None
    separate: bool = False
    field: FieldConfig | None = None
    people: MovingObstacleTracks | None = None
    reads: ReadConfig = ReadConfig()
    measure: MeasureConfig = MeasureConfig()
    losses: tuple[Loss, ...] = ()


def video_paths(setup: Setup, output: Path) -> dict[str, Path]:
    """Video file of each camera with a pose by name, next to the recording `output`.

    Empty without video, or if images are stored in the recording.
    """
    if setup.render is None or setup.store.store != "ffv1":
        return {}
    return {c.name: output.with_name(f"{output.stem}.{c.name}.avi") for c in setup.scene.cameras if c.placed}


def film(
    writer: RecordingWriter,
    setup: Setup,
    output: Path,
    chunks: Iterable[Truth | TimeGrid],
    seed: int,
    counts: Counter[str],
    *,
    overwrite: bool,
    quiet: bool,
) -> None:
    """Render the images of all cameras along the true paths, and write them and the true boxes.

    Images go into the recording, or into a video file per camera next to it. Without settings of the renderer
    nothing is done, and the chunks are not consumed.

    Args:
        writer: writer of the recording.
        setup: scene and settings.
        output: file of the recording.
        chunks: true paths.
        seed: seed of the random numbers.
        counts: numbers of frames, boxes and bytes for the summary, updated in place.
        overwrite: replace existing video files.
        quiet: show no progress.
    """
    if setup.render is None:
        return
    drawn = render(setup.scene, chunks, setup.render, seed)
    if setup.store.grey:
        drawn = (replace(frame, image=grey(frame.image)) for frame in drawn)
    frames = console.progress(drawn, "render", _frames_in_all(setup), quiet=quiet)
    if setup.store.store == "png":
        for frame, data in _compressed(frames, setup.render.workers):
            writer.image(frame.sensor, frame.t_ns, frame.index, data, "png")
            _count(writer, frame, counts)
            counts["video_bytes"] += len(data)
        return
    paths = video_paths(setup, output)
    for name, video in _film_files(writer, setup, paths, frames, counts, overwrite).items():
        writer.video(name, video.path.name, video.sha256)
        counts["video_bytes"] += video.bytes


def _count(writer: RecordingWriter, frame: Rendered, counts: Counter[str]) -> None:
    writer.table(frame.boxes)
    counts.update(frames=1, boxes=int((frame.boxes.box >= 0).sum()))


def _film_files(
    writer: RecordingWriter,
    setup: Setup,
    paths: dict[str, Path],
    frames: Iterable[Rendered],
    counts: Counter[str],
    overwrite: bool,
) -> dict[str, LosslessVideo]:
    """Write the frames to one video file per camera, and their true boxes to the recording.

    Args:
        writer: writer of the recording.
        setup: scene and settings.
        paths: file of each camera by name.
        frames: rendered frames, by time.
        counts: numbers of frames and boxes for the summary, updated in place.
        overwrite: replace existing files.

    Returns:
        Videos by camera, complete and closed.
    """
    videos: dict[str, LosslessVideo] = {}
    with ExitStack() as stack:
        for frame in frames:
            if frame.sensor not in videos:
                rate = _rate(setup, setup.scene.camera(frame.sensor))
                size = (frame.image.shape[1], frame.image.shape[0])
                video = LosslessVideo(paths[frame.sensor], size, rate, overwrite=overwrite, together=writer.together)
                videos[frame.sensor] = stack.enter_context(video)
            videos[frame.sensor].write(frame.image)
            writer.video_frame(frame.sensor, frame.t_ns, frame.index)
            _count(writer, frame, counts)
    return videos


def _rate(setup: Setup, camera: Camera) -> float:
    return camera.rate_hz or 1.0 / setup.world.step_s


def _frames_in_all(setup: Setup) -> int:
    length_s = (setup.world.steps - 1) * setup.world.step_s
    return sum(int(length_s * _rate(setup, c) + 1e-9) + 1 for c in setup.scene.cameras if c.placed)


def _compressed(frames: Iterable[Rendered], workers: int) -> Iterator[tuple[Rendered, bytes]]:
    """Generate frames with their PNG bytes in order; `workers` threads compress them in the background."""
    waiting: deque[tuple[Rendered, Future[bytes]]] = deque()
    with ThreadPoolExecutor(workers) as pool:
        for frame in frames:
            waiting.append((frame, pool.submit(encode_image, frame.image, "png", 0)))
            if len(waiting) > 2 * workers:
                done, data = waiting.popleft()
                yield done, data.result()
        for done, data in waiting:
            yield done, data.result()
