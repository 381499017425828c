"""Detours of a trajectory around obstacles: walls, and views in which a camera did not see the target.

Being outside a polygon is no convex constraint.  Each step of the trajectory that is near one
is held by a line that separates it from the polygon; with the lines fixed the problem is
convex in its constraints, and its minimum gives better lines, until nothing moves (a path
drawn tight around a corner touches it).  On which side to pass is a choice: for every segment
that runs through a polygon both ways around are tried, and the cheaper one is kept.  A view
may also be crossed unseen at a price, if the camera misses targets.

Obstacles of a trajectory: where it runs through one, and first guesses of detours around it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.plane import offset_point, route, separate, spread_along

from .interior_point import Options, Solution, cost, minimise, move_inside
from .problem import NO_PLANES, BearingLinesByStep, HalfPlanes, TrajectoryProblem, join_lines, join_planes
from .windows import StatePrior, part


class Obstacle(NamedTuple):
    """A polygon that the target avoids: a wall, or a field of view in which the camera did not detect it.

    `corners` (K, 2) are counter-clockwise, `pieces` its convex parts. For a wall `seen_through` is None; for a view it
    has the convex polygons that hide positions from the camera at `eye` (2,). `when` (T,) marks the states at which it
    counts, `price` is the cost of a state inside (infinite: not allowed).
    """

    corners: Floats  # (K, 2) simple, counter-clockwise
    pieces: tuple[Floats, ...]  # convex, counter-clockwise; they make it up
    seen_through: tuple[Floats, ...] | None  # None: a wall. Else convex polygons that hide positions in this view
    eye: Floats  # (2,) of a view: where the camera is
    when: Bools  # (T,) at which states it is there; a wall: always, and between them too
    price: float  # cost of a state inside; inf: none is


class Hold(NamedTuple):
    """States `first` to `last` (inclusive) of a trajectory that are constrained outside an obstacle.

    `obstacle` is its index.
    """

    obstacle: int
    first: int
    last: int


def segments(X: Floats, obstacles: tuple[Obstacle, ...], left_alone: Bools, touch: float) -> Iterator[Hold]:
    """Generate the runs of states inside an obstacle, or at the ends of a step through a wall.

    Args:
        X: (T, 4) states x, vx, y, vy.
        obstacles: K obstacles.
        left_alone: (K, T) states that may be inside each obstacle.
        touch: depth up to which states do not count as inside [scene unit].
    """
    xy = np.ascontiguousarray(X[:, ::2])
    for k, o in enumerate(obstacles):
        inside = overlaps(xy, o, touch) & ~left_alone[k]
        rows = np.flatnonzero(inside)
        if not len(rows):
            continue
        # Frames of a camera that comes and goes belong to one segment.
        there = np.cumsum(o.when)
        cuts = np.flatnonzero(np.diff(there[rows]) > 1) + 1
        for rest in np.split(rows, cuts):
            yield Hold(k, int(rest[0]), int(rest[-1]))


def overlaps(xy: Floats, o: Obstacle, touch: float) -> Bools:
    """Return a mask (T,): position `xy` (T, 2) is inside the obstacle `o` by more than `touch` [scene unit].

    For a wall, both ends of each step that crosses it count, too; in a view, only states at which it counts and that no
    wall hides from the camera.
    """
    out = np.zeros(len(xy), dtype=np.bool_)
    if o.seen_through is None:
        for piece in o.pieces:
            out |= separate(xy, xy, piece).gap < -touch
            cut = separate(xy[:-1], xy[1:], piece).gap < -touch
            out[:-1] |= cut
            out[1:] |= cut
        return out
    rows = np.flatnonzero(o.when)
    inside = np.zeros(len(rows), dtype=np.bool_)
    for piece in o.pieces:
        inside |= separate(xy[rows], xy[rows], piece).gap < -touch
    rows = rows[inside]
    eye = np.broadcast_to(o.eye, (len(rows), 2))
    hidden = np.zeros(len(rows), dtype=np.bool_)
    for wall in o.seen_through:
        hidden |= separate(eye, xy[rows], wall).gap < 0.0
    out[rows[~hidden]] = True
    return out


def guesses(
    X: Floats, obstacles: tuple[Obstacle, ...], segment: Hold, extent: float, clearance: float
) -> Iterator[Floats]:
    """Generate initial trajectories (T, 4) that lead a run of states around its obstacle on either side.

    Args:
        X: (T, 4) states x, vx, y, vy.
        obstacles: all obstacles.
        segment: the run of states.
        extent: size of the scene.
        clearance: distance that is kept from walls.
    """
    o, T = obstacles[segment.obstacle], len(X)
    wall = o.seen_through is None
    away = (clearance if wall else 0.0) + 1e-3 * extent
    a, b = (segment.first, segment.last) if wall else (segment.first - 1, segment.last + 1)
    inside = overlaps(np.ascontiguousarray(X[:, ::2]), o._replace(when=np.ones(T, dtype=np.bool_)), 0.0)
    if wall:  # both ends of a step through it: the states themselves may be outside
        inside = _within(X[:, ::2], o)
    while a >= 0 and inside[a]:
        a -= 1
    while b < T and inside[b]:
        b += 1
    if a < 0 or b >= T:
        yield from _to_edges(X, o, max(a, -1), min(b, T), away)
        return
    # Around the obstacle on either side, from and to states as near as the number of states in between allows
    for ccw in (True, False):
        first, last = a, b
        guess = None
        while guess is None:
            positions = route(o.corners, X[first, ::2], X[last, ::2], away, ccw=ccw)
            guess = spread_along(X[first, ::2], positions, X[last, ::2], last - first)
            if guess is None:
                if first == 0 and last == T - 1:
                    break
                first, last = max(0, first - 1), min(T - 1, last + 1)
        if guess is None:
            continue
        Y = X.copy()
        Y[first + 1 : last, ::2] = guess
        yield Y


def _within(xy: Floats, o: Obstacle) -> Bools:
    """Return a mask (T,): position `xy` (T, 2) is inside the obstacle's polygon, whether or not it counts there."""
    points = np.ascontiguousarray(xy)
    return np.asarray(np.any([separate(points, points, piece).gap < 0.0 for piece in o.pieces], axis=0))


