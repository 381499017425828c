"""Where a search begins: on a path on which most lines of sight agree.

See `occlog.track.methods.map.kernels.ransac_path`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats
from occlog.track.methods.map.config import MapConfig
from occlog.track.methods.map.kernels.problem import BearingLinesByStep, TrajectoryProblem
from occlog.track.methods.map.kernels.ransac_path import BearingHalfLines, agreed_path
from occlog.track.methods.map.measurements import SensorStations
from occlog.track.methods.map.record import TargetRecord


class ConsensusPath(NamedTuple):
    """A path of T states with the bearings that agree with it, as the start of a search.

    `X` (T, 4) are states x, vx, y, vy, `agree` (N,) marks bearings, `cost` is -2 log of the likelihood up to a
    constant.
    """

    X: Floats  # (T, 4) states
    agree: Bools  # (N,) lines of sight that agree with it
    cost: float  # -2 log of the likelihood, up to a constant


def rays_of(lines: BearingLinesByStep, record: TargetRecord, at: SensorStations) -> BearingHalfLines:
    """Return lines of sight as half-lines with the variance across them as a function of distance, by [Ercan] Eq. 2.

    Args:
        lines: N lines of sight, of the rows of the record that saw the target.
        record: measurements of the target.
        at: the sensors.
    """
    sensor = record.rows.sensor[record.rows.seen]
    left = np.column_stack([-lines.axis[:, 1], lines.axis[:, 0]])
    ratio = np.where(lines.direction, 0.0, lines.reading / lines.focal)
    ratio2 = 1.0 + ratio**2
    direction = (lines.axis + ratio[:, None] * left) / np.sqrt(ratio2)[:, None]
    to_angle = np.where(lines.direction, 1.0, 1.0 / (lines.focal * ratio2)) ** 2
    return BearingHalfLines(
        step=lines.step,
        sensor=sensor,
        position=lines.position,
        direction=np.ascontiguousarray(direction),
        a=lines.c0 * to_angle,
        # c1 belongs to the distance along the axis.
        b=lines.c1 * to_angle * ratio2,
        reach=at.range[sensor],
    )


def ransac_path(
    problem: TrajectoryProblem, record: TargetRecord, at: SensorStations, config: MapConfig, extent: float, bend: float
) -> ConsensusPath:
    """Return the most probable set of true bearings and a path along them, by a multiple-hypothesis search.

    Args:
        problem: of T states; its lines of sight are of the rows of the record that saw the target.
        record: measurements at these T times.
        at: the sensors.
        config: settings of the method.
        extent: size of the scene.
        bend: residual in standard deviations beyond which a bearing does not agree.
    """
    rays = rays_of(problem.lines, record, at)
    first = np.searchsorted(rays.step, np.arange(len(record.t_ns) + 1))
    seconds = (record.t_ns - record.t_ns[0]) / NS
    ground = np.array(
        [max(config.sigma_initial_velocity, config.process_noise_velocity), config.max_position_sigma * extent, extent]
    )
    return ConsensusPath(*agreed_path(rays, first, seconds, problem.steps, ground, bend))
