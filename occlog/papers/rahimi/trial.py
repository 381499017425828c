"""One trial: a problem of the example of [Rahimi], its estimate by method `map`, and figures of both."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.metrics.errors import normalised_squared_errors
from occlog.papers.verdicts import Experiment, Size
from occlog.pipeline.sweep.trial import Spec
from occlog.records.tables import Bearings, Diagnostics, Tracks
from occlog.settings import configure
from occlog.track.drivers.batch import track_batch
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.methods.map import method as batch_map
from occlog.track.methods.map.config import MapConfig
from occlog.track.methods.map.kernels.interior_point import Iterate

from .example import FOCAL_PX, READ_PX, SPEED, STEP_S, Example, example, identified, sparse_scene

PAPER: Mapping[str, object] = {
    "sigma_initial_velocity": SPEED,
    "wall_constraints": False,
    "loss": "square",
    "initialisation": "axes",
    "initial_depth": 1.0,
    "estimate": "mode",
    "covariance": "hessian",
}
"""Settings that make `map` the paper's method: cost, start, and positions before the cameras as the only constraint."""
ENDS = 0.1
"""Share of the times in each of the trajectory's two ends."""
KNOWN = 0.5
"""A distance counts as known if its standard deviation is at most this share of it."""
BINS = 10
"""Parts of a trajectory of equal length."""


class Solved(NamedTuple):
    """A problem, and its estimate by method `map` at T times.

    Attributes:
        problem: true path and bearings.
        tracks, diagnostics: output of the method, a row for each time.
        iterates: (T, 2) positions [m] at the start and after every iteration.
        iterations: number of iterations.
        converged: whether the search converged.
    """

    problem: Example
    tracks: Tracks
    diagnostics: Diagnostics
    iterates: tuple[Floats, ...]
    iterations: int
    converged: bool

    @property
    def xy(self) -> Floats:
        """Estimated positions (T, 2) [m]."""
        return np.column_stack([self.tracks.x, self.tracks.y])

    @property
    def true_xy(self) -> Floats:
        """True positions (T, 2) [m]."""
        return np.column_stack([self.problem.truth.x, self.problem.truth.y])


class SparseMeasurements(NamedTuple):
    """The n measurements of a problem.

    Attributes:
        state: (n,) index of the time, from 0.
        position: (n, 2) position of the camera [m].
        axis: (n, 2) unit vector along its optical axis.
        reading: (n,) lateral offset over depth, h/d: image coordinate, in units of the focal length.
    """

    state: Ints
    position: Floats
    axis: Floats
    reading: Floats


def sparse_spec(
    size: Size, run: int, *, false: float = 0.0, fit_step_s: float = STEP_S, known_range: bool = False, **track: Any
) -> Spec:
    """Specification of a trial for `sparse_trial`, with the paper's method and a motion identified on other paths.

    Args:
        size: number of steps, and the seed of all problems.
        run: number of the problem.
        false: share of the bearings that are false.
        fit_step_s: step at which the motion is identified [s].
        known_range: whether the method knows the ranges of the cameras.
        **track: settings of `map` that differ from the paper's (`PAPER`).
    """
    acceleration, jitter = identified(size.seed, fit_step_s)
    settings = {**PAPER, "process_noise_velocity": acceleration, "process_noise_position": jitter, **track}
    return {
        "sparse": "rahimi",
        "seed": size.seed,
        "run": run,
        "steps": size.steps,
        "false": false,
        "known_range": known_range,
        "track": settings,
    }


def solve_problem(spec: Spec) -> Solved:
    """Solve a problem by the code of `occlog track --method map`, and keep the iterates.

    `spec`: see `sparse_spec`.
    """
    problem = example(int(spec["seed"]), int(spec["run"]), int(spec["steps"]), float(spec["false"]))
    scene = sparse_scene(known_range=bool(spec["known_range"]))
    config = map_config(spec["track"], int(spec["steps"]))
    iterates: list[Floats] = []

    def watch(at: Iterate) -> None:
        iterates.append(at.X[:, ::2].copy())

    method = batch_map.METHOD._replace(advance=functools.partial(batch_map.advance, watch=watch))
    found = list(track_batch([problem.bearings], scene, method, TrackingTask(config, seed=0, method="map")))
    tracks, diagnostics = (Tracks.concat(p.tracks for p in found), Diagnostics.concat(p.diagnostics for p in found))
    solve = found[0].solves[0]
    return Solved(
        problem=problem,
        tracks=tracks,
        diagnostics=diagnostics,
        iterates=tuple(iterates),
        iterations=solve.iterations,
        converged=solve.converged,
    )


def map_config(settings: Mapping[str, object], states: int) -> MapConfig:
    """Settings of method `map` with a window of at least `states` states, so that a path is solved as a whole."""
    config: MapConfig = configure(MapConfig.in_unit("m"), settings)
    return replace(config, window_states=max(config.window_states, states))


def sightings(bearings: Bearings, t_ns: Ints) -> SparseMeasurements:
    """Measurements of a problem: the rows of `bearings` in which a camera saw the target.

    `t_ns`: (T,) times of the states [ns].
    """
    seen = bearings.take(bearings.seen)
    cameras = [sparse_scene(known_range=False).camera(name) for name in seen.sensor.tolist()]
    return SparseMeasurements(
        np.searchsorted(t_ns, seen.t_ns),
        np.array([c.ground for c in cameras]).reshape(-1, 2),
        np.array([[math.cos(c.yaw), math.sin(c.yaw)] for c in cameras]).reshape(-1, 2),
        -seen.u_px / FOCAL_PX,
    )


