"""[Lee] Figs. 5-28 to 5-30: escapes from oscillation, their angles and distances; robots nearly in line."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from occlog.core.navigation.forces import distance
from occlog.core.navigation.steering import SteeringState, angle_at, angle_inside, angle_outside, distance_outside
from occlog.papers import verdicts as v
from occlog.papers.lee.navigation.config import NavigateConfig
from occlog.papers.lee.navigation.obstacle_course import Disc
from occlog.papers.lee.navigation.stage import Drive, End
from occlog.papers.verdicts import Execute, Experiment, PaperRow, Size, StatementVerdict, Table

from .forces import (
    GOAL,
    OBSTACLE,
    OUT,
    SPAWN,
    START,
    WAY,
    always,
    collided,
    driven,
    force_experiment,
    printed_drive,
    random_lines,
)

MOST = 300
"""Steps of a drive: robots that come to their goal take less than 20."""
INSIDE, OUTSIDE = NavigateConfig(escape="inside", max_steps=MOST), NavigateConfig(escape="outside", max_steps=MOST)
STEPS = {"step 3.1": INSIDE, "step 3.2": OUTSIDE}
RADII = (0.0, 0.2, 0.5)
ANGLES = 24
"""Angles tried in each range."""
DONE, REACHED = "steps", "reached"
HIT = {name: f"collisions, {name}" for name in STEPS}
RANGES = "distances in (5.27) and (5.28)"


def name_of(step: str, radius: float) -> str:
    """Name of a series: `step` (name of the escape), and the radius of robot and obstacle."""
    return f"{step}, r = {radius:g}"


def escapes(size: Size, execute: Execute) -> Table:
    """Table of whether the printed robot escapes by the printed and other angles, and of collisions in random cases."""
    rows: Table = []
    for step, config in STEPS.items():
        for radius in RADII:
            robots = printed_drive(config, radius)[1]
            rows += _outcome(step, radius, math.nan, robots)
            if radius > 0.0:
                ends = (angle_inside if config is INSIDE else angle_outside)(WAY, 2.0 * radius)
                for angle in np.linspace(ends.low, ends.high, ANGLES):
                    turned = replace(config, escape_angle=float(angle))
                    rows += _outcome(step, radius, float(np.degrees(angle)), printed_drive(turned, radius)[1])
    found = execute(
        [{"item": "fig5.29", "seed": size.seed, "run": run, "lines": size.steps} for run in range(size.runs)]
    )
    for name in (*HIT.values(), RANGES):
        rows.append(PaperRow(name, math.nan, tuple(f[name] for f in found if name in f), plotted=False))
    return rows


def _outcome(step: str, radius: float, angle: float, robots: Drive) -> Table:
    """Row of one drive: least distance of centres, with the number of steps and whether the goal was reached.

    Args:
        step: name of the escape.
        radius: radius of robot and obstacle.
        angle: angle of the escape [deg] (x); NaN: the printed one, the largest of its range.
        robots: drive of one robot.
    """
    distance = float(robots.clearance[0]) + 2.0 * radius
    tried = not math.isnan(angle)
    kind = "" if tried else ", printed angle"
    extra = {DONE: float(robots.steps[0]), REACHED: float(robots.end[0] == End.REACHED)}
    return [PaperRow(name_of(step, radius) + kind, angle, (distance,), extra, plotted=tried)]


def escape_trial(spec: Mapping[str, Any]) -> dict[str, float]:
    """Shares of escaping robots that collide, by escape, and of oscillating steps within the printed distances.

    Args:
        spec: `item`, `seed`, `run`, and `lines`, the number of robots for each radius.
    """
    rng = np.random.default_rng(np.random.SeedSequence(spec["seed"], spawn_key=(*SPAWN, 29, spec["run"])))
    lines = random_lines(int(spec["lines"]), rng)
    hits, escaped = dict.fromkeys(STEPS, 0), dict.fromkeys(STEPS, 0)
    within, checked = 0, 0
    for radius in (0.1, 0.2, 0.5):
        disc = Disc(0.0, 0.0, radius)
        for name, config in STEPS.items():
            robots = driven(lines.starts, lines.goals, disc, replace(config, radius=radius))[1]
            turned = robots.states[:, SteeringState.ESCAPING] > 0
            hits[name] += int(collided(robots)[turned].sum())
            escaped[name] += int(turned.sum())
        still = NavigateConfig(escape="none", radius=radius, max_steps=MOST)
        far = distance_outside(WAY, 2.0 * radius)
        steps, robots = driven(lines.starts, lines.goals, disc, still)
        prevented = robots.states[:, SteeringState.PREVENT] > 0
        for step in steps:
            if step.steering is not None:
                rows = step.steering.recognised & prevented[step.active]
                d = distance(step.xy[rows], np.zeros(2))
                within, checked = within + int((d <= far.high * (1.0 + 1e-9)).sum()), checked + int(rows.sum())
    shares = {HIT[name]: hits[name] / escaped[name] for name in STEPS if escaped[name]}
    return shares | ({RANGES: within / checked} if checked else {})


def judge_escapes(table: Table) -> list[StatementVerdict]:
    """Verdicts on the two escapes from oscillation ([Lee] Sec. 5.2.2): do they reach the goal, angles, distances."""
    out = []
    for key, step, radius in (
        ("inside-0", "step 3.1", 0.0),
        ("inside-0.2", "step 3.1", 0.2),
        ("inside-0.5", "step 3.1", 0.5),
        ("outside-0", "step 3.2", 0.0),
        ("outside-0.2", "step 3.2", 0.2),
        ("outside-0.5", "step 3.2", 0.5),
    ):
        row = v.row_of(table, name_of(step, radius) + ", printed angle")
        out.append(
            v.fact(
                f"fig5.29-{key}",
                f"{step.capitalize()} leads the printed robot, r_r = r_o = {radius:g}, to its goal: least "
                "distance of centres.",
                holds=row.extra[REACHED] > 0.0,
                measured=row.mean,
                rule=f"goal reached without a collision; {row.extra[DONE]:g} steps, "
                f"and the radii sum to {2 * radius:g}",
            )
        )
    for key, step in (("inside", "step 3.1"), ("outside", "step 3.2")):
        out.append(
            always(
                f"fig5.29-{key}-safe",
                f"The maximum of theta_osc completely avoids the collision ({step}): share of robots that escape and "
                "collide.",
                v.row_of(table, HIT[step]),
                0.0,
            )
        )
        out.append(_shortest(table, key, step))
    radii = 0.4
    near, far = distance_outside(WAY, radii)
    outside, inside = angle_outside(WAY, radii), angle_inside(WAY, radii)
    off = max(
        abs(math.sin(angle) * d - radii) for angle, d in ((inside.low, near), (outside.low, far), (outside.high, near))
    )
    printed = 1.0 / math.sin(radii / near)
    return [
        *out,
        always(
            "fig5.30-distances",
            "d_osc is within (5.27) inside the region and within (5.28) outside it: share of oscillating steps.",
            v.row_of(table, RANGES),
            1.0,
        ),
        v.fact(
            "fig5.30-ranges",
            "The ends of (5.31) and (5.32) are the angles of (5.29) at the ends of (5.27) and (5.28), with arcsin.",
            holds=off < 1e-12,
            measured=off,
            rule="largest |sin(theta) d_osc - r_r - r_o|: 0",
        ),
        v.fact(
            "fig5.30-csc",
            "(5.30) to (5.32) as printed, with csc: the low end of (5.31) is below pi/2.",
            holds=printed < 0.5 * math.pi,
            measured=printed,
            rule="for r_r = r_o = 0.2; below pi/2",
            paper=0.5 * math.pi,
        ),
        v.fact(
            "fig5.30-maximum",
            "The maximum of d_osc gives the maximum of theta_osc: the angle there less that at the minimum, step 3.2.",
            holds=angle_at(far, radii) > angle_at(near, radii),
            measured=angle_at(far, radii) - angle_at(near, radii),
            rule="above 0 rad, for r_r = r_o = 0.2",
        ),
    ]


def _shortest(table: Table, key: str, step: str) -> StatementVerdict:
    """Verdict on whether the largest angle takes the fewest steps of all angles that lead to the goal.

    `key` is part of the id; `step` the name of the escape.
    """
    more: list[float] = []
    for radius in RADII[1:]:
        name = name_of(step, radius)
        tried = [row for row in v.series(table, name) if row.extra[REACHED] > 0.0]
        own = v.row_of(table, name + ", printed angle")
        if tried and own.extra[REACHED] > 0.0:
            more.append(own.extra[DONE] - min(row.extra[DONE] for row in tried))
    return v.fact(
        f"fig5.29-{key}-shortest",
        f"The maximum of theta_osc supports the shortest path to the goal ({step}): steps more than by other angles.",
        holds=bool(more) and max(more) == 0.0,
        measured=max(more) if more else None,
        rule=f"no angle of the range takes fewer steps, for {len(more)} radii at which the printed angle leads to the "
        "goal",
    )


ACROSS = (0.02, 0.05, 0.1, 0.2, 0.5)
"""Starts are up to so far from the line."""
MAIN = 0.5
"""Maximum distance of the starts from the line for which verdicts are given."""
NEAR_RADIUS = 0.2
WAYS = {
    "(5.15)": NavigateConfig(force="original", escape="none", max_steps=MOST),
    "equalities (5.18), (5.26)": NavigateConfig(
        escape="inside", collinearity_tolerance=0.0, opposition_tolerance=0.0, max_steps=MOST
    ),
    "tolerances, step 3.1": INSIDE,
    "tolerances, step 3.2": OUTSIDE,
}
"""Behaviour of robots that start nearly in line."""


def near_trial(spec: Mapping[str, Any]) -> dict[str, float]:
    """Shares of robots starting near the printed line that collide (`collided`), and that reach the goal (`reached`).

    Args:
        spec: `seed`, `run`, `robots`, `across` (largest distance from the line), `way` (a key of `WAYS`).
    """
    key = (*SPAWN, 18, spec["run"], round(1000 * spec["across"]))
    rng = np.random.default_rng(np.random.SeedSequence(spec["seed"], spawn_key=key))
    n, across = int(spec["robots"]), float(spec["across"])
    aside = rng.uniform(-across, across, (n, 1)) * np.array([OUT[1], -OUT[0]])
    # Starts fill a step along the line, too: where the steps fall decides on a collision
    starts = np.array(START) + rng.uniform(0.0, WAY, (n, 1)) * OUT + aside
    config = replace(WAYS[str(spec["way"])], radius=NEAR_RADIUS)
    robots = driven(starts, np.tile(GOAL, (n, 1)), Disc(*OBSTACLE, NEAR_RADIUS), config)[1]
    return {"collided": float(collided(robots).mean()), "reached": float((robots.end == End.REACHED).mean())}


def near(size: Size, execute: Execute) -> Table:
    """Table of the shares of colliding robots by the largest initial distance from the line."""
    cases = [(way, across, run) for way in WAYS for across in ACROSS for run in range(size.runs)]
    found = execute(
        [{"seed": size.seed, "run": run, "robots": size.steps, "across": a, "way": way} for way, a, run in cases]
    )
    return [
        PaperRow(way, across, tuple(f["collided"] for c, f in zip(cases, found, strict=True) if c[:2] == (way, across)))
        for way in WAYS
        for across in ACROSS
    ]


def judge_near(table: Table) -> list[StatementVerdict]:
    """Verdicts on whether the modified force prevents collisions of robots that are nearly, not exactly, in line."""
    exact, plain = "equalities (5.18), (5.26)", "(5.15)"
    out = [
        always(
            f"near-{key}",
            f"(5.25) guarantees the prevention of collisions, {way}: share of robots up to {MAIN} off the line that "
            "collide.",
            v.row_of(table, way, MAIN),
            0.0,
        )
        for key, way in (("equal", exact), ("inside", "tolerances, step 3.1"), ("outside", "tolerances, step 3.2"))
    ]
    out.append(
        v.pairs(
            "near-gain",
            "Fewer robots collide with the prevention, by the printed equalities, than with the original force (5.15).",
            v.matched(table, exact, plain),
        )
    )
    out += [
        v.pairs(
            f"near-tolerances-{key}",
            f"With tolerances fewer robots collide than with the original force (5.15), {way.split(', ')[1]}.",
            v.matched(table, way, plain),
        )
        for key, way in (("inside", "tolerances, step 3.1"), ("outside", "tolerances, step 3.2"))
    ]
    return out


ESCAPE_EXPERIMENTS = (
    force_experiment(
        item="fig5.29",
        title="Escapes from oscillation by other angles",
        x_label="angle [deg]",
        y_label="least distance of centres",
        compute=escapes,
        judge=judge_escapes,
        trial=escape_trial,
        note="Radii of robot and obstacle are r; a distance below 2 r is a collision. Shares are over robots on random "
        "lines, this many in each run and radius.",
    ),
    Experiment(
        item="near-aligned",
        title="Robots that start nearly in line with obstacle and goal",
        x_label="start, at most so far from the line",
        y_label="share that collides",
        runs=10,
        steps=1000,
        quick=(2, 200),
        compute=near,
        judge=judge_near,
        trial=near_trial,
        note="Radii of robot and obstacle are 0.2; starts fill one step along the line. Tolerances: 0.1 on unit "
        "vectors, 0.05 on the cosine.",
    ),
)
