"""Bundle adjustment of cameras and clocks over the boxes of walking people.

Parameters are the cameras (orientation, position, focal length, radial distortion, clock offset and drift), the path of
each person (position and velocity at every time step, one height and width), the mean height of people, and the bias of
the upper and lower edges of boxes, in common and of each camera. Measurements are the edges of boxes, by the body model
of method `jipda`; paths have white acceleration, and between views that are not shared its changes have a t
distribution, as people may turn there. Errors have a Student t distribution, by iteratively reweighted least
squares. Each Levenberg-Marquardt step eliminates the paths, which are chains in time, by banded Cholesky factors, and
solves for the cameras (Triggs, McLauchlan, Hartley and Fitzgibbon 2000, Sec. 6). Standard deviations are those of an
M-estimator (Huber and Ronchetti 2009, Sec. 7.6), with the scale of errors corrected for the degrees of freedom of the
paths, and with errors correlated in time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
from scipy.linalg import cho_factor, cho_solve, solveh_banded

from occlog.array_types import Bools, Floats, Ints
from occlog.records.scene import Camera
from occlog.track.methods.jipda.interface import HEIGHT, STATE_SIZE, WIDTH
from occlog.track.methods.jipda.kernels.body_box import BOTTOM, LEFT, RIGHT, TOP, pack_views

from .kernels import boxes_and_slopes, expected_boxes

TURN, SHIFT, FOCAL, RADIAL, LATE, DRIFT, UPPER, LOWER, WIDEST = slice(0, 3), slice(3, 6), 6, 7, 8, 9, 10, 11, 12
"""Parameters of a camera: rotation in its own frame [rad], translation in the world, logarithm of the focal length,
first radial coefficient, by how much its clock is late [s], drift of the clock [1], bias of the upper and the lower
edges of its boxes, downwards, in heights of the box, and height of the widest part of people above their middle, which
is between the left and right edges of a body that leans in the image [heights of a person]."""
PARAMETERS = 13
COMMON = 6
"""Parameters of all cameras: mean height of people, and where heads, feet and shoulders differ from the ellipsoid of
the body model: bias of upper and of lower edges [heights of the box], its change with the tangent of the angle from
which people are seen, and height of the widest part above the middle [heights of a person]."""
STEPS = np.array([1e-5] * 3 + [1e-4] * 3 + [1e-5, 1e-5])
"""Steps of difference quotients; lengths in heights of people."""
DEGREES = 4.0
"""Degrees of freedom of the errors of edges."""
ACCELERATION, MIN_ACCELERATION, MAX_ACCELERATION = 0.3, 0.005, 3.0
"""Spectral density of the acceleration of a person per axis, to start from, and its limits [m^2/s^3]."""
MIN_APART = 0.001
"""Least density of the acceleration where it is learned between views [m^2/s^3]."""
MIN_JITTER, MAX_JITTER = 1e-6, 0.05
"""Limits of the density of the random walk of the position [m^2/s]."""
HELD_LEVEL = 0.05
"""Stated inclinations and heights are held to this share of their standard deviations: the mode of the paths would
shrink them, since smaller paths have smaller accelerations."""
BODY_DRIFT = 0.01
"""Standard deviation by which height and width of a person change in one second, in metres."""
SIGMA_SPEED = 1.0
"""Standard deviation of the velocity of a person per axis [m/s]."""
ROUGH_ITERATIONS = (6, 6)
"""Steps before the noise is estimated, and before it is estimated again."""
MAX_ITERATIONS, TOLERANCE = 25, 1e-4
"""Steps at most at the end, and relative decrease of the cost that ends the search."""
SIGMA_COMMON = np.array([0.015, 0.015, 0.03, 0.03, 0.15])
"""Standard deviations of the parameters of all cameras but the mean height."""
MAX_STEEPNESS = 2.0
"""Largest tangent of an angle from which people are seen."""
SIGMA_OWN = np.array([0.005, 0.005, 0.1])
"""Standard deviations of what one camera's upper and lower edges and height of the widest part differ from these.

Which part of a body is the widest depends on the direction from which it is seen and on how far it leans in the image.
"""
PROBES = 4
"""Random vectors by which the share of errors that paths absorb is estimated."""
AXES = ((LEFT, RIGHT), (TOP, BOTTOM))
"""Edges of boxes that share a scale of errors."""
MIN_DAMPING = 1e-9
"""Relative damping of paths that keeps their equations solvable."""
MAX_LAG = 40
"""Lags of the correlation of errors, in observations of one person by one camera."""


class Observations(NamedTuple):
    """N boxes of people at K knots, which are the time steps of each person's path, in order.

    Attributes:
        camera: (N,) index of the camera.
        knot: (N,) index of the knot.
        delay: (N,) stamped time of the box after the time of its knot [s].
        box: (N, 4) left, top, right, bottom [px].
        use: (N, 4) mask of edges that no border of the image truncates.
        first: (P + 1,) person p has the knots first[p] to first[p + 1] - 1.
        time: (K,) times of the knots [s].
    """

    camera: Ints
    knot: Ints
    delay: Floats
    box: Floats
    use: Bools
    first: Ints
    time: Floats

    @property
    def stamps(self) -> Floats:
        """(N,) times of the boxes by the cameras' uncorrected clocks [s]."""
        return np.asarray(self.time[self.knot] + self.delay)


