from __future__ import annotations

import itertools

import numpy as np
import pytest
from made_up import run

from occlog.records.tables import Bearings
from occlog.report.content.coverage import CELLS, ObservationStreams, SensorSightings
from occlog.report.plots.over_time import coarser, sensors, watched


def observations(t_ns: list[int], seen: list[bool], sensor: str = "a", target: int = 0) -> Bearings:
    n = len(t_ns)
    angle = np.where(seen, 0.1, np.nan)
    nan = np.full(n, np.nan)
    return Bearings.of(
        t_ns=np.array(t_ns, np.int64),
        sensor=np.full(n, sensor),
        target_id=np.full(n, target),
        seen=np.array(seen, bool),
        bearing=angle,
        sigma=angle,
        u_px=nan,
        sigma_px=nan,
        score=nan,
    )


def sightings(table: Bearings, sensor: str, target: int) -> SensorSightings:
    streams = ObservationStreams()
    streams.add(table)
    return streams.finish([sensor], [target]).sightings(sensor, target)


def test_each_frame_lasts_to_the_next_and_a_gap_is_no_frame() -> None:
    found = sightings(observations([0, 10, 20, 100, 110], [True, False, True, True, False]), "a", 0)
    state = [(int(e), int(n), int(s)) for e, n, s in zip(found.edges, found.observed, found.seen, strict=False)]
    assert state == [(0, 1, 1), (10, 1, 0), (20, 1, 1), (35, 0, 0), (100, 1, 1), (110, 1, 0)]
    assert found.edges[-1] == 120
    assert found.share == pytest.approx(3 / 5)


def test_candidates_of_one_frame_are_one_look() -> None:
    found = sightings(observations([0, 0, 10, 20], [True, False, False, False], target=-1), "a", -1)
    assert found.observed.tolist() == [1, 1, 1]
    assert found.seen.tolist() == [1, 0, 0]


def test_a_single_frame_and_no_frame() -> None:
    assert sightings(observations([5], [True]), "a", 0).seen.tolist() == [1]
    nothing = sightings(observations([5], [True]), "b", 0)
    assert len(nothing.observed) == 0
    assert np.isnan(nothing.share)


def test_long_recordings_keep_their_counts() -> None:
    rng = np.random.default_rng(0)
    n = 20_000
    seen = rng.random(n) < 0.3
    found = sightings(observations(list(range(0, 10 * n, 10)), seen.tolist()), "a", 0)
    assert len(found.observed) == CELLS
    assert found.observed.sum() == n
    assert found.seen.sum() == seen.sum()


def test_sensors_in_the_scene_come_first() -> None:
    data = run(steps=20, cameras=2, bearings=observations([0], [True], "stranger"))
    assert sensors(data) == ("camera 1", "camera 2", "stranger")


def test_unassigned_candidates_are_shown_only_alone() -> None:
    assert watched(run(steps=20, bearings=observations([0], [True], target=-1))) == (-1,)
    assert watched(run(steps=20, targets=2)) == (0, 1)


def test_a_sensor_that_names_no_target_has_its_candidates_counted() -> None:
    data = run(steps=60, cameras=2)
    own = data.bearings.sensor == "camera 1"
    columns = {c.name: getattr(data.bearings, c.name) for c in Bearings.columns()}
    mixed = Bearings.of(**columns | {"target_id": np.where(own, -1, data.bearings.target_id)})
    named, free = sightings(mixed, "camera 2", 0), sightings(mixed, "camera 1", 0)
    assert (named.any_object, free.any_object) == (False, True)
    assert free.share == sightings(data.bearings, "camera 1", 0).share > 0


@pytest.mark.parametrize(("next_ns", "frames"), [(35, [1, 1, 1, 1, 1]), (36, [1, 1, 1, 0, 1, 1])])
def test_a_frame_lasts_at_most_half_as_long_again_as_usual(next_ns: int, frames: list[int]) -> None:
    t_ns = [0, 10, 20, next_ns, next_ns + 10]
    assert sightings(observations(t_ns, [True] * 5), "a", 0).observed.tolist() == frames


@pytest.mark.parametrize(
    ("cells", "most", "left"), [(500, 500, 500), (500, 200, 167), (7, 3, 3), (7, 1, 1), (3, 10, 3)]
)
def test_fewer_cells_have_the_same_frames_and_borders(cells: int, most: int, left: int) -> None:
    rng = np.random.default_rng(cells + most)
    looked = rng.integers(0, 5, cells)
    edges = np.cumsum(rng.integers(1, 9, cells + 1))
    fine = SensorSightings("a", edges, looked, rng.integers(0, looked + 1))
    coarse = coarser(fine, most)
    assert len(coarse.observed) == len(coarse.seen) == len(coarse.edges) - 1 == left
    assert (coarse.edges[0], coarse.edges[-1]) == (edges[0], edges[-1])
    for k, (start, stop) in enumerate(itertools.pairwise(coarse.edges.tolist())):
        own = (edges[:-1] >= start) & (edges[:-1] < stop)
        assert coarse.observed[k] == looked[own].sum()
        assert coarse.seen[k] == fine.seen[own].sum()
    assert coarse.share == fine.share
