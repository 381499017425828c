"""States of trackers on painted discs, in two views whose image rows are each other's epipolar lines."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from occlog.measure.epipolar.views import TrackedView, ViewGeometry
from occlog.track.methods.images.interface import Birth, FrameSet
from occlog.track.methods.images.methods.config import MipfConfig
from occlog.track.methods.images.methods.state import VisualState, initial_state
from occlog.track.methods.images.methods.step import initiate_trackers

W, H = 120, 90
VIEWS = (TrackedView("a", W, H), TrackedView("b", W, H))
PERIOD_NS = 40_000_000
LEVEL = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Fundamental matrix of two views that see a target in the same row."""
UNKNOWN = np.full((3, 3), np.nan)
ROWS = ViewGeometry(np.array([[UNKNOWN, LEVEL], [LEVEL.T, UNKNOWN]]), (None, None))
BLIND = ViewGeometry(np.full((2, 2, 3, 3), np.nan), (None, None))
RED, BLUE = (30, 40, 220), (220, 60, 30)
GROUND = (90, 120, 60)


def disc(x: float, y: float, r: float = 8.0) -> np.ndarray:
    """Ellipse of a disc."""
    return np.array([x, y, r, r, 0.0])


def painted(*discs: tuple[np.ndarray, tuple[int, int, int]]) -> np.ndarray:
    """An image of discs on plain ground, later ones in front."""
    image = np.full((H, W, 3), GROUND, dtype=np.uint8)
    y, x = np.mgrid[:H, :W]
    for (cx, cy, r, _, _), colour in discs:
        image[np.hypot(x - cx, y - cy) <= r] = colour
    return image


def frames_at(period: float, *images: np.ndarray | None, number: int = 0, **more: Any) -> FrameSet:
    """Frames so many frame periods after the first ones."""
    numbers = np.array([-1 if image is None else number for image in images])
    return FrameSet(round(period * PERIOD_NS), numbers, images, **more)


def state_of(
    config: MipfConfig,
    births: Sequence[tuple[int, int, np.ndarray]],
    images: Sequence[np.ndarray],
    geometry: ViewGeometry = ROWS,
) -> VisualState:
    """State with trackers (view, target, ellipse) born at time 0, whose views have frames at a regular rate.

    Counterparts have been checked where the settings have a loop check.
    """
    state = initial_state(VIEWS, geometry, config)
    state = initiate_trackers(state, frames_at(0, *images), [Birth(*birth) for birth in births])
    clock = state.clock._replace(interval_ns=np.full_like(state.clock.interval_ns, PERIOD_NS))
    return state._replace(clock=clock)


def changed(state: VisualState, **fields: np.ndarray) -> VisualState:
    """The state with some fields of its trackers replaced."""
    return state._replace(trackers=state.trackers._replace(**fields))
