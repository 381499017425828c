"""[Rahimi] Fig. 7: a walk of a minute past four cameras, in a building of this project.

Recording, floor plan and figure of Sec. 7 are lost.  What the text reports them is kept: cameras on the walls that
point at right angles to these, views that do not overlap, readings every 250 ms, a walk that begins and ends at the
same position, a loop before camera 1 with legs at two depths, legs towards camera 3 and away from it along one bearing,
and a wall between cameras 3 and 4.  Every run moves the turning points a little.
"""

from __future__ import annotations

import functools
import math
from itertools import pairwise

import numpy as np
from scipy.ndimage import gaussian_filter1d

from occlog.array_types import Floats
from occlog.core.plane import line_of_sight_blocked
from occlog.papers import verdicts as v
from occlog.papers.verdicts import Execute, Experiment, PaperRow, Size, StatementVerdict, Table, mean_of, share_of
from occlog.pipeline.sweep.trial import Spec
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Tracks
from occlog.simulate.config import ObserveConfig
from occlog.simulate.sensors.cameras import observe
from occlog.track.drivers.batch import track_batch
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.methods.map import method as batch_map
from occlog.track.methods.map.fit_motion.smoother import MeasuredPath

from .example import fitted_motion, scene_of, times, truth_of
from .trial import PAPER, map_config, root_mean

STEP_S, SPEED = 0.25, 0.7
SMOOTHING, MOVED = 3.0, 0.15
"""Standard deviations of the Gaussian that smooths a walk [steps], and of the turning points [m]."""
CAMERAS = ((3.0, 0.0, 90.0, 6.0), (8.0, 0.0, 90.0, 6.0), (12.5, 9.0, 270.0, 5.8), (16.0, 2.0, 180.0, 3.2))
"""x, y [m], yaw [deg] and range [m] of cameras 1 to 4."""
ROOM = ((0.0, 0.0), (16.0, 0.0), (16.0, 9.0), (0.0, 9.0))
WALL = ((13.6, 3.2), (13.8, 3.2), (13.8, 9.0), (13.6, 9.0))
"""Between cameras 3 and 4."""
HOME = (8.0, 2.5)
LOOP = ((4.5, 2.0), (1.5, 2.0), (0.8, 3.0), (1.5, 4.0), (4.5, 4.0))
LEGS = ((12.5, 2.5), (12.5, 7.5), (12.5, 2.5))
REST = ((15.0, 2.0), (12.0, 1.5))
APART = 2.0
"""Distance between the two legs of the loop [m]."""
TRAINING, FIT_EVERY = 20, 8
"""Walks at which the motion is identified, at every this many steps: about a turn."""
MOST, SOME = 0.9, 0.05
"""Shares of the walks that count as all, and as some."""
FREE, WALLED = "no walls", "walls"
FIGURES = ("loop", "legs", "order", "through")
WALK, NOISE, FIT = 0, 1, 2
"""Purpose of random numbers, the last part of their key."""


@functools.cache
def building(*, known: bool) -> Scene:
    """Scene of the building with its cameras; the same object at every call.

    `known`: with the wall and the cameras' ranges, which the paper's method does not know.
    """
    cameras = [(x, y, yaw, reach if known else None) for x, y, yaw, reach in CAMERAS]
    return scene_of("the building of [Rahimi] Sec. 7", ROOM, cameras, WALL if known else ())


