"""Selection between the person network and background subtraction for each camera, and detection with both.

In frames spread evenly over the recording, frames are counted in which the network finds a person, and those in which a
person-sized region differs from the empty scene. Background subtraction is used if the second number is at least
`MIN_MOVING` and the first less than `MIN_FOUND_RATIO` of it: people move, and the network does not recognise them
(thermal images, top views, drawings).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from occlog.array_types import Bytes
from occlog.measure.clusters.person_size import SizeMap, make_prior
from occlog.measure.clusters.stage import cell_side
from occlog.measure.detections import Detections
from occlog.measure.networks.detector import NetworkDetector
from occlog.measure.regions.background import DIFFERENCE, FOREGROUND, difference
from occlog.measure.regions.regions import cluster_regions, downscale_sizes
from occlog.records.frames import Frame, Image
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Views

from .by_background.learning import LearningFrames
from .by_background.one_camera import known_sizes
from .by_background.stage import Learned, batches
from .by_network import in_colour
from .config import (
    BATCH,
    CLEAN_PX,
    MAX_CLUSTER_RATIO,
    MAX_FOREGROUND,
    MIN_CLUSTER_RATIO,
    MIN_FOUND_RATIO,
    MIN_MOVING,
    MIN_PERSON,
    N_PROBED,
    PENALTY,
    STRENGTH,
    DetectConfig,
)


class DetectionProbe(NamedTuple):
    """Numbers of sampled frames of a camera, and of those in which people are found.

    Attributes:
        frames: number of frames.
        found: number of frames in which the network finds a person.
        moving: number of frames with a region of the size of a person that differs from the empty scene.
    """

    frames: int
    found: int
    moving: int

    @property
    def background(self) -> bool:
        """Whether background subtraction is to be used: people move in the images, and the network rarely finds any."""
        return self.moving >= MIN_MOVING and self.found < MIN_FOUND_RATIO * self.moving


def probe(
    samples: Mapping[str, LearningFrames],
    learned: Learned,
    scene: Scene,
    config: DetectConfig,
    detector: NetworkDetector,
) -> dict[str, DetectionProbe]:
    """Count, by camera, sampled frames with people by the network, and frames with person-sized moving regions.

    Cameras without sampled images are omitted; `N_PROBED` images of each are used at most.

    Args:
        samples: frames kept for learning, by camera.
        learned: empty scenes and sizes of people.
        scene: scene with the cameras.
        config: settings of the detection.
        detector: the person network.
    """
    found: dict[str, DetectionProbe] = {}
    for name, kept in samples.items():
        if not kept.images:
            continue
        numbers = np.unique(np.linspace(0, len(kept.images) - 1, N_PROBED).astype(int)).tolist()
        images = [kept.images[n] for n in numbers]
        boxed = (detector.find([detector.prepare(in_colour(image))])[0] for image in images)
        seen = sum(each is not None and len(each.boxes) > 0 for each in boxed)
        sizes = learned.sizes.get(name) or known_sizes(scene.camera(name), scene, kept.size, config)
        moving = 0 if sizes is None else moving_frames(images, learned.empty[name], downscale_sizes(sizes, kept.shrink))
        found[name] = DetectionProbe(len(images), seen, moving)
    return found


def moving_frames(images: Iterable[Image], empty: Image, sizes: SizeMap) -> int:
    """Number of images with a person-sized region that differs from the empty scene.

    Images with more than `MAX_FOREGROUND` of foreground do not count.

    Args:
        images: (height, width, 3) or (height, width).
        empty: image of the empty scene, of their shape.
        sizes: size map of people in these images.
    """
    prior, side = make_prior(sizes, STRENGTH, PENALTY, MIN_CLUSTER_RATIO), cell_side(sizes)
    count = 0
    for image in images:
        mask: Bytes = cv2.medianBlur((difference(image, empty) > DIFFERENCE).astype(np.uint8) * FOREGROUND, CLEAN_PX)
        if np.count_nonzero(mask) <= MAX_FOREGROUND * mask.size:
            fill = cluster_regions(image, mask, side, prior).fill
            count += bool(((fill >= MIN_PERSON) & (fill <= MAX_CLUSTER_RATIO)).any())
    return count


Detect = Callable[[Iterable[Frame]], Iterator[Detections]]


def detect_in_both(
    frames: Iterable[Frame], cameras: Iterable[str], by_network: Detect, by_background: Detect, embedding: int
) -> Iterator[Detections]:
    """Generate the detections of cameras with the network and of those with background subtraction, sorted by time.

    Args:
        frames: frames of all cameras in the order of time.
        cameras: names of those for the network.
        by_network: generates the detections in a batch of frames of these cameras.
        by_background: generates the detections in a batch of frames of the others.
        embedding: length of the network's embeddings; views of the others get NaN.
    """
    names = set(cameras)
    for some in batches(frames, BATCH):
        own, others = [f for f in some if f.sensor in names], [f for f in some if f.sensor not in names]
        parts = [*by_network(own), *(_widened(part, embedding) for part in by_background(others))]
        yield Detections(
            Views.merge(part.views for part in parts),
            Bearings.merge(part.bearings for part in parts),
            tuple(loss for part in parts for loss in part.losses),
            sum(part.frames for part in parts),
            sum(part.warmup for part in parts),
        )


def _widened(part: Detections, embedding: int) -> Detections:
    """Return the part with NaN embeddings of length `embedding` in its views."""
    vectors = np.full((len(part.views), embedding), np.nan, dtype=np.float32)
    return part._replace(views=replace(part.views, embedding=vectors))
