"""Tables that are put aside are read once from their source, and come back as they were."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from made_up import run

from occlog.errors import OutputError
from occlog.io.files.spill import SpilledTable
from occlog.records.tables import Bearings


def test_chunks_come_back_as_they_were(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    table, asked = run(steps=50, cameras=3).bearings, list[int]()
    assert table is not None

    def source() -> Iterator[Bearings]:
        asked.append(1)
        for start in range(0, len(table), 37):
            yield table.take(slice(start, start + 37))

    held = SpilledTable(Bearings, source)
    # Whoever stops on the way has put nothing aside
    next(iter(held.chunks()))
    for _ in range(3):
        chunks = list(held.chunks())
        assert [len(c) for c in chunks[:-1]] == [37] * (len(chunks) - 1)
        again = Bearings.concat(chunks)
        for column in Bearings.columns():
            np.testing.assert_array_equal(getattr(again, column.name), getattr(table, column.name))
        assert held.rows == len(table)
    assert len(asked) == 2
    assert not list(tmp_path.iterdir())


def test_nothing_is_put_aside_and_comes_back() -> None:
    held = SpilledTable(Bearings, lambda: iter(()))
    assert [list(held.chunks()), list(held.chunks())] == [[], []]


def test_a_full_folder_for_temporary_files_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "gone"))
    with pytest.raises(OutputError, match="gone: cannot be written"):
        list(SpilledTable(Bearings, lambda: iter(())).chunks())
