"""Method `cmct`: particles are drawn on the epipolar lines, and the target's colours are learnt anew.

A simple form of Nummiaro's tracker as [Qu] Sec. 4.2 has it: an estimate in every view, the
first colours of the target in that view, no interaction between targets.
"""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from occlog.array_types import Bools, Floats
from occlog.track.images.interface import MODES
from occlog.track.images.kernels.on_lines import drawn_on_lines

from .colours import colours_in
from .loop_check import affine_maps
from .restart import APART, nearest
from .state import LEAST, State, Trackers
from .step import Moment, Weighed
from .weigh import alone

CMCT = MODES.index("cmct")


def on_lines(state: State, particles: Floats, gap: Floats, rng: Generator) -> Floats:
    """Particles (n, N, 5) of which a share, or all after a loss, lie on the lines of the last estimates.

    A loss is an estimate that does not look like the target, or one on the place of another
    tracker while a counterpart is bad: of two targets that look alike it has the wrong one.
    """
    t, c = state.trackers, state.config
    expected = t.estimate.copy()
    expected[:, :2] += gap[:, None] * t.velocity
    maps = affine_maps(state, expected)
    many = particles.shape[1]
    bad = ((t.twin >= 0) & t.checked & ~t.good).any(axis=1)
    lost = (t.likeness < c.search_below) | (bad & (nearest(t) < APART))
    count = np.where(lost, many, round(c.on_line * many))
    twin = np.where((t.twin >= 0) & (gap <= 1.0)[t.twin], t.twin, -1)
    normals = rng.standard_normal((*particles.shape[:2], 2))
    return drawn_on_lines(
        particles,
        expected,
        maps,
        t.view,
        twin,
        state.geometry.fundamental,
        c.anchor == "bottom",
        count,
        c.along_px,
        c.across,
        normals,
    )


def by_colours(state: State, moment: Moment, rng: Generator) -> Weighed:
    """Weights of the colours only."""
    weighed = alone(state, moment, rng)
    return weighed._replace(mode=np.full(len(moment.here), CMCT))


def adapted(state: State, weighed: Weighed, likeness: Floats, here: Bools) -> Trackers:
    """Trackers whose colours follow those in estimates that are alike enough."""
    t, c = state.trackers, state.config
    colours = t.colours.copy()
    for v, bins in enumerate(state.bins):
        rows = np.flatnonzero((t.view == v) & here & (likeness >= c.adapt_above))
        new = colours_in(bins, weighed.estimate[rows], t.split[rows], c.pixel_step)
        # Where a part is hidden by the edge of the image or a mask, the colours are those of the rest.
        new *= colours[rows].sum(axis=1, keepdims=True) / np.maximum(new.sum(axis=1, keepdims=True), LEAST)
        colours[rows] = (1.0 - c.adapt) * colours[rows] + c.adapt * new
    return t._replace(colours=colours)