class Clocks(NamedTuple):
    """Clocks of C cameras: true time = stamp - late - drift (stamp - origin).

    Attributes:
        late: (C,) delay of each clock at the origin [s].
        drift: (C,) relative rate by which each clock is fast.
        origin: stamp at which `late` is stated [s].
    """

    late: Floats
    drift: Floats
    origin: float

    def errors(self, camera: Ints | int, stamps: Floats) -> Floats:
        """(N,) errors [s] of the clocks of cameras `camera` (N,), or of one camera, at stamped times (N,) [s].

        Subtract them from the stamps to get true times.
        """
        return np.asarray(self.late[camera] + self.drift[camera] * (stamps - self.origin))


class BodyPrior(NamedTuple):
    """Prior of body sizes, in scene units.

    Attributes:
        height, width: mean height and width of people.
        sigma_height, sigma_width: their standard deviations among people.
        sigma_mean: standard deviation of the mean height.
        metre: length of a metre in scene units.
    """

    height: float
    sigma_height: float
    width: float
    sigma_width: float
    sigma_mean: float
    metre: float


class NoiseModel(NamedTuple):
    """Standard deviation of box edges: `pixels` [px], and `relative` times the height of the box, in quadrature."""

    pixels: float
    relative: float


class PathPrior(NamedTuple):
    """Prior of the paths of people.

    Attributes:
        acceleration: spectral density of the acceleration per axis [m^2/s^3], to start from; with a t distribution
            that where people are seen is held, and that between views is learned.
        jitter: density of a random walk of the position per axis, such as by steps, to start from [m^2/s]; 0: none.
        degrees: degrees of freedom of the t distribution of each change of the state; inf: Gaussian.
    """

    acceleration: float = ACCELERATION
    jitter: float = 0.0
    degrees: float = np.inf


class Adjusted(NamedTuple):
    """Result of a bundle adjustment of C cameras with K path knots and N boxes.

    Attributes:
        cameras: adjusted cameras with their poses.
        values: (C, 13) changes of the parameters of each camera: rotation vector in its frame (3) [rad], translation in
            the world (3), logarithm of the focal length, first radial coefficient, delay of the clock [s], its drift,
            biases of the upper and lower edges of boxes, downwards [heights of the box], and height of the widest part
            above the middle [heights of a person]; biases stay 0.
        covariance: (C 13, C 13) covariance of `values`, row by row; 0 for fixed ones.
        states: (K, 6) x, y, vx, vy, height and width of the people at the knots.
        mean_height: mean height of people, in scene units.
        sigma_mean_height: its standard deviation, biases of edges included.
        residual: (N, 4) observed minus expected edges left, top, right, bottom [px]; NaN: this edge is not used, for
            example because the border of the image truncates the box there.
        sigma: (N, 4) estimated standard deviations of the edges [px].
        correlation: largest factor by which correlation in time and outliers of the boxes' errors multiply variances.
        converged: whether the search converged before the limit of iterations.
    """

    cameras: list[Camera]
    values: Floats
    covariance: Floats
    states: Floats
    mean_height: float
    sigma_mean_height: float
    residual: Floats
    sigma: Floats
    correlation: float
    converged: bool


def changed(camera: Camera, values: Floats) -> Camera:
    """Camera with its pose, focal length and distortion changed by parameters (13,); see `Adjusted.values`.

    Only the first eight have an effect: rotation vector in the camera's frame (3) [rad], translation in the world (3),
    logarithm of the focal length, and first radial coefficient.
    """
    distortion = camera.distortion
    if values[RADIAL] != 0.0:
        distortion = np.array(distortion, dtype=np.float64)
        distortion = np.zeros(5) if not len(distortion) else distortion
        distortion[0] += values[RADIAL]
    return replace(
        camera,
        rotation=camera.rotation @ cv2.Rodrigues(values[TURN])[0],
        position=camera.position + values[SHIFT],
        focal_px=camera.focal_px * np.exp(values[FOCAL]),
        distortion=distortion,
        placed=True,
    )


