"""Measurements of distances of the targets of the truth, as the bound takes them, while they stream by."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from occlog.records.declared.measurements import Measurements
from occlog.records.scene import Scene
from occlog.scans.config import MeasuredConfig
from occlog.scans.impossible import Differences
from occlog.scans.measured import Radio, make_stations, pack, with_strengths
from occlog.scans.shadowing import LastReads

from .information import Measured


class DistancesOfTargets:
    """Packs measurements of those identities that are of targets."""

    def __init__(self, labels: Mapping[int, int], scene: Scene, config: MeasuredConfig, radio: Radio | None) -> None:
        """No measurements yet.

        Args:
            labels: identity in the measurements to identity in the truth; rows of other identities are left out.
            scene: the stations.
            config: what the measurements do not say.
            radio: a fitted path loss; None: as the scene and the settings say.
        """
        self._labels, self._config, self._radio = labels, config, radio
        self._stations = make_stations(scene, config, radio)
        self._last: LastReads = {}
        self._differences = Differences()

    def add(self, rows: Measurements) -> Measured:
        """Some more rows, with all of each time, in the order of time.

        Raises:
            InputError: as `pack`.
        """
        own = rows.take(np.isin(rows.target_id, list(self._labels)))
        own = with_strengths(own, self._config, self._radio, self._last)
        row, found = pack(own, self._stations, self._config, self._radio, self._differences)
        target = np.array([self._labels[k] for k in own.target_id[row].tolist()], dtype=np.int64)
        return Measured(own.t_ns[row], target, found)

    def finish(self) -> None:
        """Say that all rows came.

        Raises:
            InputError: most differences are longer than their stations are apart.
        """
        self._differences.refuse()
