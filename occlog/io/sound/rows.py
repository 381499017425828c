"""Directions of arrival on their way from a log to the table, before their convention is changed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints, Strings


@dataclass(frozen=True)
class DoaOptions:
    """What a log does not say itself.

    Attributes:
        format: a key of `occlog.io.sound.directions.FORMATS`, or `auto`.
        sensor: array of a log that does not name one.
        unit: `deg` or `rad`, for columns whose name does not say; None: not given.
        convention: `math`, `compass` or `array`; None: the format's own.
        algorithm: which algorithm's estimates to take (frida).
        start_ns: time of the origin of a log without absolute times.
        ignore_extra: skip unknown columns instead of refusing them.
    """

    format: str = "auto"
    sensor: str | None = None
    unit: str | None = None
    convention: str | None = None
    algorithm: str | None = None
    start_ns: int = 0
    ignore_extra: bool = False


class DoaRows(NamedTuple):
    """Rows of a log; angles in radians, in the log's own convention."""

    line: Ints
    t_ns: Ints
    sensor: Strings
    source_id: Ints
    azimuth: Floats
    elevation: Floats
    sigma_azimuth: Floats
    sigma_elevation: Floats
    confidence: Floats


def azimuths_only(line: Ints, t_ns: Ints, sensor: Strings, azimuth: Floats) -> DoaRows:
    """Rows of a log that gives nothing but azimuths."""
    unknown = np.full(len(line), np.nan)
    nobody = np.full(len(line), -1, dtype=np.int64)
    return DoaRows(line, t_ns, sensor, nobody, azimuth, unknown, unknown, unknown, unknown)