@dataclass
class Adjustment:
    """Bundle adjustment of cameras and clocks; `run` minimises.

    Attributes:
        cameras: C cameras, from where the search starts.
        seen: observations.
        states: (K, 6) of the people at the knots, to start from.
        body: of people.
        sigma_prior: (C, 13) prior standard deviations of the changes of the parameters; 0: held; inf: free.  Those of
            the biases of edges are estimated from where they are not 0.
        clocks: to start from, which are also the means of their priors.
        noise: of the edges, to start from.
        paths: prior of the paths of people.
        level: standard deviations of the inclination [rad] and the height of the cameras, which start from what is
            stated; inf: not stated.
    """

    cameras: Sequence[Camera]
    seen: Observations
    states: Floats
    body: BodyPrior
    sigma_prior: Floats
    clocks: Clocks
    noise: NoiseModel
    paths: PathPrior = PathPrior()
    level: tuple[float, float] = (np.inf, np.inf)

    def __post_init__(self) -> None:
        """Set parameters and noise to their start values; the states are copied."""
        C, seen = len(self.cameras), self.seen
        self.free = np.append((self.sigma_prior > 0.0).ravel(), [True] + [False] * (COMMON - 1))
        with np.errstate(divide="ignore"):
            precision = np.where(self.sigma_prior > 0.0, 1.0 / self.sigma_prior**2, 0.0).ravel()
        self.precision = np.diag(np.append(precision, [1.0 / self.body.sigma_mean**2] + [0.0] * (COMMON - 1)))
        self.stated = np.zeros_like(self.precision)
        for c, camera in enumerate(self.cameras):
            # Turns in the camera's frame that incline it: all but those about the vertical
            up, own = camera.rotation[2], PARAMETERS * c + np.arange(3)
            self.stated[np.ix_(own, own)] = (np.eye(3) - np.outer(up, up)) / self.level[0] ** 2
            self.stated[own[0] + 5, own[0] + 5] = 1.0 / self.level[1] ** 2
        self.stated /= HELD_LEVEL**2
        self.precision += self.stated
        bias: Floats = np.zeros((C, PARAMETERS))
        bias[:, UPPER:] = SIGMA_OWN
        self.sigma_bias = np.append(bias.ravel(), [0.0, *SIGMA_COMMON])
        self.values = np.zeros(C * PARAMETERS + COMMON)
        self.states = self.states.copy()
        self.motion = _motion(seen, self.body.metre, self.paths, C)
        size = seen.box[:, 3] - seen.box[:, 1]
        self.sigma = np.repeat(np.hypot(self.noise.pixels, self.noise.relative * size)[:, None], 4, axis=1)
        own = np.arange(PARAMETERS) + PARAMETERS * seen.camera[:, None]
        self.columns = np.column_stack([own, np.tile(C * PARAMETERS + np.arange(1, COMMON), (len(own), 1))])
        self.biases = self._bias_slopes()

    def _bias_slopes(self) -> Floats:
        """(N, 4, 8) derivatives of the box edges left, top, right, bottom [px] by eight biases, at the start values.

        The biases are the camera's own of the upper and of the lower edges and of the height of the widest part, then
        those common to all cameras: of upper and lower edges, the change of both with steepness, and the height of the
        widest part.
        """
        seen, height = self.seen, self.body.height
        out, box = np.zeros((len(seen.camera), 4, COMMON + 2)), np.zeros((len(seen.camera), 4))
        delay, states = self._delays(self.values), self.states[seen.knot]
        expected_boxes(pack_views(self.cameras).lens, seen.camera, states, delay, box)
        box = np.where(np.isfinite(box).all(axis=1, keepdims=True), box, seen.box)
        for c, camera in enumerate(self.cameras):
            own = np.flatnonzero(seen.camera == c)
            xy = states[own, :2] + delay[own, None] * states[own, 2:4]
            away = np.maximum(np.linalg.norm(camera.position[:2] - xy, axis=1), 1e-9)
            steep = np.clip((camera.position[2] - 0.5 * height) / away, -MAX_STEEPNESS, MAX_STEEPNESS)
            size = box[own, BOTTOM] - box[own, TOP]
            for k, edge in enumerate((TOP, BOTTOM)):
                out[own, edge, k] = out[own, edge, 3 + k] = size
                out[own, edge, 5 + k] = size * steep
            ends = [camera.project(np.column_stack([xy, np.full(len(own), share * height)])) for share in (0.4, 0.6)]
            leans = np.nan_to_num((ends[1] - ends[0])[:, :1] / 0.2)
            out[own[:, None], [LEFT, RIGHT], 2] = out[own[:, None], [LEFT, RIGHT], 7] = leans
        return out

    def run(self) -> Adjusted:
        """Adjust cameras, clocks, paths and body sizes to the boxes; return the result with its covariance.

        A few searches of limited length, after each of which the noise is scaled to the residuals, then one to the end.
        """
        for limit in ROUGH_ITERATIONS:
            self._search(limit)
            self._rescale()
        converged = self._search(MAX_ITERATIONS)
        C, equations = len(self.cameras), self._equations(self.values, self.states)
        correlation = self._correlation(equations)
        covariance = self._covariance(equations, correlation)
        residual = np.where(self.seen.use & equations.good[:, None], equations.residual, np.nan)
        values = self.values[:-COMMON].reshape(C, PARAMETERS)
        return Adjusted(
            [changed(c, v) for c, v in zip(self.cameras, values, strict=True)], values,
            covariance[:-COMMON, :-COMMON], self.states, self.body.height + float(self.values[-COMMON]),
            float(np.sqrt(max(covariance[-COMMON, -COMMON], 0.0))), residual, self.sigma, float(correlation.max()),
            converged,
        )  # fmt: skip

    def _search(self, limit: int) -> bool:
        """Levenberg-Marquardt iterations up to a limit, updating values and states; return whether they converged."""
        damping = 1e-4
        equations = self._equations(self.values, self.states)
        for _ in range(limit):
            while True:
                step, moved = self._step(equations, damping)
                tried = self._equations(self.values + step, self.states + moved)
                if tried.cost < equations.cost:
                    break
                damping *= 10.0
                if damping > 1e8:
                    return True
            gain = (equations.cost - tried.cost) / equations.cost

            self.values, self.states, equations = self.values + step, self.states + moved, tried
            damping = max(damping * 0.1, 1e-9)
            if gain < TOLERANCE:
                return True
        return False

    def _delays(self, values: Floats) -> Floats:
        """(N,) true time of each box after that of its knot [s], given the parameters `values` (C 13 + 6,).

        They are `Adjusted.values` row by row, then the six that all cameras have in common.
        """
        seen, change = self.seen, values[:-COMMON].reshape(-1, PARAMETERS)
        clocks = Clocks(self.clocks.late + change[:, LATE], self.clocks.drift + change[:, DRIFT], self.clocks.origin)
        return np.asarray(seen.delay - clocks.errors(seen.camera, seen.stamps))

    def _equations(self, values: Floats, states: Floats) -> _LinearisedFit:
        """Residuals, robust cost, weights and derivatives at the parameters `values` and the path states `states`.

        `values` (C 13 + 6,) are `Adjusted.values` row by row, then the change of the mean height and five biases that
        all cameras have in common; `states` (K, 6) are x, y, vx, vy, height and width at each knot.
        """
        seen, C = self.seen, len(self.cameras)
        N = len(seen.camera)
        changes = values[:-COMMON].reshape(C, PARAMETERS)
        lens = pack_views([changed(c, v) for c, v in zip(self.cameras, changes, strict=True)]).lens
        delay, of_knot = self._delays(values), states[seen.knot]
        box, slope, good = np.zeros((N, 4)), np.zeros((N, 4, STATE_SIZE)), np.zeros(N, dtype=np.bool_)
        boxes_and_slopes(lens, seen.camera, of_knot, delay, box, slope, good)
        residual = np.where(good[:, None], seen.box - box, 0.0)
        scaled = residual / self.sigma
        use = seen.use & good[:, None]
        # A person behind the camera costs as a far outlier does
        missing = np.count_nonzero(seen.use[~good])
        robust = 0.5 * (DEGREES + 1.0) * np.log1p(scaled**2 / DEGREES)
        cost = float(robust[use].sum()) + missing * 0.5 * (DEGREES + 1.0) * np.log1p(400.0 / DEGREES)
        cost += float(0.5 * values @ self.precision @ values)
        cost += self.motion.cost(states) + self._body_cost(values, states)
        weight = np.where(use, (DEGREES + 1.0) / (DEGREES + scaled**2) / self.sigma**2, 0.0)
        return _LinearisedFit(cost, residual, weight, slope, delay, good, values, states)

    def _body_cost(self, values: Floats, states: Floats) -> float:
        first = states[self.seen.first[:-1]]
        tall = (first[:, HEIGHT] - self.body.height - values[-COMMON]) / self.body.sigma_height
        wide = (first[:, WIDTH] - self.body.width) / self.body.sigma_width
        speed = first[:, 2:4] / (SIGMA_SPEED * self.body.metre)
        return float(0.5 * ((tall**2).sum() + (wide**2).sum() + (speed**2).sum()))

    def _camera_slopes(self, equations: _LinearisedFit) -> Floats:
        """(N, 4, 18) derivatives of the box edges left, top, right, bottom [px] by 13 parameters and 5 common biases.

        The parameters are those of the box's camera. By central differences for pose and lens; 0 for parameters that
        are fixed in all cameras.
        """
        seen, C = self.seen, len(self.cameras)
        N = len(seen.camera)
        out = np.zeros((N, 4, PARAMETERS + COMMON - 1))
        changes = equations.values[:-COMMON].reshape(C, PARAMETERS)
        free = self.free[:-COMMON].reshape(C, PARAMETERS)
        of_knot = equations.states[seen.knot]
        high, low = np.zeros((N, 4)), np.zeros((N, 4))
        for k in range(LATE):
            if not free[:, k].any():
                continue
            step = STEPS[k] * (self.body.height if 3 <= k < 6 else 1.0)
            delta = np.zeros(PARAMETERS)
            delta[k] = step
            for sign, into in ((1.0, high), (-1.0, low)):
                moved = [changed(c, v + sign * delta) for c, v in zip(self.cameras, changes, strict=True)]
                lens = pack_views(moved).lens
                expected_boxes(lens, seen.camera, of_knot, equations.delay, into)
            out[:, :, k] = np.nan_to_num((high - low) / (2.0 * step))
        out[:, :, UPPER:] = self.biases
        out[:, :, LATE] = -np.einsum("nek,nk->ne", equations.slope[:, :, :2], of_knot[:, 2:4])
        out[:, :, DRIFT] = out[:, :, LATE] * (seen.stamps - self.clocks.origin)[:, None]
        return out

    def _paths(self, equations: _LinearisedFit, inflate: Floats) -> tuple[Floats, Floats, Floats]:
        """Normal equations of the paths: diagonal blocks (K, 6, 6), blocks below them (K, 6, 6), and right side (K, 6).

        `inflate` (4,) are factors of the variances of the edges left, top, right, bottom.
        """
        seen, body, states = self.seen, self.body, equations.states
        K, first = len(seen.time), seen.first[:-1]
        Js = equations.slope * (equations.weight / inflate)[:, :, None]
        A, g = np.zeros((K, STATE_SIZE, STATE_SIZE)), np.zeros((K, STATE_SIZE))
        np.add.at(A, seen.knot, np.swapaxes(Js, 1, 2) @ equations.slope)
        np.add.at(g, seen.knot, np.einsum("nei,ne->ni", Js, equations.residual))
        # Bodies, and velocities at the begin
        means = (0.0, 0.0, body.height + equations.values[-COMMON], body.width)
        sigmas = (SIGMA_SPEED * body.metre, SIGMA_SPEED * body.metre, body.sigma_height, body.sigma_width)
        for k, mean, sigma in zip((2, 3, HEIGHT, WIDTH), means, sigmas, strict=True):
            A[first, k, k] += 1.0 / sigma**2
            g[first, k] -= (states[first, k] - mean) / sigma**2
        off = self.motion.add(states, A, g)
        # People whom no camera sees from where they are
        A[:, np.arange(STATE_SIZE), np.arange(STATE_SIZE)] *= 1.0 + MIN_DAMPING
        return A, off, g

    def _solved(self, A: Floats, off: Floats, right: Floats) -> Floats:
        """(K, 6, R) solution of the block tridiagonal normal equations of the paths, which have K states in all.

        Args:
            A: (K, 6, 6) diagonal blocks.
            off: (K, 6, 6) blocks below the diagonal; those at the ends of paths are not used.
            right: (K, 6, R) right sides.
        """
        out = np.zeros_like(right)
        first, R = self.seen.first, right.shape[2]
        for p0, p1 in zip(first[:-1].tolist(), first[1:].tolist(), strict=True):
            banded = _banded(A[p0:p1], off[p0 : p1 - 1])
            solved = solveh_banded(banded, right[p0:p1].reshape(-1, R), lower=True)
            out[p0:p1] = solved.reshape(p1 - p0, STATE_SIZE, R)
        return out

    def _reduced(self, equations: _LinearisedFit, damping: float, inflate: Floats = np.ones(4)) -> _Reduced:  # noqa: B008
        """Normal equations of the cameras after elimination of the paths (Schur complement).

        `damping` is relative to the diagonal of the paths' blocks; `inflate` (4,) are factors of the variances of
        the edges left, top, right, bottom.
        """
        seen, C, body = self.seen, len(self.cameras), self.body
        K, M = len(seen.time), len(self.values)
        A, off, g = self._paths(equations, inflate)
        weight, camera = equations.weight / inflate, self._camera_slopes(equations)
        Jc = camera * weight[:, :, None]
        B = np.zeros((K, STATE_SIZE, M))
        np.add.at(
            B,
            (seen.knot[:, None, None], np.arange(STATE_SIZE)[None, :, None], self.columns[:, None, :]),
            np.swapaxes(equations.slope, 1, 2) @ Jc,
        )
        H, b = self.precision.copy(), -self.precision @ equations.values
        for c in range(C):
            own = np.flatnonzero(seen.camera == c)
            if len(own):
                of = self.columns[own[0]]
                flat = Jc[own].reshape(-1, len(of))
                H[np.ix_(of, of)] += flat.T @ camera[own].reshape(-1, len(of))
                b[of] += flat.T @ equations.residual[own].ravel()
        first, p = seen.first[:-1], 1.0 / body.sigma_height**2
        mean = M - COMMON
        B[first, HEIGHT, mean] -= p
        H[mean, mean] += p * len(first)
        b[mean] += p * float((equations.states[first, HEIGHT] - body.height - equations.values[mean]).sum())
        # Damping also keeps what nothing determines where it is
        A[:, np.arange(STATE_SIZE), np.arange(STATE_SIZE)] *= 1.0 + damping
        solved = self._solved(A, off, np.concatenate([g[:, :, None], B], axis=2))
        flat = B.reshape(-1, M)
        S = H - flat.T @ solved[:, :, 1:].reshape(-1, M)
        s = b - flat.T @ solved[:, :, 0].ravel()
        return _Reduced(0.5 * (S + S.T), s, solved)

    def _step(self, equations: _LinearisedFit, damping: float) -> tuple[Floats, Floats]:
        """Damped step: changes (C 13 + 6,) of the parameters, 0 for fixed ones, and of the path states (K, 6).

        `damping` is relative to the diagonal of the equations (Levenberg-Marquardt).
        """
        reduced = self._reduced(equations, damping)
        free = np.flatnonzero(self.free)
        S = reduced.matrix[np.ix_(free, free)]
        S = S + np.diag(damping * np.diag(S) + 1e-12)
        step = np.zeros(len(self.values))
        step[free] = cho_solve(cho_factor(S), reduced.right[free])
        moved = reduced.solved[:, :, 0] - reduced.solved[:, :, 1:] @ step
        return step, moved

    def _rescale(self) -> None:
        """Re-estimate the noise of box edges and the acceleration of people from the residuals, in place."""
        equations = self._equations(self.values, self.states)
        use = equations.weight > 0.0
        shares, absorbed = self._absorbed(equations)
        left = 1.0 - shares
        size = np.repeat((self.seen.box[:, 3] - self.seen.box[:, 1])[:, None], 4, axis=1)
        for axis, edges in enumerate(AXES):
            own = np.zeros_like(use)
            own[:, edges] = use[:, edges]
            # Student's t with 4 degrees of freedom: the median of |x| is 0.741
            square = np.abs(equations.residual[own]) / (0.741 * np.sqrt(left[axis]))
            low, high = np.median(size[own]) * 0.7, np.median(size[own]) * 1.3
            small, large = square[size[own] <= low], square[size[own] >= high]
            if len(small) < 20 or len(large) < 20:
                scale = np.median(square / self.sigma[own])
                self.sigma[:, edges] *= max(float(scale), 1e-3)
                continue
            a, b = float(np.median(small)), float(np.median(large))
            x, y = float(np.median(size[own][size[own] <= low])), float(np.median(size[own][size[own] >= high]))
            relative = max((b**2 - a**2) / (y**2 - x**2), 0.0)
            pixels = max(a**2 - relative * x**2, 0.25)
            self.sigma[:, edges] = np.sqrt(pixels + relative * size[:, edges] ** 2)
        # Variance components of the motion (Förstner 1979)
        if len(self.motion.inner):
            if self.motion.apart.any():
                absorbed = absorbed + self._of_cameras(equations)
            self.motion = self.motion.rescaled(self.states, absorbed)

    def _of_cameras(self, equations: _LinearisedFit) -> Floats:
        """(D,) sums of squares of each density's part of the changes of the motion that the cameras' errors take up."""
        motion, solved = self.motion, self._reduced(equations, 0.0)
        moved = (solved.solved[motion.inner + 1] - motion.transition @ solved.solved[motion.inner])[:, :4, 1:]
        spread = moved @ self._inverse(solved.matrix) @ np.swapaxes(moved, 1, 2)
        return np.array([np.einsum("lij,lik,lkj->", U, spread, U) for U in motion.pushes(self.states)])

    def _absorbed(self, equations: _LinearisedFit) -> tuple[Floats, Floats]:
        """Return what the estimated paths take up of the errors of boxes and of the changes of the motion.

        Both are estimated by random signs (Hutchinson 1990).

        Returns:
            (2,) share of the degrees of freedom of left and right, and of upper and lower edges, at most 0.9: mean of
            the diagonal of the hat matrix; and (D,) for each density of the motion by how much the expected sum of
            |U' d|^2 (U from `pushes`) of estimated changes d is smaller than that of the true changes.
        """
        A, off, _ = self._paths(equations, np.ones(4))
        seen, motion, rng = self.seen, self.motion, np.random.default_rng(0)
        inner, root = motion.inner, np.sqrt(equations.weight)
        signs = rng.choice([-1.0, 1.0], (PROBES, *root.shape)) * root
        ways = np.array(motion.pushes(self.states))
        D = len(ways)
        drawn = rng.choice([-1.0, 1.0], (PROBES, D, len(inner), 4))
        pushes = np.einsum("rdlj,dlij->drli", drawn, ways).reshape(D * PROBES, len(inner), 4)
        columns = (1 + D) * PROBES
        right = np.zeros((len(seen.time), STATE_SIZE, columns))
        np.add.at(right, seen.knot, np.einsum("nei,rne->nir", equations.slope, signs) @ np.eye(PROBES, columns))
        forced = np.moveaxis(pushes, 0, 2) @ np.eye(D * PROBES, columns, PROBES)
        right[inner + 1, :4] += forced
        right[inner] -= np.einsum("lji,ljr->lir", motion.transition[:, :4], forced)
        solved = self._solved(A, off, right)
        hat = np.einsum("rne,nei,nir->ne", signs, equations.slope, solved[seen.knot][..., :PROBES]) / PROBES
        use = equations.weight > 0.0
        shares = [hat[:, edges].sum() / max(np.count_nonzero(use[:, edges]), 1) for edges in AXES]
        moved = solved[inner + 1] - motion.transition @ solved[inner]
        of_motion = np.einsum("rli,lir->r", pushes, moved[:, :4, PROBES:]).reshape(D, PROBES).mean(axis=1)
        return np.clip(shares, 0.0, 0.9), of_motion

    def _correlation(self, equations: _LinearisedFit) -> Floats:
        """Variance inflation factors (4,) of the normal equations, of the edges left, top, right, bottom.

        Errors of one person in one camera are correlated in time, and those of left and right edges with each other;
        the equations of an M-estimator use mean weights in place of the derivative of the influence function.
        """
        seen, use = self.seen, equations.weight > 0.0
        scaled = np.where(use, equations.residual / self.sigma, 0.0)
        influence = (DEGREES + 1.0) * scaled / (DEGREES + scaled**2)
        slope = (DEGREES + 1.0) * (DEGREES - scaled**2) / (DEGREES + scaled**2) ** 2
        weight = (DEGREES + 1.0) / (DEGREES + scaled**2)
        person = np.searchsorted(seen.first, seen.knot, side="right") - 1
        order = np.lexsort((seen.knot, seen.camera, person))
        group = (person * len(self.cameras) + seen.camera)[order]
        left = 1.0 - self._absorbed(equations)[0]
        out = np.ones(4)
        for axis, edges in enumerate(AXES):
            x, used = influence[:, edges], use[:, edges]
            robust = (x[used] ** 2).mean() / left[axis] * weight[:, edges][used].mean()
            robust /= max(float(slope[:, edges][used].mean()), 0.1) ** 2
            total = float((x**2).sum())
            if axis == 0:
                x = x.sum(axis=1, keepdims=True)
            out[list(edges)] = robust * _time_factor(x[order], group, total)
        return out

    def _inverse(self, matrix: Floats) -> Floats:
        """Pseudo-inverse of the block of a matrix (M, M) with the free parameters; 0 for fixed parameters."""
        free = np.flatnonzero(self.free)
        out, part = np.zeros_like(matrix), matrix[np.ix_(free, free)]
        scale = 1.0 / np.sqrt(np.maximum(np.diag(part), 1e-300))
        out[np.ix_(free, free)] = scale[:, None] * np.linalg.pinv(part * np.outer(scale, scale), hermitian=True) * scale
        return out

    def _covariance(self, equations: _LinearisedFit, correlation: Floats) -> Floats:
        """(C 13 + 6, C 13 + 6) covariance of all parameters, of which the biases of edges have none.

        Biases of edges and stated inclinations and heights are consider parameters (Schmidt 1966): they are not
        estimated, since small errors of the body model would make biases large, but their effect on the estimates is
        added.

        Args:
            equations: normal equations at the solution.
            correlation: (4,) variance inflation factors of the edges.
        """
        if self.motion.apart.any():
            self.motion = self.motion.robust(
                equations.states, self._absorbed(equations)[1] + self._of_cameras(equations)
            )
        exact = self._reduced(equations, 0.0).matrix
        inverse = self._inverse(exact)
        gain = inverse @ (exact * self.sigma_bias)
        # Of the errors of what is stated the inverse contains a small share already
        held = inverse @ self.stated @ inverse * (HELD_LEVEL**-2 - 1.0)
        covariance = self._inverse(self._reduced(equations, 0.0, correlation).matrix) + gain @ gain.T + held
        return np.asarray(covariance)


