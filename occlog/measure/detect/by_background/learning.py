"""Learning pass over a recording: empty scene, size of people, and appearance of targets.

Some frames of each camera, spread evenly over the recording, are kept; others are not decoded. From them follow the
empty scene, the size of people if the camera's pose does not determine it, and the appearance of a person in a given
box.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError
from occlog.measure.clusters.person_size import SizeMap
from occlog.measure.regions.background import DIFFERENCE, difference, empty_scene, observed_sizes, person_like_blobs
from occlog.measure.regions.regions import downscale, histogram
from occlog.records.frames import Frame, Image
from occlog.records.scene import Camera, Scene

from ..config import DetectConfig
from .one_camera import Target, known_sizes, plain_image, shrink_of
from .stage import Learned

SAMPLE_BYTES = 512 * 1024 * 1024
"""TargetMemory for the samples of all cameras together."""
MAX_SAMPLES, MIN_SAMPLES = 48, 12
THICKNESS = 0.5  # of a person's width: gaps filled between the edges of a moving body
UNKNOWN_THICKNESS = 0.06  # of the image's height, where the size of people is not known yet
MIN_PIXELS = 30  # of foreground in a box, for an appearance


@dataclass(frozen=True)
class TargetBox:
    """A box around a target in one frame, drawn by the user.

    Attributes:
        target_id: identity of the target.
        sensor: name of the camera.
        frame: number of the frame.
        left_px, top_px, width_px, height_px: the box [px].
    """

    target_id: int
    sensor: str
    frame: int
    left_px: float
    top_px: float
    width_px: float
    height_px: float


@dataclass
class LearningFrames:
    """Downscaled frames of one camera kept for learning, at most `limit`, evenly spread over the recording.

    Every `stride`-th frame is kept; when there are too many, every second one is dropped and the stride doubles.
    `count` is the number of frames so far, `shape` that of the first image before it was downscaled by the factor
    `shrink`; `boxed` holds whole frames with a target's box by frame number.
    """

    limit: int = 2
    images: list[Image] = field(default_factory=list)  # shrunk
    stride: int = 1
    count: int = 0
    shape: tuple[int, ...] | None = None  # of the camera's first image, before it was shrunk
    shrink: int = 1
    boxed: dict[int, Image] = field(default_factory=dict)  # frames with a target's box

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the camera's images before downscaling [px]; (0, 0) before the first."""
        return (self.shape[1], self.shape[0]) if self.shape is not None else (0, 0)

    def wants(self, number: int) -> bool:
        """Whether the `number`-th frame of the camera (from 0) is to be kept."""
        return number % self.stride == 0

    def keep(self, number: int, image: Image) -> None:
        """Keep the downscaled image of the `number`-th frame of the camera, selected by `wants`.

        If `limit` images are kept already, every second one is dropped and the stride doubled before; the image is
        then kept only if its number still fits.
        """
        if len(self.images) == self.limit:
            self.images = self.images[::2]
            self.stride *= 2
        if self.wants(number):
            self.images.append(image)


class _LearntCamera(NamedTuple):
    empty: Image
    sizes: SizeMap | None


def learn(
    frames: Iterable[Frame],
    scene: Scene,
    config: DetectConfig,
    boxes: Sequence[TargetBox] = (),
    workers: int = 1,
) -> tuple[Learned, tuple[Target, ...]]:
    """Learn the empty scene and the sizes of people by camera, and the appearances of the targets in boxes.

    Frames that cannot be decoded, or are of another size than the camera's first, are skipped here; `detect` reports
    them.

    Args:
        frames: frames of all cameras, in the order of time.
        scene: scene with the cameras.
        config: settings of the detection.
        boxes: boxes around targets; each target's appearances are in the order of its boxes.
        workers: number of threads.

    Raises:
        InputError: a box's frame is missing, or there is no foreground in the box.
    """
    return learn_from(sample_frames(frames, scene, config, boxes), scene, config, boxes, workers)


def learn_from(
    samples: dict[str, LearningFrames],
    scene: Scene,
    config: DetectConfig,
    boxes: Sequence[TargetBox] = (),
    workers: int = 1,
) -> tuple[Learned, tuple[Target, ...]]:
    """Learn empty scenes, sizes of people and appearances of targets from sampled frames.

    Returns the empty scene of each camera, the sizes where the pose does not determine them, and the targets of
    `boxes`. InputError if a box's frame is missing or has no foreground in the box.

    Args:
        samples: frames by camera, of `sample_frames`.
        scene: scene with the cameras.
        config: settings of the detection.
        boxes: boxes around targets.
        workers: number of threads.
    """

    def study(name: str) -> _LearntCamera | None:
        return _study(samples[name], scene.camera(name), scene, config)

    with ThreadPoolExecutor(workers) as pool:
        found = {n: s for n, s in zip(samples, pool.map(study, samples), strict=True) if s is not None}
    learned = Learned(
        {name: seen.empty for name, seen in found.items()},
        {name: seen.sizes for name, seen in found.items() if seen.sizes is not None},
    )
    return learned, _targets(boxes, samples, learned)


