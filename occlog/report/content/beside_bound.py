"""Errors beside the bound, row by row: the RMSE and the bound on it over the times and targets that have both."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from occlog.array_types import Floats
from occlog.core.metrics.sums import Sum
from occlog.records.tables import Bound, Errors

WHERE = ("", "_space")
KINDS = ("bound", "smoothed")


def _both(errors: Errors, bound: Bound, target: int, kind: str, where: str) -> tuple[Floats, Floats]:
    """Errors and bounds of a target at the times that have both."""
    error, least = getattr(errors, f"error{where}"), getattr(bound, f"{kind}{where}")
    mine = (errors.target_id == target) & np.isfinite(error)
    its = (bound.target_id == target) & np.isfinite(least)
    _, e, b = np.intersect1d(errors.t_ns[mine], bound.t_ns[its], return_indices=True)
    return error[mine][e], least[its][b]


@dataclass
class _Sums:
    """Squares of errors and bounds that have one another."""

    rows: int = 0
    errors: Sum = field(default_factory=Sum)
    bounds: Sum = field(default_factory=Sum)
    told: bool = False  # whether any bound of the kind is known


@dataclass
class _Target:
    """Squares of a target's bounds up to now, whatever errors there are."""

    rows: int = 0
    squares: dict[str, Sum] = field(default_factory=lambda: {kind: Sum() for kind in KINDS})
    smoothed: bool = True  # whether all of it is known


class BesideBound:
    """Gathers errors and bounds while both stream by, in stretches of the same time."""

    def __init__(self) -> None:
        """Nothing yet."""
        self._sums: dict[tuple[int, str, str], _Sums] = {}
        self._targets: dict[int, _Target] = {}

    def add(self, errors: Errors, bound: Bound) -> Floats:
        """Another stretch; (N, 2) root mean square of the target's bounds up to each one, and of those of smoothing."""
        out = np.full((len(bound), 2), np.nan)
        for target in np.unique(bound.target_id).tolist():
            for where in WHERE:
                for kind in KINDS:
                    self._pairs(errors, bound, target, kind, where)
            own = self._targets.setdefault(target, _Target())
            rows = bound.target_id == target
            count = own.rows + np.arange(1, int(rows.sum()) + 1)
            for k, kind in enumerate(KINDS):
                squares = getattr(bound, kind)[rows] ** 2
                out[rows, k] = np.sqrt((own.squares[kind].value + np.cumsum(squares)) / count)
                own.squares[kind].add(float(squares.sum()))
            own.rows = int(count[-1])
            own.smoothed = own.smoothed and bool(np.isfinite(bound.smoothed[rows]).all())
        return out

    def _pairs(self, errors: Errors, bound: Bound, target: int, kind: str, where: str) -> None:
        found, least = _both(errors, bound, target, kind, where)
        sums = self._sums.setdefault((target, kind, where), _Sums())
        sums.rows += len(found)
        sums.errors.add(float(np.sum(found**2)))
        sums.bounds.add(float(np.sum(least**2)))
        rows = bound.target_id == target
        sums.told = sums.told or bool(np.isfinite(getattr(bound, f"{kind}{where}")[rows]).any())

    def figures(self, target: int | None = None, where: str = "", *, smoothed: bool = False) -> tuple[float, float]:
        """RMSE and root mean square bound over the times and targets that have both; NaN where none has.

        Args:
            target: of which they are; None: of all.
            where: "_space": in space; empty: on the ground.
            smoothed: the bound of smoothing, where it is known.
        """
        mine = {key: sums for key, sums in self._sums.items() if key[2] == where and target in (None, key[0])}
        later = smoothed and any(sums.told for (_, kind, _), sums in mine.items() if kind == "smoothed")
        own = [sums for (_, kind, _), sums in mine.items() if kind == ("smoothed" if later else "bound")]
        rows = sum(sums.rows for sums in own)
        if not rows:
            return float("nan"), float("nan")
        return (
            float(np.sqrt(sum(sums.errors.value for sums in own) / rows)),
            float(np.sqrt(sum(sums.bounds.value for sums in own) / rows)),
        )

    def smooths(self, target: int) -> bool:
        """Whether the bound of smoothing of a target is known all the time."""
        return target in self._targets and self._targets[target].smoothed
