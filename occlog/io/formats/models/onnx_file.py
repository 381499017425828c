"""Description of an ONNX file: inputs, outputs, metadata, and external weight files.

The Protocol Buffers wire format is parsed by field numbers of `onnx.proto3`; weights are skipped. Since models may be
untrusted, sizes and nesting are limited, and external weights must be in the model's own folder.
"""

from __future__ import annotations

import math
import mmap
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

import numpy as np

from occlog.errors import InputError
from occlog.io.files.limits import check_input

MAX_BYTES = 2 * 1024**3
"""A message of Protocol Buffers is smaller than this."""
MAX_WEIGHTS = 16 * 1024**3
"""Bytes of all files of weights next to a model."""
MAX_FIELDS = 5_000_000
"""Fields of a file that are read; networks have some tens of thousands."""
DEEPEST = 16
"""Graphs in graphs."""
LONGEST = 1024 * 1024
"""Bytes of a name or of a text of the metadata."""
KINDS = {1: "float32", 2: "uint8", 3: "int8", 6: "int32", 7: "int64", 10: "float16", 11: "float64", 16: "bfloat16"}
"""Types of elements by their number in `TensorProto.DataType`."""


BITS = {1: 32, 2: 8, 3: 8, 4: 16, 5: 16, 6: 32, 7: 64, 9: 8, 10: 16, 11: 64, 12: 32, 13: 64, 16: 16}
"""Bits of an element, by ONNX data type; runtimes read as many elements as the dimensions state."""
TYPED = {4: 4, 5: 0, 7: 0, 10: 8, 11: 0}
"""Fields of a tensor with values one by one, instead of their bytes, and the bytes of each; 0: that varies."""
LONGEST_SIDE = 2**31 - 1
"""Dimension of a tensor, at most."""
ABOVE_ZERO = ("strides", "dilations", "kernel_shape", "group", "blocksize", "size", "num_groups")
"""Attributes by which runtimes divide."""


@dataclass(frozen=True)
class Port:
    """Input or output of a neural network: name, element type and shape."""

    name: str
    kind: str  # of its elements, as NumPy calls it; empty: not stated, or none of `KINDS`
    shape: tuple[int | None, ...] | None  # None in it: any; None: not stated


@dataclass(frozen=True)
class OnnxFile:
    """Description of a network file (ONNX): inputs, outputs, metadata, and files with external weights."""

    path: Path
    inputs: tuple[Port, ...]  # without those that have a value in the file
    outputs: tuple[Port, ...]
    metadata: dict[str, str]
    weights: tuple[Path, ...]  # further files that the network is in, without repetition

    @property
    def files(self) -> tuple[Path, ...]:
        """All files of the network, including weights."""
        return (self.path, *self.weights)


def read_onnx(path: Path) -> OnnxFile:
    """Read the description of a neural network from an ONNX file; weights are skipped.

    Raises:
        InputError: the file is not a network, is damaged or too large, or has external weights outside its folder.
    """
    path = check_input(path, "a network (ONNX)")
    size = path.stat().st_size
    if size >= MAX_BYTES:
        raise InputError(
            f"{path}: has {size} bytes; an ONNX file has less than {MAX_BYTES}; it is damaged, or no ONNX file",
            id="input-too-large",
        )
    walk = _OnnxWalk()
    try:
        with path.open("rb") as file:
            # The last view of the bytes closes them.
            walk.model(memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)))
    except _DamageError as error:
        raise InputError(
            f"{path}: not an ONNX model, or damaged ({error}); export it again", id="damaged-file"
        ) from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}", id="unreadable-file") from error
    if not walk.inputs or not walk.outputs:
        raise InputError(
            f"{path}: not an ONNX model: it has no graph with an input and an output; export it again",
            id="unknown-format",
        )
    inputs = tuple(p for p in walk.inputs if p.name not in walk.given)
    return OnnxFile(path, inputs, tuple(walk.outputs), walk.metadata, _beside(path, walk.locations))


