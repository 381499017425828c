"""Metrics: tracks and truth in, figures out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, NamedTuple, Protocol

from occlog.records.tables import Errors, Tracks, Truth
from occlog.settings import Settings


class Compared(NamedTuple):
    """Tracks on the ground and what they are compared with.

    Attributes:
        tracks: rows in the order of time.
        truth: likewise; `role` tells targets from occluders.
        errors: of each estimate that has a truth at its time, paired as `occlog evaluate` pairs them.
        length_unit: of all lengths.
    """

    tracks: Tracks
    truth: Truth
    errors: Errors
    length_unit: str


class Metric(Protocol):
    """A metric (group `occlog.metrics`).  It changes nothing that it is given, and writes nothing."""

    summary: ClassVar[str]  # one line for --help
    settings: ClassVar[type[Settings]]
    units: ClassVar[Mapping[str, str]]  # unit of each figure by its name: `length`, `s`, `1`, ...

    def __init__(self, settings: Settings) -> None:
        """Nothing has been compared yet."""

    def figures(self, compared: Compared) -> Mapping[str, float]:
        """Give all figures by their names; NaN: there is nothing to compute it from."""
