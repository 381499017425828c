import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from occlog.core.numerics.interpolate import TimeGrid, frame_times, frames_at, to_grid

START = 1_577_836_800_000_000_000
BOTH = np.array([True, False])


def straight(steps, step_ns=100_000_000):
    """Two objects on straight lines: x = seconds, x = -2 seconds."""
    t = START + np.arange(steps) * step_ns
    seconds = (t - START) * 1e-9
    xyz = np.zeros((steps, 2, 3))
    xyz[:, 0, 0], xyz[:, 1, 0] = seconds, -2 * seconds
    return TimeGrid(t, np.array([0, 1]), BOTH, xyz)


def cut(grid, pieces):
    times, places = np.split(grid.t_ns, pieces), np.split(grid.xyz, pieces)
    return [TimeGrid(t, grid.ids, grid.target, xyz) for t, xyz in zip(times, places, strict=True)]


def test_rows_become_a_grid_with_gaps():
    t, ids = np.array([5, 5, 9]), np.array([7, 2, 2], dtype=np.int32)
    grid = to_grid(t, ids, np.array([True, False, False]), np.arange(9.0).reshape(3, 3))
    assert grid.t_ns.tolist() == [5, 9]
    assert grid.ids.tolist() == [2, 7]
    assert grid.target.tolist() == [False, True]
    assert grid.xyz[0, 1].tolist() == [0, 1, 2]
    assert np.isnan(grid.xyz[1, 1]).all()


@given(
    st.floats(0.3, 70.0),
    st.lists(st.integers(1, 79), max_size=5, unique=True).map(sorted),
)
def test_frames_do_not_depend_on_the_chunks(rate, pieces):
    grid = straight(80)
    got = [found for _, found in frames_at(cut(grid, pieces), [rate, None])]
    times = np.concatenate([f[0].t_ns for f in got])
    want = START + np.rint(np.arange(1000) * (1e9 / rate)).astype(np.int64)
    assert times.tolist() == want[want <= grid.t_ns[-1]].tolist()
    first = 0
    for f in got:
        if len(f[0].t_ns):
            assert f[0].first == first
        first += len(f[0].t_ns)
        seconds = (f[0].t_ns - START) * 1e-9
        assert f[0].xyz[:, 0, 0] == pytest.approx(seconds, abs=1e-9)
        assert f[0].xyz[:, 1, 0] == pytest.approx(-2 * seconds, abs=1e-9)
    assert np.concatenate([f[1].t_ns for f in got]).tolist() == grid.t_ns.tolist()
    assert [f[1].first for f in got] == [0, *pieces]


def test_an_object_that_leaves_is_absent_afterwards():
    a = to_grid(np.array([0, 0, 10, 10]), np.array([0, 1, 0, 1]), np.ones(4, dtype=bool), np.ones((4, 3)))
    b = to_grid(np.array([20, 30]), np.array([1, 1]), np.ones(2, dtype=bool), np.full((2, 3), 2.0))
    (_, (first,)), (_, (second,)) = frames_at([a, b], [1e9 / 5])
    assert first.t_ns.tolist() == [0, 5, 10]
    assert second.t_ns.tolist() == [15, 20, 25, 30]
    assert second.xyz.shape == (4, 1, 3)
    assert second.xyz[:, 0, 0].tolist() == [1.5, 2, 2, 2]


def test_frame_times_are_half_open():
    times, first = frame_times(100, 110, 130, 1e8)
    assert times.tolist() == [120, 130]
    assert first == 2
    assert len(frame_times(100, 110, 115, 1e8)[0]) == 0
