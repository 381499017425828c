"""[Lee] Figs. 5-25 to 5-27: forces along the diagonal of the printed example, with and without the prevention.

What the experiments of [Lee] Sec. 5.2.2 share: the printed example, robots on random lines, verdicts.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.core.navigation.forces import (
    Field,
    aligned,
    attractive_force,
    distance,
    repulsive_force,
    within_reach,
    zero_force_distance,
)
from occlog.core.navigation.steering import NearbyObstacles, SteeringState, StepRules, steer
from occlog.papers import verdicts as v
from occlog.papers.verdicts import Execute, Experiment, PaperRow, Size, StatementVerdict, Table, mean_of
from occlog.records.scene import Scene

from .config import NavigateConfig
from .obstacle_course import Disc, course_of
from .stage import Drive, End, RobotStep, drive

PLANE = Scene(length_unit="unit")
START, OBSTACLE, GOAL = (12.0, 12.0), (8.0, 8.0), (6.0, 6.0)
"""Positions of the printed example."""
OUT = np.array([1.0, 1.0]) / math.sqrt(2.0)
"""Along the diagonal, away from the origin: positive in Figs. 5-26 and 5-27."""
FIELD = Field(0.5, 5.0, 2, 2, influence=10.0)
WAY = math.sqrt(2.0)
SPAWN = (2009, 52)
"""Key of the random streams of these experiments."""


class RobotLines(NamedTuple):
    """N robots, each on a line with one obstacle and a goal behind it.

    Start and goal positions (N, 2), and distances of the goals from the obstacle (N,).
    """

    starts: Floats  # (N, 2)
    goals: Floats  # (N, 2)
    behind: Floats  # (N,) distance of the goal from the obstacle


def printed_drive(config: NavigateConfig, radius: float = 0.0) -> tuple[list[RobotStep], Drive]:
    """Drive the robot of the printed example; return its steps and outcome.

    `radius` is that of robot and obstacle.
    """
    starts, goals = np.array([START]), np.array([GOAL])
    return driven(starts, goals, Disc(*OBSTACLE, radius), replace(config, radius=radius))


def driven(starts: Floats, goals: Floats, obstacle: Disc, config: NavigateConfig) -> tuple[list[RobotStep], Drive]:
    """Drive robots from `starts` (N, 2) to `goals` (N, 2) around one obstacle; return steps and outcomes."""
    robots = Drive.at(starts)
    return list(drive(robots, goals, course_of(PLANE, (obstacle,), None, config), config)), robots


def random_lines(n: int, rng: np.random.Generator, obstacle: tuple[float, float] = (0.0, 0.0)) -> RobotLines:
    """Draw n random lines through an obstacle: robots 3 to 9 units before it, goals 1 to 5 behind it."""
    turn = rng.uniform(-math.pi, math.pi, n)
    along = np.column_stack([np.cos(turn), np.sin(turn)])
    behind = rng.uniform(1.0, 5.0, n)
    starts = np.array(obstacle) + rng.uniform(3.0, 9.0, n)[:, None] * along
    return RobotLines(starts, np.array(obstacle) - behind[:, None] * along, behind)


def collided(robots: Drive) -> Bools:
    """(N,) mask of robots that collided."""
    return np.asarray(robots.end == End.COLLIDED)


def always(key: str, statement: str, row: PaperRow, share: float, paper: float | None = None) -> StatementVerdict:
    """Verdict on a statement that something always, or never, happens.

    Reproduced if the share over all trials is exactly that; not reproduced if it differs from it by more than
    two standard errors over the runs.

    Args:
        key: id of the verdict.
        statement: text of the statement.
        row: share of trials in each run; None: missing.
        share: what it must be, 0 or 1.
        paper: printed value; None: none.
    """
    return v.judge(
        key, statement, mean_of(row), v.Interval(share, share), rule=f"share of trials: {share:g} in all", paper=paper
    )


FIRST, LAST, SPACING = 2.0, 14.0, 0.25
"""Ends of the diagonal in the figures, and the distance between points."""
HIDDEN = 0.6
"""Points nearer to the obstacle along an axis are in no plot: the push is too large there."""
BEHIND = math.sqrt(8.0)
"""Distance of the goal from the obstacle."""
ATTRACTION, REPULSION, TOTAL, PREVENTED = "attractive force", "repulsive force", "total force", "total force (5.24)"
BEYOND = ", beyond the obstacle"
FORCE, DELTA, PLACE = "zero force at", "delta", "position after step"
SAFE, DOOMED = "collisions, delta above a step", "collisions, (5.16) to (5.18)"
ORIGINAL = NavigateConfig(force="original", escape="none")
PREVENTION = NavigateConfig(force="prevent", escape="none")
EXACT = 1e-9


def signed(force: Floats) -> Floats:
    """(N,) components of forces (N, 2) along the diagonal, positive away from the origin."""
    return np.asarray(force @ OUT)


def diagonal(at: Floats) -> dict[str, Floats]:
    """Signed forces (n,) along the diagonal at the points (at, at) of the printed example, by name; `at` is (n,)."""
    p, goal, obstacle = np.column_stack([at, at]), np.array(GOAL), np.array(OBSTACLE)
    pull, push = signed(attractive_force(p, goal, FIELD)), signed(repulsive_force(p, obstacle, FIELD))
    rule = StepRules(way=WAY, radius=0.0, prevent=True, escape="none", side="left", aligned=0.1, opposite=0.05)
    flat = np.zeros(1)
    around = NearbyObstacles(nearest=np.tile(obstacle, (len(p), 1, 1)), radius=flat, size=flat, way=flat)
    goals, before = np.tile(goal, (len(p), 1)), np.full_like(p, np.nan)
    prevented = signed(steer(p, goals, around, FIELD, rule, before).total)
    return {ATTRACTION: pull, REPULSION: push, TOTAL: pull + push, PREVENTED: prevented}


def original_forces(size: Size, execute: Execute) -> Table:
    """Table of forces along the diagonal, the zero-force position, the printed robot's path, and collision shares."""
    at = np.arange(FIRST, LAST + 0.5 * SPACING, SPACING)
    at = at[at != OBSTACLE[0]]
    rows = _curves(at, (ATTRACTION, REPULSION, TOTAL))
    delta = float(zero_force_distance(np.array(BEHIND), FIELD))
    rows.append(PaperRow(FORCE, 0.0, (OBSTACLE[0] + delta / math.sqrt(2.0),), plotted=False))
    rows.append(PaperRow(DELTA, 0.0, (delta,), plotted=False))
    steps, _ = printed_drive(ORIGINAL)
    rows += [PaperRow(PLACE, float(s.number), (float(s.xy[0, 0]),), plotted=False) for s in steps]
    return rows + _shares("fig5.26", size, execute, (SAFE, DOOMED))


