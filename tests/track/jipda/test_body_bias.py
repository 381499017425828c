"""Error of the body model in the covariances of positions."""

from __future__ import annotations

import numpy as np
import pytest
from people_boxes import hall

from occlog.track.methods.jipda.config import JipdaConfig
from occlog.track.methods.jipda.detector_model import detector_model, prior_edge_errors, prior_statistics
from occlog.track.methods.jipda.interface import PositionSource
from occlog.track.methods.jipda.kernels.body_box import box_and_slope, cover_positions, pack_views
from occlog.track.methods.jipda.kernels.detections import DetectorModel, axis_noise
from occlog.track.methods.jipda.kernels.lasting_errors.body_bias import body_bias_shift
from occlog.track.methods.jipda.lasting_errors.body_bias import PRIOR_SIGMA, bias_information, with_body_bias

MEAN = np.array([[4.5, 5.5, 0.0, 0.0, 1.75, 0.5]])
COVARIANCE = np.diag([0.01, 0.01, 1.0, 1.0, 0.01, 0.0025])[None]


def rates_of(cameras: int) -> DetectorModel:
    config = JipdaConfig()
    return detector_model(
        prior_statistics(cameras, config), prior_edge_errors(cameras, 1.0, config), config, np.full(cameras, 0.1)
    )


@pytest.mark.parametrize("names", ["a", "ab", "abcd"])
def test_shift_is_that_of_weighted_least_squares(names: str) -> None:
    """Boxes that are lower by a thousandth of their heights move the solution by a thousandth of the shift."""
    scene = hall(names)
    views, rates = pack_views(scene.cameras), rates_of(len(names))
    shift, _ = body_bias_shift(MEAN, COVARIANCE, views, rates)
    rows, right, weight = [], [], []
    for c in range(len(names)):
        box, slope = np.zeros(4), np.zeros((4, 6))
        assert box_and_slope(views.lens[c], MEAN[0], 0.0, box, slope) > 0.0
        for axis in range(2):
            middle, size = axis_noise(rates, axis, box[2] - box[0], box[3] - box[1], 1.0)
            rows += [0.5 * (slope[axis] + slope[axis + 2]), slope[axis + 2] - slope[axis]]
            right += [0.001 * (box[3] - box[1]) if axis else 0.0, 0.0]
            weight += [1.0 / middle, 1.0 / size]
    # Heights and widths have priors
    rows += [np.eye(6)[4], np.eye(6)[5]]
    right += [0.0, 0.0]
    weight += [100.0, 400.0]
    root = np.sqrt(weight)
    free = [0, 1, 4, 5]
    solution = np.linalg.lstsq(root[:, None] * np.array(rows)[:, free], root * np.array(right), rcond=None)[0]
    np.testing.assert_allclose(0.001 * shift[0], solution[:2], rtol=1e-6)


def test_cameras_around_a_person_cancel_and_find_the_bias() -> None:
    for names, most, least in (("abcd", 0.35, 0.0), ("a", 1.0, 1.0), ("ab", 0.8, 0.4)):
        scene = hall(names)
        shift, share = body_bias_shift(MEAN, COVARIANCE, pack_views(scene.cameras), rates_of(len(names)))
        assert least <= share[0] <= most
        if names == "a":
            # Along the line of sight, as the cotangent of the angle to the ground says
            away = MEAN[0, :2] - scene.cameras[0].position[:2]
            assert abs(away[0] * shift[0, 1] - away[1] * shift[0, 0]) < 0.1 * np.hypot(*away) * np.hypot(*shift[0])
            assert bias_information(share, 100.0) == pytest.approx(0.0, abs=1e-6)
        else:
            assert bias_information(share, 5.0) > 0.3 / 0.03**2


def test_covariances_contain_what_is_not_known() -> None:
    shift = np.array([[3.0, 4.0]])
    wide = with_body_bias(COVARIANCE, shift, 0.0)
    np.testing.assert_allclose((wide - COVARIANCE)[0, :2, :2], PRIOR_SIGMA**2 * np.array([[9.0, 12.0], [12.0, 16.0]]))
    known = with_body_bias(COVARIANCE, shift, 3.0 / PRIOR_SIGMA**2)
    np.testing.assert_allclose((known - COVARIANCE)[0, 0, 0], PRIOR_SIGMA**2 * 9.0 / 4.0)


def test_positions_on_the_ground_have_no_such_bias() -> None:
    views = pack_views([*hall("a").cameras, PositionSource("lidar")])
    views = cover_positions(views, 1, np.array([[0.0, 0.0], [10.0, 10.0]]), 1.0)
    shift, share = body_bias_shift(MEAN, COVARIANCE, views, rates_of(2))
    assert not shift.any()
    assert share[0] == 0.0
