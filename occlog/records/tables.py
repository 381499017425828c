"""The tables that pass between stages: frozen column records, NumPy only, no file formats.

Each column states its dtype, unit and meaning once.  `occlog.io.files.tables.arrow_columns` and
`occlog.io.recording.reader` derive their schemas from the same declaration, and
`schemas/` publishes them.

Conventions (all tables)
    * `t_ns` is int64 nanoseconds since the Unix epoch; rows are ordered by it.
    * World frame: x, y on the ground, z up, in the scene's length unit (metres unless
      the scene says otherwise).  Angles are radians from +x towards +y in [-pi, pi).
    * Pixels carry `_px`; x to the right, y down, the centre of the first pixel is (0, 0).
    * NaN is allowed only in columns declared with `nan=...`, which says what it means.
"""

from __future__ import annotations

from collections.abc import Collection

from .columns import Table
from .declared.gallery import AppearanceMatches, Gallery
from .declared.measurements import Measurements
from .declared.people import Events, JoinedTracks, PeopleTracks, PeopleViews, Support
from .declared.plans import PlanMap
from .declared.robots import RobotPath
from .declared.sensors import APPEARANCE_BINS, UNLABELLED, Bearings, Boxes, Doa, Reads, TruthBoxes, Views
from .declared.tracks import (
    Bound,
    Calibration,
    Cooperation,
    Diagnostics,
    Errors,
    FusedTracks,
    Particles,
    Residuals,
    TagTracks,
    Tracks,
    VirtualSensors,
)
from .declared.traffic import Delays
from .declared.views import Counts, Failures, ViewTracks
from .declared.world import Hulls, Occluders, Truth

TABLES: dict[str, type[Table]] = {
    table.NAME: table
    for table in (
        Bearings,
        Views,
        Boxes,
        TruthBoxes,
        Doa,
        Reads,
        Measurements,
        Occluders,
        Hulls,
        Truth,
        Tracks,
        Diagnostics,
        Residuals,
        Particles,
        Calibration,
        Errors,
        Bound,
        Cooperation,
        VirtualSensors,
        Delays,
        ViewTracks,
        Failures,
        Counts,
        Support,
        Events,
        Gallery,
        AppearanceMatches,
        RobotPath,
        PlanMap,
    )
}
"""Every table by the name that its files carry."""
WIDER: tuple[type[Table], ...] = (FusedTracks, TagTracks, PeopleTracks, JoinedTracks, PeopleViews)
"""Tables that have the name of another one, and more columns."""


def has_all(table: type[Table]) -> bool:
    """Whether a class asks for all columns of its table: rows of one that asks for some may be alike."""
    return table.NAME in TABLES and issubclass(table, TABLES[table.NAME])


def table_with(name: str, columns: Collection[str]) -> type[Table]:
    """The table of a name that has the most of a file's columns, and of several the one with the fewest others.

    Args:
        name: one of `TABLES`.
        columns: names of the columns in the file.
    """
    told = set(columns)

    def misfit(table: type[Table]) -> tuple[int, int]:
        own = {c.name for c in table.columns()}
        return len(told - own), len(own - told)

    return min((TABLES[name], *(each for each in WIDER if issubclass(each, TABLES[name]))), key=misfit)


__all__ = [
    "APPEARANCE_BINS",
    "TABLES",
    "UNLABELLED",
    "WIDER",
    "AppearanceMatches",
    "Bearings",
    "Bound",
    "Boxes",
    "Calibration",
    "Cooperation",
    "Counts",
    "Delays",
    "Diagnostics",
    "Doa",
    "Errors",
    "Events",
    "Failures",
    "FusedTracks",
    "Gallery",
    "Hulls",
    "JoinedTracks",
    "Measurements",
    "Occluders",
    "Particles",
    "PeopleTracks",
    "PeopleViews",
    "Reads",
    "Residuals",
    "RobotPath",
    "Support",
    "TagTracks",
    "Tracks",
    "Truth",
    "TruthBoxes",
    "ViewTracks",
    "Views",
    "VirtualSensors",
    "has_all",
    "table_with",
]