def _curves(at: Floats, names: tuple[str, ...]) -> Table:
    """Rows of the forces `names` along the diagonal, at the coordinates `at` (n,) of both axes.

    Points near the obstacle are in the table, but not plotted.
    """
    curves, drawn = diagonal(at), np.abs(at - OBSTACLE[0]) >= HIDDEN
    # Curves of forces that the obstacle pushes apart are two each
    return [
        PaperRow(name if x > OBSTACLE[0] else name + BEYOND, float(x), (float(y),), plotted=bool(near))
        for name in names
        for x, y, near in zip(at, curves[name], drawn, strict=True)
    ]


def _shares(item: str, size: Size, execute: Execute, names: tuple[str, ...]) -> Table:
    """Rows of the shares `names` over random lines, a value for each run; not plotted.

    `item` is the figure of the trials.
    """
    found = execute([{"item": item, "seed": size.seed, "run": run, "lines": size.steps} for run in range(size.runs)])
    shares = {name: tuple(f[name] for f in found if name in f and not math.isnan(f[name])) for name in names}
    return [PaperRow(name, math.nan, values, plotted=False) for name, values in shares.items()]


def collision_trial(spec: Mapping[str, Any]) -> dict[str, float]:
    """Shares of robots on random lines that collide under the original force.

    Args:
        spec: `item`, `seed`, `run`, and `lines`, the number of robots.

    Returns:
        Among robots with delta above a step, and among those for which the three conditions (5.16) to (5.18)
        hold at some step, the shares that collide; NaN without such robots.
    """
    rng = np.random.default_rng(np.random.SeedSequence(spec["seed"], spawn_key=(*SPAWN, 26, spec["run"])))
    lines = random_lines(int(spec["lines"]), rng)
    steps, robots = driven(lines.starts, lines.goals, Disc(0.0, 0.0), ORIGINAL)
    hit, doomed, origin = collided(robots), np.zeros(len(lines.starts), dtype=np.bool_), np.zeros(2)
    for step in steps:
        if step.steering is None:
            continue
        pull, push = (np.hypot(*force.T) for force in (step.steering.attractive, step.steering.repulsive))
        near = within_reach(distance(step.xy, origin), np.full(len(step.xy), WAY))
        inline = aligned(step.xy, origin, lines.goals[step.active], EXACT)
        doomed[step.active] |= (pull > push) & near & inline
    safe = zero_force_distance(lines.behind, FIELD) > WAY
    return {SAFE: _share(hit[safe]), DOOMED: _share(hit[doomed])}


