"""Where a search begins: on a path on which most sight lines agree (`occlog.track.map.kernels.consensus`)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats
from occlog.track.map.config import MapConfig
from occlog.track.map.kernels.consensus import Rays, agreed_path
from occlog.track.map.kernels.problem import Problem, SightLines
from occlog.track.map.measurements import Stations
from occlog.track.map.record import Record


class Agreed(NamedTuple):
    """A path, and the sight lines that agree with it."""

    X: Floats  # (T, 4) states
    agree: Bools  # (N,) sight lines that agree with it
    cost: float  # -2 log of the likelihood, up to a constant


def rays_of(lines: SightLines, record: Record, at: Stations) -> Rays:
    """The sight lines as half-lines with the variance across them, by [Ercan] Eq. 2."""
    sensor = record.rows.sensor[record.rows.seen]
    left = np.column_stack([-lines.axis[:, 1], lines.axis[:, 0]])
    ratio = np.where(lines.direction, 0.0, lines.reading / lines.focal)
    ratio2 = 1.0 + ratio**2
    direction = (lines.axis + ratio[:, None] * left) / np.sqrt(ratio2)[:, None]
    to_angle = np.where(lines.direction, 1.0, 1.0 / (lines.focal * ratio2)) ** 2
    return Rays(
        step=lines.step,
        sensor=sensor,
        place=lines.place,
        direction=np.ascontiguousarray(direction),
        a=lines.c0 * to_angle,
        # c1 belongs to the distance along the axis.
        b=lines.c1 * to_angle * ratio2,
        reach=at.range[sensor],
    )


def agreed(problem: Problem, record: Record, at: Stations, config: MapConfig, extent: float, bend: float) -> Agreed:
    """The most probable choice of true sight lines, and a path along them.

    Args:
        problem: of T states; its sight lines are of the rows of the record that saw the target.
        record: the same T states.
        at: the sensors.
        config: settings.
        extent: size of the place.
        bend: standard deviations beyond which a sight line does not agree.
    """
    rays = rays_of(problem.lines, record, at)
    first = np.searchsorted(rays.step, np.arange(len(record.t_ns) + 1))
    seconds = (record.t_ns - record.t_ns[0]) / NS
    ground = np.array([max(config.speed, config.acceleration), config.vague * extent, extent])
    return Agreed(*agreed_path(rays, first, seconds, problem.steps, ground, bend))
