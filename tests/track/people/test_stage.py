"""Times in parts, as many together as have few rows."""

from __future__ import annotations

import numpy as np
import pytest
from crowds import crowd
from people_boxes import hall

from occlog.array_types import Floats
from occlog.records.scene import scene_from
from occlog.track.methods.jipda.config import JipdaConfig
from occlog.track.methods.jipda.interface import FrameDetections, TrackSnapshot, no_associations
from occlog.track.people.frame_detections import FrameDetectionsWithIds
from occlog.track.people.stage import JIPDA, ROWS_PER_PART, PeopleTracker, track_people

SCENE = hall("ab")


def everywhere(people: int) -> PeopleTracker[None, None]:
    """A method that sees so many people at each time, whatever the boxes."""

    def step(state: None, observations: object) -> tuple[None, TrackSnapshot]:
        ids = np.arange(people)
        covariance = np.tile(np.eye(6), (people, 1, 1))
        mean = np.zeros((people, 6))
        mean[:, 0] = 5.0 * ids
        return None, TrackSnapshot(
            0, ids, mean, covariance, np.ones(people), np.ones((people, 2)), no_associations(), ()
        )

    return PeopleTracker(begin=lambda scene, cameras, config: None, step=step)


def observations(moments: int) -> list[list[FrameDetectionsWithIds]]:
    none = np.zeros(0, dtype=np.int64)
    return [
        [
            FrameDetectionsWithIds(
                FrameDetections(t, c, np.zeros((0, 4)), np.zeros(0), none, np.zeros((0, 0)), none), t, none
            )
            for c in range(2)
        ]
        for t in range(moments)
    ]


@pytest.mark.parametrize("people", [0, 5, 100, ROWS_PER_PART])
def test_parts_have_few_rows_whatever_the_number_of_people(people) -> None:
    moments = 500 if people < ROWS_PER_PART else 3
    parts = list(track_people(observations(moments), SCENE, SCENE.cameras, JipdaConfig(), everywhere(people)))
    sizes = [len(part) for part in parts]
    assert sum(sizes) == moments
    # A row for each person in `tracks` and two in `view_tracks`
    rows = 1 + 3 * people
    assert max(sizes) <= -(-ROWS_PER_PART // rows)
    assert set(sizes[:-1]) <= {-(-ROWS_PER_PART // rows)}


@pytest.mark.jit
def test_coordinates_of_maps_cost_no_digits() -> None:
    made = crowd(people=4, cameras=3, frames=15, seed=5)
    seen = [
        [FrameDetectionsWithIds(k, t, np.arange(len(k.row))) for k in observations]
        for t, observations in enumerate(made.moments)
    ]

    def followed(at: Floats) -> Floats:
        scene, none = scene_from(made.scene, -at), np.zeros((0, 6))
        parts = track_people(seen, scene, scene.cameras, JipdaConfig(), JIPDA)
        return np.concatenate([none, *(each.snapshot.mean - [*at, 0, 0, 0, 0] for part in parts for each in part)])

    near, far = followed(np.zeros(2)), followed(np.array([500_000.0, 4_000_000.0]))
    assert len(near) > 40
    assert far == pytest.approx(near, abs=1e-6)
