"""What to track and how: the value that all drivers take."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from typing import Generic

from occlog.array_types import NS
from occlog.errors import UsageError, abridged, option
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Hulls, Occluders
from occlog.scans.distance_measurements import DistanceMeasurementFeed
from occlog.scans.grouping import BearingRows, Scan, scans_of, sensor_names
from occlog.scans.occluder_priors import OccluderFeed
from occlog.track.interface import Batch, Config, Online, State
from occlog.track.methods.apf.config import SelectConfig


@dataclass(frozen=True)
class TrackingTask(Generic[Config]):
    """Options of a tracking run in addition to the measurements.

    Attributes:
        config: settings of the method.
        seed: seed of all random numbers.
        method: name of the method in `occlog.track.catalogue`.
        sensors: names of the sensors to use; None: all.
        targets: identities of the targets to track; None: all.
        unlabelled: use candidates that are not assigned to a target.
        window_ns: rows at most this far apart form one scan.
        selection: how to select cameras; only selected ones are used.  None: no selection.
        particles: output the particles of the filters, too.
        repair_labels: labels that two targets exchange are exchanged back.
        reject_outliers: give methods that cannot reject false bearings none that contradict their target's motion.
    """

    config: Config
    seed: int
    method: str = "apf"
    sensors: frozenset[str] | None = None
    targets: tuple[int, ...] | None = None
    unlabelled: bool = True
    window_ns: int = 0
    selection: SelectConfig | None = None
    particles: bool = False
    repair_labels: bool = True
    reject_outliers: bool = False

    def rows(self, scene: Scene) -> BearingRows:
        """Return which rows of the bearings are used: by sensor (default: all of the scene), target and label."""
        used = frozenset(sensor_names(scene)) if self.sensors is None else self.sensors
        return BearingRows(used, self.targets, self.unlabelled)

    def scans(
        self, bearings: Iterable[Bearings], scene: Scene, measured: DistanceMeasurementFeed | None
    ) -> Iterator[Scan]:
        """Generate the scans of the used rows of `bearings` in the order of time, grouped by `window_ns`.

        If `measured` is given, its ranges, signal strengths and time differences are joined with them by time.
        """
        scans = scans_of(bearings, scene, self.rows(scene), self.window_ns)
        return scans if measured is None else measured.joined(scans, self.sensors, self.targets, self.window_ns)


def check_start(started: bool, target: int, others: Collection[int]) -> None:
    """Raise UsageError if the settings fix a start position and there is more than one target.

    `started`: they fix one; `target` is the next target, `others` are the targets that began before.
    """
    if started and others:
        raise UsageError(
            f"{option('start')} is the position of one target, but there is target {target} in "
            f"addition to {abridged(sorted(others))}; choose one target, e.g. "
            f"{option('target')} {target}",
            id="ambiguous-input",
        )


def feed_of(
    occluders: Iterable[Occluders] | Iterable[Hulls] | None,
    method: Online[State, Config] | Batch[State, Config],
    tracking: TrackingTask[Config],
) -> OccluderFeed | None:
    """Return the feed of priors of moving occluders for the method; None if there are none.

    Raises:
        UsageError: the method does not use moving occluders.
    """
    if occluders is None:
        return None
    if method.occluders is None:
        raise UsageError(
            f"occluders: method {tracking.method} does not use moving occluders; leave occluders out",
            id="not-applicable",
        )
    terms = method.occluders(tracking.config)
    return OccluderFeed(occluders, terms.diameter, round(terms.max_age_s * NS))
