"""Direction of each robot's next step: forces, prevention of collisions, escape from oscillation ([Lee] Sec. 5.2.2).

The thesis has one obstacle. Of several, each repels; collision prevention applies to the obstacle nearest to its reach
among those aligned with the goal, and the oscillation region is that of the nearest obstacle. Oscillation in front of
an obstacle is detected, and escaped by an angle ([Lee] Sec. 5.2.2). The thesis prints csc instead of arcsin. The
largest angle belongs to the *smallest* possible distance of the robot, although the text states the maximum.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints

from .config import FieldSettings
from .forces import ROUNDING, Field, attractive_force, direction, distance, prevented, repulsive_force


class Range(NamedTuple):
    """Interval with ends `low` and `high`."""

    low: float
    high: float


def opposite(previous: Floats, force: Floats, tolerance: float) -> Bools:
    """Return a mask (...) of successive total forces (..., 2) with opposite directions ([Lee] Eq. 5.26).

    Args:
        previous: force one step before; NaN: there was none, which is never opposite.
        force: the force now.
        tolerance: the cosine of the angle between the two may exceed -1 by this much.
    """
    lengths = np.hypot(previous[..., 0], previous[..., 1]) * np.hypot(force[..., 0], force[..., 1])
    product = np.sum(previous * force, axis=-1)
    with np.errstate(invalid="ignore"):
        return np.asarray((product <= -(1.0 - tolerance) * lengths) & (lengths > 0.0))


def distance_inside(way: float, radii: float) -> Range:
    """Return the range of the distance from robot to obstacle at an escape inside the region of prevention.

    It is d_osc of [Lee] Eq. 5.27; the low end is open.

    Args:
        way: s_r T_s, length of a step.
        radii: r_r + r_o, of robot and obstacle.
    """
    return Range(0.0, way + radii)


def distance_outside(way: float, radii: float) -> Range:
    """Return the range of the distance from robot to obstacle at an escape outside the region of prevention.

    It is d_osc of [Lee] Eq. 5.28; the low end is open.

    Args:
        way: s_r T_s, length of a step.
        radii: r_r + r_o, of robot and obstacle.
    """
    return Range(way + radii, 2.0 * way + radii)


def angle_at(d: float, radii: float) -> float:
    """Return the angle theta_osc [rad] at which a robot at distance `d` just passes an obstacle ([Lee] 5.29 and 5.30).

    `radii` is r_r + r_o, of robot and obstacle; the angle is pi / 2 if `d` is not above it.
    """
    return math.asin(min(1.0, radii / d))


def angle_inside(way: float, radii: float) -> Range:
    """Return the range of the escape angle [rad] inside the region of prevention ([Lee] Eq. 5.31); open at the top.

    `way` is the length of a step, s_r T_s, `radii` is r_r + r_o, of robot and obstacle.
    """
    return Range(angle_at(way + radii, radii), 0.5 * math.pi)


def angle_outside(way: float, radii: float) -> Range:
    """Return the range of the escape angle [rad] outside the region of prevention ([Lee] Eq. 5.32); open at the top.

    `way` is the length of a step, s_r T_s, `radii` is r_r + r_o, of robot and obstacle.
    """
    return Range(angle_at(2.0 * way + radii, radii), angle_at(way + radii, radii))


def turned(force: Floats, angle: Floats) -> Floats:
    """Return vectors `force` (..., 2) turned to the left by `angle` (...) [rad] ([Lee] Eqs. 5.33 and 5.34)."""
    c, s = np.cos(angle), np.sin(angle)
    x, y = force[..., 0], force[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


class SteeringState(IntEnum):
    """Rule that determines the direction of a step; if several apply, the highest number is reported."""

    FREE = 0  # the forces alone
    OSCILLATING = 1  # oscillation was recognised, but the robot does not escape
    PREVENT = 2  # the force away from an obstacle in line with the goal
    ESCAPING = 3  # the force turned away from the line of oscillation
    GUARDED = 4  # whatever the force: the step would have collided, and was turned or omitted


STATES = ("free", "oscillating", "prevent", "escaping", "guarded")
"""Names of the states, by number."""


class NearbyObstacles(NamedTuple):
    """K obstacles as N robots meet them at one time step: nearest points, radii and lengths of their own steps."""

    nearest: Floats  # (N, K, 2) p_o, from which distances are measured: the centre, or the nearest point of a border
    radius: Floats  # (K,) what the obstacle has beyond that point
    size: Floats  # (K,) r_o, radius of the whole obstacle
    way: Floats  # (K,) how far the obstacle itself goes in a step; 0: it stands


class StepRules(NamedTuple):
    """Length of a step and radius of the robots, and the rules of [Lee] Sec. 5.2.2 that they follow."""

    way: float  # s_r T_s
    radius: float  # r_r
    prevent: bool  # the force of (5.25), not the original one of (5.15)
    escape: str  # `none`, `inside` (step 3.1) or `outside` (step 3.2)
    side: str  # to which a robot turns: `left`, `right` or `free`
    aligned: float  # tolerance of (5.18)
    opposite: float  # tolerance of (5.26)
    angle: float | None = None  # of the escape [rad]; None: the largest one of (5.31) or (5.32)


def field_of(settings: FieldSettings) -> Field:
    """Return the constants of the potential field from the settings."""
    return Field(
        attraction=settings.attraction,
        repulsion=settings.repulsion,
        attraction_power=settings.attraction_power,
        repulsion_power=settings.repulsion_power,
        influence=settings.influence_distance,
    )


def steps_of(settings: FieldSettings, way: float, radius: float) -> StepRules:
    """Return the step rules from the settings, for robots with steps of length `way` and a `radius`."""
    return StepRules(
        way=way,
        radius=radius,
        prevent=settings.force == "prevent",
        escape=settings.escape,
        side=settings.side,
        aligned=settings.collinearity_tolerance,
        opposite=settings.opposition_tolerance,
        angle=settings.escape_angle,
    )


class Steering(NamedTuple):
    """Forces on N robots, the rule that determined the direction of each, and whether oscillation was recognised."""

    attractive: Floats  # (N, 2)
    repulsive: Floats  # (N, 2) sum over the obstacles
    total: Floats  # (N, 2) force that moves the robot: (5.15), (5.25), or turned by theta_osc
    state: Ints  # (N,) numbers of `SteeringState`
    recognised: Bools  # (N,) oscillation (5.26)


def steer(
    xy: Floats, goal: Floats, around: NearbyObstacles, field: Field, steps: StepRules, previous: Floats
) -> Steering:
    """Return the forces on robots, and the total force that determines the direction of the next step.

    By [Lee] Sec. 5.2.2: the force away from an obstacle replaces the sum in front of an aligned obstacle, and the total
    force is turned if it oscillates, both as `steps` allows.

    Args:
        xy: (N, 2) positions of the robots.
        goal: (N, 2) their goals.
        around: K obstacles.
        field: constants of the potentials.
        steps: length of steps, radius of the robots, rules.
        previous: (N, 2) total forces one step before; NaN at the first step.
    """
    # Forces of goal and obstacles ([Lee] Eqs. 5.11 to 5.15)
    attractive = attractive_force(xy, goal, field)
    repulsive = repulsive_force(xy[:, None], around.nearest, field).sum(axis=1)
    total, state = attractive + repulsive, np.full(len(xy), SteeringState.FREE, dtype=np.int64)
    reach = steps.way + around.way + steps.radius + around.radius
    beyond = distance(xy[:, None], around.nearest) - reach
    # Prevention of collisions with aligned obstacles ([Lee] Eqs. 5.24 and 5.25)
    prevent: Bools = np.zeros(len(xy), dtype=np.bool_)
    if steps.prevent and len(reach):
        blocked = prevented(xy[:, None], around.nearest, goal[:, None], reach, field, steps.aligned)
        prevent = np.asarray(blocked.any(axis=1))
        row, worst = np.flatnonzero(prevent), np.argmin(np.where(blocked, beyond, np.inf), axis=1)
        total[row] = direction(xy[row], around.nearest[row, worst[row]])
        state[row] = SteeringState.PREVENT
    # Recognition of oscillation ([Lee] Eq. 5.26)
    recognised = opposite(previous, total, steps.opposite)
    state[recognised & ~prevent] = SteeringState.OSCILLATING
    if steps.escape != "none" and len(reach) and recognised.any():
        angle = np.where(recognised, _escape_angle(xy, around, steps, beyond, reach), 0.0)
        # Escape: turn the total force by theta_osc ([Lee] Eqs. 5.33 and 5.34)
        escaping = angle > 0.0
        total = np.where(escaping[:, None], turned(total, _sided(xy, goal, around, steps, total, angle)), total)
        state[escaping] = SteeringState.ESCAPING
    return Steering(attractive, repulsive, total, state, recognised)


def _escape_angle(xy: Floats, around: NearbyObstacles, steps: StepRules, beyond: Floats, reach: Floats) -> Floats:
    """Return the (N,) escape angles [rad], not negative; 0 where a robot does not escape.

    With the rule `inside` a robot escapes in the region of prevention, with `outside` at most a step outside it.

    Args:
        xy: (N, 2) positions.
        around: K obstacles.
        steps: rule, radius and length of steps.
        beyond: (N, K) distance to each obstacle beyond its reach; <= 0: inside the region of prevention.
        reach: (K,) radius of this region.
    """
    near = np.argmin(beyond, axis=1)
    gap = beyond[np.arange(len(xy)), near]
    inside = gap <= ROUNDING * reach[near]
    if steps.escape == "inside":
        return np.where(inside, 0.5 * math.pi if steps.angle is None else steps.angle, 0.0)
    # Outside the region, but no farther than a step ([Lee] Eq. 5.28)
    outside = ~inside & (gap <= steps.way + ROUNDING * reach[near])
    radii = steps.radius + around.size[near]
    largest = np.arcsin(radii / (steps.way + radii))
    return np.where(outside, largest if steps.angle is None else steps.angle, 0.0)


def _sided(xy: Floats, goal: Floats, around: NearbyObstacles, steps: StepRules, total: Floats, angle: Floats) -> Floats:
    """Return the (N,) escape angles [rad] with the sign of the side to which robots turn; left is positive.

    `free`: the side with the next position farther from obstacles; on ties the one nearer to the goal, then the left.

    Args:
        xy: (N, 2) positions.
        goal: (N, 2) their goals.
        around: K obstacles.
        steps: side and length of steps.
        total: (N, 2) total forces before the turn.
        angle: (N,) absolute escape angles [rad].
    """
    if steps.side != "free":
        return angle if steps.side == "left" else -angle
    heading = total / np.maximum(np.hypot(total[:, 0], total[:, 1]), np.finfo(float).tiny)[:, None]
    ends = [xy + steps.way * turned(heading, sign * angle) for sign in (1.0, -1.0)]
    room = [np.min(distance(p[:, None], around.nearest) - around.radius, axis=1) for p in ends]
    left = [distance(p, goal) for p in ends]
    slack = ROUNDING * steps.way
    right = (room[1] > room[0] + slack) | ((room[1] >= room[0] - slack) & (left[1] < left[0] - slack))
    return np.where(right, -angle, angle)
