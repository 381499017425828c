"""Consistency of bearings with the estimates: rejected shares and normalised innovations squared (NIS).

NIS is the sum of squared residuals of bearings, weighted by their probability of being inliers, over its expected
value: 1 if standard deviations are right.

Residuals at the estimates: the residual of a bearing that an estimate has used is smaller than the bearing's own error,
since the estimate follows it. With the standard deviation sigma of the bearing, the gradient g of its angle with
respect to the position, and the covariance P of the estimate, a residual in units of sigma has the variance 1 - g'Pg /
sigma^2 if both are right. This holds for filters, smoothers and least squares to the extent that they are linear.

Unconfirmed bearings: if several sensors detect a target at once, a false bearing disagrees with the others. If sensors
detect it one at a time, only the motion contradicts it, and some false bearings agree with a motion about as probable
as the true one, without large residuals. A considerable rejected share then indicates that accepted bearings may be
false, too.

Angle conventions: lines of sight of one time step meet near one position if angles are measured from +x towards +y.
Converted from compass bearings, pi / 2 - b, lines of stations in general positions do not meet, or meet behind the
stations. If they do not meet as given, other conventions, units and orders of stations are tried; a warning is given
if one fits much better.

Stated noise: bearings with a stated standard deviation below that of any real sensor, which many filters cannot use,
or that differs from their scatter from frame to frame about as degrees differ from radians.

Unassociated candidates: several people offered to a filter that tracks a single target.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import combinations
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints, Strings
from occlog.core.geometry.camera import (
    intersection_point,
    noise_variance,
    planar_offsets,
    second_order_variance,
    touches,
    wrap_angle,
)
from occlog.core.metrics.errors import ratio_or_nan
from occlog.core.metrics.normalised_squares import BatchMeans, Ratio
from occlog.records.scene import Camera, MicrophoneArray, Scene
from occlog.records.tables import UNLABELLED, Bearings, Diagnostics, Residuals, Tracks
from occlog.records.verdicts import Check, finding, outcome

from .estimates import covariances

CONFIRMATION_WINDOW_S = 1.0
"""Time within which bearings of several sensors are simultaneous [s]."""
MIN_OVERLAP_SHARE = 0.5
"""Sensors see a target one at a time if fewer of its bearings are near one of another sensor."""


def confirmed_by_another(sensor: Ints | Strings, seconds: Floats) -> Bools:
    """Return, for each of N bearings of one target, whether another sensor has one of it within 1 s.

    The limit is `CONFIRMATION_WINDOW_S`.

    Args:
        sensor: (N,) sensor of each bearing of one target.
        seconds: (N,) times [s], nondecreasing.
    """
    near = np.zeros(len(sensor), dtype=np.bool_)
    for s in np.unique(sensor).tolist():
        own, others = seconds[sensor == s], seconds[sensor != s]
        if len(others):
            after = np.minimum(np.searchsorted(others, own), len(others) - 1)
            away = np.minimum(np.abs(others[after] - own), np.abs(others[np.maximum(after - 1, 0)] - own))
            near[sensor == s] = away <= CONFIRMATION_WINDOW_S
    return near


@dataclass
class UnconfirmedBearings:
    """Counts bearings, those confirmed by another sensor at about the same time, and those rejected.

    Attributes:
        bearings: number of bearings.
        confirmed: number of those with a bearing of another sensor within 1 s.
        doubted: number of rejected bearings (inlier probability below 0.5).
    """

    bearings: int = 0
    confirmed: int = 0
    doubted: int = 0

    def add(self, part: Residuals) -> None:
        """Add the residuals `part`, which follow those added before in time."""
        for target in np.unique(part.target_id).tolist():
            own = part.take(part.target_id == target)
            self.bearings += len(own)
            self.confirmed += int(np.count_nonzero(confirmed_by_another(own.sensor, (own.t_ns - own.t_ns[0]) / NS)))
            self.doubted += int(np.count_nonzero(own.inlier_probability < 0.5))

    @property
    def one_at_a_time(self) -> bool:
        """Return whether a target is mostly detected by a single sensor at a time.

        That is so if fewer than `MIN_OVERLAP_SHARE` of the bearings have one of the same target, by another sensor,
        within 1 s.
        """
        return self.confirmed < MIN_OVERLAP_SHARE * self.bearings

    @property
    def share(self) -> float:
        """Return the share of the bearings that are rejected; NaN without any."""
        return ratio_or_nan(self.doubted, self.bearings)


MIN_STEPS, MAX_STEPS = 10, 500
"""Minimum and maximum number of time steps of the check."""
MAX_MISFIT_RATIO, MIN_MISFIT_RAD2, MAX_MISFIT_RAD2 = 0.1, 0.01, 0.05
"""A median square misfit [rad^2] below this share of the other one's, where that is above `MIN_MISFIT_RAD2`, is much
better. Lines with at most `MAX_MISFIT_RAD2` meet."""
MIN_SWEEP_RAD = math.radians(30.0)
"""Angle that the bearings of an array cover, at least, to tell gon from an array that is turned."""
NARROW_RAD, MIN_SPREAD_RAD = math.radians(2.0 * math.pi) + 1e-9, math.radians(0.08)
"""Radians or turns that were read as degrees are within this of 0; those of a target that moves differ by this."""
CONVENTION = "angle convention"
"""Name of the check."""
MIN_TURN_RAD, MIN_TURN_MISFIT_RAD2 = math.radians(3.0), math.radians(1.0) ** 2
"""Least angle by which all arrays are turned that is named, and misfit as given [rad^2] from which it is estimated."""
TURN_STEPS, TURN_GRID_RAD = 60, math.radians(4.0)
"""Time steps, and distance of the angles, of the first search of that angle."""
TURN_SHARE = 0.5
"""All arrays are turned if lines then meet to less than this share of the misfit of any other reading, [rad^2]."""
AS_WELL_RAD2 = math.radians(2.0) ** 2
"""Readings of two stations with lines that meet to this fit as well as each other: two lines nearly always meet."""
MAX_READINGS = 3
"""Readings that fit as well which are named."""
MAX_LINE_MISFIT_RAD2 = 1.0
"""Misfits of single lines count at most as this [rad^2]: false ones are not to decide."""
MIN_CROSSING = 0.1
"""Lines of sight that are parallel but for this angle [rad] may meet behind the stations by their noise alone."""
NEAR = 0.2
"""Distance of a source from a station over the median one from the others, below which its bearing is arbitrary."""


class _Angles(NamedTuple):
    """Bearings of one target by n stations at one time step.

    Attributes:
        positions: (n, 2) of the stations.
        yaw: (n,) of the stations as the scene states them [rad].
        bearing: (n,) azimuths in the world [rad].
        names: names of the stations.
    """

    positions: Floats
    yaw: Floats
    bearing: Floats
    names: list[str]


def _of_gon(angle: Floats) -> Floats:
    """Return angles [rad] that were in gon from 0 to 400, but read as degrees."""
    return 0.9 * np.mod(angle, 2.0 * np.pi)


Reading = Callable[[_Angles], _Angles]
_OF_ALL: dict[str, Reading] = {
    "they are clockwise from +x: negate them": lambda a: a._replace(bearing=-a.bearing),
    "they are relative to the arrays (ingest --doa-convention array)": lambda a: a._replace(bearing=a.bearing + a.yaw),
    "they are in the world (ingest --doa-convention math)": lambda a: a._replace(bearing=a.bearing - a.yaw),
    "they are clockwise in the arrays: negate them": lambda a: a._replace(bearing=2.0 * a.yaw - a.bearing),
    "they are in radians: name their column azimuth_rad": lambda a: a._replace(bearing=np.degrees(a.bearing)),
    "they are in radians in the arrays: name their column azimuth_rad": lambda a: a._replace(
        bearing=a.yaw + np.degrees(wrap_angle(a.bearing - a.yaw))
    ),
    "they are in turns: multiply them by 360": lambda a: a._replace(bearing=360.0 * a.bearing),
    "they are in turns in the arrays: multiply them by 360": lambda a: a._replace(
        bearing=a.yaw + 360.0 * wrap_angle(a.bearing - a.yaw)
    ),
    "they are in gon: multiply them by 0.9": lambda a: a._replace(bearing=_of_gon(a.bearing)),
    "they are in gon in the arrays: multiply them by 0.9": lambda a: a._replace(
        bearing=a.yaw + _of_gon(a.bearing - a.yaw)
    ),
    "the scene has yaw in radians as yaw_deg": lambda a: a._replace(bearing=a.bearing - a.yaw + np.degrees(a.yaw)),
}
"""Other readings of the bearings of all arrays, in words with the remedy."""
_OF_COMPASS = "they are clockwise from north: name the column compass_deg"
_TURNED_ROUND = "those of {name} are turned by 180 degrees"
_OF_NARROW = [[words for words in _OF_ALL if words.startswith(f"they are in {unit}")] for unit in ("turns", "radians")]
"""Those that are tried where all bearings are near 0, so that lines are parallel and meet nowhere."""
_OF_ONE: dict[str, Callable[[_Angles], Floats]] = {
    "those of {name} are in radians: convert them": lambda a: np.degrees(a.bearing),
    "those of {name} are in turns: multiply them by 360": lambda a: 360.0 * a.bearing,
    "those of {name} are in gon: multiply them by 0.9": lambda a: _of_gon(a.bearing),
    "those of {name} are clockwise: negate them": lambda a: 2.0 * a.yaw - a.bearing,
    _TURNED_ROUND: lambda a: a.bearing + np.pi,
}
"""Other readings of the bearings of one array of several."""


def _of_one(name: str, reading: Callable[[_Angles], Floats], angles: _Angles) -> _Angles:
    """Return the bearings with that of the station `name` read as `reading`."""
    own = np.array(angles.names) == name
    return angles._replace(bearing=np.where(own, reading(angles), angles.bearing))


MAX_EXCHANGED = 6
"""Number of arrays up to which two of them are tried as exchanged."""


class AngleConventionCheck:
    """Check of whether bearings of microphone arrays fit each other better in another convention, unit or order.

    Cameras are not checked.
    """

    def __init__(self, scene: Scene) -> None:
        """Start with the arrays of a scene and no scans."""
        self._arrays = {a.name: a for a in scene.arrays}
        self._steps: list[_Angles] = []
        self._parallel: list[_Angles] = []  # time steps of which no two lines of sight cross
        self._near = 0  # time steps of a source at a station

    def watch(self, chunks: Iterable[Bearings]) -> Iterator[Bearings]:
        """Generate the chunks unchanged, and collect their bearings for the check."""
        for chunk in chunks:
            if len(self._arrays) > 1 and max(len(self._steps), len(self._parallel)) < MAX_STEPS:
                self._check_chunk(chunk)
            yield chunk

    def checks(self) -> tuple[Check, ...]:
        """Return the check, with a finding if bearings fit much better if they are read in another way."""
        every = [*self._steps, *self._parallel]
        if len(every) >= MIN_STEPS and _narrow(every):
            # Two lines in front of their stations meet in any unit; turns in radians give lines that are parallel
            plain = _median_misfit(every)
            several = np.median([len(each.names) for each in every]) > 2
            for unit in _OF_NARROW if several or plain > MAX_MISFIT_RAD2 else ():
                best, change = min((_median_misfit(map(_OF_ALL[words], every)), words) for words in unit)
                if best <= MAX_MISFIT_RAD2:
                    return self._fits(plain, best, change)
        if len(self._steps) < MIN_STEPS:
            return outcome(CONVENTION, (), unless=f"fewer than {MIN_STEPS} time steps have bearings that cross")
        plain = _median_misfit(self._steps)
        if 2 * self._near > len(self._steps):
            return outcome(CONVENTION, (), unless="sources are at a station")
        if plain <= MIN_TURN_MISFIT_RAD2:
            return outcome(CONVENTION, (), misfit_rad=float(np.sqrt(plain)))
        compass = self._misfit(_clockwise_from_north)
        readings = [(self._misfit(reading), words, reading) for words, reading in self._readings()]
        other, change, _ = min(readings, key=lambda each: each[0])
        best = min(compass, other)
        if turned := self._all_turned(plain, best):
            return self._fits(plain, *turned)
        if plain <= MIN_MISFIT_RAD2 or best > MAX_MISFIT_RATIO * plain:
            return outcome(CONVENTION, (), misfit_rad=float(np.sqrt(plain)))
        if len({name for each in self._steps for name in each.names}) == 2:
            as_well = [each for each in readings if each[0] <= max(best, AS_WELL_RAD2)]
            as_well += [(compass, _OF_COMPASS, _clockwise_from_north)] * (compass <= max(best, AS_WELL_RAD2))
            if len(words := self._different(as_well)) > 1:
                named, more = words[:MAX_READINGS], len(words) - MAX_READINGS
                several = f"{', or if '.join(named)}{f', or {more} more' if more > 0 else ''}"
                return self._fits(plain, best, f"{several} (two stations cannot tell)")
        return self._fits(plain, best, change, "compass" if best == compass else "bearings-fit-if")

    def _different(self, readings: Sequence[tuple[float, str, Reading]]) -> list[str]:
        """Return the words of readings with different bearings or positions, those of turned and compass first.

        `readings` are (misfit [rad^2], words, reading).
        """
        found: dict[tuple[float, ...], str] = {}
        turned = {_TURNED_ROUND.format(name=name) for name in self._arrays}
        for _, words, reading in sorted(readings, key=lambda each: (each[1] not in turned, each[1] != _OF_COMPASS)):
            read = [reading(each) for each in self._steps[:MIN_STEPS]]
            lines = [np.column_stack([np.cos(b := each.bearing), np.sin(b), each.positions]).ravel() for each in read]
            found.setdefault(tuple(np.round(np.concatenate(lines), 6).tolist()), words)
        return [words.split(":")[0] for words in found.values()]

    def _all_turned(self, plain: float, best: float) -> tuple[float, str] | None:
        """Return misfit [rad^2] and words if the bearings of all arrays are off by one angle; None if not.

        The angle is that of the least misfit. An angle of one array that fits about as well, or another reading, is
        the simpler cause. Two lines of sight meet over wide ranges of angles, so that three arrays are needed.

        Args:
            plain: misfit of the bearings as given.
            best: least misfit of all other readings.
        """
        steps = [each for each in self._steps if len(each.names) > 2]
        if len(steps) < MIN_STEPS or plain < MIN_TURN_MISFIT_RAD2:
            return None
        few = steps[:: -(-len(steps) // TURN_STEPS)]
        grid = np.arange(-np.pi, np.pi, TURN_GRID_RAD)
        near = grid[int(np.argmin([_turned_misfit(few, turn) for turn in grid.tolist()]))]
        fine = near + TURN_GRID_RAD * np.linspace(-1.0, 1.0, 41)
        turn = float(fine[int(np.argmin([_turned_misfit(few, each) for each in fine.tolist()]))])
        misfit_rad2 = self._misfit(lambda angles: angles._replace(bearing=angles.bearing - turn))
        if abs(turn) < MIN_TURN_RAD or misfit_rad2 > min(MAX_MISFIT_RATIO * plain, TURN_SHARE * best):
            return None
        if misfit_rad2 > TURN_SHARE * min(self._turned(name) for name in self._arrays):
            return None
        return misfit_rad2, f"all are turned by {math.degrees(turn):+.3g} degrees: subtract that from yaws or bearings"

    def _fits(self, plain: float, best: float, change: str, id: str = "bearings-fit-if") -> tuple[Check, ...]:
        """Return the finding that bearings fit with misfit `best` after a change, and with `plain` as given [rad^2]."""
        now, then = np.degrees(np.sqrt([plain, best])).tolist()
        return (finding(CONVENTION, id, change=change, misfit_deg=then, given_deg=now, steps=len(self._steps)),)

    def _readings(self) -> Iterator[tuple[str, Reading]]:
        """Generate the other readings of the bearings, in words: of all arrays, of two exchanged ones, and of one."""
        names = list(self._arrays)
        sweeps = {name: len(names) > 2 and self._sweep(name) >= MIN_SWEEP_RAD for name in names}
        yield from (
            (words, reading) for words, reading in _OF_ALL.items() if "gon" not in words or any(sweeps.values())
        )
        for pair in combinations(names, 2) if len(names) <= MAX_EXCHANGED else ():
            for turned in (False, True):
                yield f"arrays {pair[0]} and {pair[1]} are exchanged", partial(self._exchanged, pair, turned)
        for name in names:
            for words, reading in _OF_ONE.items():
                # Two lines meet in many readings of one of them
                if len(names) == 2 and words != _TURNED_ROUND:
                    continue
                # An array that is turned by a constant angle is not one in gon
                gon = partial(_of_one, name, reading) if "gon" in words else None
                if gon is None or (sweeps[name] and self._misfit(gon) < self._turned(name)):
                    yield words.format(name=name), partial(_of_one, name, reading)

    def _sweep(self, name: str) -> float:
        """Return the angle [rad] that 90 % of the bearings of one array cover; 0 without bearings."""
        own = [float(each.bearing[each.names.index(name)]) for each in self._steps if name in each.names]
        if not own:
            return 0.0
        mean = np.angle(np.exp(1j * np.array(own)).sum())
        return float(np.diff(np.quantile(wrap_angle(np.array(own) - mean), [0.05, 0.95]))[0])

    def _turned(self, name: str) -> float:
        """Return the median misfit [rad^2] with the bearings of one array turned by their median residual."""
        off = []
        for each in self._steps:
            own = np.array(each.names) == name
            if own.any() and len(own) > 2:
                away = _intersection(each.positions[~own], each.bearing[~own]) - each.positions[own][0]
                off.append(float(each.bearing[own][0]) - math.atan2(away[1], away[0]))
        turn = float(np.median(wrap_angle(np.array(off)))) if off else 0.0
        return self._misfit(partial(_of_one, name, lambda angles: angles.bearing - turn))

    def _exchanged(self, pair: tuple[str, str], turned: bool, angles: _Angles) -> _Angles:
        """Return the bearings with those of two arrays exchanged: each has the position of the other one.

        `turned`: and its yaw, as if bearings had been relative to the arrays.
        """
        other = dict([pair, pair[::-1]])
        arrays = [self._arrays[other.get(name, name)] for name in angles.names]
        yaw = np.array([each.yaw for each in arrays])
        positions = np.array([each.position[:2] for each in arrays])
        return angles._replace(positions=positions, bearing=angles.bearing + (yaw - angles.yaw if turned else 0.0))

    def _misfit(self, reading: Reading) -> float:
        """Return the median misfit [rad^2] of the collected time steps, each with its bearings read in another way."""
        return _median_misfit(map(reading, self._steps))

    def _check_chunk(self, chunk: Bearings) -> None:
        """Collect the bearings of the time steps of a chunk in which several arrays have one of one target.

        At most `MAX_STEPS` are kept.
        """
        use = chunk.seen & np.isfinite(chunk.bearing) & np.isin(chunk.sensor, list(self._arrays))
        own = chunk.take(use)
        order = np.lexsort((own.target_id, own.t_ns))
        t_ns, target = own.t_ns[order], own.target_id[order]
        cuts = np.flatnonzero((np.diff(t_ns) != 0) | (np.diff(target) != 0)) + 1
        for rows in np.split(order, cuts):
            names = own.sensor[rows].tolist()
            if len(names) > 1 and len(set(names)) == len(names):
                arrays = [self._arrays[name] for name in names]
                positions = np.array([each.position[:2] for each in arrays], dtype=np.float64)
                yaw = np.array([each.yaw for each in arrays])
                across = np.column_stack([-np.sin(own.bearing[rows]), np.cos(own.bearing[rows])])
                parallel = np.linalg.eigvalsh(across.T @ across)[0] < MIN_CROSSING**2 * len(names)
                steps = self._parallel if parallel else self._steps
                if len(steps) < MAX_STEPS:
                    self._near += not parallel and len(names) > 2 and not _away_from_all(positions, own.bearing[rows])
                    steps.append(_Angles(positions, yaw, own.bearing[rows], names))


def _clockwise_from_north(angles: _Angles) -> _Angles:
    """Return bearings of a compass in the world."""
    return angles._replace(bearing=0.5 * np.pi - angles.bearing)


def _turned_misfit(steps: Iterable[_Angles], turn: float) -> float:
    """Return the median misfit [rad^2] with all bearings turned back by an angle [rad]."""
    return _median_misfit(each._replace(bearing=each.bearing - turn) for each in steps)


def _narrow(steps: Sequence[_Angles]) -> bool:
    """Return whether all bearings are within `NARROW_RAD` of 0 in the world, or of the arrays' own x axes."""
    bearing = np.concatenate([each.bearing for each in steps])
    relative = bearing - np.concatenate([each.yaw for each in steps])
    names = np.concatenate([each.names for each in steps])
    for near in map(wrap_angle, (bearing, relative)):
        spread = max(float(np.ptp(near[names == name])) for name in np.unique(names))
        if np.abs(near).max() <= NARROW_RAD and spread >= MIN_SPREAD_RAD:
            return True
    return False


