"""Messages between the main process and the one that runs a network: length, JSON header, and raw arrays.

The main process does not trust the other one: types and sizes are checked.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

Feeds = Mapping[str, NDArray[np.generic]]
"""Inputs of a network by name."""

LONGEST = 2**20
"""Bytes of the JSON of a message."""
_LENGTH = struct.Struct(">I")


def send(pipe: IO[bytes], header: Mapping[str, Any], arrays: Feeds) -> None:
    """Write a message of a header (JSON) and named arrays to a pipe.

    Raises:
        OSError: the receiver has closed.
    """
    listed = [[name, values.dtype.str, values.shape] for name, values in arrays.items()]
    text = json.dumps({**header, "arrays": listed}).encode()
    pipe.write(_LENGTH.pack(len(text)) + text)
    for values in arrays.values():
        pipe.write(np.ascontiguousarray(values).reshape(-1).view(np.uint8).data)
    pipe.flush()


def receive(pipe: IO[bytes], most: float = math.inf) -> tuple[dict[str, Any], dict[str, NDArray[np.generic]]]:
    """Read a message, with checks of types and sizes.

    Args:
        pipe: pipe to read from.
        most: maximum number of bytes of its arrays.

    Returns:
        Its header, and its writable arrays by name.

    Raises:
        EOFError: the other process has ended.
        ValueError: the data are no message, or too large.
    """
    (length,) = _LENGTH.unpack(_whole(pipe, bytearray(_LENGTH.size)))
    if length > LONGEST:
        raise ValueError(f"a message of {length} bytes")
    text = _whole(pipe, bytearray(length))
    arrays: dict[str, NDArray[np.generic]] = {}
    try:
        header = json.loads(text)
        listed = [
            (str(name), np.dtype(str(kind)), tuple(map(int, shape))) for name, kind, shape in header.pop("arrays")
        ]
    except (AttributeError, KeyError, TypeError, RecursionError) as error:
        raise ValueError("no message") from error
    for name, dtype, shape in listed:
        size = math.prod(shape) * dtype.itemsize
        most -= size
        if dtype.kind not in "fiub" or min(shape, default=0) < 0 or most < 0:
            raise ValueError(f"an array of {dtype} {shape}")
        arrays[name] = np.frombuffer(_whole(pipe, bytearray(size)), dtype).reshape(shape)
    return header, arrays


def _whole(pipe: IO[bytes], buffer: bytearray) -> bytearray:
    """Fill the buffer from the pipe; EOFError if there is not enough data."""
    if pipe.readinto(buffer) < len(buffer):  # type: ignore[attr-defined]
        raise EOFError
    return buffer
