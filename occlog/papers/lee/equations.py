"""[Lee]: printed equations that can be computed without error, and the planes and angles that the text names.

Each formula is written down here as it is printed.  What it should give is computed another way: by the motion or the
geometry that it describes, by differences, or by its definition.  Eq. 2.41 is skipped: the scan has lost rows of it.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping

import numpy as np

from occlog.array_types import Floats
from occlog.core.bounds.in_space import direction_information, plane_variance, sight_angles
from occlog.core.geometry.projected_planes import AXES, XY, YZ, ZX, projected_angles
from occlog.filtering.motion.coordinated_turn import turn_matrix
from occlog.papers import verdicts as v
from occlog.papers.verdicts import ExactStatement, Execute, Experiment, Size, Table

from .space.worlds import ACCELERATION, SIGMA, STEP_S, TABLE, world

EQUAL = 1e-9
"""Largest deviation with which two formulas are the same, in doubles."""
BY_DIFFERENCES = 1e-6
"""Tolerance where one of the values is a quotient of differences."""
INSTANTS, FIRST_PLANES, TABLE_INSTANTS = 50, 13, 165
"""Instants of scenarios 3 and 4, those before the planes change, and seconds of the track of Tables 2.1 and 2.2."""
PHI_RANGE, THETA_RANGE = (50.47, 82.14), (36.35, 85.60)
"""Printed angles [deg] of the track of Tables 2.1 and 2.2."""
EXAMPLES = 100

SAME, CLOSE = v.at_most(EQUAL), v.at_most(BY_DIFFERENCES)
STATEMENTS: Mapping[str, ExactStatement] = {
    "eq2.13": ExactStatement(
        "(2.13) turns the state: largest deviation of the matrix from a turn.", SAME, "at most 1e-9"
    ),
    "eq3.12": ExactStatement(
        "(3.12) turns the state: largest deviation of the matrix from a turn.", SAME, "at most 1e-9"
    ),
    "eq2.14": ExactStatement(
        "A rate of +alpha/V turns clockwise: angle turned in a second [rad], clockwise positive.",
        v.above(0.0),
        "above 0",
    ),
    "eq2.15": ExactStatement("(2.15) moves by constant acceleration: largest deviation.", SAME, "at most 1e-9"),
    "eq2.32": ExactStatement(
        "(2.32) is the gradient of that motion, as (2.30) needs it: largest deviation.", SAME, "at most 1e-9"
    ),
    "eq2.30": ExactStatement(
        "With J_0 = 0 there is a bound: least information about any direction over that of the mean one (scenario 1).",
        v.at_least(1e-12),
        "at least 1e-12; 0: the matrix has no inverse",
    ),
    "eq2.36": ExactStatement(
        "(2.36) to (2.38) are gradients of the projected angles: largest deviation.", CLOSE, "at most 1e-6"
    ),
    "eq2.24-alike": ExactStatement(
        "(2.22) to (2.24) convert positions of a sensor with axes as the first one's: largest error [m].",
        SAME,
        "at most 1e-9",
    ),
    "eq2.24-reversed": ExactStatement(
        "(2.22) to (2.24) convert positions of a sensor with reversed axes: largest error [m].", SAME, "at most 1e-9"
    ),
    "eq3.10": ExactStatement(
        "(3.7) to (3.11) are weighted means: sum of the particles' shares in the estimate.",
        v.Interval(1.0 - EQUAL, 1.0 + EQUAL),
        "1 to 1e-9",
    ),
    "eq4.4": ExactStatement("(4.4) is (4.3) with P_M = P_F: largest deviation.", SAME, "at most 1e-9"),
    "eq4.11": ExactStatement(
        "(4.11) is the ratio of detections by (4.1) and (4.2): largest deviation of its logarithm.",
        SAME,
        "at most 1e-9",
    ),
    "fig2.9-lowest": ExactStatement(
        "Scenario 4: at 13 instants yz of sensor 1 has the lowest variance: share of these.", v.at_least(1.0), "all"
    ),
    "fig2.9-second": ExactStatement(
        "Scenario 4: there yz of sensor 2 has the second lowest: share of these.", v.at_least(1.0), "all"
    ),
    "fig2.9-later": ExactStatement(
        "Scenario 4: later zx of sensor 1 and yz of sensor 2 are selected: share of these instants.",
        v.at_least(1.0),
        "all",
    ),
    "sec2.2.2-phi": ExactStatement(
        "Tables 2.1 and 2.2: phi is between 50.47 and 82.14 degrees: largest difference of an end.",
        v.at_most(0.02),
        "at most two units of the last printed digit",
    ),
    "sec2.2.2-theta": ExactStatement(
        "Tables 2.1 and 2.2: theta is between 36.35 and 85.60 degrees: largest difference of an end.",
        v.at_most(0.02),
        "at most two units of the last printed digit",
    ),
}


def equations(size: Size, execute: Execute) -> Table:  # noqa: ARG001
    """Table of one quantity for each statement on the printed equations, a row each, with x as its number from 1.

    The quantity is a deviation, a share or a ratio; nothing is run.
    """
    rng = np.random.default_rng(np.random.SeedSequence(size.seed, spawn_key=(2009, 1)))
    found = {
        **_turns(),
        **_acceleration(rng),
        "eq2.30": _least_information(),
        "eq2.36": _gradients(rng),
        **_conversions(rng),
        "eq3.10": _shares(rng),
        **_decisions(),
        **_planes(),
        **_angles(),
    }
    return v.exact_rows(STATEMENTS, found)


def _turns() -> dict[str, float]:
    """Largest deviations of [Lee] Eqs. 2.13 and 3.12 from a coordinated turn, and how far clockwise they turn [rad]."""
    rate = 0.3
    s, c, n = math.sin(rate) / rate, (1.0 - math.cos(rate)) / rate, rate
    printed = [[1, s, 0, -c], [0, c, 1, s], [0, math.cos(n), 0, -math.sin(n)], [0, math.sin(n), 0, math.cos(n)]]
    ordered = [[1, 0, s, -c], [0, 1, c, s], [0, 0, math.cos(n), -math.sin(n)], [0, 0, math.sin(n), math.cos(n)]]
    turn, places_first = turn_matrix(rate, 1.0), [0, 2, 1, 3]
    vx, vy = np.array(ordered)[2:, 2]
    return {
        "eq2.13": float(np.abs(np.array(printed) - turn).max()),
        "eq3.12": float(np.abs(np.array(ordered) - turn[np.ix_(places_first, places_first)]).max()),
        "eq2.14": -math.atan2(vy, vx),
    }


def _propagator(a: float, velocity: float, step: float) -> Floats:
    """Transition matrix (2, 2) of position and velocity along one axis over `step` [s], as printed in [Lee] Eq. 2.15.

    `a` is the acceleration [m/s^2]; `velocity` [m/s] that by which it is divided there.
    """
    return np.array([[1.0, a * step**2 / (2.0 * velocity) + step], [0.0, a * step / velocity + 1.0]])


def _acceleration(rng: np.random.Generator) -> dict[str, float]:
    """Largest deviations of [Lee] Eq. 2.15 from motion at constant acceleration, and from that motion's gradient."""
    moved, gradient = 0.0, 0.0
    for x, velocity, a in zip(*rng.uniform(0.5, 2.0, (3, EXAMPLES)).tolist(), strict=True):
        F = _propagator(a, velocity, STEP_S)
        right = np.array([x + velocity * STEP_S + 0.5 * a * STEP_S**2, velocity + a * STEP_S])
        moved = max(moved, float(np.abs(F @ [x, velocity] - right).max()))
        gradient = max(gradient, float(np.abs(F - [[1.0, STEP_S], [0.0, 1.0]]).max()))
    return {"eq2.15": moved, "eq2.32": gradient}