def _beside(path: Path, locations: list[str]) -> tuple[Path, ...]:
    """Paths of the external weight files of a model, without duplicates.

    Args:
        path: the model.
        locations: stated paths, relative to its folder.

    Raises:
        InputError: a file is outside of the folder or missing, or all have more than `MAX_WEIGHTS` bytes.
    """
    folder = path.resolve().parent
    found = []
    for location in dict.fromkeys(locations):
        external = folder / location
        # The target of a link counts, not its location.
        try:
            inside = external.resolve().is_relative_to(folder) and not Path(location).is_absolute()
        except (OSError, ValueError):
            inside = False
        if not inside:
            raise InputError(
                f"{path}: weights in {location!r} are outside the model's folder; put them next to "
                "the model and export it again"
            )
        found.append(check_input(external, f"weights of {path.name}"))
    total = sum(each.stat().st_size for each in found)
    if total > MAX_WEIGHTS:
        raise InputError(
            f"{path}: its weights have {total} bytes; at most {MAX_WEIGHTS} are read; give a smaller model",
            id="input-too-large",
        )
    return tuple(found)


class _DamageError(Exception):
    """The bytes are not a valid ONNX message."""


@dataclass
class _OnnxWalk:
    """Parser of an ONNX model that collects its description; field numbers are those of `onnx.proto3`.

    Attributes:
        inputs: inputs of the main graph, also those with a value in the file.
        outputs: outputs of the main graph.
        metadata: texts by key.
        given: names of tensors with values in the file.
        locations: paths of external weights.
        fields: number of fields that were read.
    """

    inputs: list[Port] = field(default_factory=list)
    outputs: list[Port] = field(default_factory=list)
    metadata: dict[str, str] = field(default_factory=dict)
    given: set[str] = field(default_factory=set)
    locations: list[str] = field(default_factory=list)
    fields: int = 0

    def model(self, data: memoryview) -> None:
        """Parse a ModelProto: metadata, and all graphs of the network."""
        for number, value in self._messages(data):
            if number == 7:
                self._graph(value, depth=0, whole=True)
            elif number == 14:
                key, text = self._entry(value)
                self.metadata[key] = text
            elif number == 20:  # TrainingInfoProto: initialization, algorithm
                for part, graph in self._messages(value):
                    if part in (1, 2):
                        self._graph(graph, depth=0)
            elif number == 25:  # FunctionProto
                for part, node in self._messages(value):
                    if part == 7:
                        self._node(node, depth=0)

    def _graph(self, data: memoryview, depth: int, whole: bool = False) -> None:
        """Parse a GraphProto, and all graphs in it; `_DamageError` beyond `DEEPEST` nested graphs.

        Args:
            data: bytes of the message.
            depth: how deeply it is nested.
            whole: it is the main graph, of which inputs and outputs are collected.
        """
        if depth > DEEPEST:
            raise _DamageError(f"graphs in graphs, {DEEPEST} deep")
        for number, value in self._messages(data):
            if number == 1:
                self._node(value, depth)
            elif number == 5:
                self._tensor(value)
            elif number == 15:
                self._sparse(value)
            elif number == 11 and whole:
                self.inputs.append(self._port(value))
            elif number == 12 and whole:
                self.outputs.append(self._port(value))

    def _node(self, data: memoryview, depth: int) -> None:
        """Parse a NodeProto, nested at `depth`; its attributes may hold tensors and graphs.

        `_DamageError` for an attribute of 0 or less by which runtimes divide, such as strides.
        """
        for number, attribute in self._messages(data):
            if number != 5:
                continue
            name, numbers, lists = "", list[int](), list[memoryview]()
            for part, value in self._fields(attribute):
                if isinstance(value, int):
                    numbers += [value] if part in (3, 8) else []
                elif part == 1:
                    name = _text(value)
                elif part == 8:
                    lists.append(value)
                elif part in (5, 10):
                    self._tensor(value)
                elif part in (22, 23):
                    self._sparse(value)
                elif part in (6, 11):
                    self._graph(value, depth + 1)
            if name in ABOVE_ZERO and not all(0 < n < 2**63 for n in chain(numbers, *map(_varints, lists))):
                raise _DamageError(f"{name} of 0 or less")

    def _sparse(self, data: memoryview) -> None:
        """Parse a SparseTensorProto: values and indices."""
        for number, value in self._messages(data):
            if number in (1, 2):
                self._tensor(value)

    def _tensor(self, data: memoryview) -> None:
        """Parse a TensorProto: collect its name and the location of external values.

        `_DamageError` if the number of its values does not fit its dimensions.
        """
        sides: list[int] = []
        kind, name, raw, typed, external = 0, "", 0, 0, False
        for number, value in self._fields(data):
            if isinstance(value, int):
                if number == 1:
                    sides.append(value)
                elif number == 2:
                    kind = value
                elif number == 14:
                    external = value == 1
                typed += number in TYPED
            elif number == 1:
                sides.extend(_varints(value))
            elif number == 8:
                name = _text(value)
                self.given.add(name)
            elif number == 9:
                raw = len(value)
            elif number == 13:
                key, text = self._entry(value)
                if key == "location":
                    self.locations.append(text)
            elif number in TYPED:
                typed += _count(value, TYPED[number])
        if any(side > LONGEST_SIDE for side in sides):
            raise _DamageError(f"weights {name[:40]!r} have a dimension of {max(sides)}, limit {LONGEST_SIDE}")
        wanted = math.prod(sides)
        there = typed if typed else raw * 8 // BITS.get(kind, 1)
        if kind in BITS and not external and there != wanted:
            raise _DamageError(f"weights {name[:40]!r} have {there} values, but a shape of {wanted} values")

    def _entry(self, data: memoryview) -> tuple[str, str]:
        """Parse a StringStringEntryProto (key, value)."""
        found = {number: _text(value) for number, value in self._messages(data) if number in (1, 2)}
        return found.get(1, ""), found.get(2, "")

    def _port(self, data: memoryview) -> Port:
        """Parse a ValueInfoProto of a tensor, an input or output."""
        name, kind, shape = "", 0, None
        for number, value in self._messages(data):
            if number == 1:
                name = _text(value)
            elif number == 2:  # TypeProto
                for part, tensor in self._messages(value):
                    if part == 1:  # TypeProto.Tensor
                        for index, what in self._fields(tensor):
                            if index == 1 and isinstance(what, int):
                                kind = what
                            elif index == 2 and isinstance(what, memoryview):
                                shape = tuple(self._dim(dim) for part, dim in self._messages(what) if part == 1)
        return Port(name, KINDS.get(kind, ""), shape)

    def _dim(self, data: memoryview) -> int | None:
        """Parse a TensorShapeProto.Dimension: a number, or None if symbolic or missing."""
        for number, value in self._fields(data):
            if number == 1 and isinstance(value, int):
                return value if 0 < value < 2**31 else None
        return None

    def _messages(self, data: memoryview) -> Iterator[tuple[int, memoryview]]:
        """Yield (field number, bytes) of the fields with length-delimited bytes: messages, texts or packed arrays."""
        for number, value in self._fields(data):
            if isinstance(value, memoryview):
                yield number, value

    def _fields(self, data: memoryview) -> Iterator[tuple[int, int | memoryview]]:
        """Yield (field number, value) of all fields of a message: an integer, or bytes.

        0 for fixed 32- and 64-bit values. `_DamageError` if the bytes are not a valid message, or the file has more
        than `MAX_FIELDS` fields.
        """
        index, end = 0, len(data)
        while index < end:
            self.fields += 1
            if self.fields > MAX_FIELDS:
                raise _DamageError(f"more than {MAX_FIELDS} fields")
            key, index = _varint(data, index)
            number, wire = key >> 3, key & 7
            if number == 0:
                raise _DamageError("a field has the number 0")
            value: int | memoryview
            if wire == 0:
                value, index = _varint(data, index)
            elif wire == 2:
                length, index = _varint(data, index)
                value, index = data[index : index + length], index + length
            elif wire in (1, 5):
                length = 8 if wire == 1 else 4
                value, index = 0, index + length
            else:
                raise _DamageError(f"wire type {wire}")
            if index > end:
                raise _DamageError("it ends within a field")
            yield number, value


def _varint(data: memoryview, offset: int) -> tuple[int, int]:
    """Decode a variable-length integer of up to 64 bits at `offset`; return it and the offset behind it.

    `_DamageError` if it is longer or cut off.
    """
    value = 0
    for shift in range(0, 70, 7):
        if offset >= len(data):
            raise _DamageError("it ends within a number")
        byte = data[offset]
        offset += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, offset
    raise _DamageError("a number has more than 64 bits")


def _varints(data: memoryview) -> Iterator[int]:
    """Yield the consecutive variable-length integers of `data`."""
    offset = 0
    while offset < len(data):
        value, offset = _varint(data, offset)
        yield value


def _count(data: memoryview, width: int) -> int:
    """Number of packed values in `data` that have `width` bytes each; `width` 0: variable-length integers."""
    return len(data) // width if width else int(np.count_nonzero(np.frombuffer(data, np.uint8) < 0x80))


def _text(data: memoryview) -> str:
    if len(data) > LONGEST:
        raise _DamageError(f"a text of {len(data)} bytes")
    return bytes(data).decode("utf-8", "replace")
