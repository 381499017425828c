"""Matches of points in two views, from a text table."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from occlog.io.files.texts.formats import RAW, Column, Format, read_format
from occlog.records.view_pairs import Matches

POINTS = ("xa_px", "ya_px", "xb_px", "yb_px")
FORMAT = Format(
    "a table of matches of two views",
    {name: Column((name,), RAW) for name in ("sensor_a", "sensor_b")} | {name: Column((name,)) for name in POINTS},
)


def read_matches(path: Path) -> tuple[Matches, ...]:
    """The matches of each pair of views, in the order in which pairs first come; either order of a pair is one."""
    names: list[tuple[str, str]] = []
    points: dict[tuple[str, str], list[np.ndarray]] = {}
    lines: dict[tuple[str, str], list[int]] = {}
    for part in read_format(path, FORMAT):
        rows, values = part.rows, np.column_stack([part[name] for name in POINTS])
        for n, pair in enumerate(zip(part["sensor_a"].tolist(), part["sensor_b"].tolist(), strict=True)):
            if pair[0] == pair[1] or not all(pair):
                raise rows.fail(n, f"sensor_a {pair[0]!r} and sensor_b {pair[1]!r} must name two cameras")
            turned = pair[::-1] in points
            key = pair[::-1] if turned else pair
            if key not in points:
                names.append(key)
            points.setdefault(key, []).append(np.roll(values[n], 2) if turned else values[n])
            lines.setdefault(key, []).append(int(rows.lines[n]))
    return tuple(_matches(path, pair, np.array(points[pair]), lines[pair]) for pair in names)


def _matches(path: Path, pair: tuple[str, str], values: np.ndarray, lines: list[int]) -> Matches:
    where = f"{path}: lines {lines[0]} to {lines[-1]}: {pair[0]} and {pair[1]}"
    return Matches(*pair, values[:, :2], values[:, 2:], where)
