"""Other readings of ranges: multiplied by a common factor, or with one station at another position.

Circles of three or more stations at one time meet near one position. If they do not as given, but do nearly after one
of these changes, a finding states it. The position of each time step is the least-squares one, by Gauss-Newton steps
(Gauss 1809) of all time steps at once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from occlog.array_types import NS, Floats
from occlog.filtering.likelihood.distances import RANGE
from occlog.records.verdicts import Check, finding, outcome
from occlog.scans.grouping import ScanMeasurements

RANGE_READINGS = "scale of ranges"
"""Name of the check."""
STEP_NS = NS // 5
"""Ranges of one target within this time [ns] are of one position."""
MIN_STATIONS, MIN_STEPS, MAX_STEPS, MAX_USED, MAX_STATIONS = 3, 20, 2000, 200, 12
"""Stations of a time step, and numbers of steps that are needed, kept and used, and of stations."""
ITERATIONS, DAMPING = 15, 1e-9
"""Gauss-Newton steps, and share of the diagonal that is added."""
MAX_SHARE = 0.1
"""A reading fits if its median square misfit is at most this share of that as given."""
MIN_SIGMAS = 2.0
"""Misfit as given, in stated standard deviations, from which other readings are tried."""
SHARE_OF_BIASES = 0.25
"""A station is at another position if that leaves less than this share of the misfit of constant errors of ranges."""
FACTORS = {
    0.5: "multiplied by 0.5, as round trips",
    2.0: "multiplied by 2, as halves",
    0.001: "multiplied by 0.001, as of mm",
    0.01: "multiplied by 0.01, as of cm",
    0.3048: "multiplied by 0.3048, as of feet",
    3.2808399: "multiplied by 3.281, as of a scene in feet",
    100.0: "multiplied by 100, as of a scene in cm",
    1000.0: "multiplied by 1000, as of km",
}
"""Common factors of ranges, in words."""


class StationReading(NamedTuple):
    """Readings of the ranges of one station that explain why ranges do not meet.

    `bias` is by how much they are too long, with its standard error `error`; `offset` (2,) is by how much the station
    would have to be moved [all lengths]. Misfits are with the one and the other [length^2].
    """

    station: str
    bias: float
    error: float
    bias_misfit: float
    offset: Floats
    moved_misfit: float

    def offset_words(self, unit: str) -> str:
        """Return by how much the station would have to be moved, as text."""
        x, y = (np.round(self.offset, 2) + 0.0).tolist()
        return f"({x:.2f}, {y:.2f}) {unit}"


class _LeastMisfit(NamedTuple):
    """Least misfit [length^2] over k parameters, these (k,), and their standard errors (k,)."""

    misfit: float
    value: Floats
    error: Floats


class RangeReadings:
    """Check of whether the ranges of several stations meet only with a common factor or another position of one."""

    def __init__(self, names: Sequence[str]) -> None:
        """Start without ranges; `names` are the stations, in the order in which measurements number them."""
        self._names = names
        self._steps: dict[tuple[int, int], dict[int, tuple[float, ...]]] = {}

    def add(self, measured: Sequence[tuple[int, ScanMeasurements]]) -> None:
        """Add times [ns] and measurements; one range of each station, target and time step is used."""
        for t_ns, one in measured:
            rows = one.distances
            for n in np.flatnonzero(rows.kind == RANGE).tolist():
                key, station = (int(one.target_id[n]), t_ns // STEP_NS), int(rows.station[n])
                if key in self._steps or len(self._steps) < MAX_STEPS:
                    x, y = rows.position[n].tolist()
                    value = (float(rows.value[n]), float(rows.sigma[n]), x, y, float(rows.rise2[n]))
                    self._steps.setdefault(key, {}).setdefault(station, value)

    def checks(self, unit: str) -> tuple[Check, ...]:
        """Return the check, with a finding if ranges meet in another reading; `unit` is that of lengths."""
        table, _ = self._table()
        if len(table) < MIN_STEPS:
            return outcome(RANGE_READINGS, (), unless=f"fewer than {MIN_STEPS} time steps have three ranges")
        plain = _misfit(table)
        best, change = np.inf, ""
        if self._off(table, plain):
            best, change = min((_misfit(_scaled(table, factor)), words) for factor, words in FACTORS.items())
            change = f"they are {change}"
            one = self.one_station() if best > MAX_SHARE * plain else None
            if one is not None and one.moved_misfit <= SHARE_OF_BIASES * one.bias_misfit:
                best, change = one.moved_misfit, f"station {one.station} is moved by {one.offset_words(unit)}"
        if best > MAX_SHARE * plain:
            return outcome(RANGE_READINGS, (), misfit=float(np.sqrt(plain)))
        now, then = np.sqrt([plain, best]).tolist()
        return (finding(RANGE_READINGS, "ranges-fit-if", change=change, misfit=then, given=now, unit=unit),)

    def one_station(self) -> StationReading | None:
        """Return the station with a constant error, or another position, that alone explains the misfit; None if none.

        It must do so much better than one of any other station, and than a constant error of all stations.
        """
        table, stations = self._table()
        if len(table) < MIN_STEPS or not self._off(table, plain := _misfit(table)):
            return None
        S = range(len(stations))
        biases = [_fitted(partial(_longer, table, [s]), 1) for s in S]
        moves = [_fitted(partial(_moved, table, s), 2) for s in S]
        least = [min(bias.misfit, move.misfit) for bias, move in zip(biases, moves, strict=True)]
        s = int(np.argmin(least))
        common = _fitted(partial(_longer, table, list(S)), 1).misfit
        if least[s] > MAX_SHARE * plain or least[s] > SHARE_OF_BIASES * min([common, *np.delete(least, s).tolist()]):
            return None
        bias, error = float(biases[s].value[0]), float(biases[s].error[0])
        return StationReading(self._names[stations[s]], bias, error, biases[s].misfit, moves[s].value, moves[s].misfit)

    def _table(self) -> tuple[Floats, list[int]]:
        """Return the ranges (N, S, 5) of N time steps and S stations, NaN where missing, and numbers of the stations.

        Columns are range, standard deviation, x and y of the station, and square of its height.
        """
        steps = [step for step in self._steps.values() if len(step) >= MIN_STATIONS]
        steps = steps[:: max(-(-len(steps) // MAX_USED), 1)]
        stations = sorted({station for step in steps for station in step})[:MAX_STATIONS]
        table = np.full((len(steps), len(stations), 5), np.nan)
        for n, step in enumerate(steps):
            for s, station in enumerate(stations):
                if station in step:
                    table[n, s] = step[station]
        return table[np.count_nonzero(np.isfinite(table[..., 0]), axis=1) >= MIN_STATIONS], stations

    @staticmethod
    def _off(table: Floats, plain: float) -> bool:
        """Return whether the misfit as given, `plain` [length^2], is clearly above the stated noise."""
        return plain > (MIN_SIGMAS * float(np.nanmedian(table[..., 1]))) ** 2


def _scaled(table: Floats, factor: float) -> Floats:
    out = table.copy()
    out[..., :2] *= factor
    return out


def _longer(table: Floats, stations: Sequence[int], by: Floats) -> Floats:
    """Return the table with a constant (1,) subtracted from the ranges of stations."""
    out = table.copy()
    out[:, stations, 0] -= by[0]
    return out


def _moved(table: Floats, station: int, by: Floats) -> Floats:
    """Return the table with a station moved by (2,)."""
    out = table.copy()
    out[:, station, 2:4] += by
    return out


def _fitted(change: Callable[[Floats], Floats], parameters: int) -> _LeastMisfit:
    """Return the least misfit over the parameters of a change of the table."""
    start = np.zeros(parameters)

    def residuals(by: Floats) -> Floats:
        return _residuals(change(by)).ravel()

    scale = max(float(np.median(np.abs(residuals(start)))), 1e-12)
    found = least_squares(residuals, start, loss="soft_l1", f_scale=scale, max_nfev=30)
    misfit = _misfit(change(found.x))
    J: Floats = np.asarray(found.jac)
    error = np.sqrt(misfit * np.diag(np.linalg.pinv(J.T @ J)))
    return _LeastMisfit(misfit, found.x, error)


def _misfit(table: Floats) -> float:
    """Return the median over the time steps of the mean square residual per degree of freedom [length^2]."""
    residuals = _residuals(table)
    freedom = np.count_nonzero(np.isfinite(table[..., 0]), axis=1) - 2
    return float(np.median(np.sum(residuals**2, axis=1) / freedom))


def _residuals(table: Floats) -> Floats:
    """Return residuals (N, S) of ranges at the least-squares positions of N time steps; 0 for missing ranges.

    Args:
        table: (N, S, 5) range, its standard deviation, x and y of the station, and the square of its height.
    """
    known = np.isfinite(table[..., 0])
    value, position = np.where(known, table[..., 0], 0.0), np.where(known[..., None], table[..., 2:4], 0.0)
    rise2 = np.where(known, table[..., 4], 0.0)
    count = known.sum(axis=1)
    centre = position.sum(axis=1) / count[:, None]
    # The linear solution: differences of squares of ranges
    flat = np.where(known, value**2 - rise2 - np.sum(position**2, axis=-1), 0.0)
    A = np.where(known[..., None], position - centre[:, None], 0.0)
    b = np.where(known, flat - (flat.sum(axis=1) / count)[:, None], 0.0)
    xy = np.einsum("nij,nj->ni", np.linalg.pinv(A), -0.5 * b)
    for _ in range(ITERATIONS):
        away = np.where(known[..., None], xy[:, None] - position, 0.0)
        distance = np.sqrt(np.maximum(np.sum(away**2, axis=-1) + rise2, 1e-12))
        G = away / distance[..., None]
        off = np.where(known, distance - value, 0.0)
        normal = np.einsum("nsi,nsj->nij", G, G) + DAMPING * np.eye(2)
        xy = xy - np.linalg.solve(normal, np.einsum("nsi,ns->ni", G, off)[..., None])[..., 0]
    away = np.where(known[..., None], xy[:, None] - position, 0.0)
    distance = np.sqrt(np.sum(away**2, axis=-1) + rise2)
    return np.where(known, distance - value, 0.0)
