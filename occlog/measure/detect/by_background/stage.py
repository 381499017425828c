"""Detect people-sized regions and the targets' bearings in frames, camera by camera, streaming.

Frames are processed in small batches. Within a batch each camera's frames are one job, in order; jobs run on threads
(OpenCV and the kernels release the GIL), and a camera's job waits for its previous one. So the result is the same for
any number of workers, and memory does not grow with the length of the recording.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import NamedTuple

import cv2

from occlog.errors import InputError
from occlog.io.files.timing.utc import time_words
from occlog.measure.clusters.person_size import SizeMap
from occlog.measure.detections import Detections
from occlog.records.frames import Frame, Image
from occlog.records.losses import Loss
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Views

from ..config import BATCH, DetectConfig
from ..track_feedback import TrackFeedback
from .one_camera import CameraState, Target, check_targets, process
from .rows import to_tables

IN_FLIGHT = 2  # batches that wait or run while the oldest is finished


@dataclass(frozen=True)
class Learned:
    """Results of the learning pass over a recording, by camera name.

    `empty`: image of the empty scene, downscaled; `sizes`: size map of people, where the pose does not determine it.
    """

    empty: Mapping[str, Image] = field(default_factory=dict)  # images of the empty scene
    sizes: Mapping[str, SizeMap] = field(default_factory=dict)  # of people, where the pose does not determine


class _Part(NamedTuple):
    views: Views
    bearings: Bearings
    losses: tuple[Loss, ...]
    frames: int
    warmup: int


def detect(
    frames: Iterable[Frame],
    scene: Scene,
    config: DetectConfig | None = None,
    workers: int = 1,
    learned: Learned | None = None,
    targets: Sequence[Target] = (),
    *,
    near: TrackFeedback | None = None,
    batch: int = BATCH,
    states: dict[str, CameraState] | None = None,
) -> Iterator[Detections]:
    """Detect person-sized regions (`views`) and target bearings by background subtraction, sorted by time.

    A frame has one bearing row for each target, detected or not, and a view row for each region. Unusable frames are
    losses and have no row, nor have the first `warmup` frames of a camera without an image of the empty scene. A camera
    without pose gives views only.

    Args:
        frames: frames in the order of time; each camera's also in the order of its index.
        scene: scene with the cameras.
        config: settings; None: the defaults.
        workers: number of threads.
        learned: images of the empty scene and sizes of people; None: learned on the way.
        targets: people to search for; without any, the largest region is the one target, `LONE_TARGET_ID`.
        near: track feedback that limits the search for targets; None: whole image.
        batch: number of frames read ahead at a time, 1 or more; the rows do not depend on it.
        states: state of each camera by name, from earlier frames, updated in place; None: these are the first frames.

    Yields:
        One part for each batch of frames.

    Raises:
        InputError: a frame's camera is not in the scene, an image does not fit its calibration, times go back, or
            nothing states how large people are.
        UsageError: two targets have the same identity.
    """
    check_targets(targets)
    config = config or DetectConfig()
    learned = learned or Learned()
    states = {} if states is None else states
    last: dict[str, Future[_Part]] = {}
    waiting: deque[list[Future[_Part]]] = deque()
    with _one_thread_each(), ThreadPoolExecutor(workers) as pool:
        try:
            for some in batches(frames, batch):
                jobs = []
                for name, of_camera in _by_camera(some).items():
                    if name not in states:
                        empty, sizes = learned.empty.get(name), learned.sizes.get(name)
                        camera = scene.camera(name)
                        states[name] = CameraState(
                            camera, scene, config, empty=empty, sizes=sizes, targets=tuple(targets), near=near
                        )
                    last[name] = pool.submit(_job, states[name], of_camera, last.get(name))
                    jobs.append(last[name])
                waiting.append(jobs)
                if len(waiting) > IN_FLIGHT:
                    yield _merge([job.result() for job in waiting.popleft()])
            while waiting:
                yield _merge([job.result() for job in waiting.popleft()])
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def batches(frames: Iterable[Frame], size: int) -> Iterator[list[Frame]]:
    """Generate lists of at least `size` frames, the last shorter; frames of one time are never split.

    InputError if times go back.
    """
    batch: list[Frame] = []
    for frame in frames:
        if batch and frame.t_ns < batch[-1].t_ns:
            raise InputError(
                f"camera {frame.sensor}: frame {frame.index}: time {time_words(frame.t_ns)} is before "
                f"{time_words(batch[-1].t_ns)} "
                "of the frame read before it; frames must come in the order of time",
                id="unsorted-times",
            )
        if len(batch) >= size and frame.t_ns != batch[-1].t_ns:
            yield batch
            batch = []
        batch.append(frame)
    if batch:
        yield batch


def _by_camera(batch: list[Frame]) -> dict[str, list[Frame]]:
    out: dict[str, list[Frame]] = {}
    for frame in batch:
        out.setdefault(frame.sensor, []).append(frame)
    return out


def _job(state: CameraState, frames: list[Frame], before: Future[_Part] | None) -> _Part:
    """Process one camera's frames of a batch, after its part of the previous batch (`before`) has finished.

    `state` is updated in place. Jobs start in the order of submission, so that there is no deadlock.
    """
    if before is not None:
        before.result()
    segment = process(state, frames)
    views, bearings = to_tables(state, segment.found)
    return _Part(views, bearings, segment.losses, len(segment.found), segment.warmup)


def _merge(parts: list[_Part]) -> Detections:
    return Detections(
        Views.merge(p.views for p in parts),
        Bearings.merge(p.bearings for p in parts),
        tuple(loss for p in sorted(parts, key=lambda p: p.losses[0].source if p.losses else "") for loss in p.losses),
        sum(p.frames for p in parts),
        sum(p.warmup for p in parts),
    )


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Context manager: OpenCV without its own threads, since cameras are processed in parallel."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
