"""Trajectories around walls and unseen views: shapely on every step, and a general solver for the best way."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import minimize
from shapely.geometry import LineString, Point, Polygon
from trajectory_reference import dense_chain, make_steps

from occlog.core.plane import convex_pieces
from occlog.track.methods.map.kernels.gauss_markov import constant_velocity
from occlog.track.methods.map.kernels.interior_point import Options, derivatives, minimise
from occlog.track.methods.map.kernels.paths_around_obstacles import (
    Obstacle,
    PathsAroundObstacles,
    find_paths_around,
    settle,
)
from occlog.track.methods.map.kernels.problem import NO_PLANES, BearingLinesByStep, HalfPlanes, TrajectoryProblem, slack

EXTENT = 12.0
FINE = Options(1e-9)
CRISP = 0.02
NEVER = np.zeros(2)
L_WALL = np.array([[4.0, -1.0], [6.0, -1.0], [6.0, -0.8], [4.2, -0.8], [4.2, 2.0], [4.0, 2.0]])
TRAP = np.array([[4.0, 1.8], [5.8, 1.8], [5.8, -1.3], [4.0, -1.3], [4.0, -1.5], [6.0, -1.5], [6.0, 2.0], [4.0, 2.0]])


def box(x0: float, y0: float, x1: float, y1: float):
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def blocks(seed: int) -> tuple[int, list]:
    """A number of states, and three turned blocks on the straight way."""
    rng = np.random.default_rng(seed)
    T, boxes = int(rng.choice([13, 21, 41])), []
    for x in (2.6, 4.9, 7.2):
        middle, angle = np.array([x + 0.3, rng.uniform(-0.8, 0.8)]), rng.uniform(0.0, 3.0)
        w, h = rng.uniform(0.1, 0.6), rng.uniform(0.2, 1.5)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        boxes.append(np.ascontiguousarray(middle + box(-w, -h, w, h) @ turn.T))
    return T, boxes


def wall(polygon, T: int) -> Obstacle:
    return Obstacle(polygon, tuple(convex_pieces(polygon)), None, NEVER, np.ones(T, dtype=np.bool_), math.inf)


def unseen(polygon, when, price: float, *hiding) -> Obstacle:
    """A view whose camera is at its first corner."""
    return Obstacle(polygon, tuple(convex_pieces(polygon)), hiding, polygon[0], np.asarray(when, np.bool_), price)


def places(seen: Sequence[tuple[int, float, float]], T: int, *, acceleration=0.3, sigma=CRISP, planes=NO_PLANES):
    """A target whose position is measured at some of T states, one a second."""
    step = np.repeat([s[0] for s in seen], 2)
    n = len(step)
    lines = BearingLinesByStep(
        step,
        np.repeat([s[1:] for s in seen], 2, axis=0).astype(float),
        np.tile(np.eye(2), (len(seen), 1)),
        np.ones(n),
        np.zeros(n),
        np.zeros(n),
        np.full(n, sigma**2),
        np.zeros(n, np.bool_),
        np.zeros(n),
        np.zeros(n),
    )
    steps = make_steps(
        constant_velocity(acceleration, 0.0, 1.0), np.arange(T, dtype=float), np.zeros(4), np.diag([100.0, 1, 100, 1])
    )
    return TrajectoryProblem(steps, lines, planes, 0, 1.0)


def straight(T: int, y: float = 0.0, **options) -> TrajectoryProblem:
    """From (1, y) to (9, y) in T - 1 seconds, seen at both ends only."""
    x = np.linspace(1.0, 9.0, T)
    return places([(t, x[t], y) for t in (0, 1, T - 2, T - 1)], T, **options)


def go(problem: TrajectoryProblem, *obstacles: Obstacle, clearance: float = 0.0, start=None):
    free = minimise(problem, np.zeros((problem.T, 4)) if start is None else start, FINE)
    assert free.converged
    return free, find_paths_around(problem, (problem, free), obstacles, FINE, EXTENT, clearance)


def cut(X, polygon) -> float:
    """Length of the path inside a polygon."""
    shape = Polygon(polygon)
    return sum(LineString(X[t : t + 2, ::2]).intersection(shape).length for t in range(len(X) - 1))


def clear_of(X, polygon) -> float:
    return float(LineString(X[:, ::2]).distance(Polygon(polygon)))


def check_minimum(found: PathsAroundObstacles) -> None:
    """Conditions of Karush, Kuhn and Tucker under the half-planes that were drawn."""
    p, s = found.problem, found.solution
    g, _ = derivatives(p, s.X, 1.0)
    np.add.at(g, (p.planes.step, 0), -s.multiplier * p.planes.normal[:, 0])
    np.add.at(g, (p.planes.step, 2), -s.multiplier * p.planes.normal[:, 1])
    assert_allclose(g, 0.0, atol=1e-5 * (1.0 + s.multiplier.max(initial=0.0)))
    gap = slack(p.planes, s.X)
    assert gap.min(initial=1.0) > 0.0
    assert (s.multiplier >= 0.0).all()
    assert (s.multiplier * gap).max(initial=0.0) < 1e-6


def quadratic(problem: TrajectoryProblem):
    """P and q of the cost 1/2 X'PX - q.X + c of places measured on both axes."""
    P = dense_chain(problem.steps)
    q, c = P[:, :4] @ problem.steps.mean, 0.5 * problem.steps.mean @ P[:4, :4] @ problem.steps.mean
    for t, xy in zip(problem.lines.step[::2], problem.lines.position[::2], strict=True):
        for i, value in zip((4 * t, 4 * t + 2), xy, strict=True):
            P[i, i] += 1 / CRISP**2
            q[i] += value / CRISP**2
            c += 0.5 * (value / CRISP) ** 2
    return P, q, c


