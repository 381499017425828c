"""Records that are put aside come back in blocks, forwards, backwards and replaced, in memory and in a file."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.io.files.spill import Blocks

RECORD = np.dtype([("t_ns", "i8"), ("place", "f8", (2,)), ("seen", "?")])


def some(count: int) -> np.ndarray:
    out = np.zeros(count, dtype=RECORD)
    out["t_ns"] = 2**62 + np.arange(count)
    out["place"] = np.random.default_rng(count).normal(size=(count, 2))
    out["seen"] = np.arange(count) % 3 == 0
    return out


@pytest.mark.parametrize("in_memory", [0, 300, 10**9])
@pytest.mark.parametrize("count", [0, 1, 8, 16, 45])
def test_blocks_hold_what_was_appended_and_can_be_replaced(count: int, in_memory: int) -> None:
    rows, blocks = some(count), Blocks(RECORD, 8, in_memory)
    for start in range(0, count, 5):
        blocks.append(rows[start : start + 5])
    blocks.end()
    assert blocks.count == -(-count // 8)
    for number in reversed(range(blocks.count)):
        again = blocks.get(number).copy()
        np.testing.assert_array_equal(again, rows[8 * number : 8 * number + 8])
        again["seen"] = ~again["seen"]
        blocks.put(number, again)
    for number in range(blocks.count):
        block, own = blocks.get(number), rows[8 * number : 8 * number + 8]
        np.testing.assert_array_equal(block["seen"], ~own["seen"])
        np.testing.assert_array_equal(block["place"], own["place"])


def test_what_is_put_aside_does_not_change_with_its_source() -> None:
    rows, blocks = some(8), Blocks(RECORD, 8)
    blocks.append(rows)
    blocks.end()
    before = rows.copy()
    rows["t_ns"] = 0
    np.testing.assert_array_equal(blocks.get(0), before)