def sparse_trial(spec: Spec) -> dict[str, float]:
    """Solve one problem, and compare the solution with the truth.

    Args:
        spec: `seed`, `run`, `steps`, `false` (share of false bearings), `known_range` and `track` (settings of `map`).

    Returns:
        Figures of `errors`, `consistency` and `refinement`; `iterations`; `converged` (0 or 1); `measurements`; and
        `behind`, the measurements with a camera that has the estimate behind it or at its side.
    """
    solved = solve_problem(spec)
    at = sightings(solved.problem.bearings, solved.tracks.t_ns)
    depth = _depth(at, solved.xy)
    return {
        **errors(solved, at),
        **consistency(solved, at),
        **refinement(solved, at),
        "iterations": float(solved.iterations),
        "converged": float(solved.converged),
        "behind": float(np.count_nonzero(depth <= 0.0)),
        "measurements": float(len(depth)),
    }


sparse_experiment = functools.partial(Experiment, runs=50, steps=200, quick=(3, 80), trial=sparse_trial)
"""Experiment on random problems of the example, with its usual numbers of runs and steps."""


def errors(solved: Solved, at: SparseMeasurements) -> dict[str, float]:
    """RMSE of the trajectory, `rmse`, and of its parts [m]; NaN for a part without times.

    Parts: `seen`, `between` sightings, `beyond` (before the first or after the last); `ends` and `middle`; and
    `part_0`, ..., `BINS` parts of equal length.
    """
    square = np.sum((solved.xy - solved.true_xy) ** 2, axis=1)
    T = len(square)
    seen = np.isin(np.arange(T), at.state)
    inside = np.logical_or.accumulate(seen) & np.logical_or.accumulate(seen[::-1])[::-1]
    n = max(1, round(ENDS * T))
    ends = (np.arange(T) < n) | (np.arange(T) >= T - n)
    parts: dict[str, Bools] = {
        "rmse": np.ones(T, dtype=np.bool_),
        "seen": seen,
        "between": inside & ~seen,
        "beyond": ~inside,
        "ends": ends,
        "middle": ~ends,
    }
    parts |= {f"part_{k}": np.arange(T) * BINS // T == k for k in range(BINS)}
    return {name: root_mean(square[rows]) for name, rows in parts.items()}


def consistency(solved: Solved, at: SparseMeasurements) -> dict[str, float]:
    """Mean normalised squared error, 2 for a right covariance, and the share of times that the mean is over.

    `nees` (`unflagged`): over times that are not flagged. `nees_known` (`known`): over those of them at which the
    standard deviation along the line of sight of each camera that sees the target is at most `KNOWN` of the distance.
    """
    t = solved.tracks
    P = np.stack([t.cov_xx, t.cov_xy, t.cov_xy, t.cov_yy], axis=1).reshape(-1, 2, 2)
    nees = normalised_squared_errors(solved.xy - solved.true_xy, P)
    good = (solved.diagnostics.fallback == "") & np.isfinite(nees)
    ray = solved.xy[at.state] - at.position
    d2 = np.sum(ray**2, axis=1)
    along2 = np.einsum("ni,nij,nj->n", ray, P[at.state], ray) / np.maximum(d2, 1e-300)
    known = good.copy()
    known[at.state[along2 > KNOWN**2 * d2]] = False
    return {
        "nees": _mean(nees[good]),
        "unflagged": float(good.mean()),
        "nees_known": _mean(nees[known]),
        "known": float(known.mean()),
    }


def refinement(solved: Solved, at: SparseMeasurements) -> dict[str, float]:
    """Errors of the iterates: figures `ray_k`, `distance_k` and `place_k` after iteration k, and `start_off`.

    ray: root mean square of the residuals, in standard deviations. distance: that of the errors of the distances from
    the cameras, over seen states [m]. place: RMSE of all states [m]. start_off: largest deviation of a coordinate of
    the start from what the paper states [m].
    """
    true = np.sum((solved.true_xy[at.state] - at.position) * at.axis, axis=1)
    out = {}
    for k, xy in enumerate(solved.iterates):
        h, d = _across(at, xy), _depth(at, xy)
        out[f"ray_{k}"] = root_mean(((h / d - at.reading) * FOCAL_PX / READ_PX) ** 2)
        out[f"distance_{k}"] = root_mean((d - true) ** 2)
        out[f"place_{k}"] = root_mean(np.sum((xy - solved.true_xy) ** 2, axis=1))
    stated = np.zeros_like(solved.xy)
    stated[at.state] = at.position + at.axis
    out["start_off"] = float(np.abs(solved.iterates[0] - stated).max())
    return out


def _depth(at: SparseMeasurements, xy: Floats) -> Floats:
    """Distances (n,) of positions `xy` (T, 2) from the cameras along their optical axes, one per measurement [m]."""
    return np.asarray(np.sum((xy[at.state] - at.position) * at.axis, axis=1))


def _across(at: SparseMeasurements, xy: Floats) -> Floats:
    """Distances (n,) of positions `xy` (T, 2) to the left of the optical axes, one for each measurement [m]."""
    away = xy[at.state] - at.position
    return np.asarray(at.axis[:, 0] * away[:, 1] - at.axis[:, 1] * away[:, 0])


def _mean(values: Floats) -> float:
    """Mean of the values; NaN without values."""
    return float(values.mean()) if len(values) else math.nan


def root_mean(squares: Floats) -> float:
    """Root of the mean of squares; NaN without values."""
    return math.sqrt(_mean(squares)) if len(squares) else math.nan
