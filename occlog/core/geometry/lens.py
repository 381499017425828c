"""Lens distortion: ideal normalised image coordinates to distorted ones and back.

Normalised coordinates are pixels minus the principal point, over the focal length.  Models and coefficients:

* `brown`: (k1, k2, p1, p2, k3), ideal to distorted, Brown's polynomial in OpenCV's order.
* `opencv`: the complete model of OpenCV, (k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, tau_x, tau_y), ideal to
  distorted: rational radial terms, tangential ones, thin prism, tilted sensor (OpenCV, `calib3d`).
* `tsai`: (k1, 0, 0, 0, 0), distorted to ideal, x_ideal = x (1 + k1 r^2).
* `equidistant`: (k1, k2, k3, k4, 0), the fisheye of Kannala and Brandt 2006 as in OpenCV and Kalibr: a ray at the angle
  theta to the optical axis falls at the radius theta (1 + k1 theta^2 + ... + k4 theta^8). It is used up to the angle
  `MAX_ANGLE`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats

MAX_ANGLE = np.radians(80.0)
"""Angle to the optical axis up to which an equidistant lens is used: beyond, the ideal image becomes too large."""
ANGLES = 801
"""Steps of the angle in which the fold of an equidistant lens is sought."""
RAYS, RADII = 48, 200
"""Directions, and steps along each, in which the fold of a polynomial lens is sought."""
HOMOTOPY_STEPS, NEWTON_STEPS = 10, 6
"""Steps from the principal point to a distorted point, and of Newton's method at each."""
DIFFERENCE = 1e-6
"""Step of difference quotients in normalised coordinates."""
MIN_DETERMINANT = 1e-4
"""Least determinant of the Jacobian with which Newton's method goes on."""


def is_straight(coefficients: Floats, model: str) -> bool:
    """Return whether a lens has no distortion: all `coefficients` are 0; always False for the model `equidistant`."""
    return model != "equidistant" and not np.any(coefficients)


def distort(xy: Floats, coefficients: Floats, model: str) -> Floats:
    """Return distorted normalised image coordinates (N, 2) of ideal ones.

    It is `xy` itself if there is no distortion.

    Args:
        xy: (N, 2) ideal normalised coordinates: (pixel - principal point) / focal length.
        coefficients: of the model: (k1, k2, p1, p2, k3) for `brown`, the 14 of OpenCV for `opencv`, (k1, 0, 0, 0, 0)
            for `tsai`, (k1, k2, k3, k4, 0) for `equidistant`.
        model: `brown`, `opencv`, `tsai` or `equidistant`.
    """
    if model == "equidistant":
        radius = np.hypot(xy[:, 0], xy[:, 1])
        theta = np.arctan(radius)
        return xy * np.where(radius > 0, _bent(theta, coefficients) / np.where(radius > 0, radius, 1.0), 1.0)[:, None]
    if not np.any(coefficients):
        return xy
    if model == "tsai":
        return _invert(xy, coefficients, "tsai")
    return _polynomial(xy, coefficients, model)


def undistort(xy: Floats, coefficients: Floats, model: str) -> Floats:
    """Return ideal normalised image coordinates (N, 2) of distorted ones.

    NaN outside the usable disc of an equidistant lens. It is `xy` itself if there is no distortion.

    Args:
        xy: (N, 2) distorted normalised coordinates: (pixel - principal point) / focal length.
        coefficients: of the model: (k1, k2, p1, p2, k3) for `brown`, the 14 of OpenCV for `opencv`, (k1, 0, 0, 0, 0)
            for `tsai`, (k1, k2, k3, k4, 0) for `equidistant`.
        model: `brown`, `opencv`, `tsai` or `equidistant`.
    """
    if model == "equidistant":
        return _straight(xy, coefficients)
    if not np.any(coefficients):
        return xy
    if model == "tsai":
        return _polynomial(xy, coefficients, "tsai")
    return _follow(xy, coefficients) if model == "opencv" else _invert(xy, coefficients, "brown")


class UsableDisc(NamedTuple):
    """Disc of the distorted normalised image around the principal point in which an equidistant lens is used.

    It is stated as the greatest angle to the optical axis [rad] and the radius of the disc, in focal lengths.
    """

    angle: float  # greatest angle to the optical axis [rad]: `MAX_ANGLE`, or where the lens folds
    radius: float  # of the disc around the principal point, normalised


def usable_disc(coefficients: Floats) -> UsableDisc:
    """Return the disc in which an equidistant lens with coefficients (k1, k2, k3, k4, 0) is used.

    It ends at the angle `MAX_ANGLE` to the axis, or where the distorted radius no longer increases with the angle.
    """
    theta = np.linspace(0.0, MAX_ANGLE, ANGLES)
    falling = np.flatnonzero(np.diff(_bent(theta, coefficients)) <= 0.0)
    angle = float(theta[falling[0]]) if len(falling) else float(MAX_ANGLE)
    return UsableDisc(angle, float(_bent(np.array([angle]), coefficients)[0]))


