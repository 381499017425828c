"""Directions of arrival against true ones: unordered sets, assigned as well as they can be."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from occlog.array_types import Bools, Floats
from occlog.records.tables import Doa


class Pairing(NamedTuple):
    """One set of directions and the true ones of its time."""

    true: int  # number of true directions
    found: int
    errors: Floats  # (k,) estimate minus truth of the pairs [rad], wrapped


def doa_metrics(found: Doa, truth: Doa, gate: float, gap_ns: int) -> dict[str, float]:
    """Figures of all sets, and by the number of true directions; angles in degrees.

    In each set estimates and true directions are paired so that the sum of 1 - cos(error) is
    least: unlike the sum of absolute errors, which many pairings share where an estimate is far
    off, it is least for one pairing, whatever the order of the rows.

    Args:
        found: directions, any number a sensor and time.
        truth: the same; a set is compared with the true set of its sensor that is nearest in time.
        gate: pairs further apart [rad] are a missed and a false direction; their errors count all the same.
        gap_ns: true sets at most this far away in time; others are not compared.
    """
    pairs, without = [], 0
    for sensor in np.unique(np.concatenate([found.sensor, truth.sensor])).tolist():
        own, true = found.take(found.sensor == sensor), truth.take(truth.sensor == sensor)
        for pairing in _sets(own, true, gap_ns):
            if pairing is None:
                without += 1
            else:
                pairs.append(pairing)
    errors = _errors(pairs)
    out = {"doa_sets": len(pairs), "doa_sets_without_truth": without, **_counts(pairs, gate), **_spread(errors, gate)}
    for n in sorted({p.true for p in pairs}):
        some = _errors([p for p in pairs if p.true == n])
        out[f"doa_of_{n}_pairs"] = len(some)
        out |= {f"doa_of_{n}_{name}": value for name, value in _quantiles(some).items()}
    return out


def _sets(found: Doa, truth: Doa, gap_ns: int) -> Iterator[Pairing | None]:
    """The sets of one sensor in the order of time, None for one without truth; then true sets that nothing is near."""
    times = np.unique(truth.t_ns)
    used: Bools = np.zeros(len(times), dtype=np.bool_)
    for t_ns in np.unique(found.t_ns).tolist():
        nearest = int(np.argmin(np.abs(times - t_ns))) if len(times) else -1
        if nearest < 0 or abs(int(times[nearest]) - t_ns) > gap_ns:
            yield None
            continue
        used[nearest] = True
        yield paired(found.azimuth[found.t_ns == t_ns], truth.azimuth[truth.t_ns == times[nearest]])
    for t_ns in times[~used].tolist():
        yield Pairing(int((truth.t_ns == t_ns).sum()), 0, np.empty(0))


def paired(found: Floats, truth: Floats) -> Pairing:
    """The pairing of (n,) estimates with (m,) true azimuths [rad] whose sum of 1 - cos(error) is least."""
    apart = (found[:, None] - truth[None, :] + np.pi) % (2.0 * np.pi) - np.pi
    i, j = linear_sum_assignment(1.0 - np.cos(apart))
    return Pairing(len(truth), len(found), np.asarray(apart[i, j], dtype=np.float64))


def _errors(pairs: list[Pairing]) -> Floats:
    return np.concatenate([p.errors for p in pairs]) if pairs else np.empty(0)


def _counts(pairs: list[Pairing], gate: float) -> dict[str, float]:
    true, found = sum(p.true for p in pairs), sum(p.found for p in pairs)
    hits = int((np.abs(_errors(pairs)) <= gate).sum())
    return {
        "doa_true": true,
        "doa_found": found,
        "doa_hits": hits,
        "doa_missed": true - hits,
        "doa_false": found - hits,
        "doa_recall": hits / true if true else np.nan,
        "doa_precision": hits / found if found else np.nan,
    }


def _spread(errors: Floats, gate: float) -> dict[str, float]:
    near = np.degrees(errors[np.abs(errors) <= gate])
    return {
        **{f"doa_{name}": value for name, value in _quantiles(errors).items()},
        "doa_hits_rms_deg": float(np.sqrt((near**2).mean())) if len(near) else np.nan,
        "doa_hits_bias_deg": float(near.mean()) if len(near) else np.nan,
    }


def _quantiles(errors: Floats) -> dict[str, float]:
    """Of the size of all pairs' errors [deg]."""
    if not len(errors):
        return dict.fromkeys(("error_median_deg", "error_p90_deg", "error_max_deg"), np.nan)
    size = np.degrees(np.abs(errors))
    return {
        "error_median_deg": float(np.median(size)),
        "error_p90_deg": float(np.percentile(size, 90)),
        "error_max_deg": float(size.max()),
    }
