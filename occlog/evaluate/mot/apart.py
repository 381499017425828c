"""Errors of whole tracks beside those of whom the tracks are on at each time, where these are far apart."""

from __future__ import annotations

import math
from collections.abc import Mapping

APART = 2.0
"""Ratio of the two RMSE from which on a user must know what each is of."""
MOST = 0.5
"""Share of the true positions that must be met for the errors of pairs to tell of the tracks."""


def errors_apart(metrics: Mapping[str, float], unit: str) -> bool:
    """Whether errors of whole tracks are more than `APART` times those of whom the tracks are on at each time."""
    whole, pairs = metrics.get(f"rmse_{unit}", math.nan), metrics.get(f"pairs_rmse_{unit}", math.nan)
    return whole > APART * pairs


def line_of_errors_apart(metrics: Mapping[str, float], unit: str, match: str) -> tuple[str, ...]:
    """A line on which of the two errors to read where they are far apart.

    Args:
        metrics: all figures.
        unit: of lengths.
        match: how each track was paired with one target.
    """
    if not errors_apart(metrics, unit):
        return ()
    met = metrics["recall"]
    read = (
        f"{met:.0%} of the true positions are met: read the pairs for errors and NEES, and IDF1 and identity switches "
        f"({metrics['id_switches']:.0f}) for tracks that change people"
        if met >= MOST
        else f"only {met:.0%} of the true positions are met: read the first"
    )
    return (
        f"the RMSE of {metrics[f'rmse_{unit}']:.3g} {unit} holds each track to one target for all its time (match "
        f"{match}), the RMSE of the pairs, {metrics[f'pairs_rmse_{unit}']:.3g} {unit}, to whom it is on at each time; "
        f"{read}",
    )
