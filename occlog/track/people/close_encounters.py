"""Close encounters of two people, and the probability that their identities were exchanged when they separated.

A tracker of two people through a position where no camera distinguishes them can leave it with their identities
exchanged, which its states do not show.  Three properties of the tracks determine how likely that is:

* how near they came, in standard deviations of their positions: the smallest distance over its spread;
* how much likelier the tracks are than the exchanged ones, from the last time step at which a camera had a box of each
  of them alone to the next such time step: the smallest log likelihood ratio of their states, with people who turn;
* for how long no camera had a box of each of them alone: the longer, the more a given ratio means.

The probability of an exchange is a logistic function of the logarithms of these.  Its coefficients were fitted to
encounters with known truth (docs/explanation/trackers/people.md); where boxes are better or worse than those, it is too
high or too low.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from occlog.array_types import NS, Floats
from occlog.core.numerics.jit import kernel
from occlog.track.methods.jipda.config import JipdaConfig
from occlog.track.methods.jipda.interface import STATE_SIZE, VX, VY, BoxAssociations, Event, TrackSnapshot, X, Y

ENCOUNTER_DISTANCE_WIDTHS, SEPARATION_DISTANCE_WIDTHS = 1.5, 2.2
"""Two people met who come nearer than the first, and have parted beyond the second; in mean widths of a person."""
RESOLUTION_WIDTHS = 0.55
"""Minimum distance, in widths, at which the boxes of two people are distinguished."""
MIN_SEPARATE_DETECTIONS = 1.0
"""Cameras, in sum of probabilities, that must have a box of each of the two alone."""
MIN_SWITCH_PROBABILITY = 0.2
"""Less probable exchanges are not named."""
CONSTANT: Final = 2.25
BY_DISTANCE: Final = -1.3
BY_RATIO: Final = -0.9
BY_TIME: Final = -1.1
"""Coefficients of the logistic function, fitted."""
SHORTEST_S = 0.1
"""Added to the time for which two people are not distinguished [s]."""
MIN_DISTANCE_SIGMAS = 0.3
"""Smaller distances [standard deviations] count as this."""
MAX_LOG_RATIO = 100.0
"""Larger log likelihood ratios count as this, negative ones as 0."""


def switch_probability(distance: float, ratio: float, unresolved_s: float) -> float:
    """Return the probability of an identity switch in a close encounter, a fitted logistic function.

    Args:
        distance: smallest distance of the two people, in standard deviations of their positions, >= 0.
        ratio: smallest log likelihood ratio of the tracks to the exchanged ones.
        unresolved_s: longest time for which no camera had a box of each of them alone [s], >= 0.
    """
    near, clear = np.log(max(distance, MIN_DISTANCE_SIGMAS)), np.log1p(min(max(ratio, 0.0), MAX_LOG_RATIO))
    log_odds = CONSTANT + BY_DISTANCE * near + BY_RATIO * clear + BY_TIME * np.log(SHORTEST_S + unresolved_s)
    return float(1.0 / (1.0 + np.exp(-log_odds)))


@dataclass
class _Encounter:
    """An ongoing close encounter of two people: their states when last distinguished, and how near they came.

    `t_ns` is the time at which cameras last had a box of each of them alone, `means` (2, 6) and `covariances` (2, 6, 6)
    their states x, y, vx, vy, height, width then; `near`: they have been near; `named`: the filter reported a possible
    switch itself; `distance` [standard deviations] and `ratio` (log likelihood) are the smallest so far, and
    `unresolved_s` [s] is the longest time after `t_ns` so far.
    """

    t_ns: int  # when they were last distinguished
    means: Floats  # (2, 6) their states then
    covariances: Floats  # (2, 6, 6)
    near: bool = False  # they have met
    named: bool = False  # the method itself has a doubt of theirs
    distance: float = np.inf  # the smallest [standard deviations]
    ratio: float = np.inf  # the smallest
    unresolved_s: float = 0.0  # longest time without a box of each alone


class CloseEncounters:
    """Detects close encounters of two people over a stream of time steps, and possible identity switches in them.

    Only the ongoing encounters are kept in memory.
    """

    def __init__(self, config: JipdaConfig) -> None:
        """Start without encounters; `config` has the widths and manoeuvre noise of people."""
        self._width, self._manoeuvre = config.person_width, config.manoeuvre_noise_density
        self._going_on: dict[tuple[int, int], _Encounter] = {}

    def add(self, snapshot: TrackSnapshot) -> tuple[Event, ...]:
        """Add a time step, and return the events `possible_switch` of pairs that were near and have separated.

        Each such pair gives two events, one per person, if its switch probability is at least `MIN_SWITCH_PROBABILITY`
        and the filter has not reported the switch itself.
        """
        n = len(snapshot.ids)
        near = _pairs(snapshot.mean[:, [X, Y]], SEPARATION_DISTANCE_WIDTHS * self._width)
        now = {(int(snapshot.ids[i]), int(snapshot.ids[j])): (i, j) for i, j in near}
        at = {int(k): i for i, k in enumerate(snapshot.ids)}
        events: list[Event] = []
        for pair in [p for p in self._going_on if p not in now]:
            meeting = self._going_on.pop(pair)
            if meeting.near and not meeting.named and pair[0] in at and pair[1] in at:
                self._compare(meeting, snapshot, [at[k] for k in pair])
                events += _doubts(pair, switch_probability(meeting.distance, meeting.ratio, meeting.unresolved_s))
        doubted = {(min(e.id, e.other), max(e.id, e.other)) for e in snapshot.events if e.kind == "possible_switch"}
        alone = _alone(snapshot.support, n) if now else np.zeros((n, 0))
        for pair, (i, j) in now.items():
            both = [i, j]
            distance = float(np.hypot(*(snapshot.mean[i] - snapshot.mean[j])[[X, Y]]))
            if pair not in self._going_on:
                self._going_on[pair] = _Encounter(snapshot.t_ns, snapshot.mean[both], snapshot.covariance[both])
            meeting = self._going_on[pair]
            spread = np.sqrt(0.5 * np.trace(snapshot.covariance[both][:, :2, :2], axis1=1, axis2=2).sum())
            meeting.distance = min(meeting.distance, distance / spread)
            meeting.near |= distance < ENCOUNTER_DISTANCE_WIDTHS * self._width
            meeting.named |= pair in doubted
            if (
                distance > RESOLUTION_WIDTHS * self._width
                and np.minimum(alone[i], alone[j]).sum() >= MIN_SEPARATE_DETECTIONS
            ):
                self._compare(meeting, snapshot, both)
            meeting.unresolved_s = max(meeting.unresolved_s, (snapshot.t_ns - meeting.t_ns) / NS)
        return tuple(events)

    def _compare(self, meeting: _Encounter, snapshot: TrackSnapshot, both: list[int]) -> None:
        """Update the log likelihood ratio of an encounter at a time step at which cameras distinguish the two people.

        Their states there replace those at which they were last distinguished.

        Args:
            meeting: the encounter; changed.
            snapshot: the time step.
            both: indices of the two people in the snapshot, in the order of their identities.
        """
        means, covariances = snapshot.mean[both], snapshot.covariance[both]
        passed = (snapshot.t_ns - meeting.t_ns) / NS
        if passed > 0:
            ratio = log_ratio(meeting.means, meeting.covariances, means, covariances, passed, self._manoeuvre)
            meeting.ratio = min(meeting.ratio, ratio)
        meeting.t_ns, meeting.means, meeting.covariances = snapshot.t_ns, means, covariances


def _pairs(positions: Floats, distance: float) -> list[tuple[int, int]]:
    """Return all index pairs i < j of positions (m, 2) within `distance` of each other, sorted by i, then j."""
    if len(positions) < 2:
        return []
    found = cKDTree(positions).query_pairs(distance, output_type="ndarray")
    return sorted((int(i), int(j)) for i, j in found)


def _doubts(pair: tuple[int, int], probability: float) -> list[Event]:
    """Return two events `possible_switch`, one for each of the identities in `pair`.

    None (an empty list) if `probability` is below `MIN_SWITCH_PROBABILITY`.
    """
    if probability < MIN_SWITCH_PROBABILITY:
        return []
    return [Event("possible_switch", a, b, probability) for a, b in (pair, pair[::-1])]


def _alone(support: BoxAssociations, people: int) -> Floats:
    """Return sums (m, C) of the probabilities that camera C has a box of person m alone, not merged; m = `people`.

    C is the number of cameras that occur in the associations.
    """
    cameras = int(support.camera.max(initial=-1)) + 1
    out = np.zeros((people, cameras))
    np.add.at(out, (support.person, support.camera), support.probability - support.joint)
    return out


@kernel
def log_ratio(
    before: Floats, cov_before: Floats, after: Floats, cov_after: Floats, passed: float, manoeuvre: float
) -> float:
    """Return the log likelihood ratio of two people's later states: identities kept against identities exchanged.

    Args:
        before: (2, 6) earlier states x, y, vx, vy, height, width.
        cov_before: (2, 6, 6) their covariances.
        after: (2, 6) later states.
        cov_after: (2, 6, 6) their covariances.
        passed: time between [s], > 0.
        manoeuvre: spectral density of the acceleration per axis during a manoeuvre.
    """
    total = 0.0
    for i in range(2):
        mean, cov = before[i].copy(), cov_before[i].copy()
        # Walk on: F cov F^T + Q for each axis
        step = np.eye(STATE_SIZE)
        for component, speed in ((X, VX), (Y, VY)):
            step[component, speed] = passed
        mean = step @ mean
        cov = step @ cov @ step.T
        for component, speed in ((X, VX), (Y, VY)):
            cov[component, component] += manoeuvre * passed**3 / 3.0
            cov[component, speed] += manoeuvre * passed**2 / 2.0
            cov[speed, component] += manoeuvre * passed**2 / 2.0
            cov[speed, speed] += manoeuvre * passed
        for j in range(2):
            spread = cov + cov_after[j]
            off = after[j] - mean
            size = -0.5 * (off @ np.linalg.solve(spread, off) + np.linalg.slogdet(spread)[1])
            total += size if i == j else -size
    return total