def best_around(problem: TrajectoryProblem, polygon, guess) -> float:
    """Least cost near a guess of paths around a convex polygon: a program in the states and a line for every step."""
    P, q, c = quadratic(problem)
    T = problem.T
    L = np.linalg.inv(np.linalg.cholesky(P)).T
    middle = 0.5 * (guess[1:, ::2] + guess[:-1, ::2])
    angle = np.array([_facing(Polygon(polygon), m) for m in middle])

    def rules(y):
        X, a = (L @ y[: 4 * T]).reshape(T, 4), y[4 * T :]
        n = np.column_stack([np.cos(a), np.sin(a)])
        corner = n @ polygon.T
        ends = np.stack([np.einsum("ti,ti->t", n, X[:-1, ::2]), np.einsum("ti,ti->t", n, X[1:, ::2])])
        return (ends[:, :, None] - corner).ravel()

    def cost(y):
        x = L @ y[: 4 * T]
        return 0.5 * x @ P @ x - q @ x + c

    def slope(y):
        return np.concatenate([L.T @ (P @ (L @ y[: 4 * T]) - q), np.zeros(T - 1)])

    y = np.concatenate([np.linalg.solve(L, guess.ravel()), angle])
    best = math.inf
    for _ in range(3):
        found = minimize(
            cost,
            y,
            jac=slope,
            method="SLSQP",
            constraints={"type": "ineq", "fun": rules},
            options={"maxiter": 300, "ftol": 1e-12},
        )
        y = found.x
        if rules(y).min() > -1e-6:
            best = min(best, float(found.fun))
    return best


def _facing(shape: Polygon, xy) -> float:
    """Angle of the direction from the nearest point of a polygon to a place outside."""
    at = shape.exterior.interpolate(shape.exterior.project(Point(xy)))
    return math.atan2(xy[1] - at.y, xy[0] - at.x)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_thin_wall_is_passed_on_the_cheaper_side(side: float) -> None:
    thin = box(4.9, -3.0, 5.1, 1.0) * [1.0, side]
    p = straight(13)
    free, found = go(p, wall(np.ascontiguousarray(thin[:: int(side)]), 13))
    assert cut(free.X, thin) > 0.1
    assert cut(found.solution.X, thin) < 1e-6
    assert (side * found.solution.X[5:8, 2] > 0.5).all()  # by the end that is nearer
    assert not found.left_alone.any()
    assert len(found.holds) == 1
    assert found.solution.cost > free.cost
    check_minimum(found)


