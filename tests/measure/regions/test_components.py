from __future__ import annotations

import numpy as np
import pytest

from occlog.core.image import pixel_bin
from occlog.measure.clusters.merged_silhouettes import APART_FRAMES, SeparateSightings
from occlog.measure.clusters.person_size import constant_sizes, make_prior
from occlog.measure.regions.regions import ForegroundRegions, cluster_regions, component_regions, histogram

SIZE = (160, 120)
SIZES = constant_sizes(SIZE, 48.0)
PRIOR = make_prior(SIZES, 2.0, 0.1, 0.2)


def picture() -> tuple[np.ndarray, np.ndarray]:
    """Two people, a red one and a blue one, and a speck."""
    image = np.random.default_rng(0).integers(90, 110, (SIZE[1], SIZE[0], 3), dtype=np.uint8)
    mask = np.zeros((SIZE[1], SIZE[0]), dtype=np.uint8)
    for left, height, colour in ((30, 50, (10, 10, 250)), (100, 40, (250, 30, 20))):
        image[40 : 40 + height, left : left + 15] = colour
        mask[40 : 40 + height, left : left + 15] = 255
    mask[3:6, 3:6] = 255
    return image, mask


def regions(method: str, image: np.ndarray, mask: np.ndarray) -> ForegroundRegions:
    if method == "em":
        return cluster_regions(image, mask, 3, PRIOR)
    return component_regions(image, mask, SIZES.width_px, PRIOR)


@pytest.mark.parametrize("method", ["em", "components"])
def test_both_methods_measure_two_people_alike(method: str) -> None:
    image, mask = picture()
    got = regions(method, image, mask)
    np.testing.assert_allclose(got.means, [[37, 64.5], [107, 59.5]], atol=0.02)
    np.testing.assert_allclose(got.boxes, [[29.5, 39.5, 15, 50], [99.5, 39.5, 15, 40]])
    np.testing.assert_allclose(got.mass, [750, 600], rtol=1e-3)
    # Spread of n pixels in a row: (n^2 - 1) / 12.
    np.testing.assert_allclose(got.covs[:, 0], (15**2 - 1) / 12, rtol=0.01)
    np.testing.assert_allclose(got.covs[:, 2], [(50**2 - 1) / 12, (40**2 - 1) / 12], rtol=0.01)
    np.testing.assert_allclose(got.person, np.tile(SIZES.cov[0], (2, 1)))
    np.testing.assert_allclose(got.fill, got.mass / SIZES.mass[0])


@pytest.mark.parametrize("method", ["em", "components"])
def test_appearance_is_the_histogram_of_the_regions_pixels(method: str) -> None:
    image, mask = picture()
    got = regions(method, image, mask)
    red = np.zeros_like(mask)
    red[40:90, 30:45] = 1
    np.testing.assert_allclose(got.appearance[0], histogram(image, red))
    assert got.appearance[1, pixel_bin(250, 30, 20)] == 1.0


@pytest.mark.parametrize("method", ["em", "components"])
def test_nothing_is_found_where_there_is_nothing(method: str) -> None:
    image, mask = picture()
    got = regions(method, image, np.zeros_like(mask))
    assert got.means.shape == (0, 2)
    assert got.appearance.shape == (0, 72)


@pytest.mark.parametrize("method", ["em", "components"])
def test_grey_images_are_measured_too(method: str) -> None:
    image, mask = picture()
    got = regions(method, image[:, :, 1].copy(), mask)
    assert got.appearance[:, :64].sum() == 0.0
    np.testing.assert_allclose(got.appearance.sum(axis=1), 1.0)


def test_components_join_pieces_across_a_small_gap_but_not_a_large_one() -> None:
    image, mask = picture()
    mask[60:62, 30:45] = 0
    assert len(regions("components", image, mask).mass) == 2
    mask[55:67, 30:45] = 0
    assert len(regions("components", image, mask).mass) == 3


def test_touching_people_are_one_component_but_two_clusters() -> None:
    image, mask = picture()
    mask[:] = 0
    mask[40:88, 30:46] = 255
    mask[40:88, 47:63] = 255
    assert len(regions("components", image, mask).mass) == 1
    assert len(regions("em", image, mask).mass) == 2


def test_components_are_ordered_by_pixels_not_by_the_area_after_joining() -> None:
    image, mask = picture()
    mask[40:90:3, 30:45] = 0  # the taller one is striped
    got = regions("components", image, mask)
    assert np.all(np.diff(got.mass) <= 0)
    assert got.mass[0] == 600


def test_people_alone_are_the_same_with_outlines_and_those_who_overlap_are_more_with_whole_boxes() -> None:
    image, mask = picture()
    for mine, theirs in zip(
        cluster_regions(image, mask, 3, PRIOR, SeparateSightings(APART_FRAMES)),
        cluster_regions(image, mask, 3, PRIOR),
        strict=True,
    ):
        np.testing.assert_array_equal(mine, theirs)
    # One stands before the other, half a width aside and a little lower
    mask[:] = 0
    y, x = np.mgrid[0 : SIZE[1], 0 : SIZE[0]]
    for u, v in ((60, 60), (69, 52)):
        for du, dv, ru, rv in ((0, -20.5, 2.5, 3.5), (0, -8, 6, 10), (-3, 12, 3, 12), (3, 12, 3, 12)):
            mask[((x - u - du) / ru) ** 2 + ((y - v - dv) / rv) ** 2 <= 1.0] = 255
    assert len(cluster_regions(image, mask, 3, PRIOR).mass) == 1
    whole = cluster_regions(image, mask, 3, PRIOR, SeparateSightings(APART_FRAMES))
    assert len(whole.mass) == 2
    np.testing.assert_allclose(whole.boxes[:, 3], 48, rtol=0.15)
