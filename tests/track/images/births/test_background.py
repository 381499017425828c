"""Masks of what is not the empty scene."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.measure.epipolar.views import TrackedView
from occlog.measure.regions.background import make_subtractor
from occlog.records.frames import Frame
from occlog.track.methods.images.initiation.regions import (
    MAX_FOREGROUND_SHARE,
    BackgroundModel,
    background_models,
    foreground_mask,
    with_cameras,
)
from occlog.track.methods.images.run.frame_synchronisation import in_step

VIEWS = (TrackedView("a", 80, 60),)
RNG = np.random.default_rng(3)
WALL = RNG.integers(60, 120, (60, 80, 3)).astype(np.uint8)


def picture(k: int) -> np.ndarray:
    """A bright square that walks to the right, with some noise."""
    image = np.clip(WALL + RNG.normal(0.0, 1.0, WALL.shape), 0, 255).astype(np.uint8)
    image[20:40, 5 + 3 * k : 17 + 3 * k] = (250, 40, 40)
    return image


def test_what_moves_is_not_background_and_the_rest_is():
    pictures = [picture(k) for k in range(20)]
    frames = [Frame(40 * k, "a", k, lambda p=p: p) for k, p in enumerate(pictures)]
    models = background_models(frames, with_cameras(None, VIEWS), VIEWS)
    time_steps = list(in_step(frames, VIEWS, 0, background=models))
    for k, snapshot in enumerate(time_steps):
        found = snapshot.frames.masks[0] > 0
        true = np.zeros((60, 80), dtype=bool)
        true[20:40, 5 + 3 * k : 17 + 3 * k] = True
        assert np.mean(found[true]) > 0.85  # corners are rounded
        assert np.mean(found[~true]) < 0.05


def test_without_a_model_there_is_no_mask():
    frames = [Frame(0, "a", 0, lambda: WALL)]
    assert next(in_step(frames, VIEWS, 0)).frames.masks == ()
    assert next(in_step(frames, VIEWS, 0, background=(None,))).frames.masks == ()


@pytest.mark.parametrize("grey", [False, True])
def test_light_that_changes_masks_nothing(grey):
    wall = WALL[..., 0].copy() if grey else WALL
    model = BackgroundModel(make_subtractor("mog2", 500, None, True, wall), (60, 80))
    assert not foreground_mask(model, wall, 0).any()
    assert foreground_mask(model, 255 - wall, 1) is None
    # 36 of 60 rows are the most that may change
    for number, (rows, masked) in enumerate([(24, True), (36, True), (37, False)], 2):
        part = wall.copy()
        part[:rows] = 255
        assert (foreground_mask(model, part, number) is not None) is masked
    assert MAX_FOREGROUND_SHARE == 36 / 60


def test_a_model_of_shrunk_images_gives_masks_of_whole_ones():
    small = np.full((30, 40, 3), 90, np.uint8)
    model = BackgroundModel(make_subtractor("mog2", 500, None, True, small), (30, 40))
    image = np.full((61, 81, 3), 90, np.uint8)
    image[20:40, 30:50] = 250
    found = foreground_mask(model, image, 0)
    assert found.shape == (61, 81)
    assert found[30, 40] == 255
    assert found[5, 5] == 0
    assert foreground_mask(model, image[:20], 1) is None