def is_usable(xy: Floats, coefficients: Floats, model: str) -> Bools:
    """Return (N,) booleans: a distorted point is in the usable disc of an equidistant lens; all True for other models.

    Args:
        xy: (N, 2) distorted normalised coordinates.
        coefficients: coefficients of the model; (k1, k2, k3, k4, 0) for `equidistant`.
        model: `brown`, `opencv`, `tsai` or `equidistant`.
    """
    if model != "equidistant":
        return np.ones(len(xy), dtype=np.bool_)
    return np.asarray(np.hypot(xy[:, 0], xy[:, 1]) <= usable_disc(coefficients).radius)


def to_usable(xy: Floats, coefficients: Floats, model: str) -> Floats:
    """Return distorted points (N, 2), with those outside the usable disc of an equidistant lens moved to its edge.

    It is `xy` itself for other models.

    Args:
        xy: (N, 2) distorted normalised coordinates.
        coefficients: coefficients of the model; (k1, k2, k3, k4, 0) for `equidistant`.
        model: `brown`, `opencv`, `tsai` or `equidistant`.
    """
    if model != "equidistant":
        return xy
    limit = usable_disc(coefficients).radius * (1.0 - 1e-9)
    radius = np.hypot(xy[:, 0], xy[:, 1])
    return np.asarray(xy * np.minimum(1.0, limit / np.maximum(radius, 1e-300))[:, None])


def fold_radius(coefficients: Floats, model: str, far: float) -> float:
    """Return the ideal normalised radius up to which a polynomial lens is one-to-one; infinite if it exceeds `far`.

    Beyond it the distorted image folds back (OpenCV issue 20736): the determinant of the Jacobian is not positive.
    Infinite for the models `tsai` and `equidistant`.

    Args:
        coefficients: of the model: (k1, k2, p1, p2, k3) for `brown`, the 14 of OpenCV for `opencv`.
        model: `brown`, `opencv`, `tsai` or `equidistant`.
        far: greatest ideal normalised radius that is examined.
    """
    if model not in ("brown", "opencv") or not np.any(coefficients):
        return np.inf
    radius = np.linspace(far / RADII, far, RADII)
    turn = np.linspace(0.0, 2.0 * np.pi, RAYS, endpoint=False)
    xy = (radius[:, None, None] * np.column_stack([np.cos(turn), np.sin(turn)])).reshape(-1, 2)
    with np.errstate(all="ignore"):
        whole = (np.linalg.det(jacobian(xy, coefficients, model)).reshape(RADII, RAYS) > 0.0).all(axis=1)
    return np.inf if whole.all() else float(radius[max(int(np.argmin(whole)) - 1, 0)])


def _bent(theta: Floats, coefficients: Floats) -> Floats:
    """Return distorted normalised radii of rays at angles theta [rad] from the axis of an equidistant lens.

    It is theta (1 + k1 theta^2 + ... + k4 theta^8) for coefficients (k1, k2, k3, k4, 0).
    """
    t2 = theta * theta
    k1, k2, k3, k4, _ = coefficients
    return np.asarray(theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4)))))


def _straight(xy: Floats, coefficients: Floats) -> Floats:
    """Undistort points of an equidistant lens by Newton's method for the angle of each radius.

    Args:
        xy: (N, 2) distorted normalised coordinates.
        coefficients: (5,) k1, k2, k3, k4, 0.

    Returns:
        (N, 2) ideal normalised coordinates, NaN outside the usable disc.
    """
    radius = np.hypot(xy[:, 0], xy[:, 1])
    k1, k2, k3, k4, _ = coefficients
    usable = is_usable(xy, coefficients, "equidistant")
    theta = np.minimum(radius, 1.5)
    for _ in range(50):
        t2 = theta * theta
        slope = 1.0 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)))
        step = (_bent(theta, coefficients) - radius) / np.where(np.abs(slope) < 1e-3, 1e-3, slope)
        theta = np.clip(theta - step, 0.0, np.pi)
        if np.abs(step[usable]).max(initial=0.0) < 1e-13:
            break
    good = usable & (theta < 0.5 * np.pi) & (np.abs(_bent(theta, coefficients) - radius) < 1e-9)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = np.where(radius > 0, np.tan(theta) / radius, 1.0)
    return np.asarray(xy * np.where(good, scale, np.nan)[:, None])


