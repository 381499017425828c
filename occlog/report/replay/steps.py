"""Time steps of a replay, and the state at each.

Every k-th time of the tracks (or of the truth, without tracks) is kept, with the smallest k that leaves at most
`MAX_TIME_STEPS` times, `MAX_SHOWN` estimates and as many true positions. Lines of sight are those of the latest frame
of each sensor since the previous kept time, at every j-th kept time, with the smallest j that leaves at most
`MAX_OBSERVATIONS`.

Columns of numbers are encoded as compact text that the script decodes to arrays.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from occlog.array_types import NS, Bools, Floats, Ints
from occlog.core.metrics.errors import CHI2_95_2D
from occlog.records.tables import Bearings, Errors, Hulls, Occluders, PeopleTracks, Tracks, Truth
from occlog.report.content.downsampled import MAX_MOVING, TableTotals, rows_before
from occlog.report.content.model import ReportInput

KINDS = {"f8": "<f8", "u4": "<u4", "u2": "<u2", "i2": "<i2", "u1": "u1", "i1": "i1"}
"""Kinds of numbers by their names in the script."""
MAX_INT16, MAX_UINT16 = 32767, 65535
MISSING = MAX_UINT16
"""Marks unknown or unnamed values."""
SMALL = {"u4": "u2", "u2": "u1", "i2": "i1"}
"""Kinds of half the size."""
Packed = list[Any]
"""Kind and the values as little-endian bytes in base64; or `=`, how many they are and the value of all of them."""


def packed(kind: str, values: ArrayLike) -> Packed:
    """Return numbers encoded as text for the page's script, in the smallest type that holds them.

    `kind`: type such as `u2` (unsigned, 2 bytes), which is reduced if possible; ValueError if it does not hold them.
    Equal values become `["=", count, value]`, others `[type, base64]`.
    """
    array = np.asarray(values)
    fitted = array.astype(KINDS[kind])
    if kind != "f8" and not np.array_equal(fitted, array):
        raise ValueError(f"values do not fit {kind}")
    if len(array) > 1 and (fitted == fitted[0]).all():
        return ["=", len(fitted), fitted[0].item()]
    while kind in SMALL and np.array_equal(array.astype(KINDS[SMALL[kind]]), array):
        kind = SMALL[kind]
    return [kind, base64.b64encode(array.astype(KINDS[kind]).tobytes()).decode("ascii")]


def placed(values: Floats, middle: float, step: float) -> Ints:
    """Return coordinates `values` (N,) as integer steps from the centre of the plan, clipped to 16 bits.

    `middle`: coordinate of the centre; `step`: length of a step.
    """
    steps = np.round((values - middle) / step)
    return np.asarray(np.clip(steps, -MAX_INT16, MAX_INT16).astype(np.int64))


def starts(step: Ints, n_steps: int) -> Packed:
    """Return the first row of each of `n_steps` time steps, and the number of rows, encoded for the page's script.

    `step`: (N,) index of the time step of each row, ascending.
    """
    return packed("u4", np.searchsorted(step, np.arange(n_steps + 1)))


class Words:
    """Table of distinct texts, numbered in the order of their first use."""

    def __init__(self) -> None:
        """Create a table without texts."""
        self._numbers: dict[str | None, int] = {}

    def numbers(self, texts: Iterable[Any], known: Bools | None = None) -> Ints:
        """Return the numbers (N,) of N texts in this table; texts that are new are added, in place.

        `known`: (N,) mask; where it is False the text is ignored, and the number is that of the entry None.
        """
        out = [
            self._numbers.setdefault(None if known is not None and not known[k] else str(text), len(self._numbers))
            for k, text in enumerate(texts)
        ]
        return np.array(out, dtype=np.int64)

    @property
    def all(self) -> list[str | None]:
        """All texts by number; at least one (empty)."""
        return list(self._numbers) or [""]


Texts = np.ndarray[Any, Any]
MAX_OBSERVATIONS = 30_000
MAX_PRIORS = 20_000
CORNERS = 12
"""Number of corners of the drawn ellipse of a Gaussian prior."""
LONGEST_GAP = 2.5
"""Intervals between time steps longer than this many usual ones are gaps without targets."""
TRUE_FROM = 40_000
"""Numbers of true targets that are not tracked by their own identity begin here."""


@dataclass(frozen=True, eq=False)
class ReplaySteps:
    """Replay data of a run by time step, encoded for the page's script.

    Attributes:
        data: the run.
        limits: (2, 2) lower and upper corner of the plan.
        imaged: times of images [ns], at which time steps are kept too, for tracks in images.
    """

    data: ReportInput
    limits: Floats
    imaged: Ints = field(kw_only=True, default_factory=lambda: np.zeros(0, np.int64))

    @property
    def _leading(self) -> TableTotals | None:
        """Totals of the table that determines the time steps: tracks, or truth without tracks; None without either."""
        return self.data.whole.get("truth" if self.data.tracks is None else "tracks")

    @property
    def count(self) -> int:
        """Number of times in the data, those not drawn included."""
        return 0 if self._leading is None else self._leading.times

    @property
    def every(self) -> int:
        """Interval k of the kept time steps: every k-th time of the tracks is kept."""
        return self.data.figures.every

    @cached_property
    def kept(self) -> Ints:
        """Times (M,) that the page shows [ns], those of images included."""
        times, time = self.data.figures.times, self.data.time
        if not self.data.in_images or not len(times):
            return times
        inside = (self.imaged >= time.start_ns) & (self.imaged <= time.end_ns)
        # Gaps without targets have a time step at both ends, so that nothing is drawn across them
        step = round(self.period_ns * self.every)
        gaps = np.flatnonzero(np.diff(times) > LONGEST_GAP * step)
        return np.unique(np.concatenate([times, self.imaged[inside], times[gaps] + step, times[gaps + 1] - step]))

    @property
    def period_ns(self) -> float:
        """Usual interval between times of the tracks (or of the truth, without tracks) [ns]; 1 s without either."""
        return float(NS) if self._leading is None else self._leading.step_ns

    @cached_property
    def step(self) -> float:
        """Quantisation step of positions [length], with which 16 bits cover twice the size of the plan."""
        return float((self.limits[1] - self.limits[0]).max()) * 2.0 / MAX_UINT16

    @cached_property
    def same(self) -> bool:
        """Whether tracks have the identities of the truth."""
        return self.data.same_names

    @property
    def pairs(self) -> dict[int, int]:
        """Track identity of each true target, from the errors; empty unless known for all."""
        found = {target: track for target, track in self.data.followers.items() if track is not None}
        return found if not self.same and len(set(found.values())) == len(self.data.followers) else {}

    @cached_property
    def seconds(self) -> Floats:
        """Times (M,) that the page shows [s], since the report's start."""
        return np.asarray((self.kept - self.data.time.start_ns) / NS)

    def at(self, t_ns: Ints) -> tuple[Ints, Ints]:
        """Return the rows of a table at the shown times, and the index of the time step of each.

        `t_ns`: (N,) times of the table's rows [ns].
        """
        step = np.searchsorted(self.kept, t_ns)
        inside = np.minimum(step, len(self.kept) - 1)
        rows = np.flatnonzero((step < len(self.kept)) & (self.kept[inside] == t_ns))
        return rows, step[rows]

    def pack_positions(self, table: Tracks | Truth | Hulls, rows: Ints) -> dict[str, Packed]:
        """Return x and y of the rows (n,), in 16-bit steps from the centre of the plan, encoded for the script."""
        middle = self.limits.mean(axis=0)
        xs, ys = (np.where(np.isfinite(v[rows]), v[rows], np.inf) for v in (table.x, table.y))
        return {
            "x": packed("i2", placed(xs, float(middle[0]), self.step)),
            "y": packed("i2", placed(ys, float(middle[1]), self.step)),
        }

    @cached_property
    def _truth(self) -> Truth | None:
        """True positions of targets, and of other objects if few; from the errors without another source."""
        truth = _of_errors(self.data.errors) if self.data.truth is None else self.data.truth
        if truth is None or not len(truth):
            return None
        others = truth.role != "target"
        few = len(np.unique(truth.target_id[others])) <= MAX_MOVING
        return truth if few else truth.take(~others)

    def tracks(self, seen: Words, doubts: Words, size: float, sigma: float) -> dict[str, Packed]:
        """Return the estimates at each time step, encoded for the page's script.

        Args:
            seen: collects the texts that name the detecting sensors.
            doubts: collects the quality flags.
            size: quantisation step of widths and heights.
            sigma: quantisation step of standard deviations.
        """
        tracks = self.data.tracks
        if tracks is None:
            return {}
        rows, step = self.at(tracks.t_ns)
        people = tracks if isinstance(tracks, PeopleTracks) else None
        names, known, doubt = self._said(tracks, rows)
        sx, sy = np.sqrt(np.maximum(tracks.cov_xx[rows], 0)), np.sqrt(np.maximum(tracks.cov_yy[rows], 0))
        with np.errstate(divide="ignore", invalid="ignore"):
            rho = np.nan_to_num(tracks.cov_xy[rows] / (sx * sy))
        nothing = np.full(len(rows), np.nan)
        existence = nothing if people is None else people.existence_probability[rows]
        return {
            "first": starts(step, len(self.kept)),
            "target": packed("u2", np.searchsorted(self.data.targets, tracks.target_id[rows])),
            **self.pack_positions(tracks, rows),
            "sx": packed("u2", _steps(sx, sigma, MISSING)),
            "sy": packed("u2", _steps(sy, sigma, MISSING)),
            "rho": packed("i1", np.round(127 * np.clip(rho, -1, 1))),
            "existence": packed("u1", np.where(np.isnan(existence), 255, np.round(254 * np.nan_to_num(existence)))),
            "seen": packed("u2", np.minimum(seen.numbers(names, known), MISSING)),
            "doubt": packed("u2", np.minimum(doubts.numbers(doubt), MISSING)),
            "width": packed("u1", _steps(nothing if people is None else people.width[rows], size, 0, 255)),
            "height": packed("u1", _steps(nothing if people is None else people.height[rows], size, 0, 255)),
        }

    def _said(self, tracks: Tracks, rows: Ints) -> tuple[Texts, Bools, Texts]:
        """Return for each row the sensors that detected the target, whether these are known, and quality flags.

        Each (n,). `rows`: (n,) row numbers of the tracks.
        """
        if self.data.people_tracks is not None:
            people = self.data.people_tracks
            known = np.isfinite(people.existence_probability[rows]) | self.data.in_images
            return people.seen_by[rows], known, people.quality_flags[rows]
        count, diagnostics = len(rows), self.data.diagnostics
        names, known, doubt = np.full(count, "", object), np.zeros(count, np.bool_), np.full(count, "", object)
        if isinstance(tracks, PeopleTracks):
            doubt = tracks.quality_flags[rows].astype(object)
        if diagnostics is not None and len(diagnostics):
            diagnostics = diagnostics.take(np.isin(diagnostics.t_ns, tracks.t_ns[rows]))
            mine = list(zip(tracks.t_ns[rows].tolist(), tracks.target_id[rows].tolist(), strict=True))
            its = {
                key: k
                for k, key in enumerate(zip(diagnostics.t_ns.tolist(), diagnostics.target_id.tolist(), strict=True))
            }
            at = np.array([its.get(key, -1) for key in mine], dtype=np.int64)
            there = at >= 0
            names[there] = diagnostics.seen_by[at[there]]
            # Some methods do not state which sensors saw the target
            known[there] = (diagnostics.seen_by[at[there]] != "") | (diagnostics.n_detected[at[there]] == 0)
            reported = np.where(diagnostics.quality_flags != "", diagnostics.quality_flags, diagnostics.fallback)[
                at[there]
            ]
            doubt[there] = np.where(doubt[there] == "", reported, doubt[there])
        return names, known, doubt

    def truth(self) -> dict[str, Packed]:
        """Return the true positions at each time step, encoded for the page's script; empty without a truth."""
        truth = self._truth
        if truth is None:
            return {}
        who = truth.target_id.astype(np.int64) * 2 + (truth.role == "target")
        rows, step = self._latest(truth.t_ns, np.unique(who, return_inverse=True)[1])
        true = truth.role[rows] == "target"
        names, number = np.unique(truth.target_id[rows], return_inverse=True)
        number = number + TRUE_FROM
        if self.same:
            tracked = np.isin(names, self.data.targets)[number - TRUE_FROM]
            number = np.where(tracked, np.searchsorted(self.data.targets, truth.target_id[rows]), number)
        elif pairs := self.pairs:
            its = np.array([pairs.get(name, -1) for name in names.tolist()], dtype=np.int64)[number - TRUE_FROM]
            number = np.where(true & (its >= 0), np.searchsorted(self.data.targets, its), number)
        target = np.where(true, np.minimum(number, MISSING - 1), MISSING)
        return {
            "first": starts(step, len(self.kept)),
            "target": packed("u2", target),
            **self.pack_positions(truth, rows),
        }

    def sight(self, sensors: list[str]) -> tuple[dict[str, Packed], int]:
        """Return the directions of detections at each time step, encoded, and the interval of the steps that have them.

        `sensors`: names of the sensors; a detection refers to its sensor by index.
        """
        bearings = self.data.bearings
        if bearings is None or not len(bearings) or not len(self.kept):
            return {}, 1
        rows, step, number = self._observations(bearings, sensors)
        every = max(-(-len(rows) // MAX_OBSERVATIONS), 1) * self.data.figures.sight_every
        some = step % every == 0
        rows, step, number = rows[some], step[some], number[some]
        targets = np.array(self.data.targets, dtype=np.int64)
        own = np.searchsorted(targets, bearings.target_id[rows])
        known = np.isin(bearings.target_id[rows], targets) & self.same
        turns = np.round(bearings.bearing[rows] / (2 * np.pi) * (MAX_UINT16 + 1)).astype(np.int64) % (MAX_UINT16 + 1)
        table = {
            "first": starts(step, len(self.kept)),
            "sensor": packed("u2", number),
            "target": packed("u2", np.where(known, own, MISSING)),
            "angle": packed("u2", turns),
        }
        return table, every

    def _observations(self, bearings: Bearings, sensors: list[str]) -> tuple[Ints, Ints, Ints]:
        """Return the detections in each sensor's latest frame since the previous time step.

        As rows of the bearings, index of the time step, and index of the sensor in `sensors`; each (n,).
        """
        names, which = np.unique(bearings.sensor, return_inverse=True)
        index_of = {name: k for k, name in enumerate(sensors)}
        number = np.array([index_of.get(str(name), -1) for name in names], dtype=np.int64)[which]
        own = np.flatnonzero(number >= 0)
        rows, step = self._latest(bearings.t_ns[own], number[own])
        rows = own[rows]
        seen = bearings.seen[rows]
        return rows[seen], step[seen], number[rows[seen]]

    def _latest(self, t_ns: Ints, who: Ints) -> tuple[Ints, Ints]:
        """Return the rows at the latest time of each object since the previous kept time step, and their steps, sorted.

        Args:
            t_ns: (N,) times of the rows [ns].
            who: (N,) number >= 0 of the target or sensor of each row.
        """
        rows, step = rows_before(self.kept, self.period_ns, t_ns)
        groups, group = np.unique(step * (int(who.max(initial=0)) + 1) + who[rows], return_inverse=True)
        latest = np.full(len(groups), np.iinfo(np.int64).min)
        np.maximum.at(latest, group, t_ns[rows])
        last = t_ns[rows] == latest[group]
        rows, step = rows[last], step[last]
        order = np.argsort(step, kind="stable")
        return rows[order], step[order]

    def priors(self) -> tuple[dict[str, Packed], int]:
        """Return the occluder priors as encoded columns of polygons, and the number of steps from one to the next."""
        hulls = _as_hulls(self.data.occluders)
        if hulls is None or not len(self.kept):
            return {}, 1
        rows, step = self.at(hulls.t_ns)
        every = max(-(-len(rows) // MAX_PRIORS), 1) * self.data.figures.priors_every
        rows, step = rows[step % every == 0], step[step % every == 0]
        corner = np.minimum(hulls.corner[rows], 255)
        table = {
            "first": starts(step, len(self.kept)),
            "corner": packed("u1", corner),
            **self.pack_positions(hulls, rows),
        }
        return table, every


def _steps(values: Floats, step: float, unknown: int, most: int = MISSING - 1) -> Ints:
    """Return values >= 0 (N,) in integer multiples of `step`, at most `most`; `unknown` for those not finite."""
    found = np.isfinite(values)
    steps = np.clip(np.round(np.where(found, values, 0.0) / step), 0, most)
    return np.asarray(np.where(found, steps, unknown).astype(np.int64))


def _of_errors(errors: Errors | None) -> Truth | None:
    """Return the true positions that the errors were computed from as a table of targets; None for None."""
    if errors is None:
        return None
    own = errors.take(np.isfinite(errors.truth_x) & np.isfinite(errors.truth_y))
    role, z = np.full(len(own), "target"), np.full(len(own), np.nan)
    return Truth.of(t_ns=own.t_ns, target_id=own.target_id, role=role, x=own.truth_x, y=own.truth_y, z=z)


def _as_hulls(priors: Occluders | Hulls | None) -> Hulls | None:
    """Return occluder priors as polygons; a Gaussian one becomes its 95 % ellipse with `CORNERS` corners.

    None for None.
    """
    if priors is None or isinstance(priors, Hulls):
        return None if priors is None else priors.take(priors.occluder_id >= 0)
    own = priors.take(priors.occluder_id >= 0)
    turn = np.linspace(0, 2 * np.pi, CORNERS, endpoint=False)
    a = np.sqrt(np.maximum(own.cov_xx, 0))
    b = np.divide(own.cov_xy, a, out=np.zeros_like(a), where=a > 0)
    c = np.sqrt(np.maximum(own.cov_yy - b**2, 0))
    x = own.x[:, None] + np.sqrt(CHI2_95_2D) * a[:, None] * np.cos(turn)
    y = own.y[:, None] + np.sqrt(CHI2_95_2D) * (b[:, None] * np.cos(turn) + c[:, None] * np.sin(turn))
    return Hulls(
        t_ns=np.repeat(own.t_ns, CORNERS),
        occluder_id=np.repeat(own.occluder_id, CORNERS),
        corner=np.tile(np.arange(CORNERS, dtype=np.int32), len(own)),
        x=x.ravel(),
        y=y.ravel(),
    )
