"""Robots on their way: steps of constant length along the total force, until goal, collision or endless repetition.

Robots do not see each other; several at a time are for experiments with many starts.

Steps of one robot as rows of a path.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from itertools import islice
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints
from occlog.core.navigation.forces import ROUNDING, distance
from occlog.core.navigation.obstacles import MovingObstacles
from occlog.core.navigation.steering import STATES, Steering, SteeringState, field_of, steer, steps_of, turned
from occlog.records.declared.world import PATH_STATES
from occlog.records.tables import RobotPath

from .config import NavigateConfig
from .obstacle_course import Course

WINDOW = 50
"""Steps over which a robot's whereabouts are collected, to decide whether it still makes progress."""
GUARD = 1e-3
"""Clearance that guarded steps keep, in lengths of a step."""
TURNS = tuple(math.radians(15.0 * k) for k in range(-11, 13))
"""Angles by which a step that would collide is turned."""
STUCK = 4.0
"""A robot that stayed for a window and more within this many steps' length is caught."""


class End(IntEnum):
    """Outcome of a path: goal, collision, endless repetition, or no steps left."""

    GOING = 0
    REACHED = 1
    COLLIDED = 2
    ENDLESS = 3  # position and force of an earlier step come back: they come back for ever
    STOPPED = 4  # the steps ran out


class RobotStep(NamedTuple):
    """N robots at one step, A of which are still active; others have ended earlier.

    Attributes:
        number: number of the step.
        active: (A,) indices of the active robots.
        xy: (A, 2) their positions.
        clearance: (A,) least distance from obstacles since the step before, border to border.
        nearest: (A,) index of that obstacle; -1: none.
        steering: forces of the next step; None: no robot continues.
    """

    number: int
    active: Ints
    xy: Floats
    clearance: Floats
    nearest: Ints
    steering: Steering | None


@dataclass(eq=False)
class Drive:
    """Results of N robots; updated in place by `drive`.

    Attributes:
        xy: (N, 2) last positions.
        end: (N,) outcomes, numbers of `End`.
        steps: (N,) numbers of steps done.
        length: (N,) lengths of the paths; steps that the guard skipped have none.
        clearance: (N,) least distance from obstacles, border to border, also between steps.
        nearest: (N,) index of that obstacle; -1: none.
        states: (N, 4) numbers of steps in each `SteeringState`.
        recognised: (N,) numbers of steps at which oscillation was recognised.
        caught: (N,) mask of robots without steps left that stayed at one position in the end.
        prevented: (N,) mask of robots with steps of the prevention in the endless part of the path, or its last window.
    """

    xy: Floats
    end: Ints
    steps: Ints
    length: Floats
    clearance: Floats
    nearest: Ints
    states: Ints
    recognised: Ints
    caught: Bools
    prevented: Bools

    @classmethod
    def at(cls, starts: Floats) -> Drive:
        """Initial state of robots at the positions `starts` (N, 2)."""
        n = len(starts)
        return cls(
            xy=starts.copy(),
            end=np.zeros(n, dtype=np.int64),
            steps=np.zeros(n, dtype=np.int64),
            length=np.zeros(n),
            clearance=np.full(n, np.inf),
            nearest=np.full(n, -1),
            states=np.zeros((n, len(STATES)), dtype=np.int64),
            recognised=np.zeros(n, dtype=np.int64),
            caught=np.zeros(n, dtype=np.bool_),
            prevented=np.zeros(n, dtype=np.bool_),
        )


