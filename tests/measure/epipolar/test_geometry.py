"""Geometry of the views of a recording: from poses, from given matrices, with and without lens distortion."""

from dataclasses import replace

import numpy as np
import pytest
from epipolar_rigs import looking, room_points

from occlog.core.geometry.fundamental import epipolar_distances
from occlog.errors import InputError
from occlog.measure.epipolar.geometry import view_geometry
from occlog.measure.epipolar.views import TrackedView
from occlog.records.scene import Scene
from occlog.records.view_pairs import ViewPair, ViewPairs

BROWN = np.array([-0.25, 0.06, 0.002, -0.001, 0.0])
PLACES = {"a": (6, 0, 2), "b": (0, 7, 1.5), "c": (-5, -5, 3)}


def cameras(**more):
    return [
        looking(name, np.array(position, dtype=float), (0, 0, 1), 600.0, **more) for name, position in PLACES.items()
    ]


def views(*names):
    return [TrackedView(name, 640, 480) for name in names]


@pytest.mark.parametrize("lens", [np.zeros(5), BROWN])
def test_points_lie_on_their_lines_in_all_views(lens):
    scene = Scene(cameras=tuple(cameras(distortion=lens)))
    geometry = view_geometry(views("c", "a", "b"), scene)
    points = room_points(np.random.default_rng(1), 40)
    seen = [scene.camera(name).project(points) for name in "cab"]
    ideal = [p if f is None else f(p) for p, f in zip(seen, geometry.ideal, strict=True)]
    assert all((f is None) == (not lens.any()) for f in geometry.ideal)
    for i in range(3):
        assert np.isnan(geometry.fundamental[i, i]).all()
        for j in range(3):
            if i != j:
                assert epipolar_distances(geometry.fundamental[i, j], ideal[i], ideal[j]).max() < 1e-6


def test_given_matrices_come_first_and_unknown_pairs_are_nan():
    a, b, _ = cameras()
    known = view_geometry(views("a", "b"), Scene(cameras=(a, b)))
    given = ViewPairs((ViewPair("b", "a", np.arange(9.0).reshape(3, 3)),))
    mixed = view_geometry(views("a", "b", "x"), Scene(cameras=(a, b)), given)
    assert np.array_equal(mixed.fundamental[1, 0], given.pairs[0].matrix)
    assert np.array_equal(mixed.fundamental[0, 1], given.pairs[0].matrix.T)
    assert np.isnan(mixed.fundamental[2]).all()
    assert np.isfinite(known.fundamental[0, 1]).all()
    assert np.isnan(view_geometry(views("a", "b")).fundamental).all()
    for other in (replace(b, placed=False), replace(a, name="b")):
        assert np.isnan(view_geometry(views("a", "b"), Scene(cameras=(a, other))).fundamental).all()


def test_matrices_for_other_pixels_are_refused():
    plain, bent = Scene(cameras=tuple(cameras())), Scene(cameras=tuple(cameras(distortion=BROWN)))
    pair = ViewPair("a", "b", np.eye(3))
    with pytest.raises(InputError, match="a and b is for distorted pixels"):
        view_geometry(views("a", "b"), bent, ViewPairs((pair,)))
    for scene in (plain, None):
        with pytest.raises(InputError, match="a and b needs undistorted pixels"):
            view_geometry(views("a", "b"), scene, ViewPairs((pair._replace(undistorted=True),)))
    assert view_geometry(views("a", "b"), bent, ViewPairs((pair._replace(undistorted=True),))).ideal[0] is not None
    assert view_geometry(views("b", "c"), bent, ViewPairs((pair,))).ideal[0] is not None  # a pair of other views
