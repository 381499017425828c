"""Background subtraction, [Qu] Sec. 4.2: masks of what is not the empty scene, in which colours of targets count."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import cv2
import numpy as np

from occlog.measure.detect.by_background.learning import learn
from occlog.measure.detect.config import DetectConfig
from occlog.measure.epipolar.views import View
from occlog.measure.regions.background import Subtractor, foreground, make_subtractor
from occlog.measure.regions.shrink import shrink
from occlog.records.frames import Frame, Image
from occlog.records.scene import Scene

HISTORY = 5_000
"""Memory of the model [frames]; a person who stands still for a tenth of it becomes background."""
MOST = 0.6
"""Share of foreground in an image above which the light has changed or the camera has moved: nothing is masked."""


class BackgroundModel(NamedTuple):
    """Background model of one camera; `foreground_mask` advances it."""

    subtractor: Subtractor
    shape: tuple[int, int]  # of the empty scene's image


def background_models(
    frames: Iterable[Frame], scene: Scene, views: Sequence[View], workers: int = 1
) -> tuple[BackgroundModel | None, ...]:
    """Learn the empty scene of each view and make a background model of it; None for a view without images.

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


def foreground_mask(model: BackgroundModel | None, image: Image, number: int) -> Image | None:
    """(H, W) 255 on what is not background, 0 elsewhere; None without a model, or where it does not fit the image.

    Args:
        model: of the camera, whose frames must come in order; None: no model.
        image: (H, W, 3) BGR or (H, W) grey.
        number: of the frame.
    """
    if model is None:
        return None
    small = shrink(image, max(1, image.shape[0] // model.shape[0]))
    if small.shape[:2] != model.shape:
        return None
    found = foreground(model.subtractor, small, number, 5)
    if np.count_nonzero(found) > MOST * found.size:
        return None
    if small.shape[:2] == image.shape[:2]:
        return found
    height, width = image.shape[:2]
    return cv2.resize(found, (width, height), interpolation=cv2.INTER_NEAREST)  # type: ignore[no-any-return]