def _to_edges(X: Floats, o: Obstacle, a: int, b: int, away: float) -> Iterator[Floats]:
    """Generate trajectories with the states a + 1 .. b - 1 of X (T, 4) moved to one edge of the obstacle, edge by edge.

    They are put at the distance `away` outside the edge. Used for runs that begin or end the trajectory.
    """
    K = len(o.corners)
    for k in range(K):
        edge = o.corners[(k + 1) % K] - o.corners[k]
        Y = X.copy()
        xy = X[a + 1 : b, ::2]
        share = np.clip((xy - o.corners[k]) @ edge / (edge @ edge), 0.0, 1.0)
        Y[a + 1 : b, ::2] = offset_point(o.corners, k, o.corners[k] + share[:, None] * edge, away)
        yield Y


def hidden_from_view(xy: Floats, o: Obstacle, rows: Ints) -> Bools:
    """Return, for each of the states `rows`, whether a wall hides it from the camera of the view `o`; False for a wall.

    `xy` (T, 2) are all positions.
    """
    eye = np.broadcast_to(o.eye, (len(rows), 2))
    out = np.zeros(len(rows), dtype=np.bool_)
    for wall in o.seen_through or ():
        out |= separate(eye, xy[rows], wall).gap < 0.0
    return out


PASSES = 12
"""How often lines are resampled."""
ROUNDS = 10
"""Rounds of looking for segments that run through something."""
NEIGHBOURHOOD = 24
"""States before and after a segment that move while ways around it are compared, at least."""
PIN, ROUGH = 1e-5, 1e-4
"""Deviation with which the ends of such a neighbourhood are pinned, and the tolerance there, as shares of the
extent."""
TOUCH = 1e-9
"""Overlaps that are smaller, as a share of the extent, are none."""
FEW = 6
"""States before and after a segment that are held apart as well, at least."""
MU = 1e-2
"""Weight of the barrier when a detour is tried."""


class PathsAroundObstacles(NamedTuple):
    """Minimum of the cost outside the obstacles: the problem with half-planes of the detours, and its solution.

    `holds` are the runs of states that were led around an obstacle; `left_alone` (K, T) marks states inside each of the
    K obstacles, for which no cheaper way around was found.
    """

    problem: TrajectoryProblem  # with the half-planes of the detours
    solution: Solution
    holds: tuple[Hold, ...]
    left_alone: Bools  # (K, T) states inside each obstacle that no cheaper way around was found for


