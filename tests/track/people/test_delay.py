"""What is kept to find a late camera stays small; what it finds is in `test_command`."""

from __future__ import annotations

import numpy as np
from people_boxes import hall

from occlog.track.methods.jipda.interface import NO_ID, FrameDetections, TrackSnapshot, no_associations
from occlog.track.people.camera_checks.clock_offset import MAX_FRAMES, MAX_STEPS, ClockOffsetSearch
from occlog.track.people.frame_detections import FrameDetectionsWithIds


def test_what_is_kept_of_a_crowd_is_bounded_and_small():
    scene, people = hall("abcd"), 100
    delays, none = ClockOffsetSearch(scene.cameras), np.zeros(0, dtype=np.int64)
    mean, eye = np.ones((people, 6)), np.zeros((people, 6, 6))
    for k in range(MAX_STEPS + 100):
        moment = TrackSnapshot(
            k, np.arange(people), mean, eye, np.ones(people), np.ones((people, 4)), no_associations(), ()
        )
        observation = FrameDetections(
            k, k % 4, np.ones((people, 4)), none, np.full(people, NO_ID), np.zeros((people, 0)), none
        )
        delays.add(moment, [FrameDetectionsWithIds(observation, k, none)], np.ones((people, 4), dtype=np.bool_))
    kept = [*delays._people, *delays._by]
    # No row holds on to the states and covariances that it was made of
    owned = {id(a if a.base is None else a.base): a if a.base is None else a.base for a in kept}.values()
    assert len(delays._people) == MAX_STEPS
    assert sum(a.nbytes for a in owned) <= 20 * people * MAX_STEPS
    assert max(len(each.kept) for each in delays._frames) <= 2 * MAX_FRAMES
