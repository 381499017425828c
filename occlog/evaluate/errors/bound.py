"""Posterior Cramer-Rao bound, on the ground or in space, and the RMSE against it, in memory that does not grow.

The bound of a target begins with the prior at its first detection or miss. It uses every bearing of the target, at the
target's true position, unless the target was outside the field of view and the bearing points elsewhere, i.e. is of
something else. All distance measurements are used. The bound is given at the times of the target's errors, or at those
of its detections and misses if it has no errors.

The information of each time step is buffered on disk by `Bounds.update`.  `Bounds.finish` then reads it forwards for
the bound of filtering and backwards for that of smoothing, block by block, with the state that the block before, or
after, has left for each target.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints
from occlog.core.bounds import in_plane as crlb
from occlog.core.metrics.errors import Sum, ratio_or_nan
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.matching.observations import SensorObservationSet
from occlog.evaluate.matching.paths import ObjectPath, SensorGeometry
from occlog.io.files.spill import RECORDS_PER_BLOCK, Blocks, Records
from occlog.records.columns import ColumnTable
from occlog.records.scene import Scene
from occlog.records.tables import Bound, Errors

from .information import (
    StationMeasurements,
    add_distances,
    bound_table,
    dimension,
    distances_in_space,
    information_of,
    motion_of,
    prior_of,
)
from .sums import space_errors

Metrics = dict[str, float]
KINDS = ("bound", "smoothed")


class BoundDimensions(NamedTuple):
    """Whether Fisher information is buffered on disk for the plane (x, y), for space (x, y, z), or for both.

    Which of them the bound of a target uses is known after the last row only.
    """

    ground: bool
    space: bool

    @classmethod
    def of(cls, config: EvaluateConfig, *, high: bool) -> BoundDimensions:
        """Return the dimensions that the setting `bound_dimension` needs.

        `high`: whether both a track and a target have heights.
        """
        if config.bound_dimension == "auto":
            return cls(True, high)
        return cls(config.bound_dimension == "ground", config.bound_dimension == "space")


@dataclass
class _BoundTarget:
    """State of the recursion of the Cramer-Rao bound for one target, between blocks of rows.

    Attributes:
        first_ns: time of the first observation [ns]; None: none.
        errors, late: numbers of its estimates, and of those after the settling time.
        in_space: an estimate and the truth both have a height at some time.
        ranged: it has distance measurements.
        d: dimension of the bound, 2 or 3.
        last_ns: time of the last row so far [ns]; None: none.
        state: matrix of the state passed on from block to block: forwards the filtering bound (a covariance) of the
            last step, backwards the information of all later steps; None: no block yet.
    """

    first_ns: int | None = None  # of its first pass
    errors: int = 0
    late: int = 0
    in_space: bool = False
    ranged: bool = False
    d: int = 2
    last_ns: int | None = None
    state: Floats | None = None  # that the last block has left


class BoundSums:
    """Sums of squares over rows of the bound, and over errors of estimates at the same rows, for RMS values."""

    def __init__(self) -> None:
        """Create sums without rows."""
        self.rows = 0
        self._both = self._alone = 0  # rows in space: of bound and error, and of the bound
        self._sums: dict[str, Sum] = {}

    def update(self, table: Bound, error: Floats, error_space: Floats) -> None:
        """Add n rows of the bound with the errors of the estimates at them.

        Args:
            table: n rows.
            error: (n,) distance on the ground; NaN: no error.
            error_space: (n,) distance in space; NaN: none.
        """
        self.rows += len(table)
        self._more("error", error)
        for kind in KINDS:
            self._more(kind, getattr(table, kind))
        alone = np.isfinite(table.bound_space)
        both = alone & np.isfinite(error_space)
        self._both += int(np.count_nonzero(both))
        self._alone += int(np.count_nonzero(alone))
        self._more("error both", error_space[both])
        for name, rows in (("alone", alone), ("both", both)):
            for kind in KINDS:
                self._more(f"{kind} {name}", getattr(table, f"{kind}_space")[rows])
                self._more(f"{kind} z {name}", np.sqrt(getattr(table, f"{kind}_zz")[rows]))

    def _more(self, name: str, values: Floats) -> None:
        self._sums.setdefault(name, Sum()).add(float(np.square(values).sum()))

    def _rms(self, name: str, count: int) -> float:
        return float(np.sqrt(self._sums[name].value / count)) if count else float("nan")

    @classmethod
    def together(cls, parts: Iterable[BoundSums]) -> BoundSums:
        """Return new sums over the rows of all `parts`, such as several targets."""
        out = cls()
        out.update(Bound.empty(), np.zeros(0), np.zeros(0))
        for part in parts:
            out.rows += part.rows
            out._both += part._both
            out._alone += part._alone
            for name, value in part._sums.items():
                out._sums[name].add(value.value)
        return out

    def result(self, unit: str, suffix: str, *, with_errors: bool) -> Metrics:
        """Return RMS values over all rows of the bounds of filtering and smoothing, by name; NaN without rows.

        If rows have a bound in space, also those of the height and of the distance in space.

        Args:
            unit: unit of lengths, part of the names.
            suffix: part of the names, before the unit.
            with_errors: whether to add the ratios of the RMSE of the estimates to the bounds, and their number.
        """
        error, least, smoothed = (self._rms(name, self.rows) for name in ("error", *KINDS))
        out: Metrics = {f"bound_rmse{suffix}_{unit}": least}
        if with_errors:
            out[f"bound_ratio{suffix}"], out[f"bound_estimates{suffix}"] = ratio_or_nan(error, least), self.rows
        out[f"smoothed_bound_rmse{suffix}_{unit}"] = smoothed
        if with_errors:
            out[f"smoothed_bound_ratio{suffix}"] = ratio_or_nan(error, smoothed)
        name, count = ("both", self._both) if self._both else ("alone", self._alone)
        if not count:
            return out
        for kind, begin in zip(KINDS, ("", "smoothed_"), strict=True):
            out[f"{begin}bound_rmse_z{suffix}_{unit}"] = self._rms(f"{kind} z {name}", count)
            out[f"{begin}bound_rmse_space{suffix}_{unit}"] = self._rms(f"{kind} {name}", count)
        for begin in ("", "smoothed_") if self._both else ():
            least = out[f"{begin}bound_rmse_space{suffix}_{unit}"]
            out[f"{begin}bound_ratio_space{suffix}"] = ratio_or_nan(self._rms("error both", self._both), least)
        return out


class Bounds:
    """Computes the posterior Cramer-Rao bound of all targets, of filtering and of smoothing.

    `update` buffers Fisher information and errors on disk, interval by interval; `finish` runs the recursions.
    """

    def __init__(
        self,
        scene: Scene,
        config: EvaluateConfig,
        high: set[int],
        ways: BoundDimensions,
        block: int = RECORDS_PER_BLOCK,
    ) -> None:
        """Create an empty bound.

        Args:
            scene: room (for the prior) and unit of length.
            config: motion, prior, dimensions.
            high: identities of the targets with a true height at some time.
            ways: dimensions (ground plane, space) in which the information of measurements is buffered.
            block: number of records that are processed at once.
        """
        self._scene, self._config, self._high, self._ways = scene, config, high, ways
        self._block = block
        self._targets: dict[int, _BoundTarget] = {}
        kinds: list[Any] = [
            ("t_ns", "i8"),
            ("target", "i8"),
            ("n_detected", "i8"),
            ("error", "f8"),
            ("error_space", "f8"),
        ]
        kinds += [(name, "?") for name in ("observed", "estimate", "late", "known")]
        kinds += [("ground", "f8", (2, 2))] if ways.ground else []
        kinds += [("space", "f8", (3, 3))] if ways.space else []
        self._record = np.dtype(kinds)
        self._information = Blocks(self._record, block)
        self.rows = 0
        """Rows of the bound, once it is made."""
        self._all: dict[int, BoundSums] = {}
        self._estimates: dict[int, BoundSums] = {}
        self._late: dict[int, BoundSums] = {}

    def update(
        self,
        observations: Mapping[str, SensorObservationSet],
        sensors: Mapping[str, SensorGeometry],
        errors: Errors,
        late: Bools,
        targets: Mapping[int, ObjectPath],
        measured: StationMeasurements | None = None,
    ) -> None:
        """Add the next time interval.

        Args:
            observations: by name of the sensor.
            sensors: by name, at least those.
            errors: N errors of estimates, in the order of time.
            late: (N,) mask of those after the settling time.
            targets: true path of each target, at least around the interval.
            measured: distance measurements in the interval; None: none.
        """
        labels = [errors.target_id.astype(np.int64), *(found.observations.target for found in observations.values())]
        labels += [] if measured is None else [measured.target]
        parts = [np.zeros(0, dtype=self._record)]
        for target in np.unique(np.concatenate(labels)).tolist():
            own = errors.target_id == target
            known = self._targets.setdefault(target, _BoundTarget())
            known.errors += int(np.count_nonzero(own))
            known.late += int(np.count_nonzero(late[own]))
            known.in_space |= bool(space_errors(errors)[own].any())
            parts.append(
                self._records(target, observations, sensors, errors.take(own), late[own], targets[target], measured)
            )
        rows = np.concatenate(parts)
        self._information.append(rows[np.lexsort((rows["target"], rows["t_ns"]))])

    def _records(
        self,
        target: int,
        observations: Mapping[str, SensorObservationSet],
        sensors: Mapping[str, SensorGeometry],
        errors: Errors,
        late: Bools,
        path: ObjectPath,
        measured: StationMeasurements | None,
    ) -> Records:
        """Return the records of one target in a time interval: Fisher information and errors at each time.

        Empty until the target is first observed. Updates the target's state in place.

        Args:
            target: its identity.
            observations: by sensor, of all targets.
            sensors: by name.
            errors: errors of the target's estimates.
            late: (n,) mask of those after the settling time.
            path: true positions of the target.
            measured: distances to stations; None: there are none.
        """
        known = self._targets[target]
        mine = {
            name: found.observations.take(found.observations.target == target) for name, found in observations.items()
        }
        ranged = np.zeros(0, np.int64) if measured is None else measured.t_ns[measured.target == target]
        observed_ns = np.unique(np.concatenate([ranged, *(m.t_ns for m in mine.values())]))
        if known.first_ns is None:
            if not len(observed_ns):
                return np.zeros(0, dtype=self._record)
            known.first_ns = int(observed_ns[0])
        wanted = errors.t_ns >= known.first_ns
        times = np.union1d(observed_ns, errors.t_ns[wanted])
        out = np.zeros(len(times), dtype=self._record)
        out["t_ns"], out["target"] = times, target
        out["observed"] = np.isin(times, observed_ns)
        out["known"] = path.at(times, self._config.limit_ns)[1]
        out["error"] = out["error_space"] = np.nan
        at = np.searchsorted(times, errors.t_ns[wanted])
        out["estimate"][at], out["late"][at] = True, late[wanted]
        out["error"][at], out["error_space"][at] = errors.error[wanted], errors.error_space[wanted]
        for d, name in ((2, "ground"), (3, "space")):
            if name not in (self._record.names or ()):
                continue
            information, n_seen = information_of(times, mine, sensors, d)
            if measured is not None and len(ranged):
                known.ranged = True
                if d == 2:
                    add_distances(information, n_seen, times, measured, target, path, self._config)
            out[name], out["n_detected"] = information, np.maximum(out["n_detected"], n_seen)
        return out

    def finish(self, take: Callable[[ColumnTable], None]) -> None:
        """Compute the bound after the last interval; pass it to `take`, table by table, in the order of time.

        Raises:
            InputError: the bound of a target is in space, and it has distance measurements or no true height.
        """
        self._information.end()
        for target, known in sorted(self._targets.items()):
            if known.first_ns is None:
                continue
            high = target in self._high
            known.d = dimension(target, high=high, in_space=known.in_space, config=self._config)
            if known.d == 3 and known.ranged:
                raise distances_in_space()
        most = max((known.d for known in self._targets.values()), default=2)
        n = most if self._config.motion == "waypoint" else 2 * most
        kinds: list[Any] = [("dt", "f8"), ("filtered", "f8", (n, n)), ("smoothed", "f8", (most, most))]
        made = Blocks(np.dtype(kinds), self._block)
        for number in range(self._information.count):
            made.put(number, self._forwards(self._information.get(number), np.dtype(kinds)))
        for known in self._targets.values():
            known.state = None
        for number in reversed(range(self._information.count)):
            made.put(number, self._backwards(self._information.get(number), made.get(number).copy()))
        for number in range(self._information.count):
            take(self._table(self._information.get(number), made.get(number)))

    def _forwards(self, information: Records, record: np.dtype[Any]) -> Records:
        """Return the filtering bound of a block of records (forward recursion).

        Each row has the time `dt` [s] since the target's row before, and the covariance `filtered` (n, n): the bound of
        its state. The last one of each target is kept for the next block.

        Args:
            information: records of the block with Fisher information.
            record: data type of the result.
        """
        out = np.zeros(len(information), dtype=record)
        for target, rows in _by_target(information):
            known, t_ns = self._targets[target], information["t_ns"][rows]
            dt = np.diff(t_ns, prepend=t_ns[0] if known.last_ns is None else known.last_ns) / NS
            before = prior_of(known.d, self._scene, self._config) if known.state is None else known.state
            filtered = crlb.posterior_bound(*self._steps(information, rows, dt, known.d), before)
            known.state, known.last_ns = filtered[-1], int(t_ns[-1])
            n = len(before)
            out["dt"][rows] = dt
            out["filtered"][rows[:, None, None], np.arange(n)[:, None], np.arange(n)] = filtered
        return out

    def _backwards(self, information: Records, made: Records) -> Records:
        """Add the smoothing bound of a block to the records `made`, in place, and return them (backward recursion).

        Args:
            information: records of the block; blocks come from the last to the first.
            made: result of `_forwards` for the block.
        """
        for target, rows in _by_target(information):
            known = self._targets[target]
            d, n = known.d, known.d if self._config.motion == "waypoint" else 2 * known.d
            later = np.zeros((n, n)) if known.state is None else known.state
            steps = self._steps(information, rows, made["dt"][rows], d)
            smoothed, known.state = crlb.smoothing_bound_before(made["filtered"][rows][:, :n, :n], *steps, later)
            made["smoothed"][rows[:, None, None], np.arange(d)[:, None], np.arange(d)] = smoothed[:, :d, :d]
        return made

    def _steps(self, records: Records, rows: Ints, dt: Floats, d: int) -> tuple[Floats, Floats, Floats]:
        information = np.ascontiguousarray(records["ground" if d == 2 else "space"][rows])
        return motion_of(information, dt, self._scene, self._config)

    def _table(self, information: Records, made: Records) -> Bound:
        """Return a block of the bound as table rows, and add it to the sums.

        Only rows at times of errors are kept; of a target without errors those at its observations.

        Args:
            information: records of the block.
            made: filtering and smoothing bounds of these records.
        """
        parts = []
        for target, rows in _by_target(information):
            known = self._targets[target]
            own = information[rows]
            keep = own["known"] & (own["estimate"] if known.errors else own["observed"])
            rows, own, d = rows[keep], own[keep], known.d
            table = bound_table(
                own["t_ns"],
                target,
                made["filtered"][rows][:, :d, :d],
                made["smoothed"][rows][:, :d, :d],
                own["n_detected"],
            )
            self.rows += len(table)
            nothing = np.full(len(table), np.nan)
            self._all.setdefault(target, BoundSums()).update(table, nothing, nothing)
            for figures, some in ((self._estimates, own["estimate"]), (self._late, own["late"])):
                errors = own["error"][some], own["error_space"][some]
                figures.setdefault(target, BoundSums()).update(table.take(some), *errors)
            parts.append(table)
        return Bound.merge(parts)

    def result(self, unit: str, *, late: bool = False) -> Metrics:
        """Return figures of the bound, and its ratio to the errors, over all targets and for each target (`_target_N`).

        `late`: only of rows after the settling time.
        """
        counts = {k: known.late if late else known.errors for k, known in self._targets.items()}
        estimates = self._late if late else self._estimates
        if any(counts.values()):
            out = BoundSums.together(estimates.values()).result(unit, "", with_errors=True)
        else:
            out = BoundSums.together(self._all.values()).result(unit, "", with_errors=False)
        for target, own in sorted(self._all.items()):
            if own.rows:
                with_errors = counts[target] > 0
                figures = estimates[target] if with_errors else own
                out |= figures.result(unit, f"_target_{target}", with_errors=with_errors)
        return out


def _by_target(information: Records) -> list[tuple[int, Ints]]:
    """Return each target with the indices (n,) of its rows in a block of records, sorted by target."""
    return [
        (target, np.flatnonzero(information["target"] == target))
        for target in np.unique(information["target"]).tolist()
    ]
