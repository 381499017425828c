"""Arrow files whose offsets lead out of their buffers: refused in one line; the library itself reads on, or crashes."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from apart import check_apart

from occlog.errors import ExitCode

Change = tuple[bytes, bytes]
"""Bytes of a good file, and what they become."""
ROWS = 100
FAR = 1 << 30


def texts() -> pa.Array:
    return pa.array(["a"] * ROWS)


def offsets(at: int, value: int) -> Change:
    """What the offsets of `texts` become where one of them has a value."""
    good = np.arange(ROWS + 1, dtype=np.int32)
    bad = good.copy()
    bad[at] = value
    return (good.tobytes(), bad.tobytes())


def named() -> pa.Array:
    places = np.arange(ROWS, dtype=np.int32) % 2
    return pa.DictionaryArray.from_arrays(pa.array(places), pa.array(["a", "b"]))


def places(value: int) -> Change:
    good = np.arange(ROWS, dtype=np.int32) % 2
    bad = good.copy()
    bad[7] = value
    return (good.tobytes(), bad.tobytes())


def viewed() -> pa.Array:
    return pa.array(["a" * 20] * ROWS, pa.string_view())


def view(size: int, buffer: int, offset: int) -> Change:
    good = struct.pack("<i4sii", 20, b"aaaa", 0, 60)
    return (good, struct.pack("<i4sii", size, b"aaaa", buffer, offset))


CASES = {
    "last offset": (texts, offsets(-1, FAR)),
    "offset": (texts, offsets(50, FAR)),
    "offset below 0": (texts, offsets(50, -FAR)),
    "place in a dictionary": (named, places(FAR)),
    "place below 0": (named, places(-FAR)),
    "buffer of a view": (viewed, view(20, 77, 0)),
    "offset of a view": (viewed, view(20, 0, FAR)),
    "size of a view": (viewed, view(FAR, 0, 0)),
}


@pytest.mark.parametrize(("make", "change"), CASES.values(), ids=CASES)
def test_offsets_that_lead_out_of_their_buffer_are_damage(
    tmp_path: Path, make: Callable[[], pa.Array], change: Change
) -> None:
    path, out = tmp_path / "a.arrow", tmp_path / "a.csv"
    table = pa.table({"t_ns": np.arange(ROWS), "sensor": make(), "azimuth_rad": np.zeros(ROWS)})
    with pa.ipc.new_file(path, table.schema) as writer:
        writer.write_table(table)
    data = path.read_bytes()
    good, bad = change
    assert data.count(good) == 1
    path.write_bytes(data.replace(good, bad))
    outcome = check_apart("export", path, "-o", out)
    assert outcome.code == ExitCode.BAD_INPUT
    assert "damaged or not an Arrow file (In column 1: " in outcome.output
    assert not out.exists()