def _median_misfit(steps: Iterable[_Angles]) -> float:
    return float(np.median([misfit(each.positions, each.bearing) for each in steps]))


def _away_from_all(positions: Floats, bearings: Floats) -> bool:
    """Return whether no station is near the position that the lines of the others have.

    Near is below `NEAR` of the median distance of the others: bearings of a source at the station are arbitrary.

    Args:
        positions: (n, 2) where the lines begin, n >= 3.
        bearings: (n,) directions of the lines [rad].
    """
    for n in range(len(positions)):
        others = np.arange(len(positions)) != n
        away = _intersection(positions[others], bearings[others]) - positions
        distance = np.hypot(*away.T)
        if distance[n] < NEAR * np.median(distance[others]):
            return False
    return True


def _intersection(positions: Floats, bearings: Floats) -> Floats:
    """Return the position (2,) nearest to all lines from `positions` (n, 2) in directions `bearings` (n,) [rad].

    NaN if the lines are parallel.
    """
    return intersection_point(positions, np.column_stack([np.cos(bearings), np.sin(bearings)]))[0]


def misfit(positions: Floats, bearings: Floats) -> float:
    """Return the mean square angle [rad^2] between n lines of sight and the position nearest to all of them.

    Each square is clipped at `MAX_LINE_MISFIT_RAD2`, which parallel lines have.

    Args:
        positions: (n, 2) where the lines begin, n >= 2.
        bearings: (n,) directions of the lines [rad].
    """
    away = _intersection(positions, bearings) - positions
    off = (bearings - np.arctan2(away[:, 1], away[:, 0]) + np.pi) % (2.0 * np.pi) - np.pi
    return float(np.fmin(off**2, MAX_LINE_MISFIT_RAD2).mean())  # the limit for NaN, too


