"""Rows of a frame to what is drawn: who touches, who helps and where the lines are."""

import itertools

import numpy as np
import pytest

from occlog.core.geometry.camera import rotation_from_angles
from occlog.core.geometry.fundamental import epipolar_lines, line_distances
from occlog.measure.epipolar.geometry import view_geometry
from occlog.measure.epipolar.views import TrackedView
from occlog.records.declared.views import Failures, ViewTracks
from occlog.records.scene import Camera, Scene
from occlog.records.tables import TruthBoxes
from occlog.report.overlay.stage import OverlayFrameRows, OverlayRig, frame_shot, line_in_image

POINTS = np.array([[0.0, 0.2, 0.9], [0.5, -0.4, 1.1], [-0.7, 0.3, 1.0]])


def cameras(distortion=(0.0, 0.0)):
    def one(name, place, yaw):
        bend = np.array([*distortion, 0.0, 0.0, 0.0])
        rotation = rotation_from_angles(np.radians(yaw), -0.1, 0.0)
        return Camera(name, np.array(place), rotation, np.full(2, 300.0), np.array([159.5, 119.5]), (320, 240), bend)

    return one("a", [-4.0, 0.0, 1.6], 0.0), one("b", [0.0, -4.0, 1.5], 90.0)


def tracks(camera, neighbours, helpers, ids=(0, 1, 2)):
    n, pixels = len(ids), camera.project(POINTS[: len(ids)])
    nan, ones = np.full(n, np.nan), np.ones(n)
    return ViewTracks.of(
        t_ns=np.zeros(n, int),
        sensor=[camera.name] * n,
        frame=np.full(n, 7),
        target_id=list(ids),
        x_px=pixels[:, 0],
        y_px=pixels[:, 1],
        a_px=20 * ones,
        b_px=10 * ones,
        rho=0 * ones,
        cov_xx_px=ones,
        cov_xy_px=0 * ones,
        cov_yy_px=ones,
        similarity=nan,
        ess=nan,
        likelihood_mode=["bmct"] * n,
        counterpart=[""] * n,
        neighbours=neighbours,
        assisting_views=helpers,
        lifecycle=[""] * n,
    )


def rig(scene):
    views = [TrackedView(c.name, *c.image_size) for c in scene.cameras]
    return OverlayRig(views, scene.cameras, view_geometry(views, scene))


def told(scene, neighbours, helpers):
    own = tracks(scene.cameras[0], neighbours, helpers)
    return [
        OverlayFrameRows(own, None, None),
        OverlayFrameRows(tracks(scene.cameras[1], ["", "", ""], ["", "", ""]), None, None),
    ]


@pytest.mark.parametrize("distortion", [(0.0, 0.0), (-0.25, 0.05)])
def test_lines_of_helpers_go_through_the_same_point(distortion):
    scene = Scene(cameras=cameras(distortion))
    shot = frame_shot(0, 7, told(scene, ["1", "0", ""], ["b", "", "b,c"]), rig(scene))
    assert shot.title == "a   frame 7"
    assert [target for target, _ in shot.lines] == [0, 2]
    for target, points in shot.lines:
        pixel = scene.cameras[0].project(POINTS[[target]])[0]
        fine = np.concatenate([np.linspace(p, q, 200) for p, q in itertools.pairwise(points)])
        assert np.linalg.norm(fine - pixel, axis=1).min() < 1.5
        assert np.ptp(points[:, 0]) > 150 or np.ptp(points[:, 1]) > 150
    assert [(o.dashed, o.strong) for o in shot.outlines] == [(False, True), (True, False), (False, True)]
    assert len(shot.links) == 1
    assert np.allclose(shot.links[0], scene.cameras[0].project(POINTS[:2]))


def test_lines_are_of_the_points_that_stand_for_targets():
    scene = Scene(cameras=cameras())
    both = told(scene, ["", "", ""], ["b", "", ""])
    views = rig(scene)
    (line,) = [line for _, line in frame_shot(0, 7, both, views._replace(bottom=True)).lines]
    other = both[1].tracks
    low = np.array([[other.x_px[0], other.y_px[0] + 10.0]])
    assert np.abs(line_distances(epipolar_lines(views.geometry.fundamental[1, 0], low), line)).max() < 1e-6
    ((_, centre),) = frame_shot(0, 7, both, views).lines
    assert np.abs(centre - line).max() > 1.0


