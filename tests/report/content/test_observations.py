"""What bearings say without tracks is the same of pieces as of the whole table."""

from __future__ import annotations

import numpy as np
import pytest
from made_up import run

from occlog.io.files.spill import Blocks
from occlog.records.tables import Bearings, whole_times
from occlog.report.content.coverage import CELLS, LOOK, ObservationStreams


def mixed() -> Bearings:
    """Labelled observations, candidates of a sensor that names no one and a sensor of a low rate."""
    table = run(steps=700, cameras=4, targets=2).bearings
    assert table is not None
    columns = {c.name: getattr(table, c.name) for c in Bearings.columns()}
    free = table.sensor == "camera 2"
    columns["target_id"] = np.where(free, -1, table.target_id)
    named = Bearings.of(**columns).sorted()
    rare = (named.sensor != "camera 3") | (named.t_ns % 2_100_000_000 == 0)
    return named.take(rare)


@pytest.mark.parametrize(("rows", "block"), [(13, 7), (37, 10**4), (10**6, 7)])
def test_looks_are_the_same_in_chunks_of_any_length(rows: int, block: int) -> None:
    table = mixed()
    streams, at_once = ObservationStreams(Blocks(LOOK, block, in_memory=200)), ObservationStreams()
    at_once.add(table)
    for piece in whole_times(table.take(slice(s, s + rows)) for s in range(0, len(table), rows)):
        streams.add(piece)
    names = ("camera 1", "camera 2", "camera 3", "camera 4", "nobody")
    found, whole = (each.finish(names, (0, 1, -1)) for each in (streams, at_once))
    assert (found.rows, found.seen) == (len(table), int(table.seen.sum()))
    own = {name: table.sensor == name for name in np.unique(table.sensor).tolist()}
    assert found.sensors == {name: (rows.sum(), (rows & table.seen).sum()) for name, rows in own.items()}
    assert (found.labels, found.watched) == ((-1, 0, 1), (0, 1))
    frames = set()
    for name in names:
        for target in (0, 1, -1):
            got, wanted = found.sightings(name, target), whole.sightings(name, target)
            assert (got.sensor, got.any_object) == (name, wanted.any_object)
            for column in ("edges", "observed", "seen"):
                np.testing.assert_array_equal(getattr(got, column), getattr(wanted, column))
            frames.add(min(int(wanted.observed.sum()), CELLS + 1))
    # No frame at all, frames drawn one by one, and cells of several frames
    assert {0, CELLS + 1} < frames