STATED = "stated measurement noise"
"""Name of the check."""
MIN_SIGMA_RAD = 1e-7
"""Smallest standard deviation that is accepted: 0.02 seconds of arc."""


UNIT_RATIO = (20.0, 160.0)
"""Ratio of the scatter of bearings to their stated standard deviations, or its inverse, between which one is taken to
be in degrees and the other in radians: about 57."""
MAX_INTERVAL_S, MIN_TRIPLES, MAX_TRIPLES = 0.5, 30, 5000
"""Longest interval between bearings that are compared, and number of threes of successive bearings of a sensor."""
MAX_SCATTER_RAD, MAX_SMALL_SIGMA_RAD, MIN_LARGE_SIGMA_RAD = 0.35, 0.0035, 0.5
"""Largest scatter of bearings of one source; stated standard deviations below and above which their unit is doubted."""


class StatedNoiseCheck:
    """Check for bearings with an implausibly small stated standard deviation, or with one in another unit."""

    def __init__(self) -> None:
        """Start with no bearing counted."""
        self._found: Counter[str] = Counter()
        self._least = np.inf
        self._scatter: dict[str, list[Floats]] = {}  # (n, 2) scatter and stated standard deviation by sensor [rad]

    def watch(self, chunks: Iterable[Bearings]) -> Iterator[Bearings]:
        """Generate the chunks unchanged, and compare the stated standard deviations of their bearings.

        Counted are those below `MIN_SIGMA_RAD`; others are compared with second differences of successive bearings.
        Bearings with pixels are omitted, as their noise is that of the pixels.
        """
        for chunk in chunks:
            # Of those with pixels the noise is that of the reading
            own = chunk.take(chunk.seen & ~np.isfinite(chunk.u_px))
            small = own.sigma < MIN_SIGMA_RAD
            if small.any():
                self._found.update(own.sensor[small].tolist())
                self._least = min(self._least, float(own.sigma[small].min()))
            for name in np.unique(own.sensor[~small]).tolist():
                kept = self._scatter.setdefault(name, [])
                if sum(map(len, kept)) < MAX_TRIPLES:
                    kept.append(_second_differences(own.take((own.sensor == name) & ~small)))
            yield chunk

    def checks(self) -> tuple[Check, ...]:
        """Return the check, with findings on stated noises that are below any real one, or in another unit."""
        return outcome(STATED, self._findings())

    def _findings(self) -> Iterator[Check]:
        if self._found:
            yield finding(
                STATED,
                "measurement-noise-small",
                sensors=sorted(self._found),
                count=sum(self._found.values()),
                least_rad=self._least,
                allowed=MIN_SIGMA_RAD,
            )
        scatters = {name: np.concatenate(kept) for name, kept in self._scatter.items()}
        medians = {name: np.median(own, axis=0) for name, own in scatters.items() if len(own) >= MIN_TRIPLES}
        for words, inverse in (("radians", False), ("degrees", True)):
            found = {}
            for name, (scatter, sigma) in medians.items():
                doubted = sigma > MIN_LARGE_SIGMA_RAD if inverse else sigma < MAX_SMALL_SIGMA_RAD
                ratio = sigma / max(scatter, 1e-12) if inverse else scatter / sigma
                low, high = UNIT_RATIO
                if scatter < MAX_SCATTER_RAD and doubted and low < ratio < high:
                    found[name] = (float(np.degrees(scatter)), float(np.degrees(sigma)))
            if found:
                scatter_deg, sigma_deg = np.median(list(found.values()), axis=0).tolist()
                yield finding(
                    STATED, "noise-unit", sensors=list(found), sigma_deg=sigma_deg, scatter_deg=scatter_deg, unit=words
                )