def walk(rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Draw a walk: positions (T, 2) [m] `STEP_S` apart, and the index (T,) from 0 of the last turning point passed."""
    points = np.array([HOME, *LOOP, HOME, *LEGS, *REST, HOME])
    points[1:-1] += MOVED * rng.standard_normal((len(points) - 2, 2))
    legs = slice(len(LOOP) + 2, len(LOOP) + 2 + len(LEGS))
    points[legs, 0] = LEGS[0][0]  # along one bearing
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    way = np.arange(0.0, length[-1], SPEED * STEP_S)
    xy = np.column_stack([np.interp(way, length, points[:, k]) for k in range(2)])
    part = np.searchsorted(length, way, side="right") - 1
    return gaussian_filter1d(xy, SMOOTHING, axis=0, mode="nearest"), part.astype(np.float64)


def walk_trial(spec: Spec) -> dict[str, float]:
    """Simulate a walk and estimate it by the paper's method.

    Args:
        spec: `seed`, `run`, and `walls`: whether the method knows walls and ranges.

    Returns:
        `loop`, `legs`: RMSE of what camera 1 sees of the loop and camera 3 of its legs [m]; `order`: 1 if the back leg
        of the loop is estimated farther away than the other one, else 0; `through`: 1 if the path crosses the wall,
        else 0.
    """
    seed, run = int(spec["seed"]), int(spec["run"])
    xy, part = walk(_rng(seed, run, WALK))
    truth = truth_of(xy, STEP_S)
    bearings = Bearings.concat(
        observe(building(known=True), [truth], ObserveConfig(diameter=0.0), int(_rng(seed, run, NOISE).integers(2**31)))
    )
    estimate = _estimate(bearings, seed, walls=bool(spec["walls"]))
    found = np.searchsorted(truth.t_ns, estimate.t_ns)
    at = np.column_stack([estimate.x, estimate.y])
    away2, part = np.sum((at - xy[found]) ** 2, axis=1), part[found]
    by = [np.isin(estimate.t_ns, bearings.t_ns[bearings.seen & (bearings.sensor == f"cam{n}")]) for n in (1, 3)]
    first, back = (by[0] & (part == k) for k in (1, len(LOOP) - 1))
    legs = by[1] & (part >= len(LOOP) + 2) & (part < len(LOOP) + 1 + len(LEGS))
    wall = np.array(WALL)
    crossed = any(line_of_sight_blocked(a, b[None], wall)[0] for a, b in pairwise(at))
    return {
        "loop": root_mean(away2[first | back]),
        "legs": root_mean(away2[legs]),
        "order": float(at[back, 1].mean() > at[first, 1].mean()),
        "through": float(crossed),
    }


def _estimate(bearings: Bearings, seed: int, *, walls: bool) -> Tracks:
    """Tracks of the paper's method.

    Args:
        bearings: measurements of one walk.
        seed: seed of the walks at which the motion is identified.
        walls: whether the method knows walls and ranges.
    """
    acceleration, jitter = _identified(seed)
    motion = {"process_noise_velocity": acceleration, "process_noise_position": jitter}
    own = {**PAPER, **motion, "sigma_initial_velocity": SPEED, "wall_constraints": walls}
    tracking = TrackingTask(map_config(own, 1000), seed=0, method="map")
    return Tracks.concat(p.tracks for p in track_batch([bearings], building(known=walls), batch_map.METHOD, tracking))


@functools.lru_cache(maxsize=8)
def _identified(seed: int) -> tuple[float, float]:
    """Acceleration and jitter of constant-velocity motion, fitted to walks that belong to no run."""
    rng, paths = _rng(seed, 0, FIT), []
    for _ in range(TRAINING):
        xy, _ = walk(rng)
        paths.append(MeasuredPath(times(len(xy), STEP_S)[::FIT_EVERY], xy[::FIT_EVERY]))
    return fitted_motion(paths, FIT_EVERY * STEP_S)


def _rng(seed: int, run: int, purpose: int) -> np.random.Generator:
    """Generator for one purpose (`WALK`, `NOISE`, `FIT`) in the run `run`."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(run, 2004, 7, purpose)))


def fig7(size: Size, execute: Execute) -> Table:
    """Table of the figures of every walk, by a method that knows no walls, as the paper's, and by one that does."""
    ways = {FREE: False, WALLED: True}
    found = v.run_trials(
        ways, size, execute, lambda name, run: {"walk": "rahimi", "seed": size.seed, "run": run, "walls": ways[name]}
    )
    return [
        PaperRow(f"{name}, {key}", x, v.values_of(own, key))
        for name, own in found
        for x, key in enumerate(FIGURES, start=1)
    ]


def judge7(table: Table) -> list[StatementVerdict]:
    """Verdicts on [Rahimi] Fig. 7: which legs of the walk are recovered, and whether known walls help."""
    own = {row.series: row for row in table}
    loop, legs, order, through = (own[f"{FREE}, {key}"] for key in FIGURES)
    runs = order.runs
    deeper, crossed = (share_of(round(math.fsum(row.values)), runs) for row in (order, through))
    half, once = 0.5 * APART, APART
    return [
        v.judge(
            "fig7-depths",
            "Legs of the loop are found at different depths, the right way round: share of the walks.",
            deeper,
            v.at_least(MOST),
            v.at_least(0.5),
            rule=f"at least {MOST:.0%}; in part half",
        ),
        v.judge(
            "fig7-loop",
            f"The loop is recovered, its legs at {APART:g} m distance: RMSE [m].",
            mean_of(loop),
            v.at_most(half),
            v.at_most(once),
            rule=f"at most {half:g} m; in part {once:g} m",
        ),
        v.pairs(
            "fig7-legs",
            "Legs along one bearing are not recovered: error above that of the loop, by [m].",
            [(loop, legs)],
        ),
        v.judge(
            "fig7-through",
            "Paths go through the wall between cameras 3 and 4: share of the walks.",
            crossed,
            v.at_least(SOME),
            v.above(0.0),
            rule=f"at least {SOME:.0%}; in part any",
        ),
        v.pairs(
            "fig7-walls",
            "With the walls encoded (and the cameras' ranges) the legs are nearer to the truth, by [m].",
            [(own[f"{WALLED}, legs"], legs)],
        ),
    ]


FIG7 = Experiment(
    item="fig7",
    title="A walk past four cameras, stand-in for the building",
    x_label="RMSE [m] of 1 the loop, 2 the legs; share of the walks with 3 the right order, 4 a path through the wall",
    y_label="figure",
    runs=50,
    steps=240,
    quick=(3, 240),
    compute=fig7,
    judge=judge7,
    note="Recording and floor plan of Sec. 7 are lost: a building of this project. A walk takes about a minute, "
    "whatever --steps states.",
    trial=walk_trial,
)
