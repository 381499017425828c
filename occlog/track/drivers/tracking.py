"""What to track and how: the value that all drivers take."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Generic

from occlog.errors import UsageError
from occlog.measure.scans.grouping import Rows
from occlog.measure.scans.scan import sensor_names
from occlog.records.scene import Scene
from occlog.track.apf.selection_config import SelectConfig
from occlog.track.interface import Config


@dataclass(frozen=True)
class Tracking(Generic[Config]):
    """What to track and how, beside the measurements.

    Attributes:
        config: settings of the method.
        seed: of all random numbers.
        method: its name in `occlog.track.catalogue`.
        sensors: names of those to use; None: all.
        targets: identities of those to track; None: all.
        unlabelled: use candidates that are not assigned to a target.
        window_ns: rows at most this far apart form one scan.
        selection: how to select cameras; only those selected are used.  None: no selection.
    """

    config: Config
    seed: int
    method: str = "apf"
    sensors: frozenset[str] | None = None
    targets: tuple[int, ...] | None = None
    unlabelled: bool = True
    window_ns: int = 0
    selection: SelectConfig | None = None

    def rows(self, scene: Scene) -> Rows:
        """Which rows of the bearings to use."""
        used = frozenset(sensor_names(scene)) if self.sensors is None else self.sensors
        return Rows(used, self.targets, self.unlabelled)


def check_start(started: bool, target: int, others: Collection[int]) -> None:
    """UsageError where the settings have a start, which is that of one target, and there is one more than one."""
    if started and others:
        raise UsageError(
            f"start says where one target is, but there is target {target} besides "
            f"{', '.join(str(k) for k in sorted(others))}; choose one target, e.g. {target}"
        )