def _second_differences(rows: Bearings) -> Floats:
    """Return (n, 2) estimates of the standard deviation of bearings of one sensor, and the stated ones [rad].

    They are absolute second differences of three successive bearings at about equal intervals, of time steps with one
    bearing, over the factor that they have for normal noise in the median: sqrt(6) times 0.6745.
    """
    times, first, count = np.unique(rows.t_ns, return_index=True, return_counts=True)
    step_s = np.diff(times) / NS
    before, after = step_s[:-1], step_s[1:]
    alone = count == 1
    use = (np.maximum(before, after) <= np.minimum(MAX_INTERVAL_S, 1.5 * np.minimum(before, after))) & (
        alone[:-2] & alone[1:-1] & alone[2:]
    )
    bearing = rows.bearing[first]
    second = wrap_angle(bearing[2:] - bearing[1:-1]) - wrap_angle(bearing[1:-1] - bearing[:-2])
    scatter = np.abs(second) / (math.sqrt(6.0) * 0.6745)
    return np.asarray(np.column_stack([scatter, rows.sigma[first][1:-1]])[use])


GATE_SIGMAS = 4.0
"""Gate of a bearing, in standard deviations of the innovation."""
MAX_RESIDUAL = 6.0
"""Standard deviations beyond which a bearing contradicts an estimate that it alone could have determined."""
MIN_RESIDUAL_VARIANCE = 0.1
"""Minimum expected variance of residuals for an estimate of noise: below it estimates go through the bearings."""


