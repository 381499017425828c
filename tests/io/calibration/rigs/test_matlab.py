"""MATLAB files: what SciPy reads of good ones, and an error that is known for every damage."""

from __future__ import annotations

import io
import struct
import zlib
from typing import Any

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from occlog.io.formats.calibration.readers.arrays import read_matlab

LIMIT = 1_000_000
VALUES = {
    "P": np.linspace(-1.0, 2.0, 60).reshape(3, 4, 5),
    "K": np.eye(3, dtype=np.float32)[:, ::-1],
    "size": np.array([[640, 480]], np.int16),
    "small": np.arange(3, dtype=np.uint8),
    "large": np.array([2**40]),
    "empty": np.zeros((0, 3)),
    "text": "three",
    "complex": np.array([1 + 2j]),
    "record": {"a": 1},
    "cells": np.array([1, "a"], object),
}
OLD = {name: VALUES[name] for name in ("K", "size", "text", "complex")}


def saved(values: dict[str, Any], **options: Any) -> bytes:
    file = io.BytesIO()
    savemat(file, values, **options)
    return file.getvalue()


FILES = [saved(VALUES), saved(VALUES, do_compression=True), saved(OLD, format="4")]


@pytest.mark.parametrize("content", FILES, ids=["plain", "compressed", "version 4"])
def test_numbers_are_those_that_scipy_reads_and_the_rest_is_none(content: bytes) -> None:
    wanted = {key: value for key, value in loadmat(io.BytesIO(content)).items() if not key.startswith("__")}
    found = read_matlab(content, LIMIT)
    assert found.keys() == wanted.keys()
    for name, value in wanted.items():
        given = found[name]
        assert (given is not None) == (value.dtype.kind in "fiu")
        if given is not None:
            np.testing.assert_array_equal(given, value)


def test_numbers_of_the_other_order_of_bytes_are_read() -> None:
    def element(kind: int, data: bytes) -> bytes:
        return struct.pack(">II", kind, len(data)) + data + bytes(-len(data) % 8)

    parts = element(6, struct.pack(">II", 6, 0)) + element(5, struct.pack(">ii", 1, 2)) + element(1, b"t")
    content = b"MATLAB 5.0".ljust(124) + b"\1\0MI" + element(14, parts + element(9, struct.pack(">dd", 1.5, -2.0)))
    (values,) = read_matlab(content, LIMIT).values()
    np.testing.assert_array_equal(values, [[1.5, -2.0]])


@pytest.mark.parametrize("content", FILES, ids=["plain", "compressed", "version 4"])
def test_damage_ends_in_an_error_that_is_known(content: bytes) -> None:
    rng, refused = np.random.default_rng(5), 0
    for _ in range(300):
        data = bytearray(content)
        for at in rng.integers(0, len(data), 3):
            data[at] = rng.integers(256)
        cut = bytes(data[: rng.integers(1, len(data))]) if rng.random() < 0.3 else bytes(data)
        try:
            read_matlab(cut, LIMIT)
        except (ValueError, struct.error, zlib.error):
            refused += 1
    assert refused > 50


def test_what_unpacks_to_more_than_the_limit_is_refused() -> None:
    content = saved({"P": np.zeros(LIMIT)}, do_compression=True)
    with pytest.raises(ValueError, match=f"unpacks to more than {LIMIT} bytes"):
        read_matlab(content, LIMIT)
