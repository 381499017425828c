"""Method `map`: times that are added, and lags that fit into times."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from occlog.array_types import NS
from occlog.errors import InputError
from occlog.track.methods.map.config import MapConfig
from occlog.track.methods.map.method import lag_ns
from occlog.track.methods.map.record import EMPTY, TargetRecord, fill


def silent(t_ns) -> TargetRecord:
    """A record without rows."""
    return EMPTY._replace(t_ns=np.asarray(t_ns, dtype=np.int64))


@pytest.mark.parametrize(("gap_s", "longest_s"), [(86_400, 0.1), (10_000, 0.007), (10**9, 10_000.0)])
def test_long_pauses_are_filled_evenly(gap_s: int, longest_s: float) -> None:
    gap = gap_s * NS
    t = fill(silent([5, 5 + gap]), longest_s).t_ns
    pieces = len(t) - 1
    assert pieces == -(-gap // round(longest_s * NS))
    some = np.unique(np.linspace(0, pieces, 1000).astype(np.int64)).tolist()
    assert_array_equal(t[some], [5 + k * gap // pieces for k in some])  # in whole numbers of any size


@pytest.mark.parametrize("longest_s", [1 / 3, 0.3, 1e-3, 0.7, 1 / 7])
def test_what_is_filled_is_not_filled_again(longest_s: float) -> None:
    rng = np.random.default_rng(0)
    times = np.cumsum(rng.choice([NS, NS // 30, 3 * NS, 999_999_999, 2_000_000_001], 200))
    once = fill(silent(times), longest_s)
    assert np.diff(once.t_ns).max() <= longest_s * NS + 3
    assert_array_equal(fill(once, longest_s).t_ns, once.t_ns)


@pytest.mark.parametrize("lag_s", [1e-10, 0.0, -1.0, 1e10, 1e300])
def test_lags_fit_into_times(lag_s: float) -> None:
    with pytest.raises(InputError, match=r"lag_s is .*, must be at least 1e-09 and at most 1e\+09"):
        MapConfig(lag_s=lag_s)


def test_the_longest_and_the_shortest_lag() -> None:
    assert lag_ns(MapConfig(lag_s=1e-9).lag_s) == 1
    assert lag_ns(MapConfig(lag_s=1e9).lag_s) == 10**18
