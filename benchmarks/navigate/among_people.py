"""Robots among people who walk at random and do not mind them: how many reach their goals, how many collide."""

from __future__ import annotations

from collections import Counter
from statistics import fmean
from typing import Any

import numpy as np

from benchmarks.track.track import ROOT
from occlog.errors import InputError
from occlog.io.formats.scenes.scene import read_scene
from occlog.papers.lee.navigation.config import NavigateConfig
from occlog.papers.lee.navigation.obstacle_course import Course, course_of, people_of
from occlog.papers.lee.navigation.stage import Drive, End, drive
from occlog.papers.verdicts import deviation
from occlog.records.tables import Truth
from occlog.scans.occluder_priors import obstacles_of
from occlog.settings import configure
from occlog.simulate.config import WorldConfig
from occlog.simulate.stage import simulate_truth

NAME = "navigate"
SUMMARY = "robots that collide among 3 people in a room of 8 x 6 m: share with defaults to share straight on"
LIMIT = 0.5
SEEDS, ROBOTS = 15, 60
MARGIN = 0.6
"""Starts and goals keep this distance from the walls [m]."""
ALONE: dict[str, object] = {"force": "original", "escape": "none"}
"""Forces alone, without prevention and escape."""
DEFAULTS, STRAIGHT = "defaults", "straight on, no guard"
CASES: dict[str, dict[str, object]] = {
    STRAIGHT: {**ALONE, "repulsion": 0.0, "guard": False},
    "original force, no guard": {**ALONE, "guard": False},
    "prevention, no escape, no guard": {"escape": "none", "guard": False},
    "prevention, escape inside, no guard": {"guard": False},
    "prevention, escape outside, no guard": {"escape": "outside", "guard": False},
    "the same as inside, not looking ahead": {"ahead_s": 0.0, "guard": False},
    "the same as inside, repulsion 0.02": {"repulsion": 0.02, "guard": False},
    "the same as inside, repulsion 0.5": {"repulsion": 0.5, "guard": False},
    "original force": ALONE,
    DEFAULTS: {},
}


def filter_diagnostics(values: dict[str, object]) -> list[dict[str, float]]:
    """Shares of robots by the end of their path, for each seed of the people."""
    scene = read_scene(ROOT / "examples" / "room.yaml")
    world = configure(WorldConfig.in_unit("m"), {"steps": 400, "targets": 3})
    config = configure(NavigateConfig.in_unit("m"), {"steps": 390, **values})
    rng = np.random.default_rng(0)
    low, high = scene.surroundings.min(axis=0) + MARGIN, scene.surroundings.max(axis=0) - MARGIN
    starts, goals = rng.uniform(low, high, (ROBOTS, 2)), rng.uniform(low, high, (ROBOTS, 2))
    out = []
    for seed in range(SEEDS):
        people = Truth.concat(simulate_truth(scene, world, seed))
        course = course_of(scene, (), obstacles_of(people, int(people.t_ns[0]), people_of(config)), config)
        free = [n for n in range(ROBOTS) if _free(course, starts[n], goals[n], config)]
        robots = Drive.at(starts[free])
        for _ in drive(robots, goals[free], course, config):
            pass
        ends = Counter(robots.end.tolist())
        into = Counter(course.names[k].partition(" ")[0] for k in robots.nearest[robots.end == End.COLLIDED].tolist())
        shares = {"reached": ends[End.REACHED], "collided": ends[End.COLLIDED], "with people": into["person"]}
        out.append({name: count / len(free) for name, count in shares.items()})
    return out


def _free(course: Course, start: np.ndarray[Any, Any], goal: np.ndarray[Any, Any], config: NavigateConfig) -> bool:
    """Whether a robot can be at both places."""
    try:
        course.check_position("start", start, config)
        course.check_position("goal", goal, config)
    except InputError:
        return False
    return True


def run(repeats: int) -> dict[str, Any]:  # noqa: ARG001
    """Share of robots that collide with the defaults, to that of robots that go straight on."""
    found = {name: filter_diagnostics(values) for name, values in CASES.items()}
    parts: dict[str, Any] = {}
    for name, runs in found.items():
        words = []
        for key in ("reached", "collided", "with people"):
            values = [r[key] for r in runs]
            words.append(f"{key} {fmean(values):.3f} ± {deviation(values) / len(values) ** 0.5:.3f}")
        parts[name] = ", ".join(words)
    share = {name: fmean(r["collided"] for r in runs) for name, runs in found.items()}
    return {
        "ratio": share[DEFAULTS] / share[STRAIGHT],
        "limit": LIMIT,
        "parts": parts,
    }
