"""Bundle adjustment of cameras and clocks over the boxes of walking people.

Unknown are the cameras (orientation, position, focal length, radial distortion, offset of the clock), the path of each
person (position and velocity at every time step, one height and width), and the mean height of people.  The
measurements are the edges of boxes, by the body model of method `jipda`; paths have white acceleration.  Errors are of
Student's t distribution, by iteratively reweighted least squares.  Each step of Levenberg and Marquardt eliminates the
paths, which are chains in time, by banded Cholesky factors, and solves for the cameras (Triggs, McLauchlan, Hartley and
Fitzgibbon 2000, Sec. 6).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solveh_banded

from occlog.array_types import Bools, Floats, Ints
from occlog.records.scene import Camera
from occlog.track.methods.jipda.interface import HEIGHT, STATE_SIZE, WIDTH
from occlog.track.methods.jipda.kernels.body_box import BOTTOM, TOP, pack_views

from .kernels import boxes_and_slopes, expected_boxes

TURN, SHIFT, FOCAL, RADIAL, LATE = slice(0, 3), slice(3, 6), 6, 7, 8
"""Parameters of a camera: rotation in its own frame [rad], translation in the world, logarithm of the focal length,
first radial coefficient, and by how much its clock is late [s]."""
PARAMETERS = 9
STEPS = np.array([1e-5] * 3 + [1e-4] * 3 + [1e-5, 1e-5])
"""Steps of difference quotients; lengths in heights of people."""
DEGREES = 4.0
"""Degrees of freedom of the errors of edges."""
ACCELERATION = 0.3
"""Spectral density of the acceleration of a person per axis [m^2/s^3]."""
BODY_DRIFT = 0.01
"""Standard deviation by which height and width of a person change in one second, in metres."""
SIGMA_SPEED = 1.0
"""Standard deviation of the velocity of a person per axis [m/s]."""
ROUGH_ITERATIONS = (6, 6)
"""Steps before the noise is estimated, and before it is estimated again."""
MAX_ITERATIONS, TOLERANCE = 25, 1e-4
"""Steps at most at the end, and relative decrease of the cost that ends the search."""
SIGMA_EDGE_BIAS = 0.025
"""Standard deviation of the bias of upper and lower edges of the boxes of one camera, in heights."""
MAX_LAG = 40
"""Lags of the correlation of errors, in observations of one person by one camera."""


class Observations(NamedTuple):
    """Boxes of N observations of people at K knots, which are the time steps of each person, in order.

    Attributes:
        camera: (N,) number of the camera.
        knot: (N,) number of the knot.
        delay: (N,) stamped time after that of the knot [s].
        box: (N, 4) left, top, right, bottom [px].
        use: (N, 4) edges that no border of the image cuts.
        first: (P + 1,) person p has the knots first[p] to first[p + 1] - 1.
        time: (K,) of the knots [s].
    """

    camera: Ints
    knot: Ints
    delay: Floats
    box: Floats
    use: Bools
    first: Ints
    time: Floats


class BodyPrior(NamedTuple):
    """People: mean height and width, their standard deviations, that of the mean height, and units in a metre."""

    height: float
    sigma_height: float
    width: float
    sigma_width: float
    sigma_mean: float
    metre: float


class NoiseModel(NamedTuple):
    """Errors of the edges of boxes: a part in pixels, and a part of the height of the box."""

    pixels: float
    relative: float


class Adjusted(NamedTuple):
    """Result of an adjustment.

    Attributes:
        cameras: with their poses.
        values: (C, 9) changes of the parameters.
        covariance: (C 9, C 9) of the parameters; 0 of those that are held.
        states: (K, 6) of the people at the knots.
        mean_height: of people.
        residual: (N, 4) observed minus expected edges [px]; NaN: not used.
        sigma: (N, 4) standard deviations of edges [px] that were found.
        correlation: factor by which the correlation of errors in time widens variances.
        converged: the search ended by itself.
    """

    cameras: list[Camera]
    values: Floats
    covariance: Floats
    states: Floats
    mean_height: float
    residual: Floats
    sigma: Floats
    correlation: float
    converged: bool


def changed(camera: Camera, values: Floats) -> Camera:
    """A camera after a change of its parameters (9,); the clock is not part of it."""
    distortion = camera.distortion
    if values[RADIAL] != 0.0:
        distortion = np.array(distortion, dtype=np.float64)
        distortion = np.zeros(5) if not len(distortion) else distortion
        distortion[0] += values[RADIAL]
    return replace(
        camera,
        rotation=camera.rotation @ rotation_of(values[TURN]),
        position=camera.position + values[SHIFT],
        focal_px=camera.focal_px * np.exp(values[FOCAL]),
        distortion=distortion,
        placed=True,
    )


def rotation_of(turn: Floats) -> Floats:
    """(3, 3) rotation about an axis (3,) by its length [rad], by Rodrigues' formula."""
    angle = float(np.linalg.norm(turn))
    x, y, z = turn
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-8:
        return np.asarray(np.eye(3) + cross)
    return np.asarray(np.eye(3) + np.sin(angle) / angle * cross + (1.0 - np.cos(angle)) / angle**2 * cross @ cross)


