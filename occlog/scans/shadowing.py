"""Standard deviations of signal strengths that do not state their own, where shadowing lasts from one read to the next.

A strength has white noise and shadowing, whose correlation falls as exp(-dt / shadow_s).  Filters take all errors for
white.  The mean of many reads that follow each other by dt has the variance (1 + r) / (1 - r) = coth(dt / 2 shadow_s)
times that of as many independent ones, r = exp(-dt / shadow_s): so much larger is the variance of shadowing that a
read counts with, after dt since the same station last read the same target.  Reads long after another count in full.
"""

from __future__ import annotations

from collections.abc import MutableMapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Floats, Ints
from occlog.core.sight.usual_radio import NOISE_DB, SHADOW_DB, SHADOW_S
from occlog.records.declared.measurements import Measurements

SHORTEST = 1e-3
"""Shares of the time of shadowing below which no time between two reads counts."""


class Shadowing(NamedTuple):
    """Errors of signal strengths."""

    noise_db: float = NOISE_DB  # standard deviation of the white noise
    shadow_db: float = SHADOW_DB  # of the shadowing
    shadow_s: float = SHADOW_S  # time in which it is forgotten, > 0


LastReads = MutableMapping[tuple[str, int], int]
"""Times [ns] of the last strength by station and target."""


def sigmas(shadowing: Shadowing, since_s: Floats) -> Floats:
    """(n,) standard deviations [dB] that reads count with as if errors were white.

    Args:
        shadowing: how errors are.
        since_s: (n,) times since the last read of the same station and target [s]; inf: there was none.
    """
    share = np.maximum(since_s / (2.0 * shadowing.shadow_s), SHORTEST / 2.0)
    return np.asarray(np.sqrt(shadowing.noise_db**2 + shadowing.shadow_db**2 / np.tanh(share)))


def with_sigmas(table: Measurements, shadowing: Shadowing, last: LastReads | None) -> Measurements:
    """The table with a standard deviation for each strength that has none.

    Args:
        table: in the order of time.
        shadowing: how errors are.
        last: last reads of earlier parts of the table; those of this part are put in.  None: every read counts in full.
    """
    own = np.flatnonzero(np.isfinite(table.rssi))
    if not len(own):
        return table
    since = np.full(len(own), np.inf) if last is None else _since(table, own, last)
    sigma = table.sigma_rssi.copy()
    sigma[own] = np.where(np.isfinite(sigma[own]), sigma[own], sigmas(shadowing, since))
    return replace(table, sigma_rssi=sigma)


def _since(table: Measurements, own: Ints, last: LastReads) -> Floats:
    """(n,) times since the last strength of the same station and target [s]; inf: there was none."""
    since = np.full(len(own), np.inf)
    names, station = np.unique(table.sensor[own], return_inverse=True)
    order = np.lexsort((table.t_ns[own], table.target_id[own], station))
    t_ns, key = table.t_ns[own][order], np.column_stack([station, table.target_id[own]])[order]
    fresh = np.append(True, (key[1:] != key[:-1]).any(axis=1))
    since[order[1:]] = np.where(fresh[1:], np.inf, np.diff(t_ns) / NS)
    for k in np.flatnonzero(fresh).tolist():
        earlier = last.get((str(names[key[k, 0]]), int(key[k, 1])))
        since[order[k]] = np.inf if earlier is None else (int(t_ns[k]) - earlier) / NS
    for k in np.flatnonzero(np.append(fresh[1:], True)).tolist():
        last[str(names[key[k, 0]]), int(key[k, 1])] = int(t_ns[k])
    return since