class ResidualAngles(NamedTuple):
    """Residuals of N bearings of one sensor at the estimates, with the variances due to sensor and estimates."""

    residual: Floats  # (N,) in standard deviations as stated
    spread: Floats  # (N,) variance of the bearing that the estimate leads one to expect, in the same units
    sigma: Floats  # (N,) standard deviation as stated [rad]
    touched: Bools  # (N,) the target touches the sensor: the bearing is not linear in the position


class StatedResiduals(NamedTuple):
    """Residuals of N bearings of one sensor and one target at its estimates, in stated standard deviations."""

    target: int
    sensor: str
    t_ns: Ints  # (N,) of the estimates
    residual: Floats  # (N,) in standard deviations as stated
    sigma: Floats  # (N,) standard deviation as stated [rad]
    touched: Bools  # (N,) the target touches the sensor


class CandidateFrames(NamedTuple):
    """Counts of a sensor's candidates (bearings without a target) in F frames, by time.

    Counted are all, and those near no track; `again` marks frames in which one of the latter was there in the frame
    before, too.
    """

    sensor: str
    t_ns: Ints  # (F,)
    candidates: Ints  # (F,) how many there were
    unexplained: Ints  # (F,) how many of them are near no track
    again: Bools  # (F,) whether one of these was there in the frame before, too


def bearing_residuals(
    rows: Bearings, sensor: Camera | MicrophoneArray, xy: Floats, covariance: Floats
) -> ResidualAngles:
    """Return the residuals of N bearings of a sensor at estimated positions.

    Bearings with pixels have the variance of [Ercan] Eq. 2 at the estimate, the others their own. Where the target
    touches the sensor, within its covariance, their variance is that of any direction.

    Args:
        rows: N bearings of the sensor.
        sensor: the camera or microphone array.
        xy: (N, 2) estimated positions at the times of the bearings.
        covariance: (N, 2, 2) covariances of these.
    """
    away = xy - sensor.position[:2]
    r2 = np.maximum(np.sum(away**2, axis=1), 1e-24)
    variance = rows.sigma**2
    if isinstance(sensor, Camera):
        h, d = planar_offsets(xy, sensor.position[:2], sensor.yaw)
        pixels, before = np.isfinite(rows.u_px), d > 1e-9
        h, d = np.where(before, h, 0.0), np.where(before, d, 1.0)
        read = np.where(np.isfinite(rows.sigma_px), rows.sigma_px, sensor.sigma_read_px)
        f = float(sensor.focal_px[0])
        px = noise_variance(
            h, d, focal_px=f, sigma_position=sensor.sigma_position, sigma_yaw=sensor.sigma_yaw, sigma_read_px=read
        )
        variance = np.where(pixels & before, px / (f * (1.0 + (h / d) ** 2)) ** 2, variance)
    touched = touches(away, covariance)
    variance = np.maximum(variance, 1e-24) + np.where(touched, second_order_variance(away, covariance), 0.0)
    g = np.column_stack([-away[:, 1], away[:, 0]]) / r2[:, None]
    expected = np.einsum("ni,nij,nj->n", g, covariance, g) / variance
    off = wrap_angle(rows.bearing - np.arctan2(away[:, 1], away[:, 0]))
    sigma = np.sqrt(variance)
    return ResidualAngles(off / sigma, np.maximum(expected, 0.0), sigma, touched)