def adjust(
    cameras: Sequence[Camera],
    seen: Observations,
    states: Floats,
    body: BodyPrior,
    sigma: Floats,
    late: Floats,
    noise: NoiseModel,
) -> Adjusted:
    """Adjust cameras and clocks.

    Args:
        cameras: C cameras, from where the search starts.
        seen: observations.
        states: (K, 6) of the people at the knots, to start from.
        body: of people.
        sigma: (C, 9) prior standard deviations of the changes of the parameters; 0: held; inf: free.
        late: (C,) offsets of the clocks to start from [s], which are also the means of their priors.
        noise: of the edges, to start from.
    """
    return _Adjustment(cameras, seen, states, body, sigma, late, noise).run()


class _Adjustment:
    """The search, with its state."""

    def __init__(
        self,
        cameras: Sequence[Camera],
        seen: Observations,
        states: Floats,
        body: BodyPrior,
        sigma: Floats,
        late: Floats,
        noise: NoiseModel,
    ) -> None:
        self.cameras, self.seen, self.body = list(cameras), seen, body
        self.late, self.noise = late, noise
        C = len(cameras)
        self.free = np.append((sigma > 0.0).ravel(), True)
        with np.errstate(divide="ignore"):
            precision = np.where(sigma > 0.0, 1.0 / sigma**2, 0.0).ravel()
        self.precision = np.append(precision, 1.0 / body.sigma_mean**2)
        self.values = np.zeros(C * PARAMETERS + 1)
        self.states = states.copy()
        self.motion = _motion(seen, body.metre)
        size = seen.box[:, 3] - seen.box[:, 1]
        self.sigma = np.repeat(np.hypot(noise.pixels, noise.relative * size)[:, None], 4, axis=1)
        self.correlation = 1.0

    def run(self) -> Adjusted:
        """Search; rescale the noise; search on; the covariance at the end."""
        for limit in ROUGH_ITERATIONS:
            self._search(limit)
            self._rescale()
        converged = self._search(MAX_ITERATIONS)
        self.correlation = self._correlation()
        equations = self._equations(self.values, self.states)
        covariance = self._covariance(equations)
        C = len(self.cameras)
        residual = np.where(self.seen.use & equations.good[:, None], equations.residual, np.nan)
        values = self.values[:-1].reshape(C, PARAMETERS)
        return Adjusted(
            [changed(c, v) for c, v in zip(self.cameras, values, strict=True)], values, covariance, self.states,
            self.body.height + float(self.values[-1]), residual, self.sigma, self.correlation, converged,
        )  # fmt: skip

    def _search(self, limit: int) -> bool:
        """Levenberg-Marquardt; whether it converged."""
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
        """(N,) true time of each observation after its knot [s]."""
        late = self.late + values[:-1].reshape(-1, PARAMETERS)[:, LATE]
        return np.asarray(self.seen.delay - late[self.seen.camera])

    def _equations(self, values: Floats, states: Floats) -> _Equations:
        """Residuals, cost and derivatives."""
        seen, C = self.seen, len(self.cameras)
        N = len(seen.camera)
        changes = values[:-1].reshape(C, PARAMETERS)
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
        cost += float(0.5 * (self.precision * values**2).sum())
        cost += self.motion.cost(states) + self._body_cost(values, states)
        weight = np.where(use, (DEGREES + 1.0) / (DEGREES + scaled**2) / self.sigma**2, 0.0)
        return _Equations(cost, residual, weight, slope, lens, delay, good, values, states)

    def _body_cost(self, values: Floats, states: Floats) -> float:
        first = states[self.seen.first[:-1]]
        tall = (first[:, HEIGHT] - self.body.height - values[-1]) / self.body.sigma_height
        wide = (first[:, WIDTH] - self.body.width) / self.body.sigma_width
        speed = first[:, 2:4] / (SIGMA_SPEED * self.body.metre)
        return float(0.5 * ((tall**2).sum() + (wide**2).sum() + (speed**2).sum()))

    def _camera_slopes(self, equations: _Equations) -> Floats:
        """(N, 4, 9) derivatives of the expected boxes by the parameters of their cameras."""
        seen, C = self.seen, len(self.cameras)
        N = len(seen.camera)
        out = np.zeros((N, 4, PARAMETERS))
        changes = equations.values[:-1].reshape(C, PARAMETERS)
        free = self.free[:-1].reshape(C, PARAMETERS)
        of_knot = equations.states[seen.knot]
        now = [changed(c, v) for c, v in zip(self.cameras, changes, strict=True)]
        high, low = np.zeros((N, 4)), np.zeros((N, 4))
        for k in range(LATE):
            if not free[:, k].any():
                continue
            step = STEPS[k] * (self.body.height if 3 <= k < 6 else 1.0)
            delta = np.zeros(PARAMETERS)
            delta[k] = step
            for sign, into in ((1.0, high), (-1.0, low)):
                lens = pack_views([changed(c, sign * delta) for c in now]).lens
                expected_boxes(lens, seen.camera, of_knot, equations.delay, into)
            out[:, :, k] = np.nan_to_num((high - low) / (2.0 * step))
        out[:, :, LATE] = -np.einsum("nek,nk->ne", equations.slope[:, :, :2], of_knot[:, 2:4])
        return out

    def _reduced(self, equations: _Equations, damping: float, inflate: float = 1.0) -> _Reduced:
        """Normal equations of cameras after the paths are eliminated."""
        seen, C = self.seen, len(self.cameras)
        K, M = len(seen.time), C * PARAMETERS + 1
        weight = equations.weight / inflate
        camera = self._camera_slopes(equations)
        Js = equations.slope * weight[:, :, None]
        A = np.zeros((K, STATE_SIZE, STATE_SIZE))
        np.add.at(A, seen.knot, np.einsum("nei,nej->nij", Js, equations.slope))
        g = np.zeros((K, STATE_SIZE))
        np.add.at(g, seen.knot, np.einsum("nei,ne->ni", Js, equations.residual))
        B = np.zeros((K, STATE_SIZE, M))
        of = seen.camera[:, None] * PARAMETERS + np.arange(PARAMETERS)
        np.add.at(
            B,
            (seen.knot[:, None, None], np.arange(STATE_SIZE)[None, :, None], of[:, None, :]),
            np.einsum("nei,nej->nij", Js, camera),
        )
        Jc = camera * weight[:, :, None]
        H, b = np.zeros((M, M)), np.zeros(M)
        np.add.at(H, (of[:, :, None], of[:, None, :]), np.einsum("nei,nej->nij", Jc, camera))
        np.add.at(b, of, np.einsum("nei,ne->ni", Jc, equations.residual))
        # Priors: parameters, bodies, velocities at the begin
        H[np.arange(M), np.arange(M)] += self.precision
        b -= self.precision * equations.values
        body, first = self.body, seen.first[:-1]
        tall = equations.states[first, HEIGHT] - body.height - equations.values[-1]
        p = 1.0 / body.sigma_height**2
        A[first, HEIGHT, HEIGHT] += p
        g[first, HEIGHT] -= p * tall
        B[first, HEIGHT, -1] -= p
        H[-1, -1] += p * len(first)
        b[-1] += p * float(tall.sum())
        q = 1.0 / body.sigma_width**2
        A[first, WIDTH, WIDTH] += q
        g[first, WIDTH] -= q * (equations.states[first, WIDTH] - body.width)
        v = 1.0 / (SIGMA_SPEED * body.metre) ** 2
        for k in (2, 3):
            A[first, k, k] += v
            g[first, k] -= v * equations.states[first, k]
        off = self.motion.add(equations.states, A, g)
        # Damping also keeps what nothing determines where it is
        A[:, np.arange(STATE_SIZE), np.arange(STATE_SIZE)] *= 1.0 + damping
        solved = np.zeros((K, STATE_SIZE, M + 1))
        right = np.concatenate([g[:, :, None], B], axis=2)
        for p0, p1 in zip(seen.first[:-1].tolist(), seen.first[1:].tolist(), strict=True):
            banded = _banded(A[p0:p1], off[p0 : p1 - 1])
            solved[p0:p1] = solveh_banded(banded, right[p0:p1].reshape(-1, M + 1), lower=True).reshape(
                p1 - p0, STATE_SIZE, M + 1
            )
        flat = B.reshape(-1, M)
        S = H - flat.T @ solved[:, :, 1:].reshape(-1, M)
        s = b - flat.T @ solved[:, :, 0].ravel()
        return _Reduced(0.5 * (S + S.T), s, solved)

    def _step(self, equations: _Equations, damping: float) -> tuple[Floats, Floats]:
        """Changes of the parameters and of the states."""
        reduced = self._reduced(equations, damping)
        free = np.flatnonzero(self.free)
        S = reduced.matrix[np.ix_(free, free)]
        S = S + np.diag(damping * np.diag(S) + 1e-12)
        step = np.zeros(len(self.values))
        step[free] = cho_solve(cho_factor(S), reduced.right[free])
        moved = reduced.solved[:, :, 0] - reduced.solved[:, :, 1:] @ step
        return step, moved

    def _rescale(self) -> None:
        """Set the noise to what residuals have: its parts in pixels and in heights, by small and large boxes."""
        equations = self._equations(self.values, self.states)
        use = self.seen.use & equations.good[:, None]
        size = np.repeat((self.seen.box[:, 3] - self.seen.box[:, 1])[:, None], 4, axis=1)
        for axis in range(2):
            own = use.copy()
            own[:, [1 - axis, 3 - axis]] = False
            # Student's t with 4 degrees of freedom: the median of |x| is 0.741
            square = np.abs(equations.residual[own]) / 0.741
            low, high = np.median(size[own]) * 0.7, np.median(size[own]) * 1.3
            small, large = square[size[own] <= low], square[size[own] >= high]
            if len(small) < 20 or len(large) < 20:
                scale = np.median(square / self.sigma[own])
                self.sigma[:, [axis, axis + 2]] *= max(float(scale), 1e-3)
                continue
            a, b = float(np.median(small)), float(np.median(large))
            x, y = float(np.median(size[own][size[own] <= low])), float(np.median(size[own][size[own] >= high]))
            relative = max((b**2 - a**2) / (y**2 - x**2), 0.0)
            pixels = max(a**2 - relative * x**2, 0.25)
            self.sigma[:, [axis, axis + 2]] = np.sqrt(pixels + relative * size[:, [axis, axis + 2]] ** 2)

    def _correlation(self) -> float:
        """Factor by which the variance of a mean of errors is larger than of independent ones, 1 or more."""
        seen = self.seen
        equations = self._equations(self.values, self.states)
        use = seen.use & equations.good[:, None]
        influence = np.where(use, equations.residual * equations.weight * self.sigma, 0.0)
        person = np.searchsorted(seen.first, seen.knot, side="right") - 1
        order = np.lexsort((seen.knot, seen.camera, person))
        x, group = influence[order], (person * len(self.cameras) + seen.camera)[order]
        total = float((x**2).sum())
        factor = 1.0
        for lag in range(1, MAX_LAG + 1):
            same = group[lag:] == group[:-lag]
            if not same.any():
                break
            rho = float((x[lag:] * x[:-lag])[same].sum()) / max(total, 1e-12)
            if rho < 0.02:
                break
            factor += 2.0 * rho
        return factor

    def _covariance(self, equations: _Equations) -> Floats:
        """(C 9, C 9) covariance of the parameters, with errors that last.

        Upper and lower edges of the boxes of a camera may also be off by a share of the height, all alike: a detector
        has habits, and people are no ellipsoids.  These biases are consider parameters (Schmidt): they are not
        estimated, and what they do to the estimates is added.
        """
        reduced = self._reduced(equations, 0.0, inflate=self.correlation)
        S, solved = reduced.matrix, reduced.solved[:, :, 1:].reshape(-1, len(self.values))
        free = np.flatnonzero(self.free)
        out = np.zeros_like(S)
        out[np.ix_(free, free)] = np.linalg.pinv(S[np.ix_(free, free)], hermitian=True)
        seen, weight = self.seen, equations.weight / self.correlation
        camera = self._camera_slopes(equations)
        of = seen.camera[:, None] * PARAMETERS + np.arange(PARAMETERS)
        shifts = []
        for c in range(len(self.cameras)):
            for edge in (TOP, BOTTOM):
                size = SIGMA_EDGE_BIAS * (seen.box[:, BOTTOM] - seen.box[:, TOP])
                bias = np.where(seen.camera == c, size * weight[:, edge], 0.0)[:, None]
                right, g = np.zeros(len(S)), np.zeros((len(seen.time), STATE_SIZE))
                np.add.at(right, of, bias * camera[:, edge])
                np.add.at(g, seen.knot, bias * equations.slope[:, edge])
                shifts.append(out @ (right - solved.T @ g.ravel()))
        out += sum(np.outer(shift, shift) for shift in shifts)
        return out[:-1, :-1]


