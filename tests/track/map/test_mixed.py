"""Measurements of distances in a trajectory's cost: terms, the record that holds them, where a search begins."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.core.sight.distances import DIFFERENCE, LOGARITHM, RANGE, Distances, log_likelihood
from occlog.measure.scans.scan import Measured, Scan
from occlog.records.scene import MicrophoneArray, Scene
from occlog.track.map.config import MapConfig
from occlog.track.map.filtered_start import filtered_start
from occlog.track.map.mixed import local, terms
from occlog.track.map.pending import begin, problem_of
from occlog.track.map.record import after, fill, join, record_of

NS = 1_000_000_000
PLACES = np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 8.0]])


def ranges(xy: np.ndarray, sigma: float = 0.05, kind: int = RANGE) -> Distances:
    value = np.hypot(*(xy - PLACES).T)
    blank = np.zeros(3)
    return Distances(
        np.full(3, kind), value, np.full(3, sigma), PLACES, blank, np.roll(PLACES, 1, axis=0), blank, np.arange(3)
    )


def scans(path: np.ndarray, step_ns: int = NS) -> list[Scan]:
    zero = np.zeros(3, dtype=np.int32)
    return [Scan.of(k * step_ns, [])._replace(measured=Measured(zero, ranges(xy))) for k, xy in enumerate(path)]


@pytest.mark.parametrize("kind", [RANGE, LOGARITHM, DIFFERENCE])
def test_the_slope_of_a_term_is_that_of_the_negative_log_likelihood(kind: int) -> None:
    rows = ranges(np.array([4.0, 3.0]), 0.7, kind)
    X = np.array([[3.0, 0.0, 5.0, 0.0]])
    found = terms(rows, np.zeros(3, dtype=np.int64), X, square=False)
    step = 1e-6 * np.eye(2)
    slope = [(log_likelihood(rows, X[:, ::2] - d) - log_likelihood(rows, X[:, ::2] + d))[0] / 2e-6 for d in step]
    np.testing.assert_allclose(found.slope.sum(axis=0), slope, rtol=1e-5, atol=1e-7)
    assert (found.bend[:, 0] * found.bend[:, 2] - found.bend[:, 1] ** 2 >= -1e-12).all()


def test_a_record_is_joined_cut_and_filled_with_its_measurements() -> None:
    path = np.column_stack([np.arange(1.0, 7.0), np.full(6, 3.0)])
    whole = join(record_of(scans(path)[:2]), record_of(scans(path)[2:]))
    assert whole.measured_state.tolist() == np.repeat(np.arange(6), 3).tolist()
    later = after(whole, 4)
    assert later.measured_state.tolist() == [0, 0, 0, 1, 1, 1]
    np.testing.assert_allclose(later.measured.value[:3], np.hypot(*(path[4] - PLACES).T))
    filled = fill(whole, 0.5)
    assert len(filled.t_ns) == 11
    assert filled.measured_state.tolist() == np.repeat(np.arange(0, 11, 2), 3).tolist()


@pytest.mark.jit
def test_a_search_begins_near_the_path_although_ranges_fit_other_places_at_first() -> None:
    room = np.array([[-10.0, -10.0], [20.0, -10.0], [20.0, 20.0], [-10.0, 20.0]])
    scene = Scene(arrays=tuple(MicrophoneArray(f"s{i}", np.append(p, 0.0)) for i, p in enumerate(PLACES)), room=room)
    path = np.column_stack([np.linspace(2, 7, 30), np.linspace(5, 2, 30)])
    given = scans(path)
    # Two stations alone see it for the first ten times: two places fit, then the third one decides
    both, zero = np.arange(2), np.zeros(2, dtype=np.int32)
    blind = [s._replace(measured=Measured(zero, s.measured.distances.take(both))) for s in given[:10]]
    record = record_of([*blind, *given[10:]])
    pending = begin(scene, MapConfig())
    found = local(record.measured, pending.origin)
    X = filtered_start(problem_of(pending, record), record, pending, found)
    assert np.hypot(*(X[:, ::2] + pending.origin - path).T).max() < 0.2
