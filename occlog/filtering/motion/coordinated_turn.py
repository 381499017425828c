"""Motion models of manoeuvring targets in the plane ([Lee] Eqs. 2.12-2.15, 3.12-3.13).

The state is [x, vx, y, vy].  A model is a row (lateral, a_x, a_y) of accelerations
[length/s^2]: `lateral` acts at a right angle to the velocity and turns it, counter-clockwise
if positive (x to the right, y up), at the rate lateral / |v| of Eq. 2.14; (a_x, a_y) is a
known input along the axes.  (0, 0, 0) is constant velocity, Eq. 2.12.

Two misprints are corrected: rows 2 and 3 of Eq. 2.13 are swapped in print, and the rate +alpha / |v|, there called
clockwise, turns counter-clockwise. Constant acceleration enters as an input, not through the division by the velocity
of Eq. 2.15, which has no value at rest.
"""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats
from occlog.core.numerics.jit import kernel


def three_models(alpha: float) -> Floats:
    """Return (3, 3) motion models of [Lee] Sec. 3.3.1: constant velocity, clockwise and counter-clockwise turn.

    A row is (lateral acceleration, acceleration along x, along y) [length/s^2]. `alpha` >= 0 is the lateral
    acceleration of the turns.
    """
    return np.array([[0.0, 0.0, 0.0], [-alpha, 0.0, 0.0], [alpha, 0.0, 0.0]])


def acceleration_root(density: float, dt: float) -> Floats:
    """Return the (2, 2) lower Cholesky factor of the white acceleration noise of a step, for one axis.

    It is B with B B^T = density [[dt^3/3, dt^2/2], [dt^2/2, dt]], for position and velocity.

    Args:
        density: variance of the velocity accumulated over 1 s [length^2/s^3], >= 0.
        dt: length of the step [s], >= 0.
    """
    s = math.sqrt(density * dt)
    return np.array([[s * dt / math.sqrt(3.0), 0.0], [s * math.sqrt(0.75), 0.5 * s]])


def turn_matrix(rate: float, dt: float) -> Floats:
    """Return the (4, 4) transition matrix of [x, vx, y, vy] for a turn at a known rate, [Lee] Eq. 2.13 corrected.

    Args:
        rate: rate of turning [rad/s], counter-clockwise positive; 0 is constant velocity (Eq. 2.12).
        dt: length of the step [s].
    """
    along, aside, cosine, sine = _turned(rate * dt)
    along, aside = along * dt, aside * dt
    return np.array(
        [[1.0, along, 0.0, -aside], [0.0, cosine, 0.0, -sine], [0.0, aside, 1.0, along], [0.0, sine, 0.0, cosine]]
    )


@kernel
def _turned(angle: float) -> tuple[float, float, float, float]:
    """Return sin(a)/a, (1 - cos(a))/a, cos(a) and sin(a) of an angle a [rad], without cancellation."""
    if abs(angle) < 1e-8:  # the next terms are below the last digit; half of the least number would be 0
        return 1.0, 0.5 * angle, 1.0, angle
    s, c = math.sin(0.5 * angle), math.cos(0.5 * angle)
    sine, versine = 2.0 * s * c, 2.0 * s * s
    return sine / angle, versine / angle, 1.0 - versine, sine


@kernel
def move(states: Floats, model: Floats, dt: float, root: Floats, normals: Floats) -> Floats:
    """Return (L, 4) states after one step under one motion model, [Lee] Eq. 3.3.

    Args:
        states: (L, 4) rows [x, vx, y, vy].
        model: (3,) lateral acceleration and acceleration along x and y [length/s^2]. The turn rate is that of the speed
            at the start, so that with both kinds at once the result is not exact in dt.
        dt: length of the step [s].
        root: (2, 2) root B of the noise of one axis; position and velocity get B n.
        normals: (L, 4) standard normal draws, in the order of the state.
    """
    moved = np.empty_like(states)
    lateral, ax, ay = model[0], model[1], model[2]
    for l in range(states.shape[0]):  # noqa: E741 - the paper's letter
        vx, vy = states[l, 1], states[l, 3]
        speed = math.sqrt(vx * vx + vy * vy)
        # At rest it does not move, under this model as under constant velocity.
        angle = lateral * dt / speed if speed > 0.0 else 0.0
        along, aside, cosine, sine = _turned(angle)
        moved[l, 0] = states[l, 0] + dt * (along * vx - aside * vy + 0.5 * dt * ax)
        moved[l, 1] = cosine * vx - sine * vy + dt * ax
        moved[l, 2] = states[l, 2] + dt * (aside * vx + along * vy + 0.5 * dt * ay)
        moved[l, 3] = sine * vx + cosine * vy + dt * ay
        for axis in range(0, 4, 2):
            n0, n1 = normals[l, axis], normals[l, axis + 1]
            moved[l, axis] += root[0, 0] * n0 + root[0, 1] * n1
            moved[l, axis + 1] += root[1, 0] * n0 + root[1, 1] * n1
    return moved


@kernel
def move_under_all(states: Floats, models: Floats, dt: float, root: Floats, normals: Floats) -> Floats:
    """Return (J, L, 4) states after one step from L states under each of J motion models.

    Args:
        states: (L, 4) rows [x, vx, y, vy].
        models: (J, 3) lateral acceleration and acceleration along x and y [length/s^2] of each model.
        dt: length of the step [s].
        root: (2, 2) root of the noise of one axis, common to all models.
        normals: (J, L, 4) standard normal draws.
    """
    moved = np.empty((models.shape[0], states.shape[0], 4))
    for m in range(models.shape[0]):
        moved[m] = move(states, models[m], dt, root, normals[m])
    return moved