class _Equations(NamedTuple):
    cost: float
    residual: Floats
    weight: Floats
    slope: Floats
    lens: Floats
    delay: Floats
    good: Bools
    values: Floats
    states: Floats


class _Reduced(NamedTuple):
    matrix: Floats
    right: Floats
    solved: Floats


class _Motion(NamedTuple):
    """Prior of the paths: precision and transition from each knot to the next of the same person."""

    inner: Ints  # (L,) knots with a successor
    transition: Floats  # (L, 6, 6)
    precision: Floats  # (L, 6, 6)

    def _off(self, states: Floats) -> Floats:
        return np.asarray(states[self.inner + 1] - np.einsum("lij,lj->li", self.transition, states[self.inner]))

    def cost(self, states: Floats) -> float:
        """Half the squared Mahalanobis length of all transitions."""
        off = self._off(states)
        return float(0.5 * np.einsum("li,lij,lj->", off, self.precision, off))

    def add(self, states: Floats, A: Floats, g: Floats) -> Floats:
        """Add to the blocks of the diagonal and the right side; (K, 6, 6) blocks below the diagonal."""
        off, P, F = self._off(states), self.precision, self.transition
        PF = P @ F
        A[self.inner] += np.swapaxes(F, 1, 2) @ PF
        A[self.inner + 1] += P
        g[self.inner] += np.einsum("lji,lj->li", PF, off)
        g[self.inner + 1] -= np.einsum("lij,lj->li", P, off)
        below = np.zeros_like(A)
        below[self.inner] = -PF
        return below