@pytest.mark.parametrize(("T", "loss"), [(9, 0.05), (17, 0.01)])
@pytest.mark.parametrize(("low", "high"), [(-3.0, 1.0), (-1.2, 1.6), (-0.4, 0.4)])
def test_the_way_is_about_as_cheap_as_a_general_solver_finds(low: float, high: float, T: int, loss: float) -> None:
    """On the better side.  Lines are drawn again in turn with the path, which stops near the best ones, not at them:

    steps that are long against the wall cost up to 3.6 % more, of half their length 0.5 %.
    """
    p, block = straight(T), box(4.7, low, 5.3, high)
    free, found = go(p, wall(block, T))
    assert cut(free.X, block) > 0.1
    sides = []
    for top in (high + 0.3, low - 0.3):
        guess = free.X.copy()
        guess[:, 2] = top * np.clip(np.minimum(guess[:, 0] - 1, 9 - guess[:, 0]) / 2, 0, 1)
        sides.append(best_around(p, block, guess))
    assert min(sides) > free.cost
    assert found.solution.cost <= min(sides) * (1.0 + loss)
    assert found.solution.cost >= min(sides) - 1e-4  # and not better than possible
    assert cut(found.solution.X, block) < 1e-6
    check_minimum(found)


@pytest.mark.parametrize("polygon", [L_WALL, TRAP], ids=["L", "trap"])
def test_walls_that_are_not_convex(polygon) -> None:
    p = straight(17)
    free, found = go(p, wall(polygon, 17))
    assert cut(free.X, polygon) > 0.1
    assert cut(found.solution.X, polygon) < 1e-6
    assert not found.left_alone.any()
    check_minimum(found)


@pytest.mark.jit
@pytest.mark.parametrize("seed", range(6))
def test_several_walls_at_random(seed: int) -> None:
    """What is not left alone cuts nothing; costs rise."""
    rng, T = np.random.default_rng(seed), 21
    boxes = []
    for x in (2.6, 4.9, 7.2):
        low, high = -rng.uniform(0.1, 1.5), rng.uniform(0.1, 1.5)
        boxes.append(box(x, low, x + rng.uniform(0.1, 0.6), high))
    p = straight(T)
    free, found = go(p, *(wall(b, T) for b in boxes))
    assert not found.left_alone.any()
    assert sum(cut(found.solution.X, b) for b in boxes) < 1e-6
    assert found.solution.cost > free.cost
    check_minimum(found)


@pytest.mark.jit
@pytest.mark.parametrize("seed", [99, 134])
def test_ways_that_disturb_each_other_are_found_in_turn(seed: int) -> None:
    """Three blocks with room between them whose ways around do not fit together when they are found at once."""
    T, boxes = blocks(seed)
    assert all(Polygon(a).distance(Polygon(b)) > 0.4 for a, b in pairwise(boxes))
    _, found = go(straight(T), *(wall(b, T) for b in boxes))
    assert not found.left_alone.any()
    assert sum(cut(found.solution.X, b) for b in boxes) < 1e-6


@pytest.mark.jit
def test_what_is_left_alone_is_inside() -> None:
    """Turned blocks that may meet each other: every cut is flagged, and every flagged state is at a cut."""
    flagged = 0
    for seed in (0, 2, 6, 26, 30, 34, 38, 42):
        T, boxes = blocks(seed)
        _, found = go(straight(T), *(wall(b, T) for b in boxes))
        X = found.solution.X
        for b, left in zip(boxes, found.left_alone, strict=True):
            steps = np.array([cut(X[t : t + 2], b) for t in range(T - 1)])
            at = np.append(steps > 1e-7, False) | np.append(False, steps > 1e-7)
            assert not (at & ~left & (cut(X, b) > 1e-6)).any()
            assert not (left & ~(np.append(steps > 0, False) | np.append(False, steps > 0))).any()
            flagged += int(left.any())
    assert flagged > 0


def test_a_clearance_is_kept() -> None:
    thin = box(4.9, -3.0, 5.1, 1.0)
    _, near = go(straight(13), wall(thin, 13))
    _, far = go(straight(13), wall(thin, 13), clearance=0.3)
    assert clear_of(near.solution.X, thin) < 0.01  # drawn tight around the corner
    assert clear_of(far.solution.X, thin) >= 0.3 - 1e-6
    assert far.solution.cost > near.solution.cost


@pytest.mark.parametrize("obstacle", ["beside", "elsewhere", "not looked", "hidden"])
def test_nothing_changes_where_nothing_is_in_the_way(obstacle: str) -> None:
    T = 13
    view = np.array([[5.0, -4.0], [7.0, 4.0], [3.0, 4.0]])
    o = {
        "beside": wall(box(4.0, 0.1, 6.0, 1.0), T),
        "elsewhere": wall(L_WALL + 20.0, T),
        "not looked": unseen(view, np.arange(T) < 2, math.inf),  # the camera looked before the target came
        "hidden": unseen(view, np.ones(T), math.inf, box(3.0, -2.5, 7.0, -2.0)),  # a wall before the camera
    }[obstacle]
    free, found = go(straight(T), o)
    assert found.holds == ()
    assert not found.left_alone.any()
    assert np.array_equal(found.solution.X, free.X)
    assert found.solution.cost == free.cost


