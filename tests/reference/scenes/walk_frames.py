"""Somebody who walks past three stations, as a user has it: DataFrames of pandas with units in the names of columns."""

from __future__ import annotations

import numpy as np
import pandas as pd

STATIONS = {"north": (0.0, 40.0), "east": (45.0, -5.0), "west": (-40.0, 0.0)}
TIMES_S = np.arange(0.0, 20.0, 0.5)


def stations_frame() -> pd.DataFrame:
    """Name, x, y [m]."""
    return pd.DataFrame([(name, x, y) for name, (x, y) in STATIONS.items()], columns=["name", "x", "y"])


def truth_frame() -> pd.DataFrame:
    """Time [s], identity, x, y [m]."""
    return pd.DataFrame({"time": TIMES_S, "id": 7, "x": -10 + 0.5 * TIMES_S, "y": 5 + 0.1 * TIMES_S})


def bearings_frame() -> pd.DataFrame:
    """Five columns: time [s], station, id, bearing and its standard deviation [degrees]; errors of one degree."""
    rng, truth = np.random.default_rng(3), truth_frame()
    parts = []
    for name, (x, y) in STATIONS.items():
        bearing = np.degrees(np.arctan2(truth.y - y, truth.x - x)) + rng.normal(0.0, 1.0, len(truth))
        parts.append(
            pd.DataFrame(
                {"time": truth.time, "station": name, "id": 7, "bearing_deg": bearing, "sigma_deg": np.ones(len(truth))}
            )
        )
    return pd.concat(parts, ignore_index=True)
