"""What of an image is not the empty scene, for colours of the background to be none of a target, [Qu] Sec. 4.2."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import cv2
import numpy as np

from occlog.measure.detect.config import DetectConfig
from occlog.measure.detect.learning import learn
from occlog.measure.epipolar.views import View
from occlog.measure.regions.background import Subtractor, foreground, make_subtractor
from occlog.measure.regions.shrink import shrink
from occlog.records.frames import Frame, Image
from occlog.records.scene import Scene

HISTORY = 5_000
"""Frames that the model remembers: who stands still for a tenth of it becomes background."""
MOST = 0.6
"""Share of the image above which it is the light that changed, or the camera that moved, and nothing is masked."""


class BackgroundModel(NamedTuple):
    """Background model of one camera; `mask` advances it."""

    subtractor: Subtractor
    shape: tuple[int, int]  # of the empty scene's image


def background_models(
    frames: Iterable[Frame], scene: Scene, views: Sequence[View], workers: int = 1
) -> tuple[BackgroundModel | None, ...]:
    """A model for each view, from what its images show when nobody is there; None for one without images.

    Args:
        frames: of all views, in the order of time.
        scene: with all views as cameras.
        views: V views.
        workers: threads.
    """
    config = DetectConfig()
    learned, _ = learn(frames, scene, config, (), workers)
    out: list[BackgroundModel | None] = []
    for view in views:
        empty = learned.empty.get(view.name)
        if empty is None:
            out.append(None)
            continue
        model = make_subtractor("mog2", HISTORY, None, True, empty)
        out.append(BackgroundModel(model, (empty.shape[0], empty.shape[1])))
    return tuple(out)


def foreground_mask(watch: BackgroundModel | None, image: Image, number: int) -> Image | None:
    """(H, W) 255 on what is not background, 0 elsewhere; None where that cannot be told.

    Args:
        watch: of the camera, whose frames must come in order.
        image: (H, W, 3) BGR or (H, W) grey.
        number: of the frame.
    """
    if watch is None:
        return None
    small = shrink(image, max(1, image.shape[0] // watch.shape[0]))
    if small.shape[:2] != watch.shape:
        return None
    found = foreground(watch.subtractor, small, number, 5)
    if np.count_nonzero(found) > MOST * found.size:
        return None
    if small.shape[:2] == image.shape[:2]:
        return found
    height, width = image.shape[:2]
    return cv2.resize(found, (width, height), interpolation=cv2.INTER_NEAREST)  # type: ignore[no-any-return]