def _polynomial(xy: Floats, coefficients: Floats, model: str) -> Floats:
    """Return the value (N, 2) of the polynomial of a lens at normalised points.

    Args:
        xy: (N, 2) points: ideal for `brown` and `opencv`, distorted for `tsai`.
        coefficients: of the model: (k1, k2, p1, p2, k3) for `brown`, the 14 of OpenCV for `opencv`, (k1, 0, 0, 0, 0)
            for `tsai`.
        model: `brown`, `opencv` or `tsai`.
    """
    x, y = xy[:, 0], xy[:, 1]
    r2 = x * x + y * y
    k1, k2, p1, p2, k3 = coefficients[:5]
    if model == "tsai":
        return np.asarray(xy * (1.0 + k1 * r2)[:, None])
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    dx = 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    dy = p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    if model == "brown":
        return np.column_stack([x * radial + dx, y * radial + dy])
    k4, k5, k6, s1, s2, s3, s4, tau_x, tau_y = coefficients[5:]
    radial = radial / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    dx, dy = dx + r2 * (s1 + r2 * s2), dy + r2 * (s3 + r2 * s4)
    plane = np.column_stack([x * radial + dx, y * radial + dy, np.ones(len(xy))]) @ tilt(tau_x, tau_y).T
    return np.asarray(plane[:, :2] / plane[:, 2:])


def tilt(tau_x: float, tau_y: float) -> Floats:
    """Return the (3, 3) homography of an image sensor that is tilted by tau_x and tau_y [rad] about x and y.

    It maps homogeneous normalised image points of the untilted sensor, as OpenCV's `computeTiltProjectionMatrix`.
    """
    (cx, sx), (cy, sy) = ((np.cos(a), np.sin(a)) for a in (tau_x, tau_y))
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cx, sx], [0.0, -sx, cx]])
    about_y = np.array([[cy, 0.0, -sy], [0.0, 1.0, 0.0], [sy, 0.0, cy]])
    turn = about_y @ about_x
    onto = np.array([[turn[2, 2], 0.0, -turn[0, 2]], [0.0, turn[2, 2], -turn[1, 2]], [0.0, 0.0, 1.0]])
    return np.asarray(onto @ turn)


def jacobian(xy: Floats, coefficients: Floats, model: str) -> Floats:
    """Return the (N, 2, 2) Jacobian of the distortion at ideal points, by central differences.

    Rows are the distorted x and y, columns the ideal x and y.

    Args:
        xy: (N, 2) ideal normalised coordinates.
        coefficients: coefficients of the model, 5 for `brown`, 14 for `opencv`.
        model: a polynomial one, `brown` or `opencv`.
    """
    columns = [
        (_polynomial(xy + step, coefficients, model) - _polynomial(xy - step, coefficients, model)) / (2.0 * DIFFERENCE)
        for step in np.eye(2) * DIFFERENCE
    ]
    return np.stack(columns, axis=-1)


def _invert(xy: Floats, coefficients: Floats, model: str) -> Floats:
    """Return the points (N, 2) at which the polynomial of a lens has the values `xy`, by a fixed-point iteration.

    It converges for distortions of real lenses inside the image.

    Args:
        xy: (N, 2) values of the polynomial, in normalised coordinates.
        coefficients: (k1, k2, p1, p2, k3) for `brown`, (k1, 0, 0, 0, 0) for `tsai`.
        model: `brown`, or `tsai` (its polynomial is from distorted to ideal coordinates).
    """
    guess = xy.copy()
    # Beyond where a lens folds it does not converge
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(50):
            step = xy - _polynomial(guess, coefficients, model)
            guess = guess + step
            if np.abs(step).max(initial=0.0) < 1e-13:
                break
    return guess


def _follow(xy: Floats, coefficients: Floats) -> Floats:
    """Undistort points of OpenCV's complete model by continuation from the principal point.

    Newton's method with increasing radius, so that the solution stays on the branch before the lens folds.

    Args:
        xy: (N, 2) distorted normalised coordinates.
        coefficients: (14,) of the model `opencv`.

    Returns:
        (N, 2) ideal normalised coordinates.
    """
    centre = _polynomial(np.zeros((1, 2)), coefficients, "opencv")
    guess = np.zeros_like(xy)
    for share in np.linspace(0.0, 1.0, HOMOTOPY_STEPS + 1)[1:]:
        wanted = centre + share * (xy - centre)
        for _ in range(NEWTON_STEPS):
            off = wanted - _polynomial(guess, coefficients, "opencv")
            if np.abs(off).max(initial=0.0) < 1e-14:
                break
            slopes = jacobian(guess, coefficients, "opencv")
            regular = np.abs(np.linalg.det(slopes)) > MIN_DETERMINANT
            slopes[~regular] = np.eye(2)
            guess = guess + np.linalg.solve(slopes, off[:, :, None])[:, :, 0]
    return guess
