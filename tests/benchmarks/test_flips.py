"""Flipped bits in tables and recordings, in small; `python -m benchmarks.pipeline.flips 10000` flips more."""

from __future__ import annotations

import pytest

from benchmarks.pipeline import flips


@pytest.mark.parametrize("name", flips.FORMATS)
def test_no_flipped_bit_passes_as_data_or_metadata(name: str) -> None:
    found = flips.flip(name, 250, seed=5)
    assert found["data"] == found["metadata"] == 0
    assert found["refused"] >= 200
    assert found.total() == 250
