"""Regions of what moves, where nothing tells how large targets are."""

from __future__ import annotations

import numpy as np
import pytest
from view_videos import SMALL, STEP_NS, small_balls

from occlog.errors import InputError
from occlog.measure.epipolar.views import TrackedView
from occlog.records.frames import Frame
from occlog.track.methods.images.initiation.regions import blob_sizes, moving_regions

pytestmark = pytest.mark.jit  # balls are rendered
VIEWS = (TrackedView("view1", SMALL.width, SMALL.height), TrackedView("view2", SMALL.width, SMALL.height))


def frames(broken=()):
    def decode(name, frame):
        def now():
            if (name, frame.frame) in broken:
                raise InputError("cut short")
            return frame.images[int(name[4:]) - 1]

        return now

    return [Frame(f.frame * STEP_NS, v.name, f.frame, decode(v.name, f)) for f in small_balls() for v in VIEWS]


def test_regions_are_the_balls_that_stand_free():
    parts = list(moving_regions(lambda: iter(frames()), None, VIEWS))
    t_ns = np.concatenate([p.t_ns for p in parts])
    sensor = np.concatenate([p.sensor for p in parts])
    ellipse = np.vstack([p.ellipse for p in parts])
    assert (np.diff(t_ns) >= 0).all()
    found = 0
    for f in small_balls()[4:]:
        for v, view in enumerate(VIEWS):
            mine = ellipse[(t_ns == f.frame * STEP_NS) & (sensor == view.name)]
            for true in f.ellipses[v]:
                near = np.hypot(*(mine[:, :2] - true[:2]).T) if len(mine) else np.array([np.inf])
                found += near.min() < 0.5 * SMALL.radius
    assert found > 0.5 * 2 * SMALL.balls * (SMALL.frames - 4)


def test_sizes_are_measured_on_blobs_away_from_the_edge():
    wall = np.full((SMALL.height, SMALL.width, 3), 90, np.uint8)
    picture = wall.copy()
    picture[40:70, 50:70] = 250
    picture[0:20, 0:20] = 250
    given = [Frame(k, "view1", k, lambda: picture) for k in range(3)]
    sizes = blob_sizes(given, {"view1": wall}, VIEWS[:1])
    assert sizes["view1"].image_size == (SMALL.width, SMALL.height)
    tall = np.sqrt(sizes["view1"].cov[:, 2])
    low = blob_sizes([Frame(0, "view1", 0, lambda: wall)], {"view1": wall}, VIEWS[:1])
    assert not low
    assert np.ptp(tall) < 1e-9 * tall[0]


def test_frames_that_cannot_be_decoded_are_passed_over():
    parts = list(moving_regions(lambda: iter(frames({("view1", 0), ("view1", 5)})), None, VIEWS))
    t_ns = np.concatenate([p.t_ns for p in parts])
    sensor = np.concatenate([p.sensor for p in parts])
    assert not ((t_ns == 5 * STEP_NS) & (sensor == "view1")).any()
    assert ((t_ns == 6 * STEP_NS) & (sensor == "view1")).any()