def test_no_lines_without_geometry_or_the_helpers_row():
    scene = Scene(cameras=cameras())
    both = told(scene, ["", "", ""], ["b", "b", "b"])
    assert frame_shot(0, 7, both, rig(scene)._replace(geometry=None)).lines == []
    fewer = OverlayFrameRows(tracks(scene.cameras[1], [""], [""], (2,)), None, None)
    assert [target for target, _ in frame_shot(0, 7, [both[0], fewer], rig(scene)).lines] == [2]
    blind = view_geometry(rig(scene).views)  # neither poses nor matrices
    assert frame_shot(0, 7, both, rig(scene)._replace(geometry=blind)).lines == []


def test_a_line_is_cut_to_the_image_or_passes_it_by():
    view = TrackedView("a", 320, 240)
    line = np.array([0.6, 0.8, -150.0])
    points = line_in_image(line, view, None)
    assert np.abs(line_distances(np.tile(line, (2, 1)), points)).max() < 1e-9
    assert np.linalg.norm(points - [159.5, 119.5], axis=1) == pytest.approx(0.5 * np.hypot(320, 240))
    assert line_in_image(np.array([0.0, 1.0, 900.0]), view, None) is None


def test_failures_and_truth():
    scene = Scene(cameras=cameras())
    boxes = TruthBoxes.of(
        t_ns=[0, 0],
        sensor=["a", "a"],
        frame=[7, 7],
        box=[0, 1],
        target_id=[1, 2],
        left_px=[10.0, 50.0],
        top_px=[20.0, 60.0],
        width_px=[8.0, 9.0],
        height_px=[6.0, 7.0],
        confidence=[np.nan, np.nan],
    )
    failures = Failures.of(
        t_ns=[0, 0, 0],
        sensor=["a"] * 3,
        frame=[7] * 3,
        target_id=[0, 1, 5],
        kind=["label", "position", "position"],
        other_id=[2, -1, -1],
        cause=["", "", ""],
        visible=[np.nan] * 3,
    )
    first = OverlayFrameRows(tracks(scene.cameras[0], ["", "", ""], ["", "", ""]), boxes, failures)
    shot = frame_shot(0, 7, [first, OverlayFrameRows(None, None, None)], rig(scene))
    assert [o.wrong for o in shot.outlines] == ["on 2", "", ""]
    assert [(p.target_id, p.missed) for p in shot.positions] == [(1, True), (2, False)]
    assert np.isnan(shot.positions[0].visible)
    assert shot.notes == ["target 5: no tracker"]
    assert not shot.boxed
    own = frame_shot(0, 7, [first, OverlayFrameRows(None, None, None)], rig(scene)._replace(numbered=False))
    assert [o.wrong for o in own.outlines] == ["", "", ""]
    assert own.notes == ["target 5: no tracker", "a tracker of target 0 is on target 2"]
    assert [p.coloured for p in own.positions] == [False, False]
    alone = frame_shot(0, 7, [OverlayFrameRows(None, boxes, None), OverlayFrameRows(None, None, None)], rig(scene))
    assert alone.boxed
    assert alone.outlines == alone.lines == alone.links == []


def test_a_frame_without_any_target_draws_nothing():
    scene = Scene(cameras=cameras())
    nan = [np.nan]
    none_of_them = TruthBoxes.of(
        t_ns=[0],
        sensor=["a"],
        frame=[7],
        box=[-1],
        target_id=[-1],
        left_px=nan,
        top_px=nan,
        width_px=nan,
        height_px=nan,
        confidence=nan,
    )
    empty = tracks(scene.cameras[0], [], [], ())
    shot = frame_shot(
        0, 7, [OverlayFrameRows(empty, none_of_them, None), OverlayFrameRows(None, None, None)], rig(scene)
    )
    assert shot.positions == shot.outlines == []