def _time_factor(x: Floats, group: Ints, total: float) -> float:
    """Factor by which autocorrelation in time multiplies the variance of a mean of errors, at least 1.

    Args:
        x: (N, E) errors, those of a group one after the other in the order of time.
        group: (N,) group of each row.
        total: sum of squares expected for independent errors.
    """
    factor = float((x**2).sum()) / max(total, 1e-12)
    for lag in range(1, MAX_LAG + 1):
        same = group[lag:] == group[:-lag]
        if not same.any():
            break
        rho = float((x[lag:] * x[:-lag])[same].sum()) / max(total, 1e-12)
        if rho < 0.02:
            break
        factor += 2.0 * rho
    return max(factor, 1.0)


class _LinearisedFit(NamedTuple):
    """Residuals of the observations at some parameters, their weights and derivatives, and the path states."""

    cost: float
    residual: Floats
    weight: Floats
    slope: Floats
    delay: Floats
    good: Bools
    values: Floats
    states: Floats


class _Reduced(NamedTuple):
    matrix: Floats
    right: Floats
    solved: Floats


class _Motion(NamedTuple):
    """Prior of the paths: from each knot to the next of the same person."""

    inner: Ints  # (L,) knots with a successor
    transition: Floats  # (L, 6, 6)
    precision: Floats  # (L, 6, 6)
    apart: Bools  # (L,) no camera sees the person at both knots
    roots: Floats  # (D, L, 4, 4) of covariances of position and velocity, per unit of each density
    densities: Floats  # (D,) of the acceleration, that of changes that are `apart`, and the random walk
    limits: Floats  # (D, 2)
    body: Floats  # (L,) variances of the changes of height and of width
    degrees: float  # of the t distribution
    inflation: float  # of the variance of changes that are `apart`

    def _off(self, states: Floats) -> Floats:
        return np.asarray(states[self.inner + 1] - np.einsum("lij,lj->li", self.transition, states[self.inner]))

    def squares(self, states: Floats) -> Floats:
        """(L,) squared Mahalanobis lengths of the L changes of position and velocity in `states` (K, 6)."""
        off = self._off(states)[:, :4]
        return np.asarray(np.einsum("li,lij,lj->l", off, self.precision[:, :4, :4], off))

    def weights(self, states: Floats) -> Floats:
        """(L,) factors of the precision of position and velocity (iteratively reweighted least squares)."""
        if np.isinf(self.degrees):
            return np.ones(len(self.inner))
        weight = (self.degrees + 4.0) / (self.degrees + self.squares(states))
        return np.where(self.apart, weight / self.inflation, weight)

    def pushes(self, states: Floats) -> list[Floats]:
        """For each density (L, 4, 4) matrices U: the sum of |U' d|^2 of the changes d (L, 4) measures it."""
        weight = np.sqrt(self.weights(states))[:, None, None]
        return [weight * (self.precision[:, :4, :4] @ root) for root in self.roots]

    def cost(self, states: Floats) -> float:
        """Negative log prior of all transitions between `states` (K, 6), up to a constant."""
        off, square = self._off(states), self.squares(states)
        body = np.einsum("li,lij,lj->", off[:, 4:], self.precision[:, 4:, 4:], off[:, 4:])
        if np.isfinite(self.degrees):
            square = (self.degrees + 4.0) * np.log1p(square / self.degrees)
        return float(0.5 * (body + square.sum()))

    def add(self, states: Floats, A: Floats, g: Floats) -> Floats:
        """Add the prior to the normal equations of the paths, in place; return the blocks (K, 6, 6) below the diagonal.

        Args:
            states: (K, 6) states of all paths.
            A: (K, 6, 6) diagonal blocks, updated.
            g: (K, 6) right side, updated.
        """
        off, P, F = self._off(states), self.precision.copy(), self.transition
        P[:, :4] *= self.weights(states)[:, None, None]
        PF = P @ F
        A[self.inner] += np.swapaxes(F, 1, 2) @ PF
        A[self.inner + 1] += P
        g[self.inner] += np.einsum("lji,lj->li", PF, off)
        g[self.inner + 1] -= np.einsum("lij,lj->li", P, off)
        below = np.zeros_like(A)
        below[self.inner] = -PF
        return below

    def rescaled(self, states: Floats, absorbed: Floats) -> _Motion:
        """Re-estimate the densities from the changes in `states` (K, 6); estimates take up (D,) `absorbed` of them."""
        off, densities = self._off(states)[:, :4], self.densities.copy()
        for k, (push, root) in enumerate(zip(self.pushes(states), self.roots, strict=True)):
            whole = np.einsum("lji,ljk,lki->", root, self.precision[:, :4, :4], root)
            square = (np.einsum("lji,lj->li", push, off) ** 2).sum()
            densities[k] *= square / max(whole - absorbed[k], 0.01 * whole) if whole > 0.0 else 1.0
        return self.of(np.clip(densities, *self.limits.T))

    def of(self, densities: Floats) -> _Motion:
        """This prior with other densities (D,)."""
        Q = np.zeros((len(self.inner), STATE_SIZE, STATE_SIZE))
        Q[:, :4, :4] = np.einsum("d,dlij,dlkj->lik", densities, self.roots, self.roots)
        Q[:, HEIGHT, HEIGHT] = Q[:, WIDTH, WIDTH] = self.body
        return self._replace(densities=densities, precision=np.asarray(np.linalg.inv(Q), dtype=np.float64))

    def robust(self, states: Floats, absorbed: Floats) -> _Motion:
        """This prior with the variance inflation of an M-estimator for changes between views.

        Args:
            states: (K, 6) states of all paths.
            absorbed: (D,) what the estimates take up of the squares of changes.
        """
        if not self.apart.any():
            return self
        v, square = self.degrees, self.squares(states)[self.apart]
        weight = (v + 4.0) / (v + square)
        slope = float((weight * (1.0 - 0.5 * square / (v + square))).mean())
        left = max(1.0 - float(absorbed[1] * self.densities[1]) / (4.0 * len(square)), 0.1)
        influence = float((weight**2 * square).mean()) / (4.0 * left)
        return self._replace(inflation=max(influence * float(weight.mean()) / slope**2, 1.0))


