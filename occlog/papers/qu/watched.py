"""Where the trackers of some targets in one view are: on their own target, on another, or on none."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.core.metrics.mot.frame_pairs import Objects
from occlog.track.images.interface import MODES

from .follow import Followed


class Whereabouts(NamedTuple):
    """Where each tracker is in each frame; one that has ended is on none."""

    own: Bools  # (T, k) within reach of its own target
    other: Bools  # (T, k) not on its own, and within reach of another
    helped: float  # share of the rows in which another view helped; NaN without rows


def whereabouts(truth: Objects, followed: Followed, tau: Floats, view: int, targets: Sequence[int]) -> Whereabouts:
    """Find where the trackers of some targets are.

    Args:
        truth: boxes by view and frame.
        followed: output of a method.
        tau: (n,) largest distance of a tracker on a target, for each true row [px].
        view: number of the view.
        targets: k targets.
    """
    assert truth.view is not None
    frames = int(truth.frame.max()) + 1
    most = int(max(truth.label.max(), followed.target.max(), max(targets))) + 1
    place, reach = np.full((frames, most, 2), np.nan), np.full((frames, most), np.nan)
    rows = truth.view == view
    middle = truth.place[:, :2] + 0.5 * truth.place[:, 2:]
    place[truth.frame[rows], truth.label[rows]], reach[truth.frame[rows], truth.label[rows]] = middle[rows], tau[rows]
    tracked = np.full((frames, most, 2), np.nan)
    rows = (followed.view == view) & np.isin(followed.target, list(targets))
    tracked[followed.frame[rows], followed.target[rows]] = followed.ellipse[rows, :2]
    # Distances of the trackers from all targets; comparisons with NaN are false
    away = np.linalg.norm(tracked[:, list(targets), None] - place[:, None], axis=-1)
    near = away <= reach[:, None]
    own = near[:, np.arange(len(targets)), list(targets)]
    modes = followed.mode[rows & (followed.mode >= 0)]
    helped = float(np.mean(modes == MODES.index("bmct"))) if len(modes) else math.nan
    return Whereabouts(own, near.any(axis=2) & ~own, helped)


def watched_figures(where: Whereabouts) -> dict[str, float]:
    """Return the shares `helped`, `off` (rows off their target), and `end_own`, `end_other`, `end_none` at the end."""
    own, other = float(where.own[-1].mean()), float(where.other[-1].mean())
    return {
        "helped": where.helped,
        "off": 1.0 - float(where.own.mean()),
        "end_own": own,
        "end_other": other,
        "end_none": 1.0 - own - other,
    }