def test_a_wall_that_closes_the_room_off_is_left_alone() -> None:
    T = 13
    room = HalfPlanes(np.repeat(np.arange(T), 2), np.tile([[0.0, 1.0], [0.0, -1.0]], (T, 1)), np.full(2 * T, -2.0))
    p, shut = straight(T, planes=room), box(4.9, -6.0, 5.1, 6.0)
    free, found = go(p, wall(shut, T))
    assert found.holds == ()
    assert found.left_alone.shape == (1, T)
    assert found.left_alone[0, 6]
    assert not found.left_alone[0, [0, 1, T - 2, T - 1]].any()
    assert_allclose(found.solution.X, free.X, atol=1e-9)
    door = box(4.9, -6.0, 5.1, 1.0)  # with a way through, it is taken
    _, open_ = go(p, wall(door, T))
    assert not open_.left_alone.any()
    assert cut(open_.solution.X, door) < 1e-6
    assert (np.abs(open_.solution.X[:, 2]) < 2.0).all()


def test_a_view_is_left_unless_to_cross_it_unseen_is_cheap() -> None:
    T = 17
    view, when = np.array([[5.0, -1.0], [5.6, 3.0], [4.4, 3.0]]), np.ones(T, np.bool_)
    p = straight(T)
    free, around = go(p, unseen(view, when, math.inf))
    inside = np.array([Polygon(view).contains(Point(xy)) for xy in free.X[:, ::2]])
    assert inside.any()
    out = around.solution.X[:, ::2]
    assert all(not Polygon(view).buffer(-1e-6).contains(Point(xy)) for xy in out)
    assert not around.left_alone.any()
    check_minimum(around)
    extra = around.solution.cost - free.cost
    assert extra > 1e-3
    n = int(inside.sum())
    _, cheap = go(p, unseen(view, when, 0.5 * extra / n))
    assert np.array_equal(cheap.left_alone[0], inside)
    assert np.array_equal(cheap.solution.X, free.X)
    _, dear = go(p, unseen(view, when, 2.0 * extra / n))
    assert not dear.left_alone.any()
    assert dear.solution.cost == pytest.approx(around.solution.cost, rel=1e-3)


def test_a_view_holds_only_when_its_camera_looked() -> None:
    """The same place may be crossed between two frames."""
    T = 17
    view = np.array([[5.0, -1.0], [5.6, 3.0], [4.4, 3.0]])
    when = np.arange(T) % 2 == 1  # not at state 8, which is at x = 5
    free, found = go(straight(T), unseen(view, when, math.inf))
    assert Polygon(view).contains(Point(free.X[8, ::2]))
    held = np.flatnonzero(when)
    assert all(not Polygon(view).buffer(-1e-6).contains(Point(xy)) for xy in found.solution.X[held, ::2])
    assert Polygon(view).contains(Point(found.solution.X[8, ::2]))


@pytest.mark.parametrize("first", [True, False])
def test_a_track_that_begins_or_ends_in_a_wall_is_moved_out(first: bool) -> None:
    """The last states have no measurement of their own: they stop before the wall, or pass next to it."""
    T = 13
    x = 1.0 + 0.6 * np.arange(T)
    seen = range(4, T) if first else range(T - 4)
    p = places([(t, x[t], 0.0) for t in seen], T)
    block = box(-2.0, -2.0, 2.0, 1.0) if first else box(7.2, -2.0, 10.0, 1.0)
    free, found = go(p, wall(block, T))
    assert cut(free.X, block) > 0.1
    assert cut(found.solution.X, block) < 1e-6
    assert not found.left_alone.any()
    check_minimum(found)


def test_settle_has_no_answer_where_a_guess_is_inside() -> None:
    T = 13
    p, block = straight(T), box(4.0, -1.0, 6.0, 1.0)
    free, found = go(p, wall(block, T))
    holds = found.holds
    assert settle(p, free.X, (wall(block, T),), holds, FINE, EXTENT, 0.0) is None
    again = settle(p, found.solution.X, (wall(block, T),), holds, FINE, EXTENT, 0.0)
    assert again is not None
    assert again[1].cost <= found.solution.cost * (1 + 1e-6)
