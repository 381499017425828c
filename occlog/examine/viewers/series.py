"""Numbers over time as protobuf messages for plots: a field per numeric column.

For Rerun, the main numbers as a ROS 2 message without names.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from occlog.records.columns import ColumnTable

LEFT_OUT = ("t_ns", "target_id")
NUMBERS = ("i8", "i4", "f8", "f4", "?")


@dataclass(frozen=True)
class Series:
    """Type of Protobuf messages `occlog.NAME` with fields of type double, for plots over time.

    Attributes:
        name: name of the message, within the package `occlog`.
        fields: names of the fields, in the order of their numbers.
    """

    name: str
    fields: Sequence[str]

    @classmethod
    def of_table(cls, table: type[ColumnTable]) -> Series:
        """Return the type of messages for the numeric columns of a table, except time and identity."""
        names = [c.name for c in table.columns() if c.kind in NUMBERS and not c.width and c.name not in LEFT_OUT]
        return cls(table.NAME.capitalize(), names)

    @property
    def schema(self) -> str:
        """Full name of the Protobuf message: `occlog.NAME`."""
        return f"occlog.{self.name}"

    @cached_property
    def _file(self) -> descriptor_pb2.FileDescriptorProto:
        file = descriptor_pb2.FileDescriptorProto(name=f"occlog/{self.name}.proto", package="occlog", syntax="proto3")
        message = file.message_type.add(name=self.name)
        kind = descriptor_pb2.FieldDescriptorProto
        for number, name in enumerate(self.fields, 1):
            message.field.add(name=name, number=number, type=kind.TYPE_DOUBLE, label=kind.LABEL_OPTIONAL)
        return file

    @cached_property
    def _class(self) -> Any:
        pool = descriptor_pool.DescriptorPool()
        pool.Add(self._file)
        return message_factory.GetMessageClass(pool.FindMessageTypeByName(self.schema))

    @property
    def descriptors(self) -> bytes:
        """Encoded set of Protobuf descriptors, which MCAP stores as the schema of these messages."""
        found = descriptor_pb2.FileDescriptorSet(file=[self._file])
        data: bytes = found.SerializeToString(deterministic=True)
        return data

    def message(self, values: Sequence[float]) -> bytes:
        """Return the values, in the order of `fields`, as an encoded message; unknown ones are NaN."""
        message = self._class(**dict(zip(self.fields, values, strict=True)))
        data: bytes = message.SerializeToString(deterministic=True)
        return data


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
    "Diagnostics": [("ess",), ("n_detected",)],
    "Bound": [("bound",)],
    "Tracks": [("x", "y")],
}
"""Columns by the name of their message; the second choice is for methods that have nothing of the first."""
LITTLE_ENDIAN = b"\x00\x01\x00\x00"
"""First bytes of a message in CDR."""


def main_columns(series: Series, values: Sequence[float]) -> tuple[str, ...]:
    """Return the names of the main columns to plot of a row: the first choice of which all values are known.

    If there is none, the very first choice. `values`: values of all fields of the series, NaN: unknown.
    """
    known, choices = dict(zip(series.fields, values, strict=True)), MAIN[series.name]
    return next((names for names in choices if not any(math.isnan(known[name]) for name in names)), choices[0])


def main_numbers(series: Series, names: Sequence[str], values: Sequence[float]) -> bytes:
    """Return a `std_msgs/msg/Float64MultiArray` in CDR; the label of its dimension lists the columns.

    Args:
        series: one of those in `MAIN`.
        names: columns to store; the same for all messages of a topic, since plotted lines have no names.
        values: values of all fields of the series; NaN: unknown.
    """
    known = dict(zip(series.fields, values, strict=True))
    label = ",".join(names).encode() + b"\x00"
    count = len(names)
    body = struct.pack("<II", 1, len(label)) + label
    body += bytes(-len(body) % 4) + struct.pack("<IIII", count, count, 0, count)
    body += bytes(-len(body) % 8) + struct.pack(f"<{count}d", *(known[name] for name in names))
    return LITTLE_ENDIAN + body