class BearingConsistency:
    """Comparison of bearings with tracks, chunk by chunk: residuals of those near a track, and counts of others.

    `stated` has the residuals of the last comparison, in stated standard deviations, by target and sensor.
    """

    def __init__(self, scene: Scene, window_ns: int = 0) -> None:
        """Start the comparison with the sensors of a scene.

        Args:
            scene: its sensors; arrays that are not upright are omitted, as their azimuths depend on elevations.
            window_ns: an estimate holds for bearings at most this long before it [ns].
        """
        self._sensors: dict[str, Camera | MicrophoneArray] = {c.name: c for c in scene.cameras if c.placed}
        self._sensors |= {a.name: a for a in scene.arrays if a.upright}
        self._window_ns = window_ns
        self._last: dict[str, tuple[int, Floats]] = {}  # the frame before, and what was unexplained in it
        self.stated: list[StatedResiduals] = []  # of the last comparison

    def compare(
        self, tracks: Tracks, bearings: Bearings, diagnostics: Diagnostics | None = None
    ) -> tuple[Residuals, tuple[CandidateFrames, ...]]:
        """Return the residuals of the tracks' bearings, and the candidates near no track, for complete time steps.

        Of unlabelled candidates, the one nearest to the estimate counts, if it is within `GATE_SIGMAS`.

        Args:
            tracks: estimates in the order of time.
            bearings: bearings in the order of time; those without an estimate at their time, or at an estimate of
                unknown covariance, are omitted.
            diagnostics: rows of the same estimates, which state the sensors used; None: all sensors.
        """
        seen = bearings.take(bearings.seen)
        paths = list(self._paths(tracks, diagnostics))
        parts: list[Residuals] = []
        frames: list[CandidateFrames] = []
        self.stated = []
        for name, sensor in self._sensors.items():
            own = seen.take(seen.sensor == name)
            if not len(own):
                continue
            free = own.target_id == UNLABELLED
            near = np.zeros(len(own), dtype=np.bool_)
            met = np.zeros(len(own), dtype=np.bool_)
            for path in paths:
                at, found = path.at(own.t_ns, self._window_ns, name)
                labelled = ~free & (own.target_id == path.target)
                rows = found & (labelled | (free & ~np.isin(own.t_ns, own.t_ns[labelled])))
                met |= found & free
                n, i = np.flatnonzero(rows), at[rows]
                residuals = bearing_residuals(own.take(n), sensor, path.xy[i], path.covariance[i])
                far = np.abs(residuals.residual) / np.sqrt(1.0 + residuals.spread)
                near[n] |= far <= GATE_SIGMAS
                keep = labelled[n] | _nearest(i, np.where(labelled[n], np.inf, far))
                parts.append(_table(path, name, i[keep], residuals, far, keep))
                stated = (residuals.residual[keep], residuals.sigma[keep], residuals.touched[keep])
                self.stated.append(StatedResiduals(path.target, name, path.t_ns[i[keep]], *stated))
            if met.any():
                frames.append(self._left(name, own.take(met), near[met]))
        return Residuals.merge(parts), tuple(frames)

    def _paths(self, tracks: Tracks, diagnostics: Diagnostics | None) -> Iterator[EstimatedTrajectory]:
        """Generate the estimates of each target as a trajectory.

        Args:
            tracks: estimates in the order of time.
            diagnostics: rows of the same estimates, for the sensors that each used; None, or of other length: unknown.
        """
        xy, covariance = np.column_stack([tracks.x, tracks.y]), covariances(tracks)
        used = None if diagnostics is None or len(diagnostics) != len(tracks) else _commas(diagnostics.cameras)
        for target in np.unique(tracks.target_id).tolist():
            own = tracks.target_id == target
            yield EstimatedTrajectory(
                target, tracks.t_ns[own], xy[own], covariance[own], None if used is None else used[own]
            )

    def _left(self, name: str, rows: Bearings, near: Bools) -> CandidateFrames:
        """Return a sensor's numbers of candidates and of those near no track, frame by frame.

        For each frame there is also whether one near no track continues such a candidate of the frame before. The
        bearings of those of the last frame are stored for the next call.

        Args:
            name: name of the sensor.
            rows: N candidates of the sensor, by time.
            near: (N,) whether a candidate is near a track.
        """
        times, first = np.unique(rows.t_ns, return_index=True)
        left, again = np.add.reduceat(~near, first, dtype=np.int64), np.zeros(len(times), dtype=np.bool_)
        ends = [*first[1:].tolist(), len(rows)]
        for n, (t_ns, a, b) in enumerate(zip(times.tolist(), first.tolist(), ends, strict=True)):
            bearing, sigma = rows.bearing[a:b][~near[a:b]], rows.sigma[a:b][~near[a:b]]
            before_ns, before = self._last.get(name, (t_ns, np.empty(0)))
            if len(bearing) and len(before):
                reach = 3.0 * np.sqrt(2.0) * sigma + TURN_RATE * (t_ns - before_ns) * 1e-9
                again[n] = bool(np.any(np.abs(wrap_angle(bearing[:, None] - before[None, :])) <= reach[:, None]))
            self._last[name] = (t_ns, bearing)
        return CandidateFrames(name, times, np.diff([*first.tolist(), len(rows)]), left, again)


