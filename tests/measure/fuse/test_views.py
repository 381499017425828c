"""Views in the fusion: where feet are, boxes of who was missed, numbers of frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from occlog.measure.clusters.person_size import person_in_image
from occlog.measure.detect.from_boxes import detect_boxes
from occlog.measure.detections import Detections
from occlog.measure.fuse.config import FuseConfig
from occlog.measure.fuse.stage import fuse
from occlog.measure.fuse.views import feet, placed_cameras
from occlog.records.scene import Camera, Scene, camera_rotation
from occlog.records.tables import APPEARANCE_BINS, Bearings, Boxes, Views

HEIGHT = 1.7
PLACE = (4.0, 5.5)


def scene() -> Scene:
    """Three cameras 2.5 m up tilted 15 degrees down."""
    corners = (("a", 0.0, 0.0, 45.0), ("b", 10.0, 0.0, 135.0), ("c", 10.0, 10.0, 225.0))
    cameras = tuple(
        Camera(
            n,
            np.array([x, y, 2.5]),
            camera_rotation(np.radians(yaw), np.radians(-15.0), 0.0),
            np.array([600.0, 600.0]),
            np.array([499.5, 399.5]),
            (1000, 800),
            fov=np.radians(79.0),
        )
        for n, x, y, yaw in corners
    )
    return Scene(cameras=cameras, room=np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]]))


def box(camera: Camera, xy: Sequence[float], cut: float = 0.0) -> list[float]:
    """Box of a person at a place; a share `cut` of it, at the feet, is hidden."""
    middle, spans = person_in_image(camera, np.array([xy]), HEIGHT)
    width, height = np.abs(spans[0]).sum(axis=0)
    return [middle[0, 0] - 0.5 * width, middle[0, 1] - 0.5 * height, width, (1.0 - cut) * height]


def boxes(where: Scene, seen: dict[str, Sequence[float] | None], step: int = 0, first: int = 0) -> Boxes:
    rows = [(n, [np.nan] * 4 if xy is None else box(where.camera(n), xy)) for n, xy in seen.items()]
    there = [0 if seen[n] is not None else -1 for n, _ in rows]
    four = np.array([b for _, b in rows])
    return Boxes.of(
        t_ns=np.full(len(rows), step * 10**8),
        sensor=[n for n, _ in rows],
        frame=np.full(len(rows), first + step),
        box=np.array(there, dtype=np.int32),
        target_id=np.full(len(rows), -1, dtype=np.int32),
        left_px=four[:, 0],
        top_px=four[:, 1],
        width_px=four[:, 2],
        height_px=four[:, 3],
        confidence=np.full(len(rows), np.nan),
    ).sorted()


def run(where: Scene, tables: Sequence[Boxes], config: FuseConfig | None = None) -> tuple[Views, Bearings]:
    parts = list(fuse(detect_boxes(tables, where), where, config))
    return Views.concat([p.views for p in parts]), Bearings.concat([p.bearings for p in parts])


def test_feet_on_the_floor_tell_the_distance():
    where = scene()
    cameras = placed_cameras(where, FuseConfig.in_unit(where.length_unit))
    views = next(iter(detect_boxes([boxes(where, dict.fromkeys("abc", PLACE))], where))).views
    found = feet(views, cameras)
    assert len(found) == len(views) == 3
    for row, name in enumerate(views.sensor.tolist()):
        away = np.hypot(*(np.array(PLACE) - where.camera(name).ground))
        # The lower edge is that of the body's nearest side, a few centimetres before its middle.
        assert found[row, 0] == pytest.approx(away, abs=0.45)
        assert abs(found[row, 0] - away) < 2.0 * found[row, 1]


def test_feet_that_do_not_show_tell_nothing():
    where = scene()
    cameras = placed_cameras(where, FuseConfig.in_unit(where.length_unit))
    table = boxes(where, dict.fromkeys("abc", PLACE))
    short = box(where.camera("a"), PLACE, cut=0.5)
    cut = replace(table, height_px=np.where(table.sensor == "a", short[3], table.height_px))
    found = feet(next(iter(detect_boxes([cut], where))).views, cameras)
    assert np.isnan(found[0]).all()
    assert np.isfinite(found[1:]).all()
    flat = Scene(
        cameras=tuple(
            Camera(c.name, c.position * [1, 1, 0], c.rotation, c.focal_px, c.principal_px, c.image_size, fov=c.fov)
            for c in where.cameras
        ),
        room=where.room,
    )
    views = next(iter(detect_boxes([table], where))).views
    assert np.isnan(feet(views, placed_cameras(flat, FuseConfig.in_unit(flat.length_unit)))).all()


def test_a_missed_person_gets_a_box_where_it_should_be():
    where = scene()
    tables = [boxes(where, dict.fromkeys("abc", PLACE), 0, 7), boxes(where, {"a": PLACE, "b": PLACE, "c": None}, 1, 7)]
    views, bearings = run(where, tables)
    new = views.take(views.cause == "recovered")
    assert (len(new), new.sensor[0], new.frame[0], new.cluster[0], new.t_ns[0]) == (1, "c", 8, 0, 10**8)
    true = box(where.camera("c"), PLACE)
    assert [new.left_px[0], new.top_px[0], new.width_px[0], new.height_px[0]] == pytest.approx(true, abs=2.0)
    assert np.isnan(new.appearance).all()
    assert new.appearance.shape == (1, APPEARANCE_BINS)
    row = bearings.take(bearings.cause == "recovered")
    assert (row.sensor[0], row.target_id[0], bool(row.seen[0])) == ("c", -1, True)
    assert row.bearing[0] == new.bearing[0]
    # The candidate's row "not seen" of that frame is gone, the others have one row a frame.
    assert len(bearings) == 6


def test_a_camera_that_sees_somebody_only_later_has_views_from_then_on():
    where = scene()
    late = [boxes(where, {"a": PLACE, "b": PLACE, "c": PLACE if k > 2 else None}, k) for k in range(5)]
    whole = run(where, [Boxes.concat(late)])
    for views, bearings in (whole, run(where, late)):
        assert not ((views.sensor == "c") & (views.t_ns < 3 * 10**8)).any()
        assert np.array_equal(bearings.cause, whole[1].cause)
        assert (bearings.cause[bearings.sensor == "c"] == "recovered").any()


def test_a_false_box_is_marked_in_views_and_no_longer_seen():
    where = scene()
    views, bearings = run(where, [boxes(where, {"a": None, "b": (7.0, 4.0), "c": None})])
    assert views.cause.tolist() == ["removed"]
    assert not bearings.seen.any()
    assert bearings.cause[bearings.sensor == "b"].tolist() == ["removed"]


def test_one_box_alone_is_believed_where_no_other_camera_looks():
    where = scene()
    views, bearings = run(where, [boxes(where, {"b": (7.0, 4.0)})])
    assert views.cause.tolist() == ["kept"]
    assert bearings.seen.all()


def test_views_of_no_bearing_stay_as_they_are():
    where = scene()
    part = next(iter(detect_boxes([boxes(where, dict.fromkeys("abc", PLACE))], where)))
    only = Detections(part.views, Bearings.empty(), (), 3, 0)
    after = Views.concat([f.views for f in fuse([only], where)])
    assert after.cause.tolist() == ["", "", ""]
    assert np.array_equal(after.left_px, part.views.left_px)
