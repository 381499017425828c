"""Scripted targets to their true positions: sections of constant velocity, turns and accelerations.

A section is traversed exactly, whatever the steps: a turn keeps its speed in the plane and
turns at the rate lateral / speed ([Lee] Eqs. 2.13-2.14), an acceleration is a known input.
Noise is that of white acceleration, collected from step to step.

True paths as positions on a grid of times.
"""

from __future__ import annotations

import itertools
import math
from bisect import bisect_right
from collections.abc import Iterator

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.numerics.interpolate import TimeGrid, to_grid
from occlog.core.numerics.seeds import RandomStream, generator
from occlog.core.plane import inside_polygon
from occlog.errors import InputError
from occlog.filtering.motion.coordinated_turn import acceleration_root, turn_matrix
from occlog.records.scene import PLANES, MotionScript, Scene, ScriptedTarget, Segment, to_ns
from occlog.records.tables import Truth

CHUNK_STEPS = 256


def step_times(first: int, count: int, step_s: float) -> Ints:
    """(count,) times [ns] after step 0 of the steps from number `first` on; a step takes `step_s` [s]."""
    times: Ints = np.rint(np.arange(first, first + count) * (step_s * 1e9)).astype(np.int64)
    return times


def simulate_paths(
    script: MotionScript, steps: int, step_s: float, z: float, start_ns: int, seed: int
) -> Iterator[TimeGrid]:
    """Generate the true positions of all scripted objects, chunk by chunk; NaN where one is absent.

    Args:
        script: scripted objects.
        steps: number of steps.
        step_s: duration of a step [s].
        z: height of objects that state none; NaN: unknown.
        start_ns: time of the first step [ns].
        seed: seed of the noise; each object has its own random numbers.

    Returns:
        Generator of grids of up to CHUNK_STEPS times with all objects; `grid_truth` converts them to tables of truth.
    """
    ids = np.array([t.id for t in script.targets], dtype=np.int64)
    target = np.array([t.role == "target" for t in script.targets])
    paths = [_follow(t, steps, step_s, z, generator(seed, RandomStream.PATH_NOISE, t.id)) for t in script.targets]
    for first in range(0, steps, CHUNK_STEPS):
        count = min(CHUNK_STEPS, steps - first)
        positions = np.stack([np.array(list(itertools.islice(p, count))) for p in paths], axis=1)
        yield TimeGrid(start_ns + step_times(first, count, step_s), ids, target, positions)


def grid_truth(grid: TimeGrid) -> Truth:
    """Convert positions on a grid of times to a table of truth; absent objects have no row."""
    step, column = np.nonzero(~np.isnan(grid.xyz[..., 0]))
    positions = grid.xyz[step, column]
    return Truth.of(
        t_ns=grid.t_ns[step],
        target_id=grid.ids[column].astype(np.int32),
        role=np.where(grid.target[column], "target", "occluder"),
        x=positions[:, 0],
        y=positions[:, 1],
        z=positions[:, 2],
    )


def silences(script: MotionScript, start_ns: int) -> dict[int, Ints]:
    """Silent intervals by number of each object that has some: (k, 2) times from and to [ns]."""
    return {
        t.id: start_ns + np.array([[to_ns(a), to_ns(b)] for a, b in t.silent], dtype=np.int64)
        for t in script.targets
        if t.silent
    }


def check_inside(scene: Scene, grid: TimeGrid, start_ns: int) -> None:
    """Check that people on scripted paths can be rendered; InputError for one outside the room or in a static occluder.

    Args:
        scene: room and static occluders.
        grid: positions at some times.
        start_ns: start of the simulation [ns], for the message.
    """
    for column, number in enumerate(grid.ids.tolist()):
        there = np.flatnonzero(~np.isnan(grid.xyz[:, column, 0]))
        positions = np.ascontiguousarray(grid.xyz[there, column, :2])
        wrong = [(~inside_polygon(positions, scene.surroundings), "outside the room")]
        wrong += [(inside_polygon(positions, o.polygon), f"inside {o.name}") for o in scene.occluders]
        for bad, what in wrong:
            if bad.any():
                k = int(np.flatnonzero(bad)[0])
                at_s, (x, y) = (int(grid.t_ns[there[k]]) - start_ns) * 1e-9, positions[k]
                raise InputError(
                    f"target {number} is {what} at {at_s:g} s, at ({x:.4g}, {y:.4g}); "
                    "paths in video must stay on the free floor"
                )