TURN_RATE = 0.25
"""How fast a person's azimuth changes, at 1.2 m/s and a distance of 5 m [rad/s]."""


class EstimatedTrajectory(NamedTuple):
    """T estimates of one target over time, with the sensors that each used.

    `used` are names with a comma before and after each, None if unknown.
    """

    target: int
    t_ns: Ints  # (T,)
    xy: Floats  # (T, 2)
    covariance: Floats  # (T, 2, 2) NaN: not known
    used: np.ndarray | None  # (T,) names of sensors between commas; None: not known

    def at(self, t_ns: Ints, window_ns: int, sensor: str) -> tuple[Ints, Bools]:
        """Return the index (N,) of the next estimate at or after each time, and whether it is valid (N,).

        An estimate is valid if it is at most `window_ns` after the time, its covariance is known, and it used the
        sensor.

        Args:
            t_ns: (N,) times [ns].
            window_ns: longest time from one of them to its estimate [ns].
            sensor: name of the sensor.
        """
        n = np.searchsorted(self.t_ns, t_ns)
        i = np.minimum(n, len(self.t_ns) - 1)
        found = (n < len(self.t_ns)) & (self.t_ns[i] - t_ns <= window_ns) & ~np.isnan(self.covariance[i, 0, 0])
        if self.used is not None:
            found &= (np.strings.find(self.used, f",{sensor},") >= 0)[i]
        return i, np.asarray(found)


def _commas(cameras: np.ndarray) -> np.ndarray:
    """Return strings (N,) with a comma added before and after each list of names.

    `cameras` are (N,) names separated by commas. With `,name,` a name is then found, but not a part of one.
    """
    return np.strings.add(np.strings.add(",", cameras), ",")


def _nearest(estimate: Ints, far: Floats) -> Bools:
    """Return (N,) booleans: the candidate is the nearest one of its estimate, and within the gate.

    Args:
        estimate: (N,) index of the estimate that each candidate is compared with.
        far: (N,) distance from it [standard deviations].
    """
    order = np.lexsort([far, estimate])
    first = np.ones(len(order), dtype=np.bool_)
    first[1:] = np.diff(estimate[order]) != 0
    out = np.zeros(len(order), dtype=np.bool_)
    out[order[first]] = True
    return np.asarray(out & (far <= GATE_SIGMAS))


def _table(
    path: EstimatedTrajectory, name: str, i: Ints, residuals: ResidualAngles, far: Floats, keep: Bools
) -> Residuals:
    """Return the table `residuals` of bearings of one sensor and target.

    Args:
        path: estimates of the target.
        name: name of the sensor.
        i: (n,) index of the estimate of each kept bearing.
        residuals: residuals of all N bearings.
        far: (N,) distance of each from its estimate [standard deviations]; within `GATE_SIGMAS` it is an inlier.
        keep: (N,) whether the table has the bearing; n in all.
    """
    return Residuals.of(
        t_ns=path.t_ns[i],
        target_id=np.full(len(i), path.target, dtype=np.int32),
        sensor=np.full(len(i), name),
        residual=residuals.residual[keep],
        expected_variance=np.maximum(1.0 - residuals.spread[keep], 0.0),
        inlier_probability=(far[keep] <= GATE_SIGMAS).astype(np.float64),
    )


class ComparedBearings(NamedTuple):
    """Result of a comparison of bearings with tracks: residuals, and counts of candidates near no track."""

    residuals: Residuals
    frames: tuple[CandidateFrames, ...]


class BearingBuffer:
    """Buffers the bearings of a stream until their estimates are available, and compares both."""

    def __init__(self, scene: Scene, window_ns: int, *, unlabelled: bool) -> None:
        """Start with an empty buffer.

        Args:
            scene: the sensors.
            window_ns: an estimate holds for bearings at most this long before it [ns].
            unlabelled: candidates without a label are compared, too.
        """
        self._sight, self._unlabelled = BearingConsistency(scene, window_ns), unlabelled
        self._all = BearingConsistency(scene, window_ns)
        self._kept: list[Bearings] = []

    def watch(self, chunks: Iterable[Bearings]) -> Iterator[Bearings]:
        """Generate the chunks unchanged, and buffer their bearings."""
        for chunk in chunks:
            self._kept.append(chunk if self._unlabelled else chunk.take(chunk.target_id != UNLABELLED))
            yield chunk

    def compare(self, tracks: Tracks, diagnostics: Diagnostics) -> ComparedBearings:
        """Compare the buffered bearings up to the time of the last estimate, and drop them from the buffer.

        Args:
            tracks: next estimates, by time; without rows nothing is compared.
            diagnostics: rows of the same estimates, which state the sensors used.
        """
        kept = Bearings.concat(self._kept)
        if not len(tracks):
            return ComparedBearings(Residuals.empty(), ())
        n = int(np.searchsorted(kept.t_ns, tracks.t_ns[-1], side="right"))
        self._kept = [kept.take(slice(n, None))]
        self._all.compare(tracks, kept.take(slice(None, n)))
        return ComparedBearings(*self._sight.compare(tracks, kept.take(slice(None, n)), diagnostics))

    @property
    def stated(self) -> tuple[StatedResiduals, ...]:
        """Return the residuals of all bearings in the last comparison, including those that the method did not use.

        They are by sensor, normalised by the noise stated for it.
        """
        return tuple(self._all.stated)


@dataclass
class SensorConsistency:
    """Residual sums of one sensor's bearings.

    Attributes:
        bearings: number of bearings used.
        inliers: number of those that are more probably true than false.
        means: squared residuals and their expected values, without those of estimates that go through the bearing in
            any case.
        pose: part of the expected squares that is due to errors of the sensor's pose, which are constant in time.
    """

    bearings: int = 0
    inliers: int = 0
    means: BatchMeans = field(default_factory=BatchMeans)
    pose: float = 0.0

    @property
    def doubted(self) -> float:
        """Return the share of bearings that are rejected; NaN without any."""
        return 1.0 - ratio_or_nan(self.inliers, self.bearings)

    @property
    def nis(self) -> Ratio:
        """Return the normalised innovation squared, with a standard error that includes the constant pose error."""
        value, error = self.means.ratio
        share = ratio_or_nan(self.pose, self.means.expected)
        return Ratio(value, math.hypot(error, math.sqrt(2.0) * share * value) if share > 0.0 else error)