def find_paths_around(
    problem: TrajectoryProblem,
    solved: tuple[TrajectoryProblem, Solution],
    obstacles: tuple[Obstacle, ...],
    options: Options,
    extent: float,
    clearance: float = 0.0,
    holds: Iterable[Hold] = (),
    left_alone: Bools | None = None,
) -> PathsAroundObstacles:
    """Return the minimum of the cost outside all obstacles, as far as detours are found.

    Args:
        problem: cost of the trajectory, with all constraints except the obstacles.
        solved: the problem with the half-planes of `holds`, and its minimum.
        obstacles: K obstacles.
        options: stopping criteria of each search.
        extent: size of the scene.
        clearance: distance that is kept from walls.
        holds: runs of states that are led around an obstacle already.
        left_alone: (K, T) states that need not be outside each obstacle; None: none.
    """
    here, solution = solved
    held, iterations, space = tuple(holds), solution.iterations, (options, extent, clearance)
    alone = np.zeros((len(obstacles), problem.T), dtype=np.bool_) if left_alone is None else left_alone.copy()
    for _ in range(ROUNDS):
        # Find segments inside an obstacle, and the cheapest way around each by itself
        X = solution.X.copy()
        added: list[Hold] = []
        ways: list[Floats] = []
        for segment in list(segments(X, obstacles, alone, TOUCH * extent)):
            hold = _padded(segment, problem.T)
            way, spent = _local_way(problem, X, obstacles, segment, (*held, *added), space)
            iterations += spent
            if way is None:
                alone[segment.obstacle, segment.first : segment.last + 1] = True
            else:
                X, added = way, [*added, hold]
                ways.append(way)
        if not added:
            break
        # Solve the whole with all ways; of ways that disturb each other half are searched again
        found = None
        while found is None and added:
            found = settle(problem, ways[len(added) - 1], obstacles, (*held, *added), *space)
            if found is None and len(added) == 1:
                alone[added[0].obstacle, added[0].first : added[0].last + 1] = True
            if found is None:
                added = added[: len(added) // 2]
        if found is None:
            continue
        (here, solution), held = found, (*held, *added)
        iterations += solution.iterations
    # States that are inside an obstacle in the end: detours around others may have led some out again
    xy = np.ascontiguousarray(solution.X[:, ::2])
    inside = [overlaps(xy, o, TOUCH * extent) for o in obstacles]
    alone = np.array(inside, dtype=np.bool_).reshape(len(obstacles), problem.T)
    return PathsAroundObstacles(here, solution._replace(iterations=iterations), held, alone)


def _local_way(
    problem: TrajectoryProblem,
    X: Floats,
    obstacles: tuple[Obstacle, ...],
    segment: Hold,
    held: tuple[Hold, ...],
    space: tuple[Options, float, float],
) -> tuple[Floats | None, int]:
    """Return the trajectory with one run of states led around its obstacle the cheapest way, and the iterations used.

    Only nearby states move; None if no detour is found or being inside costs less.

    Args:
        problem: cost of the trajectory, with all constraints except the obstacles.
        X: (T, 4) states x, vx, y, vy.
        obstacles: all obstacles.
        segment: the run of states.
        held: runs that are led around an obstacle already.
        space: options of each search, size of the scene, and distance that is kept from walls.
    """
    options, extent, clearance = space
    reach = max(NEIGHBOURHOOD, 2 * (segment.last - segment.first))
    first, last = max(0, segment.first - reach), min(problem.T, segment.last + 1 + reach)
    local = _pinned(problem, X, first, last, extent)
    own = tuple(o._replace(when=o.when[first:last]) for o in obstacles)
    here = Hold(segment.obstacle, segment.first - first, segment.last - first)
    near = [
        Hold(h.obstacle, max(h.first, first) - first, min(h.last, last - 1) - first)
        for h in held
        if h.first < last and h.last >= first
    ]
    # Try both ways around
    rough = options._replace(tolerance=max(options.tolerance, ROUGH * extent))
    best, spent = None, 0
    for guess in guesses(X[first:last], own, here, extent, clearance):
        tried = settle(local, guess, own, (*near, _padded(here, last - first)), rough, extent, clearance)
        if tried is None:
            continue
        spent += tried[1].iterations
        if best is None or tried[1].cost < best.cost:
            best = tried[1]
    # Take the cheaper one, unless being inside costs less
    o = obstacles[segment.obstacle]
    price = o.price * int(np.count_nonzero(o.when[segment.first : segment.last + 1]))
    if best is None or best.cost > cost(local, X[first:last]) + price:
        return None, spent
    Y = X.copy()
    Y[first:last] = best.X
    return Y, spent


def _pinned(problem: TrajectoryProblem, X: Floats, first: int, last: int, extent: float) -> TrajectoryProblem:
    """Return the problem of states first .. last - 1 alone, joined to the trajectory X (T, 4) at both ends.

    The prior of the first state follows from X[first - 1].  The last two positions are held at X with a standard
    deviation of `PIN` times `extent`, except at the end of the trajectory and in parts of fewer than 3 states.
    """
    steps = problem.steps
    before = StatePrior(steps.mean, steps.spread)
    if first > 0:
        kind = steps.kind[first - 1]
        before = StatePrior(steps.A[kind] @ X[first - 1], steps.sigma[kind])
    local = part(problem, first, last, before)
    if last == problem.T or last - first < 3:
        return local
    # The last two positions hold still, and with them the velocity there.
    rows = np.array([last - first - 2, last - first - 1]).repeat(2)
    position = X[first:last][rows, ::2]
    axis = np.tile(np.eye(2), (2, 1))
    still = BearingLinesByStep(
        step=rows,
        position=position,
        axis=axis,
        focal=np.ones(4),
        reading=np.zeros(4),
        c0=np.zeros(4),
        c1=np.full(4, (PIN * extent) ** 2),
        direction=np.zeros(4, dtype=np.bool_),
        volume=np.zeros(4),
        lean=np.zeros(4),
    )
    return local._replace(lines=join_lines(local.lines, still))


def _padded(segment: Hold, T: int) -> Hold:
    """Return the run extended on both sides by half its length, at least `FEW` states, within the T states."""
    pad = max(FEW, (segment.last - segment.first) // 2)
    return segment._replace(first=max(0, segment.first - pad), last=min(T - 1, segment.last + pad))


def separating_planes(
    X: Floats, obstacles: tuple[Obstacle, ...], holds: Iterable[Hold], clearance: float
) -> tuple[HalfPlanes, float]:
    """Return half-planes that keep the runs `holds` outside their obstacles, and the narrowest gap at X (T, 4).

    The gap is negative inside an obstacle; `clearance` is the distance kept from walls.
    """
    xy = np.ascontiguousarray(X[:, ::2])
    parts, narrowest = [NO_PLANES], math.inf
    for hold in holds:
        o = obstacles[hold.obstacle]
        for piece in o.pieces:
            planes, gap = _piece_planes(xy, o, piece, hold, clearance)
            parts.append(planes)
            narrowest = min(narrowest, gap)
    return join_planes(*parts), narrowest


def _piece_planes(xy: Floats, o: Obstacle, piece: Floats, hold: Hold, clearance: float) -> tuple[HalfPlanes, float]:
    """Return half-planes between the states of `hold` and a convex piece (K, 2) of the obstacle, and the narrowest gap.

    For a wall each step gives a line for both of its ends; in a view each state that counts and is not hidden. The gap
    is negative inside. `xy` (T, 2) are all positions; `clearance` is kept from walls.
    """
    rows: Ints = np.arange(hold.first, hold.last + 1)
    if o.seen_through is None:
        start, end = (rows[:-1], rows[1:]) if len(rows) > 1 else (rows, rows)
        s = separate(xy[start], xy[end], piece)
        planes = HalfPlanes(
            np.concatenate([start, end]),
            np.vstack([s.normal, s.normal]),
            np.tile(s.support + clearance, 2),
        )
        return planes, float(s.gap.min(initial=math.inf)) - clearance
    rows = rows[o.when[rows]]
    rows = rows[~hidden_from_view(xy, o, rows)]
    s = separate(xy[rows], xy[rows], piece)
    return HalfPlanes(rows, s.normal, s.support), float(s.gap.min(initial=math.inf))


def settle(
    problem: TrajectoryProblem,
    guess: Floats,
    obstacles: tuple[Obstacle, ...],
    holds: tuple[Hold, ...],
    options: Options,
    extent: float,
    clearance: float,
) -> tuple[TrajectoryProblem, Solution] | None:
    """Return the minimum near a guess with lines between runs of states and obstacles, and its problem.

    Lines and minimum are computed in turn until nothing moves; None if no line separates the guess.

    Args:
        problem: cost of the trajectory, with all constraints except the obstacles.
        guess: (T, 4) states outside the obstacles where they are held.
        obstacles: all obstacles.
        holds: which states are kept out of which obstacle.
        options: stopping criteria of each search.
        extent: size of the scene.
        clearance: distance that is kept from walls.
    """
    X, found, iterations = guess, None, 0
    for _ in range(PASSES):
        # Draw lines between the held states and their obstacles
        planes, gap = separating_planes(X, obstacles, holds, clearance)
        if gap < -TOUCH * extent:
            return found
        here = problem._replace(planes=join_planes(problem.planes, planes))
        Y, stuck = move_inside(X, here.planes, 1e-5 * extent)
        if stuck.any():
            return found
        # Minimise with the lines fixed
        solution = minimise(here, Y, options._replace(mu=MU))
        iterations += solution.iterations
        moved = float(np.abs(solution.X - X)[:, ::2].max())
        better = found is None or solution.cost < found[1].cost
        if better:
            found = here, solution._replace(iterations=iterations)
        X = solution.X
        if moved < 1e-4 * extent or not better:
            break
    return found