def moved(state: Floats, segment: Segment, dt: float) -> Floats:
    """Position and velocity (6,) `dt` seconds after `state` (6,) in one path segment, without noise."""
    out = state.copy()
    out[:3] += dt * state[3:]
    if any(segment.acceleration):
        acceleration = np.array(segment.acceleration)
        out[:3] += 0.5 * dt * dt * acceleration
        out[3:] += dt * acceleration
    if segment.lateral != 0.0:
        i, j = PLANES[segment.plane]
        speed = math.hypot(state[3 + i], state[3 + j])
        if speed > 0.0:  # at rest there is nothing to turn
            axes = [i, 3 + i, j, 3 + j]
            out[axes] = turn_matrix(segment.lateral / speed, dt) @ state[axes]
    return out


def _follow(target: ScriptedTarget, steps: int, step_s: float, z: float, rng: np.random.Generator) -> Iterator[Floats]:
    """Generate the position (3,) of one scripted target at each step; NaN while it is absent.

    Args:
        target: script of the target.
        steps: number of steps.
        step_s: duration of a step [s].
        z: height of a target that states none.
        rng: generator of the process noise.
    """
    x, y, own_z = target.position
    state = np.array([x, y, z if math.isnan(own_z) else own_z, *target.velocity])
    begin, end = to_ns(target.from_s), math.inf if math.isinf(target.until_s) else to_ns(target.until_s)
    now = begin
    pieces = _pieces(target)
    starts = [start for start, _ in pieces]
    state = _entered(state, pieces[0][1])
    for first in range(0, steps, CHUNK_STEPS):
        for t in step_times(first, min(CHUNK_STEPS, steps - first), step_s).tolist():
            if not begin <= t <= end:
                yield np.full(3, np.nan)
                continue
            state = _advanced(state, pieces, starts, now, t)
            if target.noise_density > 0 and t > now:
                state = state + _noise(target.noise_density, (t - now) * 1e-9, rng)
            now = t
            yield state[:3]


def _pieces(target: ScriptedTarget) -> list[tuple[int, Segment]]:
    """Start times [ns] and segments of a path, with constant velocity before, between and after the scripted ones."""
    begin = to_ns(target.from_s)
    pieces = [(begin, Segment(target.from_s))]
    for segment in target.segments:
        start = to_ns(segment.from_s)
        if pieces[-1][0] == start:
            pieces.pop()
        pieces.append((start, segment))
        if not math.isinf(segment.until_s):
            pieces.append((to_ns(segment.until_s), Segment(segment.until_s)))
    return pieces


def _entered(state: Floats, segment: Segment) -> Floats:
    return state if segment.velocity is None else np.concatenate([state[:3], segment.velocity])


def _advanced(state: Floats, pieces: list[tuple[int, Segment]], starts: list[int], now: int, t: int) -> Floats:
    """State (6,) at the time `t` [ns], propagated from the time `now` [ns] through all segments in between.

    Args:
        state: (6,) position and velocity at `now`.
        pieces: start [ns] and segment, in order.
        starts: the start times alone.
        now: time of the state [ns].
        t: later time [ns].
    """
    piece = bisect_right(starts, now) - 1
    while piece + 1 < len(pieces) and starts[piece + 1] <= t:
        state = _entered(moved(state, pieces[piece][1], (starts[piece + 1] - now) * 1e-9), pieces[piece + 1][1])
        piece, now = piece + 1, starts[piece + 1]
    return moved(state, pieces[piece][1], (t - now) * 1e-9) if t > now else state


def _noise(density: float, dt: float, rng: np.random.Generator) -> Floats:
    collected = acceleration_root(density, dt) @ rng.standard_normal((2, 3))
    return collected.ravel()


def truth_grid(truth: Truth | TimeGrid) -> TimeGrid:
    """Positions x, y, z of a table of truth as a grid of times and objects; NaN where an object has no row.

    A grid is returned unchanged.
    """
    if isinstance(truth, TimeGrid):
        return truth
    positions = np.column_stack([truth.x, truth.y, truth.z])
    return to_grid(truth.t_ns, truth.target_id, truth.role == "target", positions)
