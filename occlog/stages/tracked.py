"""What tracking gives out, chunk by chunk."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, NamedTuple

from ..errors import UsageError
from ..records import Calibration, Cooperation, Diagnostics, Tracks


class Solve(NamedTuple):
    """One search of a batch method."""

    target: int
    iterations: int
    converged: bool


class Tracked(NamedTuple):
    """Some more rows of a track and how the filter fared, equal in number, and what it learned of the sensors."""

    tracks: Tracks
    diagnostics: Diagnostics
    calibration: Calibration  # rows of every sensor and scan; none if it is not estimated
    solves: tuple[Solve, ...] = ()  # of a batch method
    cooperation: Cooperation | None = None  # of a method that asks cameras
    offered: int = 0  # frames that it could have asked for


def check_start(config: Any, target: int, others: Collection[int]) -> None:
    """UsageError where there is a start for one more target than one."""
    if others and getattr(config, "start", None) is not None:
        raise UsageError(
            f"--start says where one target is, but there is target {target} besides "
            f"{', '.join(str(k) for k in sorted(others))}; choose one, e.g. --target {target}"
        )
