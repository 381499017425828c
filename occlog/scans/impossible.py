"""Measurements of distances that cannot be: negative ranges, too strong signals, too long differences, copies."""

from __future__ import annotations

import numpy as np

from occlog.array_types import Ints
from occlog.errors import InputError
from occlog.filtering.likelihood.distances import DIFFERENCE, LOGARITHM, RANGE, Distances
from occlog.records.declared.measurements import Measurements

BELOW = 5.0
"""Standard deviations by which noise may bring a range below 0, or a difference beyond the distance of its stations."""
STRONGEST_DBM = 20.0
"""Nothing that is received is stronger."""
FEWEST, MOST = 5, 0.5
"""Fewest differences that tell, and the share of them that may be beyond their stations: single ones are false."""


class Differences:
    """Counts differences that are longer than their stations are apart, while measurements come by."""

    def __init__(self) -> None:
        """None yet."""
        self._all = self._beyond = 0
        self._first = ""

    def add(self, table: Measurements, row: Ints, packed: Distances) -> None:
        """Some more measurements; see `refuse_impossible`."""
        differs = packed.kind == DIFFERENCE
        rise = np.sqrt(packed.rise2) + np.sqrt(packed.other_rise2)
        apart = np.hypot(*(packed.place - packed.other).T) + rise
        beyond = np.flatnonzero(differs & (np.abs(packed.value) > apart + BELOW * packed.sigma))
        if len(beyond) and not self._beyond:
            n = int(beyond[0])
            where = _where(table, int(row[n]))
            self._first = f"that {where} is {packed.value[n]:.4g}, and these are {apart[n]:.4g} apart"
        self._all, self._beyond = self._all + int(np.count_nonzero(differs)), self._beyond + len(beyond)

    def refuse(self) -> None:
        """InputError where these are too many."""
        if self._all >= FEWEST and self._beyond > MOST * self._all:
            raise InputError(
                f"measurements: {self._beyond} of {self._all} differences are longer than their stations are apart: "
                f"{self._first}; check the unit of times, propagation, and the unit of the stations"
            )


def _where(table: Measurements, n: int) -> str:
    return f"of {str(table.sensor[n])!r} at {table.t_ns[n]} ns"


def refuse_impossible(
    table: Measurements, row: Ints, packed: Distances, differences: Differences | None = None
) -> None:
    """InputError, with the station and the time, for measurements from which only a wrong place could come.

    Args:
        table: the measurements, or a part of them that has all of each time.
        row: (m,) rows of the table that the packed measurements are of.
        packed: m measurements.
        differences: counts those of a part, for whoever has all parts to refuse them; None: this is the whole.
    """
    with np.errstate(invalid="ignore"):
        strong = np.flatnonzero(table.rssi > STRONGEST_DBM)
    if len(strong):
        raise InputError(
            f"measurements: the signal strength {_where(table, int(strong[0]))} is {table.rssi[strong[0]]:g} dBm, and "
            f"received signals are below {STRONGEST_DBM:g}; are signs missing?"
        )
    low = np.flatnonzero((packed.kind == RANGE) & (packed.value < -BELOW * packed.sigma))
    if len(low):
        n = int(low[0])
        raise InputError(
            f"measurements: the range {_where(table, int(row[n]))} is {packed.value[n]:g}, "
            f"{-packed.value[n] / packed.sigma[n]:.0f} standard deviations below 0; a range is a "
            "distance (range_difference is a difference)"
        )
    found = Differences() if differences is None else differences
    found.add(table, row, packed)
    if differences is None:
        found.refuse()
    _refuse_copies(table, row, packed)


def _refuse_copies(table: Measurements, row: Ints, packed: Distances) -> None:
    """InputError for a range or difference that is there twice: it would count as two that agree."""
    exact = np.flatnonzero(packed.kind != LOGARITHM)  # of whole dBm two may well be alike
    own = row[exact]
    keys = (table.t_ns[own], packed.station[exact], table.target_id[own], packed.kind[exact], packed.value[exact])
    keys = (*keys, *packed.other[exact].T)
    order = np.lexsort(keys)
    same = np.ones(max(len(order) - 1, 0), dtype=np.bool_)
    for key in keys:
        same &= key[order][1:] == key[order][:-1]
    if same.any():
        n = int(own[order][1:][same][0])
        raise InputError(
            f"measurements: a value of {str(table.sensor[n])!r} at {table.t_ns[n]} ns is there twice, and would count "
            "as two that agree; remove one of the rows"
        )
