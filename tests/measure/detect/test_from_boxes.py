from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from detect_scenes import camera, scene

from occlog.errors import InputError
from occlog.measure.detect.config import DetectConfig
from occlog.measure.detect.from_boxes import detect_boxes
from occlog.measure.detections import Detections
from occlog.records.tables import Boxes

NAN = float("nan")


def table(*rows: tuple[int, str, int, float, float, float, float, float]) -> Boxes:
    """Rows of time, camera, box, left, top, width, height, confidence; the frame is the time."""
    columns = list(zip(*rows, strict=True))
    return Boxes.of(
        t_ns=columns[0],
        sensor=columns[1],
        frame=columns[0],
        box=np.array(columns[2], dtype=np.int32),
        target_id=np.full(len(rows), -1, dtype=np.int32),
        left_px=columns[3],
        top_px=columns[4],
        width_px=columns[5],
        height_px=columns[6],
        confidence=np.array(columns[7], dtype=np.float64),
    )


BOXES = table(
    (0, "a", 0, 40.0, 30.0, 10.0, 30.0, 0.9),
    (0, "a", 1, 90.0, 30.0, 20.0, 60.0, 0.8),
    (0, "b", -1, NAN, NAN, NAN, NAN, NAN),
    (1, "a", 0, 40.0, 30.0, 10.0, 30.0, 0.1),
    (1, "b", 0, 60.0, 30.0, 12.0, 36.0, NAN),
)


def run(place: object = None, **options: object) -> Detections:
    (got,) = detect_boxes([BOXES], place or scene(), DetectConfig(**options))  # type: ignore[arg-type]
    return got


def test_each_box_is_a_candidate_and_an_empty_frame_looked_and_saw_nothing() -> None:
    got = run()
    assert got.frames == 4
    b = got.bearings
    assert b.t_ns.tolist() == [0, 0, 0, 1, 1]
    assert b.sensor.tolist() == ["a", "a", "b", "a", "b"]
    assert b.seen.tolist() == [True, True, False, False, True]
    assert (b.target_id == -1).all()
    np.testing.assert_array_equal(b.score, [0.9, 0.8, NAN, NAN, NAN])
    cam = scene().camera("a")
    np.testing.assert_allclose(np.sort(b.bearing[:2]), np.sort(cam.bearings(np.array([[45.0, 45.0], [100.0, 60.0]]))))


def test_boxes_are_views_by_falling_area() -> None:
    v = run().views
    assert v.cluster.tolist() == [0, 1, 0]
    assert v.area_px.tolist() == [1200.0, 300.0, 432.0]
    assert v.x_px.tolist() == [100.0, 45.0, 66.0]
    np.testing.assert_allclose(v.cov_yy_px, [300.0, 75.0, 108.0])
    assert np.isnan(v.appearance).all()
    assert np.isnan(v.similarity).all()
    assert v.confidence.tolist()[:2] == [0.8, 0.9]


def test_the_least_confidence_can_be_chosen() -> None:
    assert run(min_confidence=0.05).bearings.seen.sum() == 4
    assert run(min_confidence=0.85).bearings.seen.sum() == 2


def test_wider_boxes_and_boxes_at_the_border_are_more_uncertain() -> None:
    cam = camera("a", 0.0, 0.0, 45.0)
    rows = table(
        (0, "a", 0, 60.0, 30.0, 10.0, 30.0, 0.9),
        (0, "a", 1, 45.0, 30.0, 40.0, 60.0, 0.9),
        (1, "a", 0, 0.0, 30.0, 10.0, 30.0, 0.9),
    )
    (got,) = detect_boxes([rows], scene(cam))
    large, small, border = got.views.sigma_px
    assert large > 1.5 * small
    assert border > small


def test_a_camera_without_pose_gives_views_only() -> None:
    made_scene = scene(replace(camera("a", 0.0, 0.0, 45.0), placed=False), camera("b", 8.0, 0.0, 135.0))
    got = run(made_scene)
    assert set(got.bearings.sensor.tolist()) == {"b"}
    assert np.isnan(got.views.bearing[got.views.sensor == "a"]).all()


def test_an_unknown_camera_is_refused() -> None:
    with pytest.raises(InputError, match="no camera named 'b'"):
        run(scene(camera("a", 0.0, 0.0, 45.0)))


def test_nothing_gives_nothing() -> None:
    assert list(detect_boxes([], scene())) == []
    (got,) = detect_boxes([Boxes.empty()], scene())
    assert (len(got.bearings), len(got.views), got.frames) == (0, 0, 0)


@pytest.mark.parametrize(
    ("given", "sigma_px"), [({"sigma_px": 4.0}, 4.0), ({"sigma_px": 4.0, "sigma_scale": 0.5}, 2.0)]
)
def test_a_given_noise_is_that_of_every_box_in_full_view(given: dict[str, float], sigma_px: float) -> None:
    (found,) = detect_boxes([BOXES], scene(), DetectConfig(**given))
    seen = found.bearings.take(found.bearings.seen)
    middle = np.abs(seen.u_px) < 20.0
    assert middle.any()
    np.testing.assert_allclose(seen.sigma_px[middle], sigma_px, rtol=0.02)
