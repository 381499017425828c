"""Parts of method `cmct`: particles on epipolar lines, and colours that adapt.

The method is a simple form of Nummiaro's colour-based multicamera tracker, as [Qu] Sec. 4.2 compares
with it: an estimate in every view, the first colours of the target in that view as its model,
and no interaction between targets.
"""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from occlog.array_types import Bools, Floats
from occlog.track.images.kernels.ellipse_colour import colours_in
from occlog.track.images.kernels.epipolar_lines import drawn_on_lines

from .config import CmctConfig
from .loop_check import APART, affine_maps, nearest
from .state import LEAST, Trackers, VisualState


def propose_on_lines(state: VisualState, c: CmctConfig, particles: Floats, gap: Floats, rng: Generator) -> Floats:
    """Move a share of the particles, or all after a loss, to the epipolar lines of the last estimates in other views.

    A target counts as lost when the likeness of its estimate is below `search_below`, or when
    its estimate is nearer than `APART` to another tracker while a counterpart is bad: of two
    targets that look alike the tracker then has the wrong one.  Only counterparts that had a
    frame in the last frame period give a line.

    Args:
        state: before the frame.
        c: settings.
        particles: (n, N, 5) after the motion.
        gap: (n,) frames since the last one.
        rng: draws (n, N, 2) standard normal numbers.

    Returns:
        (n, N, 5); a tracker without a line keeps its particles.
    """
    t = state.trackers
    expected = t.estimate.copy()
    expected[:, :2] += gap[:, None] * t.velocity
    many = particles.shape[1]
    bad = ((t.counterpart >= 0) & t.checked & ~t.good).any(axis=1)
    lost = (t.likeness < c.search_below) | (bad & (nearest(t) < APART))
    return drawn_on_lines(
        particles,
        estimate=expected,
        affine=affine_maps(state, expected),
        view=t.view,
        counterpart=np.where((t.counterpart >= 0) & (gap <= 1.0)[t.counterpart], t.counterpart, -1),
        fundamental=state.geometry.fundamental,
        bottom=c.bottom,
        count=np.where(lost, many, round(c.on_line * many)),
        along=c.along_px,
        across=c.across,
        normals=rng.standard_normal((*particles.shape[:2], 2)),
    )


def adapt_colours(state: VisualState, c: CmctConfig, here: Bools) -> Trackers:
    """Move the colours of trackers towards those in their estimates: new = (1 - adapt) old + adapt found.

    Estimates count where they are alike enough (`adapt_above`).

    Args:
        state: after the frame.
        c: settings.
        here: (n,) trackers whose view has a frame; the others keep their colours.
    """
    t = state.trackers
    colours = t.colours.copy()
    for v, bins in enumerate(state.bins):
        rows = np.flatnonzero((t.view == v) & here & (t.likeness >= c.adapt_above))
        found = colours_in(bins, t.estimate[rows], t.split[rows], c.pixel_step)
        # Where the edge of the image or a mask hides a part, the colours of the rest stand for all.
        found *= colours[rows].sum(axis=1, keepdims=True) / np.maximum(found.sum(axis=1, keepdims=True), LEAST)
        colours[rows] = (1.0 - c.adapt) * colours[rows] + c.adapt * found
    return t._replace(colours=colours)
