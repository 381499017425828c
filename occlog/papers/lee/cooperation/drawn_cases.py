"""The drawn cases of [Lee] Sec. 3.3.3: which of the triggers (3.14) to (3.16) fire in Figs. 3-8, 3-10, 3-11 and 3-13.

The figures are sketches without numbers.  Here each run draws positions, courses and noise that fit what the
text states about a case, so that a share of runs shows whether its statement depends on the sketch.

Fig. 3-8: two changes at one time step that leave the number of bearings as it is.  The text describes (b)
and (c); (d) to (f) are "similar cases", represented by the other pairs of the changes that Sec. 3.3.2 names.
The array hears everywhere, so that I(k-1) of (3.14) is the number of tracks.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import NS, Floats
from occlog.papers import verdicts as v
from occlog.papers.verdicts import (
    Execute,
    Experiment,
    Measure,
    PaperRow,
    Size,
    StatementVerdict,
    Table,
    exact,
    share_of,
)
from occlog.pipeline.sweep.trial import Spec
from occlog.records.scene import MicrophoneArray, Scene
from occlog.scans.grouping import Scan
from occlog.settings import configure
from occlog.track.methods.imm import kernel as imm
from occlog.track.methods.imm.camera_requests import RequestMemory, requests_after_scan
from occlog.track.methods.imm.config import ImmConfig
from occlog.track.methods.imm.filter import init, step
from occlog.track.methods.imm.tracks import Track, confirmed_track

from .trial import FORMS, SCENES, START_SIGMA, START_SIGMA_V

SIGMA = math.radians(math.sqrt(3.0))
"""Standard deviation of a bearing: the variance of Fig. 3-7, in degrees squared."""
RESOLUTION = math.radians(3.0)
"""Bearings of two sources nearer than this are one."""
BEFORE, WITHIN = 30, 10
"""Steps before the change, and steps from it on in which a trigger should fire."""
SPEED, APART = 0.25, math.radians(25.0)
"""Speed of the objects [m/s], and least angle between two that are heard separately."""
NEAR, FAR, EDGE = 8.0, 18.0, 22.5
"""Distances of objects inside the range, and of those at its end [m]."""
CERTAIN = 0.9
"""Share of the runs from which something always happens."""
GAPS = (math.radians(15.0), math.radians(30.0))
"""Least and greatest angle between the two bearings of Figs. 3-10, 3-11 and 3-13."""
PARTICLES, TIGHT, WIDE = 500, 0.4, 1.5
"""Particles of each model, and the standard deviations of a narrow and of a wide cloud [m]."""
PERFORMANCE = ("bearing", "ellipse")
"""Causes of requests by (3.15) and (3.16)."""


class HearingChange(NamedTuple):
    """A case of [Lee] Fig. 3-8: groups of objects heard before and from a time step on; a group is heard as one source.

    `what` describes it; `edge` are objects at the end of the range then, `close` two objects with bearings that
    differ by the resolution.
    """

    what: str
    before: tuple[tuple[int, ...], ...]
    after: tuple[tuple[int, ...], ...]
    edge: tuple[int, ...] = ()  # objects at the end of the range
    close: tuple[int, ...] = ()  # two objects with bearings that differ by the resolution


CHANGES = {
    "b": HearingChange("object 4 comes in, object 3 falls silent", ((1,), (2,), (3,)), ((1,), (2,), (4,)), (4,)),
    "c": HearingChange("object 4 comes in, object 3 goes out", ((1,), (2,), (3,)), ((1,), (2,), (4,)), (3, 4)),
    "d": HearingChange(
        "object 4 comes in, 2 and 3 are heard as one", ((1,), (2,), (3,)), ((1,), (2, 3), (4,)), (4,), (2, 3)
    ),
    "e": HearingChange(
        "3 and 4 are heard apart, object 1 falls silent", ((1,), (2,), (3, 4)), ((2,), (3,), (4,)), (), (3, 4)
    ),
    "f": HearingChange(
        "3 and 4 are heard apart, object 1 goes out", ((1,), (2,), (3, 4)), ((2,), (3,), (4,)), (1,), (3, 4)
    ),
}


def change_trial(spec: Spec) -> dict[str, float]:
    """Run the thesis' filter through a change of [Lee] Fig. 3-8 without answers of cameras.

    Args:
        spec: `case`, `seed`, `run`.

    Returns:
        `count`: 1 if (3.14) holds at the change; `bearing`, `ellipse`, `either`: 1 if (3.15), (3.16) or one of them
        holds in the `WITHIN` steps from it on; `after` and `before`: share of these steps, and of as many before the
        change, in which one of them holds.
    """
    case = CHANGES[spec["case"]]
    rng = np.random.default_rng(np.random.SeedSequence(spec["seed"], spawn_key=(spec["run"], 2009, 38)))
    start, velocity = _objects(case, rng)
    scene = Scene(arrays=(MicrophoneArray("mic", np.zeros(3), sigma=SIGMA, planar=True, rate_hz=1.0),), length_unit="m")
    config = configure(ImmConfig(), {**SCENES["field"], **FORMS["thesis"], "cooperate": "printed", "walls": False})
    tracks = tuple(_track(config, start, velocity, group, rng) for group in case.before)
    state, memory = init(scene, config, rng)._replace(tracks=tracks, free=5), RequestMemory()
    causes: list[set[str]] = []
    for k in range(BEFORE + WITHIN):
        heard = case.before if k < BEFORE else case.after
        state, report = step(state, _scan(k, start + k * velocity, heard, rng), rng)
        asked, memory = requests_after_scan(state, report, memory, rng)
        causes.append({c for a in asked for c in a.causes})
    after = set().union(*causes[BEFORE:])
    fired = np.array([bool(c & set(PERFORMANCE)) for c in causes], dtype=np.float64)
    return {
        "count": float("count" in causes[BEFORE]),
        **{c: float(c in after) for c in PERFORMANCE},
        "either": float(fired[BEFORE:].any()),
        "after": float(fired[BEFORE:].mean()),
        "before": float(fired[BEFORE - WITHIN : BEFORE].mean()),
    }


def _objects(case: HearingChange, rng: Generator) -> tuple[Floats, Floats]:
    """Draw initial positions (4, 2) [m] and velocities (4, 2) [m/s] with which the sketch holds at the change.

    `case` states which objects are close to each other or at the edge of the range then.
    """
    while True:
        angle = rng.uniform(-math.pi, math.pi, 4)
        if case.close:
            one, other = (number - 1 for number in case.close)
            angle[other] = angle[one] + RESOLUTION
        gaps = [
            abs(math.remainder(angle[i] - angle[j], 2.0 * math.pi))
            for i in range(4)
            for j in range(i)
            if {i + 1, j + 1} != set(case.close)
        ]
        if min(gaps) >= APART:
            break
    distance = rng.uniform(NEAR, FAR, 4)
    distance[[number - 1 for number in case.edge]] = EDGE
    course = rng.uniform(-math.pi, math.pi, 4)
    if case.close:
        course[case.close[1] - 1] = course[case.close[0] - 1]
    velocity = SPEED * np.column_stack([np.cos(course), np.sin(course)])
    positions = distance[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    return positions - BEFORE * velocity, velocity


def _track(config: ImmConfig, start: Floats, velocity: Floats, group: tuple[int, ...], rng: Generator) -> Track:
    """Track of the first object of a group that is heard as one, started near its true state.

    Args:
        config: settings of the filter.
        start: (4, 2) positions of all objects [m].
        velocity: (4, 2) velocities [m/s].
        group: numbers of the group's objects, from 1.
        rng: random generator of the particles.
    """
    i = group[0] - 1
    state = (*start[i], START_SIGMA, *velocity[i], START_SIGMA_V)
    return confirmed_track(config, group[0], state, 0, rng)


def _scan(k: int, positions: Floats, heard: Sequence[tuple[int, ...]], rng: Generator) -> Scan:
    """Draw the array's bearings at step k; a group is heard in the mean direction of its members.

    Args:
        k: number of the step, and time in seconds.
        positions: (4, 2) positions of the objects relative to the array [m].
        heard: groups as numbers of objects, from 1.
        rng: random generator of the noise.
    """
    at = np.arctan2(positions[:, 1], positions[:, 0])
    middle = [math.atan2(*(sum(f(at[n - 1]) for n in group) for f in (math.sin, math.cos))) for group in heard]
    bearing = np.array(middle) + SIGMA * rng.standard_normal(len(heard))
    order = np.argsort(bearing)
    return Scan.of(k * NS, [0] * len(heard), bearing=bearing[order], sigma=np.full(len(heard), SIGMA))


def changes(size: Size, execute: Execute) -> Table:
    """Table of the share of runs in which each trigger of [Lee] Sec. 3.3.3 fires, for every case of Fig. 3-8."""
    return [
        PaperRow(title, n, v.values_of(own, name))
        for n, (_, own) in enumerate(_trials(CHANGES, "lee38", size, execute), start=2)
        for name, title in TITLES.items()
    ]


def _trials(cases: Iterable[str], paper: str, size: Size, execute: Execute) -> list[tuple[str, list[dict[str, float]]]]:
    """Run the trials of all cases; return each case with the figures of its runs."""
    return v.run_trials(
        cases, size, execute, lambda case, run: {"case": case, "seed": size.seed, "run": run, "paper": paper}
    )


TITLES = {
    "count": "(3.14) at the change",
    "bearing": "(3.15) soon",
    "ellipse": "(3.16) soon",
    "either": "(3.15) or (3.16) soon",
    "after": "steps with (3.15) or (3.16), after",
    "before": "steps with (3.15) or (3.16), before",
}


def judge_changes(table: Table) -> list[StatementVerdict]:
    """Verdicts for each case of [Lee] Fig. 3-8: does (3.14), the trigger by counts, stay silent, and do others fire.

    The others are (3.15) and (3.16), by the error of the estimate.
    """
    out = []
    for n, (letter, case) in enumerate(CHANGES.items()):
        rows = {name: v.row_of(table, title, n + 2.0) for name, title in TITLES.items()}
        count, either, after, before = (rows[name] for name in ("count", "either", "after", "before"))
        statement = f"({letter}) {case.what}: (3.14) does not fire (share of the runs in which it does)."
        out.append(v.judge(f"fig3.8-{letter}", statement, exact(count.mean, count.runs), v.at_most(0.0), rule="0"))
        statement = f"({letter}) {case.what}: (3.15) or (3.16) fires in {WITHIN} steps (share of the runs)."
        out.append(_always(f"fig3.8-soon-{letter}", statement, share_of(round(sum(either.values)), either.runs)))
        statement = (
            f"({letter}) {case.what}: one of them holds in more of {WITHIN} steps after the change than before it."
        )
        out.append(v.pairs(f"fig3.8-more-{letter}", statement, [(before, after)]))
    return out


class Sketch(NamedTuple):
    """A case of [Lee] Figs. 3-10, 3-11 or 3-13: where the particles of each model are, and which conditions hold.

    `clouds` are triples (side, along, width): `side` is a share of the angle from z1, the bearing of the object, to
    z2, that of another; `along` a share of the distance from the near end to the far one; `width` a standard
    deviation [m]. `bearing` and `ellipse`: whether (3.15) and (3.16) fire; None: not stated.
    """

    clouds: tuple[tuple[float, float, float], ...]
    bearing: bool | None  # whether (3.15) fires; None: the text does not state
    ellipse: bool | None  # (3.16)


SKETCHES = {
    "3.10": Sketch(((0.0, 0.5, TIGHT), (1.0, 0.5, TIGHT)), bearing=True, ellipse=None),
    "3.11": Sketch(((0.0, 0.0, TIGHT), (0.0, 1.0, TIGHT)), bearing=False, ellipse=True),
    "3.13": Sketch(((0.0, 0.5, TIGHT), (1.0, 0.5, TIGHT), (0.5, 0.5, WIDE)), bearing=True, ellipse=False),
}
CONDITIONS = {"bearing": "(3.15)", "ellipse": "(3.16)"}


def sketch_trial(spec: Spec) -> dict[str, float]:
    """Weight the particles of a drawn case by two bearings, and evaluate the triggers ([Lee] Sec. 3.3.3).

    Args:
        spec: `case`, a key of `SKETCHES`, `seed` and `run`.

    Returns:
        1 or 0: `bearing`, whether Eq. 3.15 fires (the estimate is outside the 95 % ranges of all bearings), and
            `ellipse`, whether Eq. 3.16 does (it is outside the 95 % ellipses of all models).
    """
    case = SKETCHES[spec["case"]]
    rng = np.random.default_rng(np.random.SeedSequence(spec["seed"], spawn_key=(spec["run"], 2009, 313)))
    first, gap = rng.uniform(-math.pi, math.pi), rng.uniform(*GAPS)
    bearing, sigma, origin = first + np.array([0.0, gap]), np.full(2, SIGMA), np.zeros(2)
    # The particles of each model (Eq. 3.3), and weights by both bearings (Eqs. 3.5-3.6)
    predicted = np.zeros((len(case.clouds), PARTICLES, 4))
    for m, (side, along, width) in enumerate(case.clouds):
        angle, distance = first + side * gap, NEAR + along * (FAR - NEAR)
        middle = distance * np.array([math.cos(angle), math.sin(angle)])
        predicted[m, :, ::2] = middle + width * rng.standard_normal((PARTICLES, 2))
    prior = np.full(predicted.shape[:2], 1.0 / predicted[..., 0].size)
    weights = imm.update_weights(predicted, prior, bearing, sigma, origin)
    # The estimate, and both conditions
    mean, ahead = imm.moments(predicted, weights.total).mean, imm.moments(predicted, prior)
    return {
        "bearing": float(imm.outside_ranges(mean, bearing, sigma, origin)),
        "ellipse": float(imm.outside_ellipses(mean, ahead.means, ahead.covariances)),
    }


def sketches(size: Size, execute: Execute) -> Table:
    """Table of the share of runs in which the triggers [Lee] Eqs. 3.15 and 3.16 fire in Figs. 3-10, 3-11 and 3-13."""
    return [
        PaperRow(title, float(figure.split(".")[1]), v.values_of(own, name))
        for figure, own in _trials(SKETCHES, "lee313", size, execute)
        for name, title in CONDITIONS.items()
    ]


def judge_sketches(table: Table) -> list[StatementVerdict]:
    """Verdicts on whether the triggers [Lee] Eqs. 3.15 and 3.16 fire where the text states it, and only there."""
    out = []
    for figure, case in SKETCHES.items():
        for name, title in CONDITIONS.items():
            wanted = case.bearing if name == "bearing" else case.ellipse
            row = v.find(table, title, float(figure.split(".")[1]))
            if wanted is None or row is None:
                continue
            statement = f"Fig. {figure.replace('.', '-')}: {title} {'fires' if wanted else 'does not fire'}"
            held = share_of(round(sum(x == wanted for x in row.values)), row.runs)
            out.append(_always(f"fig{figure}-drawn-{name}", f"{statement} (share of the runs).", held))
    return out


def _always(key: str, statement: str, share: Measure) -> StatementVerdict:
    rule = f"share of at least {CERTAIN:g}; in part from 0.5"
    return v.judge(key, statement, share, v.at_least(CERTAIN), v.at_least(0.5), rule=rule)


DRAWN_EXPERIMENTS = (
    Experiment(
        item="fig3.8",
        title="Changes that leave the number of bearings as it is",
        x_label="case: 2 b, 3 c, 4 d, 5 e, 6 f",
        y_label="share of the runs",
        runs=100,
        steps=BEFORE + WITHIN,
        quick=(4, BEFORE + WITHIN),
        compute=changes,
        judge=judge_changes,
        note="The text describes (b) and (c) only; (d) to (f) are the other pairs of the changes of Sec. 3.3.2. "
        "Each run draws positions, courses and noise.",
        trial=change_trial,
    ),
    Experiment(
        item="fig3.13",
        title="Where only one of (3.15) and (3.16) fires",
        x_label="figure: 10, 11 and 13 of chapter 3",
        y_label="share of the runs",
        runs=400,
        steps=1,
        quick=(40, 1),
        compute=sketches,
        judge=judge_sketches,
        note="The sketches have no numbers: each run draws the angle between two bearings and the particles.",
        trial=sketch_trial,
    ),
)