def _least_information() -> float:
    """Recursion of the information matrix by [Lee] Eq. 2.30, with 2.39 as printed, from 0: its least eigenvalue.

    The absolute value, for a state in units in which each component has the information 1.
    """
    w = world(1, INSTANTS)
    each = direction_information(w.states[:, :3], np.zeros(3), np.eye(3), SIGMA, SIGMA)
    J = np.zeros((6, 6))
    for k in range(1, INSTANTS):
        F = np.zeros((6, 6))
        for axis in range(3):
            own = [axis, axis + 3]
            F[np.ix_(own, own)] = _propagator(ACCELERATION[axis], float(w.states[k - 1, axis + 3]), STEP_S)
        back = np.linalg.inv(F)
        J = back.T @ J @ back
        J[:3, :3] += each[k]
    unit = 1.0 / np.sqrt(np.diag(J))
    return abs(float(np.linalg.eigvalsh(J * unit[:, None] * unit)[0]))


def _gradients(rng: np.random.Generator) -> float:
    """Largest deviation of [Lee] Eqs. 2.36 to 2.38 from difference quotients of the projected angles."""
    h, off = 1e-6, 0.0
    for xyz in rng.uniform(1.0, 5.0, (EXAMPLES, 3)):
        for plane, (a, b) in enumerate(AXES):
            printed = np.zeros(3)
            printed[a], printed[b] = np.array([-xyz[b], xyz[a]]) / (xyz[a] ** 2 + xyz[b] ** 2)
            by_steps = [
                (projected_angles(xyz + s) - projected_angles(xyz - s))[plane] / (2.0 * h) for s in h * np.eye(3)
            ]
            off = max(off, float(np.abs(printed - by_steps).max()))
    return off