def _motion(seen: Observations, metre: float) -> _Motion:
    """Prior of the paths: white acceleration, and bodies that hardly change."""
    last = seen.first[1:] - 1
    inner = np.setdiff1d(np.arange(len(seen.time)), last)
    dt = seen.time[inner + 1] - seen.time[inner]
    L = len(inner)
    F, Q = np.tile(np.eye(STATE_SIZE), (L, 1, 1)), np.zeros((L, STATE_SIZE, STATE_SIZE))
    q = ACCELERATION * metre**2
    for k in range(2):
        F[:, k, k + 2] = dt
        Q[:, k, k], Q[:, k + 2, k + 2] = q * dt**3 / 3.0, q * dt
        Q[:, k, k + 2] = Q[:, k + 2, k] = q * dt**2 / 2.0
    for k in (HEIGHT, WIDTH):
        Q[:, k, k] = (BODY_DRIFT * metre) ** 2 * dt
    return _Motion(inner, F, np.asarray(np.linalg.inv(Q), dtype=np.float64))


def _banded(diagonal: Floats, below: Floats) -> Floats:
    """(12, 6 T) lower banded form of a block tridiagonal symmetric matrix of (T, 6, 6) and (T - 1, 6, 6) blocks."""
    n = STATE_SIZE
    T = len(diagonal)
    out = np.zeros((2 * n, T * n))
    for i in range(n):
        for j in range(i + 1):
            out[i - j, j::n] = diagonal[:, i, j]
        for j in range(n):
            out[n + i - j, j : (T - 1) * n : n] = below[:, i, j]
    return out
