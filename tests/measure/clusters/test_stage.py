from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from occlog.measure.clusters.em import group_worth, merge, split, union
from occlog.measure.clusters.person_size import Prior, constant_sizes, make_prior
from occlog.measure.clusters.stage import Clusters, cell_side, find_clusters
from occlog.measure.regions.regions import gather

SIZE = (160, 120)
HEIGHT = 48  # of a person [px]
WIDTH = 16


def the_prior(height: float = HEIGHT) -> Prior:
    return make_prior(constant_sizes(SIZE, height), 2.0, 0.1, 0.2)


def body(mask: np.ndarray, x: int, y: int, rows: slice = slice(None)) -> None:
    """Draw a filled ellipse of a person's size centred at (x, y), or some of its rows."""
    v, u = np.mgrid[0 : mask.shape[0], 0 : mask.shape[1]]
    inside = ((u - x) / (WIDTH / 2)) ** 2 + ((v - y) / (HEIGHT / 2)) ** 2 <= 1.0
    kept = np.zeros_like(inside)
    kept[rows] = True
    mask[inside & kept] = 255


def clusters_of(mask: np.ndarray, prior: Prior | None = None) -> Clusters:
    cells, corners = gather(mask, 3)
    return find_clusters(cells, corners, 3, prior or the_prior())


def empty() -> np.ndarray:
    return np.zeros((SIZE[1], SIZE[0]), dtype=np.uint8)


def test_one_body_is_one_cluster_with_the_moments_of_its_pixels() -> None:
    mask = empty()
    body(mask, 70, 60)
    got = clusters_of(mask)
    y, x = np.nonzero(mask)
    assert len(got.mass) == 1
    np.testing.assert_allclose(got.means[0], [x.mean(), y.mean()], atol=0.1)
    np.testing.assert_allclose(got.covs[0], [x.var(), 0.0, y.var()], atol=0.5, rtol=0.05)
    assert got.mass[0] == pytest.approx(len(x), rel=0.01)
    # An ellipse fills pi / 4 of its box, a walking person about 0.6.
    assert got.fill[0] == pytest.approx(np.pi / 4 / 0.6, rel=0.1)


@pytest.mark.parametrize("gap", [0, 2, 6])
def test_two_bodies_side_by_side_are_two_clusters(gap: int) -> None:
    mask = empty()
    body(mask, 60, 60)
    body(mask, 60 + WIDTH + gap, 60)
    got = clusters_of(mask)
    assert len(got.mass) == 2
    np.testing.assert_allclose(np.sort(got.means[:, 0]), [60, 60 + WIDTH + gap], atol=1.0)


def test_a_body_in_three_pieces_is_one_cluster() -> None:
    mask = empty()
    for rows in (slice(36, 48), slice(52, 64), slice(70, 84)):
        body(mask, 80, 60, rows)
    got = clusters_of(mask)
    assert len(got.mass) == 1
    np.testing.assert_allclose(got.means[0], [80, 60], atol=2.0)


def test_isolated_small_blobs_are_dropped_and_do_not_pull_a_cluster() -> None:
    mask = empty()
    body(mask, 100, 60)
    alone = clusters_of(mask).means[0]
    mask[5:10, 5:10] = 255
    mask[110:114, 30:36] = 255
    got = clusters_of(mask)
    assert len(got.mass) == 1
    np.testing.assert_allclose(got.means[0], alone, atol=0.2)


def test_specks_all_over_are_no_cluster() -> None:
    mask = np.where(np.random.default_rng(0).random((SIZE[1], SIZE[0])) < 0.01, 255, 0).astype(np.uint8)
    assert len(clusters_of(mask).mass) == 0


def test_an_empty_mask_has_no_clusters() -> None:
    got = clusters_of(empty())
    assert len(got.mass) == 0
    assert got.means.shape == (0, 2)


@pytest.mark.jit
def test_a_full_mask_is_specks_and_half_of_one_ends() -> None:
    mask = np.full((SIZE[1], SIZE[0]), 255, dtype=np.uint8)
    assert len(clusters_of(mask).mass) == 0
    mask[:, 80:] = 0
    got = clusters_of(mask)
    assert 1 <= len(got.mass) <= 64
    assert np.isfinite(got.covs).all()