@dataclass
class ResidualStatistics:
    """Sums of residuals by sensor, over a stream of tables.

    Attributes:
        sensors: sums of each sensor's bearings, by its name.
        noise: by target, the largest factor by which its motion's variance exceeds what was stated.
    """

    sensors: dict[str, SensorConsistency] = field(default_factory=dict)
    noise: dict[int, float] = field(default_factory=dict)

    def add(self, part: Residuals, poses: Mapping[str, float] | None = None) -> None:
        """Add residuals, in the order of time.

        Args:
            part: the residuals.
            poses: by sensor, the share of errors of its pose in the stated variance; None: 0.
        """
        for name in np.unique(part.sensor).tolist():
            own = part.take(part.sensor == name)
            found = self.sensors.setdefault(name, SensorConsistency())
            found.bearings += len(own)
            # What an estimate that just goes through it leaves far off contradicts the estimate, however wide that is
            far = (own.expected_variance < MIN_RESIDUAL_VARIANCE) & (np.abs(own.residual) > MAX_RESIDUAL)
            found.inliers += int(np.count_nonzero((own.inlier_probability >= 0.5) & ~far))
            informative = own.take(own.expected_variance >= MIN_RESIDUAL_VARIANCE)
            expected = informative.inlier_probability * informative.expected_variance
            found.means.add(informative.inlier_probability * informative.residual**2, expected)
            found.pose += (poses or {}).get(name, 0.0) * float(expected.sum())

    def moves(self, target: int, factor: float) -> None:
        """Record that the motion of `target` has `factor` times the stated variance; the largest factor is kept."""
        self.noise[target] = max(self.noise.get(target, 0.0), factor)

    @property
    def bearings(self) -> int:
        """Return the number of bearings of all sensors."""
        return sum(a.bearings for a in self.sensors.values())

    @property
    def doubted(self) -> float:
        """Return the share of bearings of all sensors that are rejected; NaN without any."""
        return 1.0 - ratio_or_nan(sum(a.inliers for a in self.sensors.values()), self.bearings)

    @property
    def nis(self) -> Ratio:
        """Return the normalised innovation squared of all bearings with its standard error.

        Sensors are taken as independent. NaN and inf without bearings.
        """
        informative = [a for a in self.sensors.values() if a.means.expected > 0.0]
        expected = math.fsum(a.means.expected for a in informative)
        if not informative:
            return Ratio(math.nan, math.inf)
        value = math.fsum(a.means.squares for a in informative) / expected
        return Ratio(value, math.sqrt(math.fsum((a.nis.error * a.means.expected) ** 2 for a in informative)) / expected)

    def figures(self) -> dict[str, float | int]:
        """Return the figures of a summary by name; empty if no bearing was compared.

        They are the numbers of bearings and of rejected ones, and, if known, the NIS with its standard error.
        """
        if not self.bearings:
            return {}
        whole = self.nis
        return {
            "bearings": self.bearings,
            "rejected_bearings": self.bearings - sum(a.inliers for a in self.sensors.values()),
            **({"nis": whole.value, "nis_error": whole.error} if math.isfinite(whole.value) else {}),
        }


def pose_shares(tracks: Tracks, scene: Scene) -> dict[str, float]:
    """Return the share of pose errors in the variance of bearings, by camera, at the median distance of the tracks.

    By [Ercan] Eq. 2 on the optical axis the pose errors are f^2 sigma_yaw^2 + f^2 sigma_position^2 / d^2; the rest is
    measurement noise. Cameras without pose errors are missing.
    """
    out: dict[str, float] = {}
    for c in scene.cameras:
        if not len(tracks) or not (c.sigma_yaw > 0.0 or c.sigma_position > 0.0):
            continue
        out[c.name] = pose_share(c, float(np.median(np.hypot(tracks.x - c.position[0], tracks.y - c.position[1]))))
    return out


def pose_share(camera: Camera, distance: float) -> float:
    """Return the share of the pose errors in the variance of a camera's measurement at a `distance` ([Ercan] Eq. 2)."""
    pose = float(camera.focal_px[0]) ** 2 * (camera.sigma_yaw**2 + (camera.sigma_position / max(distance, 1e-9)) ** 2)
    return pose / (pose + camera.sigma_read_px**2)


@dataclass
class CandidateCounts:
    """Counts of one sensor's frames with candidates, of the candidates, and of those near no track."""

    frames: int = 0
    candidates: int = 0
    unexplained: int = 0
    crowded: int = 0  # frames with a candidate that no track explains and that was there in the frame before, too


@dataclass
class UnassociatedCandidates:
    """Numbers of candidates near no track, by sensor, over a stream of frames."""

    sensors: dict[str, CandidateCounts] = field(default_factory=dict)

    def add(self, parts: Iterable[CandidateFrames]) -> None:
        """Add the counts of further frames; each part is of one sensor."""
        for part in parts:
            own = self.sensors.setdefault(part.sensor, CandidateCounts())
            own.frames += len(part.t_ns)
            own.candidates += int(part.candidates.sum())
            own.unexplained += int(part.unexplained.sum())
            own.crowded += int(np.count_nonzero(part.again))

    @property
    def frames(self) -> int:
        """Return the number of frames of all sensors that have candidates."""
        return sum(s.frames for s in self.sensors.values())

    @property
    def candidates(self) -> float:
        """Return the mean number of candidates in a frame that has any; NaN without frames."""
        return ratio_or_nan(sum(s.candidates for s in self.sensors.values()), self.frames)

    @property
    def unexplained(self) -> float:
        """Return the mean number of candidates near no track in a frame with candidates; NaN without frames."""
        return ratio_or_nan(sum(s.unexplained for s in self.sensors.values()), self.frames)

    def persistent(self, fewest: int) -> dict[str, float]:
        """Return the share of frames with a persistent candidate near no track, by sensor with `fewest` frames or more.

        Persistent means that it was there in the frame before, too.
        """
        return {name: s.crowded / s.frames for name, s in sorted(self.sensors.items()) if s.frames >= fewest}