def drive(robots: Drive, goals: Floats, course: Course, config: NavigateConfig) -> Iterator[RobotStep]:
    """Move robots step by step to their goals by potential fields; generate each step, the initial one included.

    Args:
        robots: robots at their starts; their results are updated in place.
        goals: (N, 2) goals.
        course: obstacles.
        config: speed, rules, maximum number of steps.
    """
    steps, field = steps_of(config, config.way, config.radius), field_of(config)
    total = np.full_like(robots.xy, np.nan)
    watch = _Watch(robots.xy)
    obstacles = course.obstacles_at(0)
    active = np.arange(len(robots.xy))
    gaps = course.clearance(robots.xy, robots.xy, config.radius, _standing(obstacles))
    for number in range(config.max_steps + 1):
        clearance, nearest = _least(gaps)
        _note_clearance(robots, active, clearance, nearest)
        xy = robots.xy[active]
        # Ends: collision first, since a robot that drives through something has not reached its goal
        arrived = distance(xy, goals[active]) <= config.near * (1.0 + ROUNDING)
        collided = clearance <= ROUNDING * config.way
        end = np.where(collided, End.COLLIDED, np.where(arrived, End.REACHED, End.GOING))
        if number == config.max_steps:
            robots.caught[active] = watch.stays(active, STUCK * config.way)
            robots.prevented[active] = watch.prevented[active]
            end = np.where(end == End.GOING, End.STOPPED, end)
        elif course.moving is None:
            again = (end == End.GOING) & watch.repeats(active, xy, total[active], ROUNDING * config.way)
            robots.prevented[active[again]] = watch.prevented[active[again]]
            end = np.where(again, End.ENDLESS, end)
        robots.end[active] = end
        going = end == End.GOING
        if not going.any():
            yield RobotStep(number, active, xy, clearance, nearest, None)
            return
        obstacles = course.obstacles_at(number)
        steering = steer(xy, goals[active], course.around(xy, obstacles), field, steps, total[active])
        # Step: of constant length along the total force
        length = np.hypot(steering.total[:, 0], steering.total[:, 1])[:, None]
        move = config.way * np.where(length > 0.0, steering.total / np.where(length > 0.0, length, 1.0), 0.0)
        if config.collision_guard:
            move, state = _guarded(xy, move, steering.state, goals[active], course, obstacles, config)
            steering = steering._replace(state=state)
        yield RobotStep(number, active, xy, clearance, nearest, steering)
        active, before, moved = active[going], xy[going], Steering(*(part[going] for part in steering))
        robots.xy[active] = before + move[going]
        robots.steps[active] += 1
        robots.length[active] += np.hypot(move[going, 0], move[going, 1])
        robots.states[active, moved.state] += 1
        robots.recognised[active] += moved.recognised
        total[active] = moved.total
        watch.see(robots.xy, active, moved.state == SteeringState.PREVENT)
        gaps = course.clearance(before, robots.xy[active], config.radius, obstacles)


def _guarded(
    xy: Floats,
    move: Floats,
    state: Ints,
    goals: Floats,
    course: Course,
    obstacles: MovingObstacles,
    config: NavigateConfig,
) -> tuple[Floats, Ints]:
    """Steps (A, 2) that do not collide if people continue as before, and the state (A,) of each robot.

    A step that would collide is turned by the smallest sufficient angle, of two equal ones to the side nearer to
    the goal; if no direction is free, that with the largest clearance is taken, which may be no motion.

    Args:
        xy: (A, 2) positions.
        move: (A, 2) steps by the forces.
        state: (A,) states before.
        goals: (A, 2) goals.
        course: static obstacles.
        obstacles: people.
        config: radius and length of a step.
    """
    expected = obstacles.expected()
    clearance = _least(course.clearance(xy, xy + move, config.radius, expected))[0]
    rows = np.flatnonzero(clearance <= GUARD * config.way)
    if not len(rows):
        return move, state
    # All directions, and no motion as the last: (T + 1, R, 2)
    angles = np.array(TURNS)[:, None]
    tried = turned(
        np.broadcast_to(move[rows], (len(TURNS), len(rows), 2)), np.broadcast_to(angles, (len(TURNS), len(rows)))
    )
    tried = np.concatenate([tried, np.zeros((1, len(rows), 2))])
    start = np.broadcast_to(xy[rows], tried.shape).reshape(-1, 2)
    gaps = _least(course.clearance(start, start + tried.reshape(-1, 2), config.radius, expected))[0]
    gaps = gaps.reshape(tried.shape[:2])
    # Order of preference: least turn, then the nearer goal
    left = distance(xy[rows] + tried, goals[rows])
    turn = np.append(np.abs(TURNS), math.inf)[:, None]
    free = gaps > GUARD * config.way
    order = np.lexsort((left, np.broadcast_to(turn, left.shape), ~free), axis=0)
    best = np.where(free.any(axis=0), order[0], np.argmax(gaps, axis=0))
    move, state = move.copy(), state.copy()
    move[rows] = tried[best, np.arange(len(rows))]
    state[rows] = SteeringState.GUARDED
    return move, state


def _standing(obstacles: MovingObstacles) -> MovingObstacles:
    """Moving obstacles at their present positions, as if they stood still."""
    return obstacles._replace(after=obstacles.xy, radius_after=obstacles.radius)


def _least(gaps: Floats) -> tuple[Floats, Ints]:
    """Smallest (A,) of clearances `gaps` (A, K), and the index of its obstacle; inf and -1 without obstacles."""
    if not gaps.shape[1]:
        return np.full(len(gaps), np.inf), np.full(len(gaps), -1)
    nearest = np.argmin(gaps, axis=1)
    least = gaps[np.arange(len(gaps)), nearest]
    return least, np.where(np.isfinite(least), nearest, -1)


def _note_clearance(robots: Drive, active: Ints, clearance: Floats, nearest: Ints) -> None:
    """Update the least clearance of robots, and the index of its obstacle, in `robots`.

    Args:
        robots: results of all N robots, updated in place.
        active: (A,) indices of the active robots.
        clearance: (A,) their clearance in this step.
        nearest: (A,) index of the nearest obstacle.
    """
    less = clearance < robots.clearance[active]
    robots.clearance[active[less]] = clearance[less]
    robots.nearest[active[less]] = nearest[less]


