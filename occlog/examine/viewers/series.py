"""Numbers over time as messages of protobuf, which every viewer plots: a field for each column of numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from occlog.records.columns import Table

LEFT_OUT = ("t_ns", "target_id")
NUMBERS = ("i8", "i4", "f8", "f4", "?")


@dataclass(frozen=True)
class Series:
    """Messages `occlog.NAME` with fields of type double.

    Attributes:
        name: of the message, within the package `occlog`.
        fields: their names, in the order of their numbers.
    """

    name: str
    fields: Sequence[str]

    @classmethod
    def of_table(cls, table: type[Table]) -> Series:
        """The columns of numbers of a table, under its name; time and identity are told otherwise."""
        names = [c.name for c in table.columns() if c.kind in NUMBERS and not c.width and c.name not in LEFT_OUT]
        return cls(table.NAME.capitalize(), names)

    @property
    def schema(self) -> str:
        """Full name of the message."""
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
        """The set of descriptors as MCAP wants it for schemas of protobuf."""
        found = descriptor_pb2.FileDescriptorSet(file=[self._file])
        data: bytes = found.SerializeToString(deterministic=True)
        return data

    def message(self, values: Sequence[float]) -> bytes:
        """The bytes of one message; a value that is not known is NaN."""
        message = self._class(**dict(zip(self.fields, values, strict=True)))
        data: bytes = message.SerializeToString(deterministic=True)
        return data
