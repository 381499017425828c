"""How far cameras disagree: against boxes with known errors."""

from __future__ import annotations

import numpy as np
from crowds import cameras_around

from occlog.track.methods.jipda.kernels.body_box import expected_box, pack_views
from occlog.track.methods.jipda.kernels.detections import DetectorModel, PackedDetections
from occlog.track.methods.jipda.kernels.lasting_errors.camera_disagreement import camera_disagreement

VIEWS = pack_views(cameras_around(4, 10.0, 8.0))
RATES = DetectorModel(
    np.full(4, 0.9), np.ones(6), 0.0, 0.0, np.zeros((4, 4)), np.array([[4.5, 0.0], [18.0, 0.0]] * 2), 0.0, np.ones(4),
    merge=np.zeros(4), common_miss=0.0, slow=1.0,
)  # fmt: skip


def test_a_common_shift_is_no_disagreement_and_noise_is_found_by_its_share() -> None:
    rng, squares, kept, positions = np.random.default_rng(0), [], [], []
    believed = np.array([[5.3, 4.2, 0.0, 0.0, 1.7, 0.5]])
    covariance = np.diag([1.0, 1.0, 1.0, 1.0, 1e-8, 1e-8])[None]
    for _ in range(400):
        box = np.empty((4, 4))
        for c in range(4):
            expected_box(VIEWS.lens[c], 5.0, 4.0, 1.7, 0.5, box[c])
        made = PackedDetections(np.arange(4), np.zeros(4), np.arange(5), box + rng.normal(0.0, 3.0, (4, 4)),
                     np.ones((4, 4), dtype=bool), np.zeros(4))  # fmt: skip
        owner = np.zeros(4, dtype=np.int64)
        found = camera_disagreement(believed, covariance, VIEWS, made, RATES, owner, owner == 0)
        squares.append(found.residual**2)
        kept.append(found.kept)
        positions.append(found.position[0])
    # The filter is 0.36 m off, and the noise is still that of the edges
    share = np.mean(kept, axis=(0, 1))
    np.testing.assert_allclose(np.mean(squares, axis=(0, 1)) / share, [4.5, 18.0, 4.5, 18.0], rtol=0.25)
    np.testing.assert_allclose(np.mean(positions, axis=0), [5.0, 4.0], atol=0.05)


def test_boxes_that_are_not_good_say_nothing() -> None:
    made = PackedDetections(
        np.arange(4), np.zeros(4), np.arange(5), np.ones((4, 4)), np.ones((4, 4), dtype=bool), np.zeros(4)
    )
    none = np.zeros(4, dtype=bool)
    mean, covariance = np.array([[5.0, 4.0, 0.0, 0.0, 1.7, 0.5]]), np.eye(6)[None]
    found = camera_disagreement(mean, covariance, VIEWS, made, RATES, np.zeros(4, dtype=np.int64), none)
    assert not found.kept.any()
    assert np.isnan(found.position).all()
