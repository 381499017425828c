"""Windows of reads: counts and means by window and tag, wherever chunks are cut."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from occlog.array_types import NS
from occlog.errors import InputError
from occlog.records.tables import Reads
from occlog.track.methods.readers.inputs import Windows, windows_of

START = 1_700_000_000 * NS


def reads(*rows: tuple[float, str, int, float]) -> Reads:
    t, sensor, target, rssi = zip(*rows, strict=True)
    return Reads.of(
        t_ns=[START + round(s * NS) for s in t],
        sensor=sensor,
        tag=[str(i) for i in target],
        target_id=target,
        rssi=rssi,
    )


LOG = reads(
    (0.0, "A", 1, -70.0),
    (0.2, "B", 1, -80.0),
    (0.4, "A", 1, -74.0),
    (0.9, "A", 2, float("nan")),
    (1.0, "B", 1, -60.0),
    (3.5, "B", 1, float("nan")),
)


def collected(parts: list[Windows]) -> Windows:
    columns = ("t_ns", "target_id", "count", "rssi")
    return Windows(*(np.concatenate([getattr(p, c) for p in parts]) for c in columns))


def test_a_window_has_counts_and_mean_strengths_of_each_tag() -> None:
    found = collected(list(windows_of([LOG], ("A", "B"), NS)))
    assert found.target_id.tolist() == [1, 2, 1, 1]
    assert found.t_ns.tolist() == [START + round(s * NS) for s in (0.2, 0.9, 1.0, 3.5)]
    assert found.count.tolist() == [[2, 1], [1, 0], [0, 1], [0, 1]]
    assert_array_equal(found.rssi, [[-72.0, -80.0], [np.nan, np.nan], [np.nan, -60.0], [np.nan, np.nan]])


@pytest.mark.parametrize("cut", range(1, 6))
def test_it_does_not_matter_where_chunks_are_cut(cut: int) -> None:
    whole = collected(list(windows_of([LOG], ("A", "B"), NS)))
    parts = collected(list(windows_of([LOG.take(slice(0, cut)), LOG.take(slice(cut, None))], ("A", "B"), NS)))
    for name in ("t_ns", "target_id", "count", "rssi"):
        assert_array_equal(getattr(parts, name), getattr(whole, name))


def test_other_readers_and_targets_do_not_count() -> None:
    found = collected(list(windows_of([LOG], ("B",), NS, targets=(1,))))
    assert found.target_id.tolist() == [1, 1, 1]
    assert found.count.ravel().tolist() == [1, 1, 1]


def test_times_that_go_back_are_refused() -> None:
    with pytest.raises(InputError, match="sort by t_ns"):
        list(windows_of([LOG.take(slice(3, None)), LOG.take(slice(0, 3))], ("A", "B"), NS))


def test_no_reads_make_no_windows() -> None:
    assert list(windows_of([Reads.empty()], ("A",), NS)) == []
