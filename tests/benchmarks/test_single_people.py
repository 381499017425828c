"""Real people with false bearings: what the benchmark measures holds for one of its seeds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.track._single_people import LEAST, Noise, people, scene_of
from benchmarks.track.single_people import ELLIPSE, LIMIT, follow, longest
from occlog.track.methods.apf.config import SelectConfig


def test_people_who_are_there_for_long_are_followed_among_false_bearings(shared_data: Path) -> None:
    folder = shared_data / "wildtrack_annotations"
    if not folder.is_dir():
        pytest.skip("the annotations of WILDTRACK are not there")
    scene = scene_of(folder)
    people_tracks = people(folder, scene, Noise(), seed=7)
    assert len(people_tracks) == 20
    assert min(len(p.t_ns) for p in people_tracks) >= LEAST
    found = [follow(p, scene, "map", {}) for p in people_tracks[::4]]
    assert np.median([o.rmse for o in found]) < LIMIT
    assert not any(o.lost for o in found)
    assert 0.9 < np.mean(np.concatenate([o.nees for o in found]) < ELLIPSE) < 0.98
    caught = sum(o.caught for o in found)
    assert caught > 0.9 * sum(o.blamed for o in found)
    assert caught > 0.9 * sum(o.false for o in found)


@pytest.mark.jit
def test_three_of_seven_cameras_follow_people_at_two_frames_a_second(shared_data: Path) -> None:
    """Selected for as long as the default says, without regard to what cameras see, they cost 8 times the RMSE."""
    folder = shared_data / "wildtrack_annotations"
    if not folder.is_dir():
        pytest.skip("the annotations of WILDTRACK are not there")
    scene = scene_of(folder, room=True)
    reported = {"detection_probability": 0.85, "false_alarm_probability": 0.05}
    people_tracks = people(folder, scene, Noise(), seed=7)[::5]
    found = [
        [follow(p, scene, "apf", reported, selection=selection) for p in people_tracks]
        for selection in (None, SelectConfig("greedy", 3))
    ]
    whole, some = (np.array([o.rmse for o in part]) for part in found)
    assert np.median(some) < 2.0 * np.median(whole) < 0.3
    assert not any(o.lost for o in found[1])
    for part in found:
        assert np.mean(np.concatenate([o.nees for o in part]) < ELLIPSE) > 0.9
    assert sum(o.frames for o in found[1]) < 0.5 * sum(o.frames for o in found[0])


@pytest.mark.parametrize(("rows", "length"), [([], 0), ([0, 0], 0), ([1], 1), ([1, 1, 0, 1], 2), ([0, 1, 1, 1], 3)])
def test_the_longest_run(rows, length: int) -> None:
    assert longest(np.array(rows, dtype=np.bool_)) == length
