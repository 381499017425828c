"""The first figures of an evaluation of tracks whose identities are the tracker's own, not those of the truth.

One-to-one pairs over the whole run count every identity switch as an error of position.  The figures that say how good
such tracks are come first: HOTA, IDF1, MOTA, identity switches, and RMSE and NEES of the pairs of each frame.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

OWN = "tracks_own_identities"
"""Figure that is 1 where tracks have identities of their own and several tracks or targets were compared."""
APART = 2.0
"""Ratio of the RMSE of whole tracks to that of the pairs of each frame from which on a note says what each is of."""
MOST = 0.5
"""Share of the true positions that must be met for the errors of pairs to describe the tracks."""


def own_identities(metrics: Mapping[str, object]) -> bool:
    """Whether the figures are of tracks with identities of their own, so that those of the pairs come first."""
    return metrics.get(OWN) == 1.0


def first_of(metrics: Mapping[str, object]) -> dict[str, object]:
    """The first figures alone, in whatever unit of lengths."""
    begin = "pairs_rmse_"
    unit = next((name.removeprefix(begin) for name in metrics if name.startswith(begin)), "")
    return {name: metrics[name] for name in names(unit) if name in metrics}


def names(unit: str) -> tuple[str, ...]:
    """Names of the first figures."""
    pairs = (f"pairs_rmse_{unit}", "pairs_nees_mean", "pairs_nees_share_95", f"pairs_gate_{unit}")
    return ("hota", "idf1", "mota", "id_switches", *pairs)


def first(metrics: Mapping[str, float], unit: str) -> dict[str, float]:
    """All figures, those of tracks with identities of their own in the order of `names`, then the others."""
    return {name: metrics[name] for name in names(unit) if name in metrics} | dict(metrics)


def errors_apart(metrics: Mapping[str, float], unit: str) -> bool:
    """Whether errors of whole tracks are more than `APART` times those of the pairs of each frame."""
    whole, pairs = metrics.get(f"rmse_{unit}", math.nan), metrics.get(f"pairs_rmse_{unit}", math.nan)
    return whole > APART * pairs


def notes(metrics: Mapping[str, float], unit: str, match: str) -> tuple[str, ...]:
    """A line on which of two errors to read where they are far apart.

    Args:
        metrics: all figures.
        unit: of lengths.
        match: how each track was paired with one target.
    """
    if not errors_apart(metrics, unit):
        return ()
    whole, pairs = metrics[f"rmse_{unit}"], metrics[f"pairs_rmse_{unit}"]
    if own_identities(metrics):
        gate = metrics[f"pairs_gate_{unit}"]
        return (
            f"RMSE {pairs:.3g} {unit} with matching per frame ({gate:g} {unit} gate); {whole:.3g} {unit} with "
            "one-to-one matching over the whole run, which counts identity switches as errors",
        )
    met = metrics["recall"]
    read = (
        f"{met:.0%} of the true positions are met: read the pairs for errors and NEES, and IDF1 and identity switches "
        f"({metrics['id_switches']:.0f}) for tracks that change people"
        if met >= MOST
        else f"only {met:.0%} of the true positions are met: read the first"
    )
    return (
        f"the RMSE of {whole:.3g} {unit} holds each track to one target for all its time (match {match}), the RMSE of "
        f"the pairs, {pairs:.3g} {unit}, to whom it is on at each time; {read}",
    )