def _share(of: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> float:
    return float(of.mean()) if len(of) else math.nan


def judge_original(table: Table) -> list[StatementVerdict]:
    """Verdicts on what [Lee] Sec. 5.2.2 states about the printed example, Fig. 5-26, and the problem's definition."""
    zero, delta = v.find(table, FORCE), v.find(table, DELTA)
    fine = np.arange(8.91, LAST, 0.01)
    negative = float(np.mean(diagonal(fine)[TOTAL] < 0.0))
    off = np.arange(0.25, 4.0, 0.25)
    pulls = [diagonal(GOAL[0] + sign * off)[ATTRACTION] for sign in (1.0, -1.0)]
    pushes = [diagonal(OBSTACLE[0] + sign * off)[REPULSION] for sign in (1.0, -1.0)]
    positions = [row.mean for row in v.series(table, PLACE)]
    expected = [12.0, 11.0, 10.0, 9.0]
    return [
        v.printed("fig5.26-zero", "The total force is zero at (8.9, 8.9).", 8.9, zero),
        v.printed("fig5.26-delta", "delta, the distance of zero force from the obstacle, is 1.27.", 1.27, delta),
        v.fact(
            "fig5.26-negative",
            "The total forces from (14,14) to (8.9,8.9) are negative.",
            holds=negative == 1.0,
            measured=negative,
            rule="share of points at distances of 0.01 down to (8.91,8.91)",
        ),
        v.fact(
            "fig5.26-attraction",
            "From the goal position (6,6), the attractive force is symmetrically exerted.",
            holds=_mirrored(pulls) < EXACT,
            measured=_mirrored(pulls),
            rule="largest sum of forces at equal distances: 0",
        ),
        v.fact(
            "fig5.26-repulsion",
            "From the obstacle position (8,8), the repulsive force is symmetrically exerted.",
            holds=_mirrored(pushes) < EXACT,
            measured=_mirrored(pushes),
            rule="largest sum of forces at equal distances: 0",
        ),
        v.fact(
            "fig5.26-path",
            "The robot moves toward the obstacle from (12,12), and passes (11,11), (10,10) and (9,9).",
            holds=np.allclose(positions[:4], expected, atol=EXACT),
            measured=float(np.abs(np.subtract(positions[:4], expected)).max()),
            rule="largest deviation: 0",
        ),
        v.fact(
            "fig5.26-collision",
            "From (9,9) it continuously moves toward the obstacle and collides with it at (8,8).",
            holds=len(positions) == 5
            and abs(positions[4] - 8.0) < EXACT
            and printed_drive(ORIGINAL)[1].end[0] == End.COLLIDED,
            measured=positions[-1],
            rule="the path ends by a collision at (8,8)",
            paper=8.0,
        ),
        always("fig5.26-conditions", "Robots for which (5.16) to (5.18) hold collide.", v.row_of(table, DOOMED), 1.0),
        always(
            "fig5.26-safe",
            "If delta is larger than s_r T_s, the collision is prevented: share that collides.",
            v.row_of(table, SAFE),
            0.0,
        ),
    ]


def _mirrored(forces: list[Floats]) -> float:
    """Largest absolute sum of two arrays of forces that should be opposite."""
    return float(np.abs(forces[0] + forces[1]).max())


GUARDED, WIDE = "collisions by (5.24)", "collisions by (5.25)"
ENDLESS, FIRED = "endless oscillation by (5.25)", "lines on which equality (5.18) holds in doubles"


def prevention_trial(spec: Mapping[str, Any]) -> dict[str, float]:
    """Shares of robots that collide, and that oscillate forever, under the modified force.

    Args:
        spec: `item`, `seed`, `run`, and `lines`, the number of robots.
    """
    rng = np.random.default_rng(np.random.SeedSequence(spec["seed"], spawn_key=(*SPAWN, 27, spec["run"])))
    n = int(spec["lines"])
    lines = random_lines(n, rng)
    points = driven(lines.starts, lines.goals, Disc(0.0, 0.0), PREVENTION)[1]
    hits, tried, endless, held = 0, 0, 0, 0
    for radius in (0.1, 0.2, 0.5, 1.0):
        config = NavigateConfig(force="prevent", escape="none", radius=radius)
        separate = distance(lines.starts, np.zeros(2)) > 2.0 * radius
        wide = driven(lines.starts[separate], lines.goals[separate], Disc(0.0, 0.0, radius), config)[1]
        hits, tried = hits + int(collided(wide).sum()), tried + int(separate.sum())
        prevented = wide.states[:, SteeringState.PREVENT] > 0
        endless, held = endless + int((wide.end[prevented] == End.ENDLESS).sum()), held + int(prevented.sum())
    exact = aligned(lines.starts, np.zeros(2), lines.goals, 0.0)
    return {
        GUARDED: float(collided(points).mean()),
        WIDE: hits / tried,
        ENDLESS: endless / held if held else math.nan,
        FIRED: float(exact.mean()),
    }


def prevented_forces(size: Size, execute: Execute) -> Table:
    """Table of forces along the diagonal by [Lee] Eq. 5.24, the printed robot's path, and shares over random lines."""
    at = np.arange(FIRST, LAST + 0.5 * SPACING, SPACING)
    at = at[at != OBSTACLE[0]]
    steps, _ = printed_drive(PREVENTION)
    rows = _curves(at, (TOTAL, PREVENTED))
    rows += [PaperRow(PLACE, float(s.number), (float(s.xy[0, 0]),), plotted=False) for s in steps]
    return rows + _shares("fig5.27", size, execute, (GUARDED, WIDE, ENDLESS, FIRED))


def judge_prevention(table: Table) -> list[StatementVerdict]:
    """Verdicts on what [Lee] Sec. 5.2.2 states about the modified force, Fig. 5-27 and the oscillation after it."""
    positions = [row.mean for row in v.series(table, PLACE)]
    robots = printed_drive(PREVENTION)[1]
    back = [9.0, 10.0, 9.0, 10.0][: len(positions) - 3]
    return [
        v.fact(
            "fig5.27-back",
            "When the robot moves from (10,10) to (9,9), it moves back to (10,10), and the collision is avoided.",
            holds=abs(positions[4] - 10.0) < EXACT and not collided(robots)[0],
            measured=positions[4],
            rule="the position after (9,9) is (10,10), without a collision",
            paper=10.0,
        ),
        v.fact(
            "fig5.27-oscillation",
            "It moves back and forth between (9,9) and (10,10) and never reaches the goal.",
            holds=robots.end[0] == End.ENDLESS and np.allclose(positions[3:], back, atol=EXACT),
            measured=float(np.abs(np.subtract(positions[3:], back)).max()),
            rule="position and force come back exactly; largest deviation of positions: 0",
        ),
        v.fact(
            "fig5.27-recognised",
            "The oscillation is recognised by (5.26).",
            holds=bool(robots.recognised[0] > 0),
            measured=float(robots.recognised[0]),
            rule="steps at which it is recognised, with a tolerance of 0.05 on the cosine: above 0",
        ),
        always(
            "fig5.27-never",
            "With (5.24) a point robot in line with obstacle and goal never collides: share that does.",
            v.row_of(table, GUARDED),
            0.0,
        ),
        always(
            "fig5.27-radii",
            "(5.25) guarantees the prevention, in line and before an escape: share of robots of a size that collides.",
            v.row_of(table, WIDE),
            0.0,
        ),
        always(
            "fig5.27-endless",
            "A robot that is prevented oscillates and never reaches its goal: share of robots.",
            v.row_of(table, ENDLESS),
            1.0,
        ),
        always(
            "fig5.27-equality",
            "The condition of (5.24) is the equality of two unit vectors: share of aligned robots for which it holds "
            "in double precision.",
            v.row_of(table, FIRED),
            1.0,
        ),
    ]


force_experiment = functools.partial(Experiment, runs=10, steps=400, quick=(2, 100))
FORCE_EXPERIMENTS = (
    force_experiment(
        item="fig5.26",
        title="Forces along the diagonal of the printed example",
        x_label="x = y",
        y_label="force, away from the origin",
        compute=original_forces,
        judge=judge_original,
        trial=collision_trial,
        note="Shares are over robots on random lines through an obstacle, this many in each run.",
    ),
    force_experiment(
        item="fig5.27",
        title="Total force with the prevention of collisions in line",
        x_label="x = y",
        y_label="force, away from the origin",
        compute=prevented_forces,
        judge=judge_prevention,
        trial=prevention_trial,
        note="Radii of robot and obstacle are equal: 0.1, 0.2, 0.5 and 1.",
    ),
)