class _Watch:
    """Detects robots that repeat themselves forever, or that stay at one position.

    Among static obstacles, position and total force determine all later steps: if both recur, the robot repeats its
    steps. The state that is compared is renewed at steps 1, 2, 4, 8, ... (Brent's cycle detection), so that a cycle
    of any length is found without a memory of all steps.
    """

    def __init__(self, xy: Floats) -> None:
        """Create a watch for robots at the positions `xy` (N, 2), before the first step."""
        self._step, self._next = 0, 1
        self._xy, self._total = np.full_like(xy, np.nan), np.full_like(xy, np.nan)
        self._box = np.stack([xy, xy])  # least and largest x and y of each robot in this window of steps
        self._before = self._box
        self.prevented = np.zeros(len(xy), dtype=np.bool_)
        """(N,) whether the prevention acted since the state that is compared was taken."""

    def repeats(self, active: Ints, xy: Floats, total: Floats, slack: float) -> Bools:
        """(A,) mask of robots with a position and total force that they had before (Brent's cycle detection).

        Args:
            active: (A,) indices of the robots.
            xy: (A, 2) positions.
            total: (A, 2) total forces.
            slack: distance within which positions are equal.
        """
        size = np.hypot(total[:, 0], total[:, 1])
        same = (distance(xy, self._xy[active]) <= slack) & (distance(total, self._total[active]) <= ROUNDING * size)
        if self._step == self._next:
            self._next *= 2
            # Robots that have just been found to repeat themselves are reported so before the state is forgotten
            fresh = active[~same]
            self._xy[fresh], self._total[fresh], self.prevented[fresh] = xy[~same], total[~same], False
        return np.asarray(same)

    def see(self, xy: Floats, active: Ints, prevented: Bools) -> None:
        """Record the positions `xy` (N, 2) of all robots, and for which active ones the prevention acted.

        `active` (A,) are their indices, `prevented` (A,) the mask.
        """
        self._step += 1
        self.prevented[active] |= prevented
        if self._step % WINDOW == 0:
            self._before, self._box = self._box, np.stack([xy, xy])
        self._box = np.stack([np.minimum(self._box[0], xy), np.maximum(self._box[1], xy)])

    def stays(self, active: Ints, most: float) -> Bools:
        """(A,) mask of the robots `active` (indices) that stayed within `most` in the last two windows of steps.

        `most` limits the extent along x and y. False before there are two windows.
        """
        if self._step < 2 * WINDOW:
            return np.zeros(len(active), dtype=np.bool_)
        low = np.minimum(self._before[0, active], self._box[0, active])
        high = np.maximum(self._before[1, active], self._box[1, active])
        return np.asarray(np.max(high - low, axis=1) <= most)


ROWS = 4096
"""Rows of a table at a time."""
NOTHING = np.full((1, 2), np.nan)
LAST = Steering(
    attractive=NOTHING,
    repulsive=NOTHING,
    total=NOTHING,
    state=np.array([len(STATES)]),
    recognised=np.zeros(1, dtype=np.bool_),
)
"""Steering in the last row, which is followed by no step."""


class PathRows:
    """Converts the steps of a drive with one robot to tables."""

    def __init__(self, names: Sequence[str], start_ns: int, step_s: float) -> None:
        """Set the names of the obstacles, the time of the first row [ns], and the time between two rows [s]."""
        self._names, self._start_ns, self._step_s = (*names, ""), start_ns, step_s

    def tables(self, steps: Iterable[RobotStep]) -> Iterator[RobotPath]:
        """Generate the steps of a drive as tables of up to `ROWS` rows."""
        left = iter(steps)
        while part := list(islice(left, ROWS)):
            yield self._table(part)

    def _table(self, steps: Sequence[RobotStep]) -> RobotPath:
        decisions = [LAST if s.steering is None else s.steering for s in steps]
        seconds = np.array([s.number for s in steps]) * self._step_s
        xy = np.concatenate([s.xy for s in steps])
        clearance: Floats = np.concatenate([s.clearance for s in steps])
        attractive, repulsive, total = (
            np.concatenate(part)
            for part in zip(*((s.attractive, s.repulsive, s.total) for s in decisions), strict=True)
        )
        return RobotPath.of(
            t_ns=self._start_ns + np.rint(seconds * NS).astype(np.int64),
            x=xy[:, 0],
            y=xy[:, 1],
            attractive_x=attractive[:, 0],
            attractive_y=attractive[:, 1],
            repulsive_x=repulsive[:, 0],
            repulsive_y=repulsive[:, 1],
            total_x=total[:, 0],
            total_y=total[:, 1],
            state=np.array(PATH_STATES)[np.concatenate([s.state for s in decisions])],
            recognised=np.concatenate([s.recognised for s in decisions]),
            clearance=np.where(np.isfinite(clearance), clearance, np.nan),
            obstacle=np.array(self._names)[np.concatenate([s.nearest for s in steps])],
        )
