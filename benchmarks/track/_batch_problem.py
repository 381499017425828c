"""Trajectories of any length through the sparse room of [Rahimi] Sec. 6, as problems of the batch method."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from occlog.array_types import Floats
from occlog.measure.scans.scan import sensor_names
from occlog.papers.rahimi.example import example, identified, sparse_scene
from occlog.track.drivers.batch import COLUMNS
from occlog.track.interface import Record
from occlog.track.map.config import MapConfig, map_defaults
from occlog.track.map.kernels.problem import Problem
from occlog.track.map.method import begin, problem_of, start_of


def sparse_config() -> MapConfig:
    """The paper's method, with the motion of the world as it was identified."""
    acceleration, jitter = identified(0)
    return replace(map_defaults("m"), acceleration=acceleration, jitter=jitter, walls=False, depth=1.0)


def sparse_problem(steps: int, seed: int) -> tuple[Problem, Floats, float]:
    """A problem of so many states, the paper's initial guess, and the size of the room."""
    scene = sparse_scene(known_range=False)
    table = example(0, seed, steps).bearings
    place = {name: n for n, name in enumerate(sensor_names(scene))}
    sensor = np.array([place[name] for name in table.sensor.tolist()])
    t_ns, state = np.unique(table.t_ns, return_inverse=True)
    order = np.lexsort((sensor, state))
    columns = {"sensor": sensor} | {name: getattr(table, name) for name in COLUMNS[1:]}
    record = Record(t_ns, state[order], *(columns[name][order] for name in COLUMNS))
    pending = begin(scene, sparse_config())
    problem = problem_of(pending, record)
    start, stuck = start_of(pending, problem)
    if stuck.any():
        raise RuntimeError("the constraints contradict each other")
    return problem, start, pending.extent
