from __future__ import annotations

import numpy as np
import pytest

from occlog.measure.clusters.merged_silhouettes import APART_FRAMES, Crowds, SeparateSightings, split_silhouettes
from occlog.measure.clusters.person_size import constant_sizes, make_prior
from occlog.measure.clusters.stage import find_clusters
from occlog.measure.regions.regions import gather

HEIGHT, SIDE = 96, 3
PRIOR = make_prior(constant_sizes((320, 240), HEIGHT), 2.0, 0.1, 0.2)


def person(mask: np.ndarray, x: int, y: int) -> None:
    """A head, a trunk and two legs whose middle is at (x, y)."""
    v, u = np.mgrid[0 : mask.shape[0], 0 : mask.shape[1]]
    for du, dv, ru, rv in ((0, -41, 5, 7), (0, -16, 12, 20), (-6, 24, 6, 24), (6, 24, 6, 24)):
        mask[((u - x - du) / ru) ** 2 + ((v - y - dv) / rv) ** 2 <= 1.0] = 255


def crowds(mask: np.ndarray, apart: SeparateSightings | None = None) -> Crowds:
    """What a camera makes of a frame that has seen several people apart, by default."""
    cells, corners = gather(mask, SIDE)
    apart = SeparateSightings(APART_FRAMES) if apart is None else apart
    return split_silhouettes(cells, corners, SIDE, PRIOR, find_clusters(cells, corners, SIDE, PRIOR), apart)


@pytest.mark.jit
def test_silhouettes_hold_several_once_several_were_seen_apart() -> None:
    touching, apart, alone = (np.zeros((240, 320), dtype=np.uint8) for _ in range(3))
    for mask, places in ((touching, ((150, 120), (168, 104))), (apart, ((80, 120), (200, 120))), (alone, ((80, 120),))):
        for position in places:
            person(mask, *position)
    seen = SeparateSightings()
    for _ in range(2 * APART_FRAMES):  # one person, and two who touch, were never seen apart
        crowds(alone, seen)
        assert len(crowds(touching, seen).boxes) == 1
    assert seen.frames == 0
    for _ in range(APART_FRAMES - 1):
        crowds(apart, seen)
    assert len(crowds(touching, seen).boxes) == 1
    crowds(apart, seen)
    assert len(crowds(touching, seen).boxes) == 2


def test_people_of_whom_one_hides_the_half_of_another_are_two_with_boxes() -> None:
    mask = np.zeros((240, 320), dtype=np.uint8)
    for x, y in ((150, 120), (168, 104)):
        person(mask, x, y)
    cells, corners = gather(mask, SIDE)
    assert len(find_clusters(cells, corners, SIDE, PRIOR).mass) == 1
    got = crowds(mask)
    assert len(got.boxes) == 2
    order = np.argsort(got.boxes[:, 0])
    middles = got.boxes[order, :2] + 0.5 * got.boxes[order, 2:]
    np.testing.assert_allclose(middles, [[150, 120], [168, 104]], atol=6.0)
    np.testing.assert_allclose(got.boxes[:, 3], HEIGHT, rtol=0.1)
    # Every pixel is somebody's, and masses are those of the labels, by falling mass
    clusters = got.clusters
    labelled = [cells[clusters.labels == k, 0].sum() for k in range(2)]
    np.testing.assert_allclose(clusters.mass, labelled)
    assert clusters.mass.sum() == pytest.approx((mask > 0).sum(), rel=0.02)
    assert clusters.mass[0] >= clusters.mass[1]


@pytest.mark.parametrize("apart", [0, 60])
def test_people_who_stand_alone_are_their_clusters(apart: int) -> None:
    mask = np.zeros((240, 320), dtype=np.uint8)
    for x in {130, 130 + apart}:
        person(mask, x, 120)
    cells, corners = gather(mask, SIDE)
    want = find_clusters(cells, corners, SIDE, PRIOR)
    got = crowds(mask)
    assert np.isnan(got.boxes).all()
    for mine, theirs in zip(got.clusters, want, strict=True):
        np.testing.assert_array_equal(mine, theirs)


def test_people_behind_a_post_are_left_to_the_clusters() -> None:
    mask = np.zeros((240, 320), dtype=np.uint8)
    for x, y in ((150, 120), (168, 104)):
        person(mask, x, y)
    mask[:, 158:170] = 0
    got = crowds(mask)
    assert len(got.boxes) > 0
    assert np.isnan(got.boxes).all()


def test_a_frame_without_foreground_holds_no_one() -> None:
    got = crowds(np.zeros((240, 320), dtype=np.uint8))
    assert len(got.boxes) == len(got.clusters.mass) == 0
