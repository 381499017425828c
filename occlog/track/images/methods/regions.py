"""Influence of a detector's regions on the trackers of a frame, besides births and ends.

Without regions nothing here has an effect.  Colours count inside regions only, as [Qu]
Sec. 4.2 uses background subtraction.  Where a tracker and a region have only each other
within reach, the tracker is drawn to the region and takes its size.  Where people merge into
one region nothing draws their trackers: the method has to keep them apart.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Bytes, Floats, Ints
from occlog.core.image.ellipse import nearness_between
from occlog.track.images.interface import FrameSet

OUTSIDE = 255
"""Bin of pixels that belong to no target."""


class OwnRegions(NamedTuple):
    """The regions that belong to one of n trackers each."""

    has: Bools  # (n,) whether the tracker has one
    region: Floats  # (n, 5) NaN: none


def mask_outside(bins: Bytes, boxes: Ints, frames: FrameSet, view: int) -> None:
    """Set the pixels of a view's map that belong to no target to `OUTSIDE`.

    These are the pixels that the view's mask calls background, and those in no region's box.

    Args:
        bins: (H, W) changed in place, inside the boxes only.
        boxes: (n, 4) left, top, right, bottom, half-open.
        frames: with the masks and regions.
        view: whose map it is.
    """
    regions = frames.regions[view] if frames.regions else None
    mask = frames.masks[view] if frames.masks else None
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


def is_masked(frames: FrameSet, view: int) -> bool:
    """Whether `mask_outside` may change a view's map."""
    regions = bool(frames.regions) and frames.regions[view] is not None
    return regions or (bool(frames.masks) and frames.masks[view] is not None)


def _clear(bins: Bytes, boxes: Ints, inside: Bools) -> None:
    """Set the bins that are in the boxes and not `inside` (H, W) to `OUTSIDE`."""
    for left, top, right, bottom in boxes.tolist():
        part = slice(max(top, 0), max(bottom, 0)), slice(max(left, 0), max(right, 0))
        bins[part][~inside[part]] = OUTSIDE


def own_regions(frames: FrameSet, view: Ints, expected: Floats, reach: float) -> OwnRegions:
    """Find the regions and trackers that have only each other within reach.

    Args:
        frames: with the regions.
        view: (n,) of the trackers.
        expected: (n, 5) ellipses where they should be now.
        reach: largest distance of the centres in sums of radii.
    """
    out = np.full((len(view), 5), np.nan)
    for v, regions in enumerate(frames.regions):
        mine = np.flatnonzero(view == v)
        if regions is None or not len(regions) or not len(mine):
            continue
        near = nearness_between(expected[mine], regions) <= reach
        only = near & (near.sum(axis=1) == 1)[:, None] & (near.sum(axis=0) == 1)[None, :]
        row, column = np.nonzero(only)
        out[mine[row]] = regions[column]
    return OwnRegions(np.isfinite(out[:, 0]), out)


def drawn_at_regions(particles: Floats, own: OwnRegions, normals: Floats, share: float, spread: float) -> Floats:
    """Draw a share of each tracker's particles anew at its own region.

    Args:
        particles: (n, N, 5).
        own: regions of the trackers; one without keeps its particles.
        normals: (n, N, 5) from N(0, 1).
        share: of the particles, 0 to 1.
        spread: standard deviation of their centres over the region's radius.
    """
    count = round(share * particles.shape[1])
    if not own.has.any():
        return particles
    out, rows = particles.copy(), own.has
    radius = np.sqrt(own.region[rows, 2] * own.region[rows, 3])[:, None, None]
    fresh = np.repeat(own.region[rows][:, None], count, axis=1)
    fresh[..., :2] += spread * radius * normals[rows, :count, :2]
    out[rows, :count] = fresh
    return out


def log_region_likelihood(ellipses: Floats, own: OwnRegions, owner: Ints, spread: float) -> Floats:
    """(P,) log likelihood, without its constant, of the distance of ellipses from their tracker's own region.

    Args:
        ellipses: (P, 5).
        own: regions of n trackers; 0 without one.
        owner: (P,) row of each one's tracker.
        spread: standard deviation of the distance over the region's radius.
    """
    if not own.has.any():
        return np.zeros(len(ellipses))
    region = own.region[owner]
    away = (ellipses[:, :2] - region[:, :2]) / np.sqrt(region[:, 2] * region[:, 3])[:, None]
    return np.asarray(np.where(own.has[owner], -0.5 * (away**2).sum(axis=-1) / spread**2, 0.0))
