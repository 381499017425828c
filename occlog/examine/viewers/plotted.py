"""The main number of each table as the message of ROS 2 that Rerun plots by itself, which has numbers without names."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence

from .series import Series

SCHEMA = "std_msgs/msg/Float64MultiArray"
DEFINITION = """\
std_msgs/MultiArrayLayout layout
float64[] data
================================================================================
MSG: std_msgs/MultiArrayLayout
std_msgs/MultiArrayDimension[] dim
uint32 data_offset
================================================================================
MSG: std_msgs/MultiArrayDimension
string label
uint32 size
uint32 stride
"""
"""The published definition, without its comments."""
MAIN: dict[str, Sequence[tuple[str, ...]]] = {
    "Errors": [("error",)],
    "Diagnostics": [("ess",), ("n_seen",)],
    "Bound": [("bound",)],
    "Tracks": [("x", "y")],
}
"""Columns by the name of their message; the second choice is for methods that have nothing of the first."""
LITTLE_ENDIAN = b"\x00\x01\x00\x00"
"""First bytes of a message in CDR."""


def main_columns(series: Series, values: Sequence[float]) -> tuple[str, ...]:
    """The first choice of columns of which the values of a row are known; the very first where none are."""
    known, choices = dict(zip(series.fields, values, strict=True)), MAIN[series.name]
    return next((names for names in choices if not any(math.isnan(known[name]) for name in names)), choices[0])


def main_numbers(series: Series, names: Sequence[str], values: Sequence[float]) -> bytes:
    """The bytes of a `std_msgs/msg/Float64MultiArray` in CDR; the label of its dimension names the columns.

    Args:
        series: one of those in `MAIN`.
        names: of the columns that are taken, the same for all messages of a topic: lines have no names of their own.
        values: of all its fields; NaN: not known.
    """
    known = dict(zip(series.fields, values, strict=True))
    label = ",".join(names).encode() + b"\x00"
    count = len(names)
    body = struct.pack("<II", 1, len(label)) + label
    body += bytes(-len(body) % 4) + struct.pack("<IIII", count, count, 0, count)
    body += bytes(-len(body) % 8) + struct.pack(f"<{count}d", *(known[name] for name in names))
    return LITTLE_ENDIAN + body
