"""What bearings say without tracks is the same of pieces as of the whole table."""

from __future__ import annotations

import numpy as np
import pytest
from made_up import run

from occlog.io.files.put_aside.blocks import Blocks
from occlog.records.pieces import whole_times
from occlog.records.tables import Bearings
from occlog.report.content.looks import CELLS, LOOK, Looked, LookStreams, sightings


def mixed() -> Bearings:
    """Labelled looks, candidates of a sensor that names nobody (several in a frame), and a sensor that looks rarely."""
    table = run(steps=700, cameras=4, targets=2).bearings
    assert table is not None
    columns = {c.name: getattr(table, c.name) for c in Bearings.columns()}
    free = table.sensor == "camera 2"
    columns["target_id"] = np.where(free, -1, table.target_id)
    named = Bearings.of(**columns).sorted()
    rare = (named.sensor != "camera 3") | (named.t_ns % 2_100_000_000 == 0)
    return named.take(rare)


@pytest.mark.parametrize("rows", [1, 37, 10**6])
@pytest.mark.parametrize("block", [7, 10**4])
def test_looks_of_pieces_are_those_of_the_whole_table(rows: int, block: int) -> None:
    table = mixed()
    streams = LookStreams(Blocks(LOOK, block, in_memory=200))
    for piece in whole_times(table.take(slice(s, s + rows)) for s in range(0, len(table), rows)):
        streams.add(piece)
    names = ("camera 1", "camera 2", "camera 3", "camera 4", "nobody")
    found, whole = streams.finish(names, (0, 1, -1)), Looked.of(table)
    assert (found.rows, found.seen) == (whole.rows, whole.seen) == (len(table), int(table.seen.sum()))
    assert found.sensors == whole.sensors
    assert found.labels == whole.labels == (-1, 0, 1)
    assert found.watched == whole.watched == (0, 1)
    frames = set()
    for name in names:
        for target in (0, 1, -1):
            got, wanted = found.sightings(name, target), sightings(table, name, target)
            assert (got.sensor, got.any_object) == (name, wanted.any_object)
            for column in ("edges", "looked", "seen"):
                np.testing.assert_array_equal(getattr(got, column), getattr(wanted, column))
            frames.add(min(int(wanted.looked.sum()), CELLS + 1))
    # No frame at all, frames drawn one by one, and cells of several frames
    assert {0, CELLS + 1} < frames