@given(st.lists(st.tuples(st.integers(12, 147), st.integers(26, 93)), min_size=1, max_size=4))
def test_clusters_are_ordered_labelled_and_hold_all_they_say(places: list[tuple[int, int]]) -> None:
    mask = empty()
    for x, y in places:
        body(mask, x, y)
    got = clusters_of(mask)
    assert np.all(np.diff(got.mass) <= 0)
    assert 1 <= len(got.mass) <= 2 * len(places)
    assert got.labels.min() >= -1
    assert got.labels.max() < len(got.mass)
    assert got.mass.sum() <= np.count_nonzero(mask) * (1 + 1e-9)
    # The most there is to find is found.
    assert got.mass.sum() > 0.8 * np.count_nonzero(mask)


def test_the_same_mask_gives_the_same_clusters() -> None:
    mask = empty()
    body(mask, 50, 50)
    body(mask, 60, 58)
    for a, b in zip(clusters_of(mask), clusters_of(mask), strict=True):
        np.testing.assert_array_equal(a, b)


def test_clusters_move_with_the_bodies() -> None:
    first, second = empty(), empty()
    for mask, dx in ((first, 0), (second, 30)):
        body(mask, 40 + dx, 60)
        body(mask, 70 + dx, 62)
    np.testing.assert_allclose(clusters_of(second).means - clusters_of(first).means, [[30, 0], [30, 0]], atol=0.3)


def test_a_tilted_person_is_found_with_a_tilted_prior() -> None:
    sizes = constant_sizes(SIZE, HEIGHT)
    c, s = np.cos(0.4), np.sin(0.4)
    across, along = sizes.cov[0, 0], sizes.cov[0, 2]
    turned = np.array([c * c * across + s * s * along, c * s * (across - along), s * s * across + c * c * along])
    prior = make_prior(
        type(sizes)(SIZE, sizes.shape, np.tile(turned, (len(sizes.mass), 1)), sizes.mass, sizes.spread), 2.0, 0.1, 0.2
    )
    v, u = np.mgrid[0 : SIZE[1], 0 : SIZE[0]]
    mask = empty()
    for x in (60.0, 60.0 + 1.1 * WIDTH):
        p, q = c * (u - x) + s * (v - 60), -s * (u - x) + c * (v - 60)
        mask[(p / (WIDTH / 2)) ** 2 + (q / (HEIGHT / 2)) ** 2 <= 1] = 255
    got = clusters_of(mask, prior)
    assert len(got.mass) == 2
    np.testing.assert_allclose(np.sort(got.means[:, 0]), [60.0, 60.0 + 1.1 * WIDTH], atol=1.5)


def test_union_is_the_moments_of_both() -> None:
    rng = np.random.default_rng(1)
    points = rng.normal(size=(30, 2)) * [3, 8]

    def group(p: np.ndarray) -> np.ndarray:
        d = p - p.mean(axis=0)
        s = d.T @ d
        return np.array([len(p), *p.mean(axis=0), s[0, 0], s[0, 1], s[1, 1]])

    np.testing.assert_allclose(union(group(points[:12]), group(points[12:])), group(points))


def test_merging_and_splitting_raise_the_worth_of_all_clusters() -> None:
    prior = the_prior()
    mask = empty()
    for x in (40, 58, 100):
        body(mask, x, 60)
    cells, _ = gather(mask, 3)
    labels = np.where(cells[:, 1] < 80, 0, 1)
    groups = np.array([[0.0] * 6, [0.0] * 6])
    for k in (0, 1):
        for cell in cells[labels == k]:
            groups[k] = union(cell, groups[k])
    diverged = split(cells, labels, groups, prior)
    assert len(diverged) == 3
    assert sum(group_worth(g, prior) for g in diverged) > sum(group_worth(g, prior) for g in groups)
    # Thin slices of one body belong together.
    slices = np.array([[100, 50 + 2.0 * i, 60, 33, 0, 14000] for i in range(4)])
    covs = np.tile([20.0, 0.0, 150.0], (4, 1))
    together = merge(slices, covs, np.zeros((4, 4)), prior)
    assert len(together) == 1
    gain = group_worth(together[0], prior) - sum(group_worth(g, prior) for g in slices)
    assert gain > 0
    # Pixels that clusters explain together are an argument for keeping them apart.
    shared = np.full((4, 4), gain)
    assert len(merge(slices, covs, shared, prior)) == 4


def test_cells_are_a_tenth_of_a_person() -> None:
    assert cell_side(constant_sizes(SIZE, 120.0)) == 4
    assert cell_side(constant_sizes(SIZE, 10.0)) == 2
    assert cell_side(constant_sizes(SIZE, 2000.0)) == 16
