"""Known differences of clocks from UTC, by which an offset between two sensors or tables is explained."""

from __future__ import annotations

MAX_CLOCK_ERROR_S = 0.6
"""Largest distance of an offset from a known one [s]."""
CLOCKS = (
    ("TAI", 37.0, 37.0),
    ("leap seconds of GPS", 18.0, 18.0),
    ("GPS time", 315_964_782.0, 315_964_800.0),
    ("GPS weeks from 0 again", 619_315_200.0, 619_315_200.0),
    ("times since 2001, as of macOS", 978_307_200.0, 978_307_200.0),
    ("times since 1904, as of LabVIEW", 2_082_844_800.0, 2_082_844_800.0),
    ("times since 1900, as of NTP", 2_208_988_800.0, 2_208_988_800.0),
    ("times since 1601, as of Windows", 11_644_473_600.0, 11_644_473_600.0),
    ("times since year 1, as of .NET", 62_135_596_800.0, 62_135_596_800.0),
)
"""Clocks, and by how much they differ from UTC [s]; the leap seconds are those since 2017."""
ZONE_S, MAX_ZONES, MIN_EPOCH_S = 900.0, 56, 3e7
"""Step and number of time zones; a larger difference [s] than the last is that of an origin."""


def cause_of(offset_s: float, slack_s: float = MAX_CLOCK_ERROR_S) -> str:
    """What sets clocks apart by an offset, in brackets after a space; empty: no known cause.

    Args:
        offset_s: of one clock against the other [s].
        slack_s: how far the offset may be from a known one [s].
    """
    for cause, low, high in CLOCKS:
        if low - slack_s <= abs(offset_s) <= high + slack_s:
            return f" ({cause})"
    quarters = offset_s / ZONE_S
    if 1.0 <= abs(quarters) <= MAX_ZONES and abs(offset_s - round(quarters) * ZONE_S) <= slack_s:
        return " (a time zone)"
    return " (times since a start)" if abs(offset_s) > MIN_EPOCH_S else ""
