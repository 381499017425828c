"""How bearings agree with the estimates: shares that are not believed, and normalised squared residuals (NIS).

NIS is the sum of squared residuals of bearings, by their probability of being true, over what it is expected to be:
1 if standard deviations are right.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from occlog.core.metrics.consistency import BatchMeans, Ratio
from occlog.core.metrics.errors import ratio
from occlog.records.scene import Camera, Scene
from occlog.records.tables import Residuals, Tracks

from .sight import SURE


@dataclass
class Agreement:
    """How the bearings of one sensor agree with the estimates.

    Attributes:
        bearings: how many were used.
        believed: how many of them are more probably true than false.
        means: squared residuals of those that an estimate does not just go through.
        pose: what is expected of squares that errors of the sensor's pose make, which stay the same.
    """

    bearings: int = 0
    believed: int = 0
    means: BatchMeans = field(default_factory=BatchMeans)
    pose: float = 0.0

    @property
    def doubted(self) -> float:
        """Share of bearings that are not believed; NaN without any."""
        return 1.0 - ratio(self.believed, self.bearings)

    @property
    def nis(self) -> Ratio:
        """Normalised squared residual, with an error that knows of the pose's errors, one for all times."""
        value, error = self.means.ratio
        share = ratio(self.pose, self.means.expected)
        return Ratio(value, math.hypot(error, math.sqrt(2.0) * share * value) if share > 0.0 else error)


@dataclass
class Agreements:
    """Gathers residuals while they stream by.

    Attributes:
        sensors: agreement of the bearings of each sensor, by its name.
        noise: of each target the largest factor by which its motion's variance exceeds what was stated.
    """

    sensors: dict[str, Agreement] = field(default_factory=dict)
    noise: dict[int, float] = field(default_factory=dict)

    def add(self, part: Residuals, poses: Mapping[str, float] | None = None) -> None:
        """Count some more rows, in the order of time.

        Args:
            part: residuals.
            poses: of each sensor the share of the stated variance that errors of its pose make; None: no share.
        """
        for name in np.unique(part.sensor).tolist():
            own = part.take(part.sensor == name)
            found = self.sensors.setdefault(name, Agreement())
            found.bearings += len(own)
            found.believed += int(np.count_nonzero(own.believed >= 0.5))
            told = own.take(own.expected >= SURE)
            expected = told.believed * told.expected
            found.means.add(told.believed * told.residual**2, expected)
            found.pose += (poses or {}).get(name, 0.0) * float(expected.sum())

    def moves(self, target: int, factor: float) -> None:
        """The variance of a target's motion is so many times what was stated."""
        self.noise[target] = max(self.noise.get(target, 0.0), factor)

    @property
    def bearings(self) -> int:
        """How many bearings were used."""
        return sum(a.bearings for a in self.sensors.values())

    @property
    def doubted(self) -> float:
        """Share of bearings that are not believed; NaN without any."""
        return 1.0 - ratio(sum(a.believed for a in self.sensors.values()), self.bearings)

    @property
    def nis(self) -> Ratio:
        """Normalised squared residual of all bearings; sensors are independent of one another."""
        told = [a for a in self.sensors.values() if a.means.expected > 0.0]
        expected = math.fsum(a.means.expected for a in told)
        if not told:
            return Ratio(math.nan, math.inf)
        value = math.fsum(a.means.squares for a in told) / expected
        return Ratio(value, math.sqrt(math.fsum((a.nis.error * a.means.expected) ** 2 for a in told)) / expected)

    def figures(self) -> dict[str, float | int]:
        """Figures for a summary; none if no bearing was judged."""
        if not self.bearings:
            return {}
        whole = self.nis
        return {
            "bearings": self.bearings,
            "bearings_not_believed": self.bearings - sum(a.believed for a in self.sensors.values()),
            **({"nis": whole.value, "nis_error": whole.error} if math.isfinite(whole.value) else {}),
        }


def pose_shares(tracks: Tracks, scene: Scene) -> dict[str, float]:
    """Of each camera the share of a bearing's variance that errors of its pose make, at the median distance of tracks.

    [Ercan] Eq. 2 on the optical axis: f^2 sigma_yaw^2 + f^2 sigma_position^2 / d^2 of it, beside the reading's.
    """
    out: dict[str, float] = {}
    for c in scene.cameras:
        if not len(tracks) or not (c.sigma_yaw > 0.0 or c.sigma_position > 0.0):
            continue
        out[c.name] = pose_share(c, float(np.median(np.hypot(tracks.x - c.position[0], tracks.y - c.position[1]))))
    return out


def pose_share(camera: Camera, distance: float) -> float:
    """The same of one camera at one distance."""
    pose = float(camera.focal_px[0]) ** 2 * (camera.sigma_yaw**2 + (camera.sigma_position / max(distance, 1e-9)) ** 2)
    return pose / (pose + camera.sigma_read_px**2)
