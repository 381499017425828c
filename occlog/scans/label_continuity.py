"""Labels of bearings against the continuity of motion: labels that two targets exchange, and labels that jump.

Bearings are checked as a stream on the way to a method. Exchanged labels of two targets, of all sensors or of one, are
detected and optionally corrected: the identity of a target is that of its first label. A label that jumps without an
exchange is reported.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints, Ints32
from occlog.records.scene import Scene
from occlog.records.tables import UNLABELLED, Bearings

from .kernels.label_continuity import (
    EXCHANGED,
    ContinuityState,
    LabelledRows,
    SensorPositions,
    WalkingSpeed,
    follow_labels,
)

MAX_SPEED_RATIO = 1.5
"""Speed of a jump from which it is reported, over the usual speed that is stated, or that of the target if it is more
irregular."""
MAX_SIGMA = 1e6
"""Standard deviation [rad] from which bearings contain nothing; squares of larger ones overflow."""
MIN_BEARINGS = 100
"""Bearings of a target from which its motion is judged."""
MAX_LABELS = 200
"""Labels that are followed at the same time; of further labels nothing is found."""


class LabelExchange(NamedTuple):
    """An interval in which the labels of two targets are exchanged, in one sensor or (sensor "") in all."""

    targets: tuple[int, int]
    sensor: str  # empty: all sensors
    begin_ns: int
    end_ns: int | None  # None: up to the end


class LabelJump(NamedTuple):
    """A label that continues at a distant position, with the speed [length/s] that this implies and the limit of it."""

    target: int
    begin_ns: int  # first bearing of the new position
    end_ns: int  # the new position is known from here on
    distance: float
    speed: float  # that the distance implies, less its uncertainty
    allowed: float  # limit of the speed


@dataclass
class LabelEvents:
    """Exchanged and jumping labels that were found in a stream of bearings.

    Attributes:
        exchanges: exchanges of labels, in the order of time.
        jumps: jumps of labels, in the order of time.
        repaired: the labels of the exchanges were corrected.
        labels: number of labels followed.
        origin_ns: time of the first bearing [ns].
        contradicting: target, time and sensor of bearings that contradict the motion of their target.
        motion: by target, the geometric mean of the factor by which its motion's variance exceeds what is stated; only
            of targets with `MIN_BEARINGS` bearings or more.
    """

    exchanges: list[LabelExchange]
    jumps: list[LabelJump]
    repaired: bool
    labels: int = 0
    origin_ns: int = 0
    contradicting: set[tuple[int, int, str]] = field(default_factory=set)
    motion: dict[int, float] = field(default_factory=dict)

    def consistent(self, chunks: Iterable[Bearings]) -> Iterator[Bearings]:
        """Generate the chunks without the bearings that contradict the motion of their target."""
        for chunk in chunks:
            if self.contradicting:
                keys = zip(chunk.target_id.tolist(), chunk.t_ns.tolist(), chunk.sensor.tolist(), strict=True)
                against = np.array([key in self.contradicting for key in keys], dtype=np.bool_) & chunk.seen
                yield chunk.take(~against) if against.any() else chunk
            else:
                yield chunk

    def at(self, t_ns: Ints, target_id: Ints32) -> tuple[Bools, Bools]:
        """Return two (N,) masks of rows: labels of the row's target were exchanged then, and its label jumped then.

        Args:
            t_ns: (N,) times [ns].
            target_id: (N,) targets.
        """
        exchanged, jumped = np.zeros(len(t_ns), dtype=np.bool_), np.zeros(len(t_ns), dtype=np.bool_)
        for one in self.exchanges:
            own = (t_ns >= one.begin_ns) & np.isin(target_id, one.targets)
            exchanged |= own if one.end_ns is None else own & (t_ns < one.end_ns)
        for jump in self.jumps:
            jumped |= (target_id == jump.target) & (t_ns >= jump.begin_ns) & (t_ns <= jump.end_ns)
        return exchanged, jumped


class LabelContinuity:
    """Checks the labels of a stream of bearings by the continuity of motion; `events` are the findings so far."""

    def __init__(
        self, scene: Scene, usual_speed: float, walk: WalkingSpeed, used: Collection[str], *, repair: bool
    ) -> None:
        """Start without labels.

        Args:
            scene: scene with the sensors.
            usual_speed: usual speed (RMS) of targets [length/s].
            walk: motion model of targets.
            used: names of the sensors that count.
            repair: correct exchanged labels.
        """
        sensors = [(c.name, c.position, c.sigma_position, c.sigma_yaw) for c in scene.cameras if c.placed]
        sensors += [(a.name, a.position, 0.0, 0.0) for a in scene.arrays if a.upright]
        sensors = [one for one in sensors if one[0] in used]
        self._number = {name: s for s, (name, *_) in enumerate(sensors)}
        xy = np.array([position[:2] for _, position, _, _ in sensors], dtype=np.float64).reshape(-1, 2)
        self._sensors = SensorPositions(
            np.ascontiguousarray(xy[:, 0]),
            np.ascontiguousarray(xy[:, 1]),
            np.array([deviation**2 for *_, deviation, _ in sensors], dtype=np.float64),
        )
        self._yaw_variance = np.array([yaw**2 for *_, yaw in sensors], dtype=np.float64)
        self._walk, self._usual_speed = walk, usual_speed
        self.events = LabelEvents([], [], repair)
        self._labels: list[int] = []
        self._state = _empty(0, len(sensors))
        self._origin_ns: int | None = None
        self._held = Bearings.empty()  # passed by, and may still change, or are of a time step that goes on
        self._identity = np.empty(0, dtype=np.int64)  # of the held rows that were followed

    def watch(self, chunks: Iterable[Bearings]) -> Iterator[Bearings]:
        """Generate the chunks, with corrected labels if `repair` is set.

        Undecided rows are delayed by at most a second.
        """
        for chunk in chunks:
            if not len(self._held) and not np.any(chunk.target_id != UNLABELLED):
                yield chunk
                continue
            self._held = Bearings.concat([self._held, chunk]) if len(self._held) else chunk
            yield from self._passed(last=False)
        yield from self._passed(last=True)

    def _passed(self, *, last: bool) -> Iterator[Bearings]:
        """Process the buffered rows, and generate those with decided identities.

        `last`: no more rows come, so that all are decided.
        """
        held = self._held
        if not len(held):
            return
        # The last time step may go on in the next chunk
        whole = len(held) if last else int(np.searchsorted(held.t_ns, held.t_ns[-1]))
        begun = len(self._identity)
        settled_ns = int(held.t_ns[0])  # no row is settled without a further time step
        if whole > begun:
            settled_ns = self._follow(held.take(slice(None, whole)), begun)
        settled = whole if last else min(whole, int(np.searchsorted(held.t_ns, settled_ns)))
        if not settled:
            return
        out, identity = held.take(slice(None, settled)), self._identity[:settled]
        self._held, self._identity = held.take(slice(settled, None)), self._identity[settled:]
        wrong = identity != out.target_id
        if self.events.repaired and wrong.any():
            # Rows of one sensor and time may now be in another order
            out = Bearings.merge([replace(out, target_id=identity.astype(np.int32))])
        yield out

    def _follow(self, rows: Bearings, begun: int) -> int:
        """Determine the identities of the buffered rows from index `begun` on, and record the events found.

        Return the time [ns] from which identities may still change.
        """
        if self._origin_ns is None:
            self._origin_ns = self.events.origin_ns = int(rows.t_ns[0])
        labelled = rows.target_id != UNLABELLED
        for label in np.unique(rows.target_id[begun:][labelled[begun:]]).tolist():
            if label not in self._labels and len(self._labels) < MAX_LABELS:
                self._labels.append(label)
        if len(self._labels) > len(self._state.known):
            self._state = _grown(self._state, len(self._labels))
            self.events.labels = len(self._labels)
        number = {label: k for k, label in enumerate(self._labels)}
        sensor = np.array([self._number.get(name, -1) for name in rows.sensor.tolist()], dtype=np.int64)
        label = np.array([number.get(k, -1) for k in rows.target_id.tolist()], dtype=np.int64)
        use = (sensor >= 0) & (label >= 0)
        use[:begun] &= self._identity >= 0
        found: Ints = rows.target_id.astype(np.int64)
        found[:begun] = self._identity
        if not use[begun:].any():
            self._identity = found
            return int(rows.t_ns[-1]) + 1
        detected = rows.seen & np.isfinite(rows.bearing) & (rows.sigma > 0.0)
        spread = np.minimum(rows.sigma, MAX_SIGMA) ** 2
        variance = spread + self._yaw_variance[sensor] if len(self._yaw_variance) else spread
        given = LabelledRows(
            (rows.t_ns[use] - self._origin_ns) / NS,
            sensor[use],
            label[use],
            np.where(detected, rows.bearing, np.nan)[use],
            np.where(detected, variance, 1.0)[use],
        )
        ids = np.array(self._labels, dtype=np.int64)
        identity = np.array([number.get(k, 0) for k in found[use].tolist()], dtype=np.int64)
        against, old = np.zeros(len(identity), dtype=np.bool_), int(np.count_nonzero(use[:begun]))
        events, open_s = follow_labels(given, self._sensors, self._walk, self._state, identity, against, old)
        times, names = rows.t_ns[use][against].tolist(), rows.sensor[use][against].tolist()
        of = found[use] if self.events.repaired else rows.target_id[use].astype(np.int64)
        self.events.contradicting.update(zip(of[against].tolist(), times, names, strict=True))
        found[use] = ids[identity]
        self._identity = found
        for event in events.tolist():
            self._add(event)
        for k, (total, count) in enumerate(self._state.factors.tolist()):
            if count >= MIN_BEARINGS:
                self.events.motion[self._labels[k]] = math.exp(total / count)
        return int(rows.t_ns[-1]) + 1 if math.isinf(open_s) else self._time(open_s)

    def _time(self, seconds: float) -> int:
        """Return the time [ns] of a row at `seconds` after the first one."""
        assert self._origin_ns is not None
        return self._origin_ns + round(seconds * NS)

    def _add(self, event: list[float]) -> None:
        """Record an event of `follow_labels` (7 numbers): an exchange, or a jump if its speed exceeds the limit."""
        kind, at_s, speed, first, second, third, distance = event
        if kind == EXCHANGED:
            names = {s: name for name, s in self._number.items()}
            a, b = sorted((self._labels[int(first)], self._labels[int(second)]))
            self._exchange((a, b), names.get(int(third), ""), self._time(at_s))
            return
        allowed = MAX_SPEED_RATIO * self._usual_speed * math.sqrt(second)
        if speed > allowed:
            target = self._labels[int(first)]
            self.events.jumps.append(LabelJump(target, self._time(at_s), self._time(third), distance, speed, allowed))

    def _exchange(self, targets: tuple[int, int], sensor: str, t_ns: int) -> None:
        """Record the beginning of an exchange of two targets' labels in a sensor at `t_ns` [ns], or its end.

        It is the end if an exchange of the two in this sensor is open. `sensor` is empty for all sensors.
        """
        exchanges = self.events.exchanges
        for n, one in enumerate(exchanges):
            if one.targets == targets and one.sensor == sensor and one.end_ns is None:
                exchanges[n] = one._replace(end_ns=t_ns)
                return
        exchanges.append(LabelExchange(targets, sensor, t_ns, None))


def _empty(labels: int, sensors: int) -> ContinuityState:
    """Return the state of the label filters before the first bearing, for a number of labels and sensors."""
    return ContinuityState(
        mean=np.zeros((labels, 4)),
        covariance=np.zeros((labels, 4, 4)),
        known=np.zeros(labels, dtype=np.int64),
        at_s=np.full(labels, -np.inf),
        last=np.tile([-np.inf, 0.0, 0.0, 0.0], (labels, 1)),
        scale=np.ones(labels),
        factors=np.zeros((labels, 2)),
        accepted=np.zeros(labels, dtype=np.int64),
        agreed=np.zeros(labels, dtype=np.int64),
        confirmed=np.zeros(labels, dtype=np.int64),
        before=np.tile([-np.inf, 0.0, 0.0, 0.0], (labels, 1)),
        contradicted=np.tile([np.inf, 1.0, *2 * [-np.inf, 0.0, 0.0, 0.0]], (labels, 1)),
        rival_mean=np.zeros((labels, 4)),
        rival_covariance=np.zeros((labels, 4, 4)),
        rival=np.tile([np.inf, 0.0, 0.0, 0.0, 0.0, 0.0], (labels, 1)),
        recent=np.full((labels, sensors, 3), -np.inf),
        identity=np.tile(np.arange(labels, dtype=np.int64), (sensors, 1)),
        odds=np.zeros((sensors + 1, labels, labels)),
        open_s=np.full((sensors + 1, labels, labels), np.inf),
    )


def _grown(state: ContinuityState, labels: int) -> ContinuityState:
    """Return the state with filters for more labels, `labels` in all; those of earlier labels are kept."""
    K, out = len(state.known), _empty(labels, len(state.identity))
    for name, values in zip(ContinuityState._fields, state, strict=True):
        new: Floats = getattr(out, name)
        if name == "identity":
            new[:, :K] = values
        elif name in ("odds", "open_s"):
            new[:, :K, :K] = values
        else:
            new[:K] = values
    return out
