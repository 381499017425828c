"""What a detector's regions of a frame tell the trackers of it, beside where trackers begin and end.

Without them nothing here has an effect.  Colours count inside regions only, as [Qu] Sec. 4.2
uses background subtraction; and a tracker that has one region to itself, as that has the
tracker, is drawn to it and takes its size.  Where people merge into one region nothing
draws them: then it is the method that keeps them apart.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Bytes, Floats, Ints
from occlog.core.image.ellipse import nearness_between
from occlog.track.images.interface import Looks

OUTSIDE = 255
"""Bin of pixels that are of no target."""


class Held(NamedTuple):
    """The regions that n trackers have to themselves."""

    has: Bools  # (n,)
    region: Floats  # (n, 5) NaN: none


def mask_outside(bins: Bytes, boxes: Ints, looks: Looks, view: int) -> None:
    """Take the colours away from those pixels of a view's map that are in the boxes (n, 4), but of no target.

    They are background by the view's mask, or in no region's box.
    """
    regions = looks.regions[view] if looks.regions else None
    mask = looks.masks[view] if looks.masks else None
    if mask is not None:
        _clear(bins, boxes, mask > 0)
    if regions is None:
        return
    height, width = bins.shape
    inside = np.zeros((height, width), dtype=np.bool_)
    for x, y, a, b, _ in regions.tolist():
        rows = slice(max(int(np.ceil(y - b)), 0), max(int(np.floor(y + b)) + 1, 0))
        inside[rows, max(int(np.ceil(x - a)), 0) : max(int(np.floor(x + a)) + 1, 0)] = True
    _clear(bins, boxes, inside)


def masked(looks: Looks, view: int) -> bool:
    """Whether `mask_outside` may take colours away in a view."""
    regions = bool(looks.regions) and looks.regions[view] is not None
    return regions or (bool(looks.masks) and looks.masks[view] is not None)


def _clear(bins: Bytes, boxes: Ints, inside: Bools) -> None:
    """Set the bins in the boxes, outside of what is inside, to `OUTSIDE`."""
    for left, top, right, bottom in boxes.tolist():
        part = slice(max(top, 0), max(bottom, 0)), slice(max(left, 0), max(right, 0))
        bins[part][~inside[part]] = OUTSIDE


def held(looks: Looks, view: Ints, expected: Floats, reach: float) -> Held:
    """Regions and trackers that have only each other within reach.

    Args:
        looks: the frames.
        view: (n,) of the trackers.
        expected: (n, 5) ellipses where they should be now.
        reach: distance of the centres in sums of radii.
    """
    out = np.full((len(view), 5), np.nan)
    for v, regions in enumerate(looks.regions):
        mine = np.flatnonzero(view == v)
        if regions is None or not len(regions) or not len(mine):
            continue
        near = nearness_between(expected[mine], regions) <= reach
        only = near & (near.sum(axis=1) == 1)[:, None] & (near.sum(axis=0) == 1)[None, :]
        row, column = np.nonzero(only)
        out[mine[row]] = regions[column]
    return Held(np.isfinite(out[:, 0]), out)


def drawn(particles: Floats, found: Held, normals: Floats, share: float, spread: float) -> Floats:
    """Particles (n, N, 5) of which a share starts anew at the tracker's region; normals (n, N, 5) from N(0, 1)."""
    count = round(share * particles.shape[1])
    if not found.has.any():
        return particles
    out, rows = particles.copy(), found.has
    radius = np.sqrt(found.region[rows, 2] * found.region[rows, 3])[:, None, None]
    fresh = np.repeat(found.region[rows][:, None], count, axis=1)
    fresh[..., :2] += spread * radius * normals[rows, :count, :2]
    out[rows, :count] = fresh
    return out


def pull(particles: Floats, found: Held, spread: float) -> Floats:
    """(n, N) log-likelihood of particles by how far they are from the tracker's region; 0 without one."""
    if not found.has.any():
        return np.zeros(particles.shape[:2])
    region = found.region[:, None]
    away = (particles[..., :2] - region[..., :2]) / np.sqrt(region[..., 2] * region[..., 3])[..., None]
    return np.asarray(np.where(found.has[:, None], -0.5 * (away**2).sum(axis=-1) / spread**2, 0.0))
