"""Random tables of every kind that pass their own checks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from occlog.records.columns import ANY_WIDTH
from occlog.records.declared.people import KINDS, MAX_BINS, OTHER, AppearanceMatches, Events, Gallery
from occlog.records.declared.sensors import Measurements
from occlog.records.declared.views import COUNTERPARTS, EVENTS, Failures, ViewTracks
from occlog.records.declared.world import PATH_STATES, RobotPath
from occlog.records.tables import Hulls, Occluders, Positions, Tracks

WORDS = {
    (ViewTracks, "lifecycle"): EVENTS,
    (ViewTracks, "counterpart"): COUNTERPARTS,
    (Failures, "kind"): ["position", "label"],
    (Events, "kind"): KINDS,
    (RobotPath, "state"): PATH_STATES,
    (AppearanceMatches, "decision"): [OTHER],
    (AppearanceMatches, "reason"): [""],
    (Measurements, "sensor"): ["north", "east"],
    (Measurements, "reference"): ["west"],
}


def words(table: type, column: str) -> Sequence[str]:
    """Words that a column may hold."""
    for (owner, name), known in WORDS.items():
        if name == column and issubclass(table, owner):
            return known
    return ["target", "occluder"]


def random_table(table: type, rows: int, seed: int = 0):
    """A table of that type that passes its own checks, with NaN where it is declared."""
    rng = np.random.default_rng(seed)
    values = {}
    for c in table.columns():
        if c.kind == "U":
            values[c.name] = rng.choice(words(table, c.name), rows)
        elif c.kind == "?":
            values[c.name] = np.ones(rows, bool)
        elif c.kind in ("i8", "i4"):
            values[c.name] = rng.integers(0, 99, rows)
        elif c.width == ANY_WIDTH:
            values[c.name] = rng.normal(size=(rows, 3)).astype(np.float32)
        elif c.width:
            values[c.name] = np.full((rows, c.width), np.nan)
        else:
            values[c.name] = rng.uniform(0.1, 1.0, rows)
    values["t_ns"] = 1_700_000_000_000_000_789 + np.cumsum(rng.integers(0, 10**9, rows))
    if issubclass(table, Tracks | Occluders | Positions):
        values["cov_xy"] = np.zeros(rows)
    if table is Hulls and rows % 4 == 0:
        values["t_ns"], values["occluder_id"] = np.repeat(values["t_ns"][::4], 4), np.zeros(rows, np.int32)
        values["corner"] = np.arange(rows, dtype=np.int32) % 4
    elif table is Hulls:
        values |= {"occluder_id": np.full(rows, -1), "corner": np.zeros(rows, np.int32)}
        values |= {"x": np.full(rows, np.nan), "y": np.full(rows, np.nan)}
    if table is Gallery:
        values |= {name: np.full(rows, 5) for name in ("angles", "bins")}
        values |= {"target_id": np.arange(rows), "angle": np.arange(rows) % 5 + 1}
        values |= {"samples": values["samples"] + 1, "pixels": values["pixels"] + 1}
        values["density"] = np.zeros((rows, MAX_BINS)) + (np.arange(MAX_BINS) < 5) / 5
    return table.of(**values)
