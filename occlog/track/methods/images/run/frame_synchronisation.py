"""Frames of several cameras in step: the images of all views at one time, decoded on a thread for each camera.

Frames make one time step when they are at most a window apart, one frame of each camera.  With
a window below half the shortest frame period a frame is always together with the nearest one
of another camera.  A camera has time steps without a frame when its rate is lower, when it starts
later or ends early, and when a frame cannot be decoded.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Ints
from occlog.errors import InputError, option
from occlog.io.files.timing.utc import time_words
from occlog.measure.detect.by_background.one_camera import check_size, plain_image
from occlog.measure.epipolar.views import TrackedView
from occlog.records.frames import Frame, Image
from occlog.records.scene import Camera
from occlog.track.methods.images.initiation.regions import BackgroundModel, foreground_mask
from occlog.track.methods.images.interface import FrameSet

STAMPS = 64
"""First frames of a camera from which its frame period is taken."""
READ_AHEAD_BYTES = 64 * 1024 * 1024
"""Images decoded ahead take at most about this."""
MAX_AHEAD = 8
"""Maximum number of time steps decoded at a time."""


class CameraSurvey(NamedTuple):
    """What the first frames of a camera show before tracking: image size, frame period, and frame numbers.

    These are the first number, the last that was read, and those wanted but missing.
    """

    view: TrackedView
    period_ns: int  # median of the first frames; 0: there is one frame only
    first: int  # number of the first frame
    last: int  # the last number that was read
    missing: tuple[int, ...]  # wanted numbers that were not found


class MaskedImage(NamedTuple):
    """Image of a frame with a mask of its foreground (None: unknown)."""

    image: Image
    mask: Image | None


class FrameSetImages(NamedTuple):
    """Images of all V views at one time step, with the own time of each frame, and the frames that cannot be used."""

    frames: FrameSet
    t_ns: Ints  # (V,) each frame's own time; -1: no frame
    lost: tuple[tuple[int, int, str], ...]  # (view, frame, why) of those that cannot be used


def survey(
    name: str,
    frames: Iterable[Frame],
    camera: Camera | None = None,
    wanted: Iterable[int] = (),
    bits: int | None = None,
) -> CameraSurvey:
    """Read the first frames of a camera for its image size, frame period and first number.

    Reading stops after `STAMPS` frames, once one could be decoded and all `wanted` numbers were found.

    Args:
        name: name of the camera.
        frames: frames of the camera in the order of time.
        camera: the scene's camera, to compare image sizes; None: it is not in the scene.
        wanted: numbers of frames that must be there.
        bits: significant bits of 16-bit images; None: such images are not usable.

    Raises:
        InputError: the camera has no frame that can be decoded, or its images do not fit the scene's.
    """
    view, missing = None, set(wanted)
    numbers: list[int] = []
    stamps: list[int] = []
    first, last, why = -1, -1, "it has no frame"
    for frame in frames:
        first, last = (frame.index if first < 0 else first), frame.index
        missing.discard(frame.index)
        if len(stamps) < STAMPS:
            stamps.append(frame.t_ns)
            numbers.append(frame.index)
        if view is None:
            try:
                image = plain_image(frame.decode(), bits)
                view = TrackedView(name, image.shape[1], image.shape[0])
            except InputError as error:
                why = str(error).rsplit(": ", 1)[-1]
        if view is not None and len(stamps) == STAMPS and not missing:
            break
    if view is None:
        raise InputError(
            f"camera {name}: not one frame can be decoded ({why}); leave this camera out ({option('without')})",
            id="damaged-file",
        )
    if camera is not None:
        check_size(camera, (view.width, view.height))
    # Frame numbers leave gaps where frames were lost: divide by them
    steps = np.diff(stamps) / np.maximum(np.diff(numbers), 1)
    period = int(np.median(steps)) if len(stamps) > 1 else 0
    return CameraSurvey(view, period, first, last, tuple(sorted(missing)))


def step_window(periods: Iterable[int]) -> int:
    """Return the largest time window [ns] below half the shortest frame period; 0 if no period is known."""
    shortest = min((p for p in periods if p > 0), default=0)
    return max((shortest - 1) // 2, 0)


def in_step(
    frames: Iterable[Frame],
    views: Sequence[TrackedView],
    window_ns: int,
    workers: int = 1,
    bits: int | None = None,
    background: Sequence[BackgroundModel | None] = (),
) -> Iterator[FrameSetImages]:
    """Generate the frames of all views time step by time step, decoded a little ahead on threads.

    The result does not depend on `workers`.

    Args:
        frames: frames of all cameras, in the order of time; those of cameras that are not among the views are omitted.
        views: V views; images of another size are lost frames.
        window_ns: frames at most this far apart [ns] make one time step, one for each camera.
        workers: threads that decode, each for one camera at a time.
        bits: significant bits of 16-bit images; None: such images are lost frames.
        background: background models of the views, for foreground masks; updated in place; empty: no masks.

    Raises:
        InputError: the time of a frame is before that of the one before.
    """
    index_of = {view.name: v for v, view in enumerate(views)}
    size = sum(3 * view.width * view.height for view in views)
    ahead = int(np.clip(READ_AHEAD_BYTES // max(size, 1), 1, MAX_AHEAD))
    last: dict[str, Future[list[MaskedImage | str]]] = {}
    waiting: deque[tuple[tuple[dict[str, Frame], ...], dict[str, Future[list[MaskedImage | str]]]]] = deque()
    with ThreadPoolExecutor(max(1, min(workers, len(views)))) as pool:
        try:
            groups = _groups(frames, index_of, window_ns)
            while batch := tuple(islice(groups, ahead)):
                jobs = {}
                for name, v in index_of.items():
                    mine = [group[name] for group in batch if name in group]
                    model = background[v] if background else None
                    if mine:
                        jobs[name] = last[name] = pool.submit(_decode, mine, views[v], bits, last.get(name), model)
                waiting.append((batch, jobs))
                if len(waiting) > 1:
                    yield from _frame_sets(*waiting.popleft(), index_of)
            while waiting:
                yield from _frame_sets(*waiting.popleft(), index_of)
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _groups(frames: Iterable[Frame], index_of: dict[str, int], window_ns: int) -> Iterator[dict[str, Frame]]:
    """Generate the frames of each time step as a dict by camera name, at most one frame of each camera.

    A time step ends at a frame more than `window_ns` after its first one, or of a camera that it already has.

    Args:
        frames: frames of all cameras, in the order of time.
        index_of: cameras of interest, by name; other frames are omitted.
        window_ns: longest time between the frames of a step [ns].

    Raises:
        InputError: times go back.
    """
    group: dict[str, Frame] = {}
    first = last = None
    for frame in frames:
        if last is not None and frame.t_ns < last:
            raise InputError(
                f"camera {frame.sensor}: frame {frame.index}: time {time_words(frame.t_ns)} is before "
                f"{time_words(last)} of the frame read before it; sort the frames by time",
                id="unsorted-times",
            )
        last = frame.t_ns
        if frame.sensor not in index_of:
            continue
        if group and (frame.sensor in group or frame.t_ns - (first or 0) > window_ns):
            yield group
            group = {}
        if not group:
            first = frame.t_ns
        group[frame.sensor] = frame
    if group:
        yield group


def _decode(
    frames: list[Frame],
    view: TrackedView,
    bits: int | None,
    before: Future[list[MaskedImage | str]] | None,
    model: BackgroundModel | None,
) -> list[MaskedImage | str]:
    """Decode frames of one camera in order, and update its background model with each.

    Args:
        frames: frames of the camera in the order of time.
        view: the view, with the expected image size.
        bits: significant bits of 16-bit images.
        before: the job of the camera's earlier frames, for which this one waits.
        model: background model, updated in place; None: no masks.

    Returns:
        For each frame the image with its mask, or a text: why it cannot be used.
    """
    if before is not None:
        before.exception()  # waits; the error itself is raised where the result is taken
    images = ((frame.index, _image(frame.decode, view, bits)) for frame in frames)
    return [
        image if isinstance(image, str) else MaskedImage(image, foreground_mask(model, image, number))
        for number, image in images
    ]


def _image(decode: Callable[[], Image], view: TrackedView, bits: int | None) -> Image | str:
    """Decode a frame to an 8-bit image, or return a text that says why it cannot be used.

    It cannot if decoding fails, if a 16-bit image comes without `bits` (its significant bits), or if the size is not
    that of `view`.
    """
    try:
        decoded = decode()
    except InputError as error:
        # The message begins with file, camera and frame; without them equal reasons are equal.
        return str(error).rsplit(": ", 1)[-1]
    try:
        image = plain_image(decoded, bits)
    except InputError as error:
        return str(error)
    height, width = image.shape[:2]
    if (width, height) != (view.width, view.height):
        return f"image is {width} x {height} px, the camera's first was {view.width} x {view.height} px"
    return image


def _frame_sets(
    groups: Sequence[dict[str, Frame]], jobs: dict[str, Future[list[MaskedImage | str]]], index_of: dict[str, int]
) -> Iterator[FrameSetImages]:
    """Generate the time steps of a batch of frames, waiting until their frames are decoded.

    Args:
        groups: frames of each time step by camera name.
        jobs: by camera name, the decoding of all the batch's frames of that camera, in the order of the time steps.
        index_of: number of each view by camera name.
    """
    decoded = {name: iter(job.result()) for name, job in jobs.items()}
    for group in groups:
        yield _frame_set(group, {name: next(decoded[name]) for name in index_of if name in group}, index_of)


def _frame_set(
    group: dict[str, Frame], decoded: dict[str, MaskedImage | str], index_of: dict[str, int]
) -> FrameSetImages:
    """Return a time step with its frames arranged by view number.

    Args:
        group: frames by camera.
        decoded: images by camera, or text: why one cannot be used.
        index_of: number of each view by camera name.
    """
    number, t_ns = np.full(len(index_of), -1), np.full(len(index_of), -1, dtype=np.int64)
    images: list[Image | None] = [None] * len(index_of)
    masks: list[Image | None] = [None] * len(index_of)
    lost = []
    for name, v in index_of.items():
        seen = decoded.get(name)
        if isinstance(seen, str):
            lost.append((v, group[name].index, seen))
        elif seen is not None:
            images[v], masks[v], number[v], t_ns[v] = seen.image, seen.mask, group[name].index, group[name].t_ns
    time = max(frame.t_ns for frame in group.values())
    frames = FrameSet(time, number.astype(np.int64), tuple(images))
    if any(m is not None for m in masks):
        frames = frames._replace(masks=tuple(masks))
    return FrameSetImages(frames, t_ns, tuple(lost))


def there(frame_set: FrameSetImages) -> Bools:
    """Return (V,) booleans: whether each view has a frame."""
    return np.array([image is not None for image in frame_set.frames.images])
