"""Figures of errors over a stream: over all targets and for each target, on the ground and in space."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.metrics.errors import (
    CHI2_95_2D,
    CHI2_95_3D,
    ErrorSums,
    Sum,
    add_sums,
    error_sums,
    group_medians,
    quantile,
    quantiles,
    ratio_or_nan,
)
from occlog.io.files.spill import NUMBERS_IN_MEMORY, Spool
from occlog.records.columns import rows_by_label
from occlog.records.tables import Errors

Metrics = dict[str, float]


def space_errors(errors: Errors) -> Bools:
    """Return the mask (N,) of errors with a height of both estimate and truth."""
    return np.isfinite(errors.error_space)


class Consistency:
    """Sums of normalised estimation errors squared (NEES): their mean and the share within the 95 % limit.

    With correct covariances the mean equals the dimension, and the share is 0.95.
    """

    def __init__(self, limit: float) -> None:
        """Start without errors; `limit`: 95 % quantile of chi-square for the dimension."""
        self._limit, self._sum = limit, Sum()
        self.n_finite = self.inside = self.rows = 0

    def update(self, nees: Floats) -> None:
        """Add values `nees` (n,), NaN where the covariance is singular."""
        finite = nees[np.isfinite(nees)]
        self._sum.add(float(finite.sum()))
        self.rows, self.n_finite = self.rows + len(nees), self.n_finite + len(finite)
        self.inside += int(np.count_nonzero(finite <= self._limit))

    def merge(self, other: Consistency) -> None:
        """Add the sums of another part to this one."""
        self._sum.merge(other._sum)
        self.n_finite, self.inside = self.n_finite + other.n_finite, self.inside + other.inside
        self.rows += other.rows

    def result(self, name: str, suffix: str) -> Metrics:
        """Return mean, share within the 95 % limit, and number of singular covariances.

        Their names are `name`, the figure, and `suffix`.
        """
        return {
            f"{name}_mean{suffix}": ratio_or_nan(self._sum.value, self.n_finite),
            f"{name}_share_95{suffix}": ratio_or_nan(self.inside, self.n_finite),
            f"{name}_singular{suffix}": self.rows - self.n_finite,
        }


class InSpace:
    """Sums of errors in space, of estimates with known height and true height."""

    def __init__(self) -> None:
        """Create sums without errors."""
        self.rows = 0
        self._squares, self._squares_z = Sum(), Sum()
        self._nees = Consistency(CHI2_95_3D)

    def update(self, high: Errors) -> None:
        """Add `high`, rows of errors that all have a height of both estimate and truth."""
        self.rows += len(high)
        self._squares.add(float(np.sum(np.square(high.error_space))))
        self._squares_z.add(float(np.sum(np.square(high.error_z))))
        self._nees.update(high.nees_space)

    def result(self, unit: str, suffix: str) -> Metrics:
        """Return RMSE along z and in space, and consistency (expected mean NEES: 3); empty without errors in space.

        `unit` (of length) and `suffix` are parts of the names.
        """
        if not self.rows:
            return {}
        return {
            f"rmse_z{suffix}_{unit}": float(np.sqrt(self._squares_z.value / self.rows)),
            f"rmse_space{suffix}_{unit}": float(np.sqrt(self._squares.value / self.rows)),
            **self._nees.result("nees_space", suffix),
            f"estimates_space{suffix}": self.rows,
        }


def quantiles_of(values: Spool, shares: Sequence[float]) -> list[float]:
    """Return a quantile for each of the `shares` (0 to 1), as `np.quantile`; NaN without numbers.

    `values` are in memory or in a temporary file.
    """
    whole = values.whole
    if whole is not None:
        return [quantile(whole, share) for share in shares]
    return quantiles(values.blocks, values.count, shares)


def median_of(values: Spool) -> float:
    """Return the median, as `np.median`, of numbers in memory or in a temporary file; NaN without numbers."""
    whole = values.whole
    if whole is not None:
        return float(np.median(whole)) if len(whole) else float("nan")

    def blocks() -> Iterator[tuple[Ints, Floats]]:
        for block in values.blocks():
            yield np.zeros(len(block), dtype=np.int64), block

    return float(group_medians(blocks, np.array([values.count]))[0])


class Spread:
    """Accumulates distances for their mean, quantiles and maximum; many of them go to a temporary file."""

    def __init__(self, in_memory: int) -> None:
        """Start without distances; up to `in_memory` of them stay in memory."""
        self._values, self._sum, self._most = Spool(in_memory), Sum(), np.nan

    @property
    def mean(self) -> float:
        """Mean of the distances; NaN without any."""
        return ratio_or_nan(self._sum.value, self._values.count)

    def update(self, values: Floats) -> None:
        """Add distances (n,)."""
        self._values.add(values)
        self._sum.add(float(values.sum()))
        self._most = float(np.fmax(self._most, values.max())) if len(values) else self._most

    def merge(self, other: Spread) -> None:
        """Add the distances of another part to this one."""
        for block in other._values.blocks():
            self._values.add(block)
        self._sum.merge(other._sum)
        self._most = float(np.fmax(self._most, other._most))

    def result(self, name: str, unit: str) -> Metrics:
        """Return mean, median, 95 % quantile and maximum; their names begin with `name` and end with `unit`."""
        middle, high = quantiles_of(self._values, (0.5, 0.95))
        return {
            f"{name}_mean_{unit}": self.mean,
            f"{name}_median_{unit}": middle,
            f"{name}_p95_{unit}": high,
            f"{name}_max_{unit}": self._most,
        }


class _ErrorTarget:
    """Accumulated squared errors along x and y, NEES, and errors in space, of one target."""

    def __init__(self) -> None:
        self.sums: list[Sum] = [Sum(), Sum()]
        self.rows = 0
        self.nees = Consistency(CHI2_95_2D)
        self.space = InSpace()

    def update(self, errors: Errors, high: Errors) -> None:
        found = error_sums(np.column_stack([errors.error_x, errors.error_y]))
        self.rows += found.n
        self.sums[0].add(found.square_x)
        self.sums[1].add(found.square_y)
        self.nees.update(errors.nees)
        self.space.update(high)

    @property
    def squares(self) -> ErrorSums:
        return ErrorSums(self.rows, self.sums[0].value, self.sums[1].value)


class ErrorFigures:
    """Accumulates figures of errors over all targets and for each target."""

    def __init__(self, unit: str, in_memory: int = NUMBERS_IN_MEMORY) -> None:
        """Start without errors.

        Args:
            unit: unit of lengths, which ends the names of figures.
            in_memory: how many distances are kept in memory; more go to a file without a name.
        """
        self.rows = 0
        self._unit = unit
        self._targets: dict[int, _ErrorTarget] = {}
        self._spread, self._spread_space = Spread(in_memory), Spread(in_memory)
        self._bias = {axis: Sum() for axis in "xyz"}
        self._nees, self._space = Consistency(CHI2_95_2D), InSpace()

    def update(self, errors: Errors) -> None:
        """Add rows of errors, in any order, to the figures of all targets and of each."""
        self.rows += len(errors)
        for k, rows in rows_by_label(errors.target_id):
            part = errors.take(rows)
            self._targets.setdefault(k, _ErrorTarget()).update(part, part.take(space_errors(part)))
        self._spread.update(errors.error)
        for axis in "xy":
            self._bias[axis].add(float(getattr(errors, f"error_{axis}").sum()))
        self._nees.update(errors.nees)
        high = errors.take(space_errors(errors))
        self._space.update(high)
        self._spread_space.update(high.error_space)
        self._bias["z"].add(float(high.error_z.sum()))

    def result(self) -> Metrics:
        """Return the figures over all targets, then for each target, by name."""
        unit, targets = self._unit, dict(sorted(self._targets.items()))
        out = _accuracy(add_sums(t.squares for t in targets.values()), unit, "")
        out |= self._spread.result("error", unit)
        out |= {f"bias_{axis}_{unit}": ratio_or_nan(self._bias[axis].value, self.rows) for axis in "xy"}
        out |= self._nees.result("nees", "") | self._space.result(unit, "")
        if self._space.rows:
            out |= self._spread_space.result("error_space", unit)
            out[f"bias_z_{unit}"] = ratio_or_nan(self._bias["z"].value, self._space.rows)
        for k, own in targets.items():
            out |= _accuracy(own.squares, unit, f"_target_{k}") | own.nees.result("nees", f"_target_{k}")
            out |= own.space.result(unit, f"_target_{k}")
            out[f"estimates_target_{k}"] = own.rows
        return out


def _accuracy(sums: ErrorSums, unit: str, suffix: str) -> Metrics:
    return {
        f"rmse{suffix}_{unit}": sums.rmse,
        f"rmse_x{suffix}_{unit}": sums.rmse_x,
        f"rmse_y{suffix}_{unit}": sums.rmse_y,
    }
