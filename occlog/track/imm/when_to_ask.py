"""When the filter asks cameras where its targets are, and what their answers do ([Lee] Sec. 3.3).

periodic  every so many seconds, for all targets.
printed   whenever [Lee] Eq. 3.14 (count), 3.15 (bearing) or 3.16 (ellipse) holds.
count     when the number of an array's bearings is another than in its scan before: Eq. 3.14 at its edges.
spread    for each target whose position's standard deviation is above a limit.

Where an array has more bearings than there are targets in its range, cameras are also asked what else
is there.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import NS, Floats
from occlog.scans.scan import Scan

from . import kernel as imm
from .after_fix import moved_to, updated
from .config import ImmConfig
from .filter import Belief, Count, ImmState, Report
from .tracks import UNLABELLED, UNNUMBERED, Track, at_place, on_line

CAUSES = ("periodic", "count", "bearing", "ellipse", "spread")
SHARED = "shared"
"""Cause of a row about a target that no question was about, but that the frames show as well."""


class Memory(NamedTuple):
    """What was asked before."""

    period_ns: int | None = None  # since when the period runs
    bearings: Mapping[int, int] = {}  # of each array, in its scan before
    refused: Mapping[int, int] = {}  # track -> when it was asked for in vain


class Ask(NamedTuple):
    """A question to cameras: where is this target, or which target is on this sight line?"""

    number: int  # UNNUMBERED: a target that is not known yet
    causes: tuple[str, ...]
    label: int
    place: Floats  # (2,) where it is thought to be
    covariance: Floats  # (2, 2)


class Answer(NamedTuple):
    """What the cameras found; `place` None: nothing."""

    ask: Ask
    place: Floats | None  # (2,)
    covariance: Floats | None  # (2, 2)
    label: int


def asks(state: ImmState, report: Report, memory: Memory, rng: Generator) -> tuple[list[Ask], Memory]:
    """What to ask after a scan, by track, and what to remember."""
    assert state.t_ns is not None
    config, t_ns = state.world.config, state.t_ns
    causes: dict[int, list[str]] = {b.number: [] for b in report.beliefs}
    unknown: list[Count] = []
    # Period
    since = t_ns if memory.period_ns is None else memory.period_ns
    if "periodic" in config.policies and t_ns - since >= config.period_s * NS:
        # The period runs on from its own end, not from this scan, so that it holds on average.
        since += math.floor((t_ns - since) / (config.period_s * NS)) * round(config.period_s * NS)
        for own in causes.values():
            own.append("periodic")
    # Number of bearings (Eq. 3.14)
    for count in report.counts:
        if _count_asks(config, count, memory):
            for belief in report.beliefs:
                if _reaches(state, count.array, belief):
                    causes[belief.number].append("count")
            if count.bearings > count.targets:
                unknown.append(count)
    # Bearing (Eq. 3.15), ellipse (Eq. 3.16) and spread of each target
    for belief in report.beliefs:
        causes[belief.number] += _own_causes(state, report, belief)
    # Questions, unless one about the same target was in vain a moment ago
    out = [
        Ask(b.number, tuple(dict.fromkeys(causes[b.number])), b.moved.track.label, *_where(b.estimate))
        for b in report.beliefs
        if causes[b.number] and t_ns - memory.refused.get(b.number, -(2**62)) >= config.retry_s * NS
    ]
    if unknown and t_ns - memory.refused.get(UNNUMBERED, -(2**62)) >= config.retry_s * NS:
        out += _leads(state, report, unknown, rng)
    bearings = {**memory.bearings, **{c.array: c.bearings for c in report.counts}}
    return out, memory._replace(period_ns=since, bearings=bearings)


def others(state: ImmState, report: Report, asked: Sequence[Ask]) -> list[Ask]:
    """Targets that no question is about, and that the frames may show as well; none if `config.share` is false."""
    if not state.world.config.share or not asked:
        return []
    numbers = {a.number for a in asked}
    return [
        Ask(b.number, (SHARED,), b.moved.track.label, *_where(b.estimate))
        for b in report.beliefs
        if b.number not in numbers
    ]


def _count_asks(config: ImmConfig, count: Count, memory: Memory) -> bool:
    if "printed" in config.policies and "count" in config.printed and imm.count_differs(count.bearings, count.targets):
        return True
    return "count" in config.policies and count.bearings != memory.bearings.get(count.array, count.targets)


def _own_causes(state: ImmState, report: Report, belief: Belief) -> list[str]:
    """Causes that lie in one track."""
    config, estimate, found = state.world.config, belief.estimate, []
    if "printed" in config.policies and "bearing" in config.printed:
        arrays = ((sensor - state.world.cameras, heard) for sensor, heard in report.scan.by_sensor())
        if any(
            imm.outside_ranges(estimate.mean, heard.bearing, heard.sigma, state.world.places[a])
            for a, heard in arrays
            if _reaches(state, a, belief)
        ):
            found.append("bearing")
    if "printed" in config.policies and "ellipse" in config.printed:
        predicted = imm.moments(belief.moved.predicted, belief.moved.prior)
        if imm.outside_ellipses(estimate.mean, predicted.means, predicted.covariances):
            found.append("ellipse")
    if "spread" in config.policies and imm.spread_above(estimate.covariance, config.spread):
        found.append("spread")
    return found


def _reaches(state: ImmState, array: int, belief: Belief) -> bool:
    away = belief.estimate.mean[::2] - state.world.places[array]
    return math.hypot(*away) <= float(state.world.reach[array])


def _where(estimate: imm.Estimate) -> tuple[Floats, Floats]:
    return estimate.mean[::2], estimate.covariance[::2, ::2]


def _leads(state: ImmState, report: Report, unknown: Iterable[Count], rng: Generator) -> list[Ask]:
    """Questions about targets not known yet: tracks that are not confirmed, or else bearings of no target."""
    waiting = [t for t in state.tracks if t.number == UNNUMBERED]
    if not waiting:
        waiting = [_lead(state, report.scan, count.array, i, rng) for count in unknown for i in count.free.tolist()]
    return [Ask(UNNUMBERED, ("count",), t.label, *_middle(t)) for t in waiting]


def _lead(state: ImmState, scan: Scan, array: int, i: int, rng: Generator) -> Track:
    """A track on the sight line of bearing i of an array."""
    heard = dict(scan.by_sensor())[state.world.cameras + array]
    assert state.t_ns is not None
    return on_line(state.world, array, float(heard.bearing[i]), float(heard.sigma[i]), state.t_ns, UNLABELLED, rng)


def _middle(track: Track) -> tuple[Floats, Floats]:
    xy = track.cloud.states[:, ::2]
    return xy.mean(axis=0), np.cov(xy.T, bias=True)


def located(
    state: ImmState, report: Report, answers: Iterable[Answer], memory: Memory, rng: Generator
) -> tuple[ImmState, Report, Memory]:
    """The state with what the cameras found, the report of it, and when they found nothing."""
    assert state.t_ns is not None
    config, t_ns, free = state.world.config, state.t_ns, state.free
    tracks, refused = list(state.tracks), dict(memory.refused)
    beliefs = {b.number: b for b in report.beliefs}
    for answer in answers:
        number = answer.ask.number
        # In vain: not asked again at once
        if answer.place is None or answer.covariance is None:
            refused[number] = t_ns
            continue
        refused.pop(number, None)
        # A new target in the place of its candidate
        if number == UNNUMBERED:
            number = _number(answer.label, tracks, free)
            free = max(free, number + 1)
            new = at_place(state.world, answer.place, answer.covariance, number, answer.label, t_ns, rng)
            tracks = [t for t in tracks if not _same_lead(t, answer)] + [new]
            continue
        # A known target: its particles are updated with the place, or moved there
        k = next(i for i, t in enumerate(tracks) if t.number == number)
        tracks[k] = _fixed(config, tracks[k], answer, t_ns, rng)
        beliefs[number] = beliefs[number]._replace(estimate=_moments(tracks[k]))
    tracks.sort(key=lambda t: (t.number == UNNUMBERED, t.number))
    told = tuple(beliefs[n] for n in sorted(beliefs))
    return (
        state._replace(tracks=tuple(tracks), free=free),
        report._replace(beliefs=told),
        memory._replace(refused={n: at for n, at in refused.items() if n in {UNNUMBERED, *(t.number for t in tracks)}}),
    )


def _number(label: int, tracks: list[Track], free: int) -> int:
    """Number of a new track: its label, where no track has that number."""
    return label if label != UNLABELLED and all(t.number != label for t in tracks) else free


def _same_lead(track: Track, answer: Answer) -> bool:
    """Whether a track that is not confirmed is the one that the answer is about."""
    return track.number == UNNUMBERED and bool(np.array_equal(_middle(track)[0], answer.ask.place))


def _fixed(config: ImmConfig, track: Track, answer: Answer, t_ns: int, rng: Generator) -> Track:
    """The track once cameras found it."""
    assert answer.place is not None
    assert answer.covariance is not None
    change = moved_to if config.fix == "replace" else updated
    normals = rng.standard_normal((len(track.cloud.states), 2))
    states = change(track.cloud.states, answer.place, answer.covariance, normals)
    label = track.label if answer.label == UNLABELLED else answer.label
    return track._replace(cloud=track.cloud._replace(states=states), exists=1.0, met_ns=t_ns, label=label)


def _moments(track: Track) -> imm.Estimate:
    """Moments of a track's particles, all models together."""
    states = track.cloud.states
    return imm.moments(states[None], np.full((1, len(states)), 1.0 / len(states)))