def _conversions(rng: np.random.Generator) -> dict[str, float]:
    """Largest errors [m] of [Lee] Eqs. 2.22 to 2.24 for sensors with axes equal and opposite to those of the first."""
    own, sensor = rng.uniform(1.0, 10.0, (2, EXAMPLES))
    similar, reversed_ = own - sensor, own + (sensor - own)
    return {
        "eq2.24-alike": float(np.abs(similar - (sensor + own)).max()),
        "eq2.24-reversed": float(np.abs(reversed_ - (sensor - own)).max()),
    }


def _shares(rng: np.random.Generator) -> float:
    """Sum of the particle coefficients in [Lee] Eqs. 3.7 to 3.11, for 2 bearings, 3 models and 100 random particles."""
    w = rng.random((2, 3, 100))
    w /= w.sum()
    mass = w.sum(axis=2)  # of bearing i and model m
    by_bearing = mass / mass.sum(axis=1, keepdims=True)  # (3.9)
    of_model = by_bearing.sum(axis=0) / by_bearing.sum()  # (3.11)
    return float(np.sum(mass * by_bearing * of_model))  # (3.7), (3.8) and (3.10) with every particle at 1


def _decisions() -> dict[str, float]:
    """Largest deviations of [Lee] Eq. 4.4 from 4.3, and of the ratio in 4.11 from the probabilities that define it."""
    equal, ratio, sensors = 0.0, 0.0, 6
    for p_miss in (0.05, 0.1, 0.2, 0.3):
        for detected in range(sensors + 1):
            hit, silent = math.log((1.0 - p_miss) / p_miss), math.log(p_miss / (1.0 - p_miss))
            by_4_3 = detected * hit + (sensors - detected) * silent
            equal = max(equal, abs(by_4_3 - (2 * detected - sensors) * hit))
        for p_false in (0.05, 0.1, 0.2, 0.3):
            ratio = max(ratio, abs(math.log((1.0 - p_false) / p_false) - math.log((1.0 - p_miss) / p_false)))
    return {"eq4.4": equal, "eq4.11": ratio}


def _planes() -> dict[str, float]:
    """Shares of instants of scenario 4 with the printed order of variances of three planes and two sensors.

    First-order variances at the true positions.
    """
    w = world(4, INSTANTS)
    variance = np.array(
        [[plane_variance(w.states[:, :3], at, np.eye(3), SIGMA, SIGMA, p) for p in range(3)] for at in w.positions]
    )
    sensor, plane = np.unravel_index(np.argsort(variance.reshape(6, INSTANTS), axis=0, kind="stable"), (2, 3))
    early = slice(0, FIRST_PLANES)
    least = variance.min(axis=0)  # of each plane, over the sensors
    later, by = least[:, FIRST_PLANES:], variance[:, :, FIRST_PLANES:].argmin(axis=0)
    selected = (later.argmax(axis=0) == XY) & (by[ZX] == 0) & (by[YZ] == 1)
    return {
        "fig2.9-lowest": float(np.mean((sensor[0, early] == 0) & (plane[0, early] == YZ))),
        "fig2.9-second": float(np.mean((sensor[1, early] == 1) & (plane[1, early] == YZ))),
        "fig2.9-later": float(np.mean(selected)),
    }


def _angles() -> dict[str, float]:
    """Largest differences of the angles' ranges along the track of [Lee] Table 2.1 from the printed ones [deg]."""
    w = world(TABLE, TABLE_INSTANTS)
    theta, phi = (np.degrees(a) for a in sight_angles(w.states[:, :3], np.zeros(3), np.eye(3)))
    return {
        f"sec2.2.2-{name}": max(abs(float(a.min()) - low), abs(float(a.max()) - high))
        for name, a, (low, high) in (("phi", phi, PHI_RANGE), ("theta", theta, THETA_RANGE))
    }


EQUATIONS = Experiment(
    item="equations",
    title="Printed equations, planes and angles",
    x_label="statement",
    y_label="quantity",
    runs=1,
    steps=1,
    quick=(1, 1),
    compute=equations,
    judge=functools.partial(v.judge_exactly, STATEMENTS),
    note="Computed without noise; the examples are drawn, and the largest deviation is shown.",
)
