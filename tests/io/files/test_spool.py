"""Numbers that are put aside come back in order, from memory or from a file that leaves nothing."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest

from occlog.errors import OutputError
from occlog.io.files import spill as spool
from occlog.io.files.spill import Spool


@pytest.mark.parametrize("in_memory", [0, 10, 1000])
def test_numbers_come_back_in_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, in_memory: int) -> None:
    monkeypatch.setattr(spool, "NUMBERS_PER_BLOCK", 7)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    values, held = np.arange(100.0), Spool(in_memory)
    for part in np.split(values[:60], 6):
        held.add(part)
    for _ in range(2):
        np.testing.assert_array_equal(np.concatenate(list(held.blocks())), values[:60])
    held.add(values[60:])
    np.testing.assert_array_equal(np.concatenate(list(held.blocks())), values)
    whole = held.whole
    assert (whole is None) == (in_memory < 100)
    assert whole is None or np.array_equal(whole, values)
    assert held.count == 100
    assert not list(tmp_path.iterdir())


def test_a_full_folder_for_temporary_files_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "gone"))
    with pytest.raises(OutputError, match="gone: cannot be written"):
        Spool(0).add(np.ones(1))