def sample_frames(
    frames: Iterable[Frame], scene: Scene, config: DetectConfig, boxes: Sequence[TargetBox] = ()
) -> dict[str, LearningFrames]:
    """Collect frames of each camera for learning: spread evenly over the recording, and those with `boxes`.

    Returns them by camera. Frames that cannot be decoded, or differ in size from the camera's first, are skipped.
    """
    wanted = {(b.sensor, b.frame) for b in boxes}
    samples: dict[str, LearningFrames] = {}
    for frame in frames:
        kept = samples.setdefault(frame.sensor, LearningFrames())
        number, boxed = kept.count, (frame.sensor, frame.index) in wanted
        kept.count += 1
        if not (boxed or kept.wants(number)):
            continue
        try:
            image = plain_image(frame.decode(), config.bit_depth)
        except InputError:
            continue
        if boxed:
            kept.boxed[frame.index] = image
        if kept.shape is None:
            _begin(kept, image, frame.sensor, scene, config)
        if kept.wants(number) and image.shape == kept.shape:
            kept.keep(number, downscale(image, kept.shrink))
    return samples


def _begin(samples: LearningFrames, image: Image, name: str, scene: Scene, config: DetectConfig) -> None:
    """Set shape, downscaling factor and maximum number of samples by the first image of a camera, in place.

    Args:
        samples: frames of the camera that are kept for learning, updated.
        image: first image of the camera.
        name: name of the camera.
        scene: scene with all cameras.
        config: settings of the detection.
    """
    samples.shape = image.shape
    samples.shrink = shrink_of(scene.camera(name), scene, samples.size, config)
    samples.limit = sample_limit(downscale(image, samples.shrink).nbytes, len(scene.cameras))


def sample_limit(image_bytes: int, n_cameras: int) -> int:
    """Maximum number of samples per camera in memory, even, from `MIN_SAMPLES` to `MAX_SAMPLES`.

    `image_bytes` is the size of a downscaled image. All cameras share `SAMPLE_BYTES`.
    """
    fits = SAMPLE_BYTES // max(1, image_bytes * n_cameras)
    return int(np.clip(fits, MIN_SAMPLES, MAX_SAMPLES)) // 2 * 2


def _study(samples: LearningFrames, camera: Camera, scene: Scene, config: DetectConfig) -> _LearntCamera | None:
    """Learn the empty scene of a camera, and the sizes of people in its images where no pose gives them.

    Args:
        samples: downscaled images of the camera.
        camera: camera, perhaps with a pose.
        scene: gives length unit and room.
        config: settings of the detection; may state the height of people.

    Returns:
        None without images.
    """
    if not samples.images:
        return None
    sizes = known_sizes(camera, scene, samples.size, config)
    height = samples.images[0].shape[0]
    thickness = THICKNESS * sizes.width_px / samples.shrink if sizes is not None else UNKNOWN_THICKNESS * height
    empty = empty_scene(samples.images, thickness)
    if sizes is not None:
        return _LearntCamera(empty, None)
    blobs = samples.shrink * person_like_blobs(samples.images, empty)
    return _LearntCamera(empty, observed_sizes(samples.size, blobs))


def _targets(boxes: Sequence[TargetBox], samples: dict[str, LearningFrames], learned: Learned) -> tuple[Target, ...]:
    ids = list(dict.fromkeys(b.target_id for b in boxes))
    found: dict[int, list[Floats]] = {target_id: [] for target_id in ids}
    for box in boxes:
        image = samples[box.sensor].boxed.get(box.frame) if box.sensor in samples else None
        if image is None:
            raise InputError(
                f"target {box.target_id}: the recording has no readable frame {box.frame} of camera {box.sensor!r}; "
                f"it has {', '.join(f'{n} (0 to {s.count - 1})' for n, s in samples.items()) or 'no frames'}",
                id="disjoint-inputs",
            )
        found[box.target_id].append(appearance_in_box(image, learned.empty.get(box.sensor), box))
    return tuple(Target(i, np.stack(found[i])) for i in ids)


def appearance_in_box(image: Image, empty: Image | None, box: TargetBox) -> Floats:
    """(72,) normalised colour histogram of the foreground inside a target's box.

    Args:
        image: (height, width, 3) BGR or (height, width) grey.
        empty: image of the empty scene, perhaps downscaled; None, or of another shape: all of the box counts.
        box: box in pixels of the image.

    Raises:
        InputError: the box is outside the image, or fewer than `MIN_PIXELS` pixels in it differ from the empty scene.
    """
    factor = 1 if empty is None else max(1, image.shape[0] // empty.shape[0])
    image = downscale(image, factor)
    x0, y0 = (max(int(v / factor), 0) for v in (box.left_px, box.top_px))
    x1 = max(int(np.ceil((box.left_px + box.width_px) / factor)), 0)
    y1 = max(int(np.ceil((box.top_px + box.height_px) / factor)), 0)
    part = image[y0:y1, x0:x1]
    where = f"target {box.target_id}: box in frame {box.frame} of camera {box.sensor}"
    if 0 in part.shape:
        raise InputError(f"{where}: is outside the image")
    if empty is None or empty.shape != image.shape:
        return histogram(part)
    mask = (difference(part, empty[y0:y1, x0:x1]) > DIFFERENCE).astype(np.uint8)
    if np.count_nonzero(mask) < MIN_PIXELS:
        raise InputError(
            f"{where}: only {np.count_nonzero(mask)} pixels differ from the empty scene, minimum {MIN_PIXELS}; "
            "draw the box around the target, in a frame in which it moves",
            id="insufficient-data",
        )
    return histogram(part, mask)
