"""Patches against plain interpolation, densities against eigenvectors of the covariance and full Gaussians."""

import math

import numpy as np
import pytest

from occlog.track.methods.images.kernels.appearance import (
    PatchModels,
    disc_points,
    learn_patches,
    learn_target,
    log_density,
    patch_log_likelihood,
    stack_models,
    warp_patches,
)


def gaussian(x, mean, covariance):
    gap = x - mean
    return -0.5 * (gap @ np.linalg.solve(covariance, gap) + np.linalg.slogdet(2.0 * np.pi * covariance)[1])


def one_density(patch, model, m=0):
    return log_density(patch[None], np.array([m]), *model)[0]


def correlated(rng, n, d):
    return rng.standard_normal((n, d)) @ rng.standard_normal((d, d)) + rng.standard_normal(d)


def test_full_rank_is_the_exact_gaussian():
    rng = np.random.default_rng(1)
    for d in (1, 3, 8):
        patches = correlated(rng, 60, d)
        model = learn_patches(patches, d, 1e-12)
        covariance = np.atleast_2d(np.cov(patches.T, bias=True))
        for x in rng.standard_normal((4, d)):
            assert one_density(x, model) == pytest.approx(gaussian(x, patches.mean(axis=0), covariance), rel=1e-9)


def test_components_are_the_eigenvectors_and_the_rest_is_their_mean():
    rng = np.random.default_rng(2)
    patches, d, k = correlated(rng, 40, 9), 9, 4
    values, vectors = np.linalg.eigh(np.cov(patches.T, bias=True))
    values, vectors = values[::-1], vectors[:, ::-1]
    model = learn_patches(patches, k, 1e-12)
    assert model.variance[0] == pytest.approx(values[:k], rel=1e-9)
    assert model.rest[0] == pytest.approx(values[k:].mean(), rel=1e-9)
    covariance = vectors @ np.diag(np.r_[values[:k], np.full(d - k, values[k:].mean())]) @ vectors.T
    for x in rng.standard_normal((4, d)):
        assert one_density(x, model) == pytest.approx(gaussian(x, patches.mean(axis=0), covariance), rel=1e-9)


def test_few_patches_make_few_components():
    patches = np.random.default_rng(3).standard_normal((4, 20))
    assert learn_patches(patches, 10).basis.shape == (1, 3, 20)
    alone = learn_patches(patches[:1], 10, 0.5)
    assert alone.basis.shape == (1, 0, 20)
    assert alone.rest.tolist() == [0.5]
    assert one_density(patches[0], alone) == pytest.approx(-10 * math.log(2 * math.pi * 0.5))


def test_stacked_models_say_what_each_says():
    rng = np.random.default_rng(4)
    models = [learn_patches(correlated(rng, n, 6), 4) for n in (9, 1, 3)]
    patches, owner = rng.standard_normal((7, 6)), np.array([0, 1, 2, 0, 2, 1, 1])
    got = log_density(patches, owner, *stack_models(models))
    assert got == pytest.approx([one_density(x, models[m]) for x, m in zip(patches, owner, strict=True)], rel=1e-12)


def test_patches_are_turned_and_read_linearly():
    rng = np.random.default_rng(5)
    image, points = rng.integers(0, 256, (30, 40, 3)).astype(np.uint8), disc_points(8)
    grey, e = image.mean(axis=2), np.array([19.3, 14.8, 9.0, 5.0, 0.7])
    want = []
    for u, v in points * e[2:4]:
        x, y = e[0] + math.cos(e[4]) * u - math.sin(e[4]) * v, e[1] + math.sin(e[4]) * u + math.cos(e[4]) * v
        i, j = math.floor(y), math.floor(x)
        corner = grey[i : i + 2, j : j + 2]
        want.append([1 - y + i, y - i] @ corner @ [1 - x + j, x - j])
    want = (np.array(want) - np.mean(want)) / np.std(want)
    assert warp_patches(image, e[None], points)[0] == pytest.approx(want, abs=1e-9)


def test_a_patch_over_the_border_reads_the_images_edge_again():
    image, points = np.random.default_rng(7).integers(0, 256, (30, 40, 3)).astype(np.uint8), disc_points(8)
    e = np.array([[39.2, 14.8, 9.0, 5.0, 0.7], [0.4, 29.0, 9.0, 5.0, -0.3], [20.0, -1.5, 9.0, 5.0, 1.2]])
    wide = np.pad(image, ((20, 20), (20, 20), (0, 0)), mode="edge")
    assert warp_patches(image, e, points) == pytest.approx(
        warp_patches(wide, e + 20.0 * np.eye(5)[:2].sum(axis=0), points), abs=1e-9
    )


def test_brightness_and_contrast_do_not_count():
    image = np.random.default_rng(6).integers(0, 100, (30, 40)).astype(np.uint8)
    e = np.array([[20.0, 15.0, 9.0, 6.0, 0.3], [38.0, 2.0, 9.0, 6.0, 0.3]])
    plain, lit = (warp_patches(i[..., None], e, disc_points()) for i in (image, (2 * image + 30).astype(np.uint8)))
    assert lit == pytest.approx(plain, abs=1e-9)
    flat = np.full((30, 40, 1), 9, dtype=np.uint8)
    assert not warp_patches(flat, e, disc_points()).any()


def test_points_fill_the_disc():
    points = disc_points(16)
    assert (np.hypot(*points.T) <= 1.0).all()
    assert len(points) == pytest.approx(math.pi / 4 * 256, rel=0.05)


def test_an_axis_has_no_direction():
    """Opposite points are in the opposite order, and half a turn makes no difference."""
    points = disc_points()
    assert np.array_equal(points[::-1], -points)
    rng = np.random.default_rng(8)
    image = rng.integers(0, 256, (30, 40)).astype(np.uint8)
    e = np.array([19.3, 14.8, 9.0, 5.0, 0.7])
    model = learn_target(image, e, rng.standard_normal((20, 5)), 6)
    tried = e + 0.3 * rng.standard_normal((5, 5))
    owner = np.zeros(5, dtype=np.int64)
    got = patch_log_likelihood(image, tried, owner, model)
    assert patch_log_likelihood(image, np.add(tried, [0, 0, 0, 0, np.pi]), owner, model) == pytest.approx(got)
    assert got == pytest.approx(log_density(warp_patches(image[..., None], tried, points), owner, *model))


def test_target_is_likelier_in_its_own_place():
    rng = np.random.default_rng(7)
    image = np.kron(rng.integers(0, 256, (15, 20)), np.ones((4, 4))).astype(np.uint8)
    e = np.array([40.0, 30.0, 12.0, 9.0, 0.2])
    model = learn_target(image, e, rng.standard_normal((30, 5)), 8)
    assert isinstance(model, PatchModels)
    shifts = np.array([[0, 0], [3, 0], [0, 6], [20, 10]])
    tried = np.column_stack([e[:2] + shifts, np.tile(e[2:], (4, 1))])
    own, *others = patch_log_likelihood(image, tried, np.zeros(4, dtype=np.int64), model)
    assert own > max(others)