def _motion(seen: Observations, metre: float, prior: PathPrior, count: int) -> _Motion:
    """Prior of the paths: white acceleration, a random walk of the position, and nearly constant body size.

    Args:
        seen: has the times of the paths' states.
        metre: a metre in scene units.
        prior: of the paths.
        count: number of cameras.
    """
    has = np.zeros((len(seen.time), count), dtype=np.bool_)
    has[seen.knot, seen.camera] = True
    inner = np.setdiff1d(np.arange(len(seen.time)), seen.first[1:] - 1)
    dt = seen.time[inner + 1] - seen.time[inner]
    L, own = len(inner), np.arange(2)
    F, root, walk = np.tile(np.eye(STATE_SIZE), (L, 1, 1)), np.zeros((L, 4, 4)), np.zeros((L, 4, 4))
    F[:, own, own + 2] = dt[:, None]
    # Cholesky factor of the covariance of white acceleration, density 1
    root[:, own, own] = metre * np.sqrt(dt**3 / 3.0)[:, None]
    root[:, own + 2, own] = metre * np.sqrt(0.75 * dt)[:, None]
    root[:, own + 2, own + 2] = metre * np.sqrt(0.25 * dt)[:, None]
    walk[:, own, own] = metre * np.sqrt(dt)[:, None]
    apart = ~(has[inner] & has[inner + 1]).any(axis=1) & np.isfinite(prior.degrees)
    roots, start = [root], [prior.acceleration]
    limits = [(MIN_ACCELERATION, MAX_ACCELERATION)]
    if np.isfinite(prior.degrees):
        roots = [root * ~apart[:, None, None], root * apart[:, None, None]]
        start, limits = start * 2, [(prior.acceleration, prior.acceleration), (MIN_APART, MAX_ACCELERATION)]
    if prior.jitter > 0.0:
        roots, start, limits = [*roots, walk], [*start, prior.jitter], [*limits, (MIN_JITTER, MAX_JITTER)]
    made = _Motion(
        inner, F, np.zeros((L, STATE_SIZE, STATE_SIZE)), apart, np.array(roots), np.zeros(0), np.array(limits),
        (BODY_DRIFT * metre) ** 2 * dt, prior.degrees, 1.0,
    )  # fmt: skip
    return made.of(np.array(start))


def _banded(diagonal: Floats, below: Floats) -> Floats:
    """(12, 6 T) lower banded form, as `scipy.linalg.solveh_banded` takes it, of a symmetric block tridiagonal matrix.

    `diagonal` (T, 6, 6) and `below` (T - 1, 6, 6) are its blocks.
    """
    n = STATE_SIZE
    T = len(diagonal)
    out = np.zeros((2 * n, T * n))
    for i in range(n):
        for j in range(i + 1):
            out[i - j, j::n] = diagonal[:, i, j]
        for j in range(n):
            out[n + i - j, j : (T - 1) * n : n] = below[:, i, j]
    return out
