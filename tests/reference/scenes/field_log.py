"""The field log of an animal's bearings (`telemetr_bearings`), and the fixes that its authors published."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path

NS = 1_000_000_000
FIX = re.compile(r"(\d\d/\d\d/\d\d)\s+(\d\d:\d\d:\d\d)[^\r]*\r\s*(\d{7})\s+(\d{7})")


def logs(folder: Path) -> list[str]:
    """Options of `occlog ingest`."""
    return ["--doa", str(folder / "azimuth.dat"), "--arrays", str(folder / "towers.dat")]


def rounds(folder: Path) -> int:
    """Number of rounds of the log: a line has the bearings of up to three towers at one time."""
    return sum(1 for line in (folder / "azimuth.dat").read_text(encoding="ascii").splitlines() if line.strip())


def published_fixes(folder: Path) -> dict[int, tuple[float, float]]:
    """East and north in whole metres by time [ns]; those that overflowed in print are left out."""
    out = {}
    for day, clock, east, north in FIX.findall((folder / "fixes.dat").read_bytes().decode("latin-1")):
        at = datetime.strptime(f"{day} {clock}", "%m/%d/%y %H:%M:%S").replace(tzinfo=UTC)
        out[round(at.timestamp()) * NS] = (float(east), float(north))
    return out
