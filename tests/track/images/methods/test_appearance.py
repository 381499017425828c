"""The density of patches as a further likelihood: what it adds, whom it is remembered for; off by default."""

import numpy as np
import pytest

from occlog.measure.epipolar.views import TrackedView, ViewGeometry
from occlog.track.methods.images.interface import Birth, FrameSet
from occlog.track.methods.images.kernels.appearance import disc_points, learn_target, patch_log_likelihood
from occlog.track.methods.images.methods.config import CONFIGS, MipfConfig
from occlog.track.methods.images.methods.state import COMPONENTS, PATCHES, initial_state, learn_appearance, log_patches
from occlog.track.methods.images.methods.step import advance, initiate_trackers

W, H = 100, 80
VIEWS = (TrackedView("left", W, H), TrackedView("right", W, H))
NOWHERE = ViewGeometry(np.full((2, 2, 3, 3), np.nan), (None, None))
E = np.array([40.0, 38.0, 12.0, 9.0, 0.4])
PCA = MipfConfig(model="pca", pca_power=2.0)


def scene(seed):
    blocks = np.random.default_rng(seed).integers(0, 256, (H // 4, W // 4, 3))
    return np.kron(blocks, np.ones((4, 4, 1))).astype(np.uint8)


def frame_set(frame, *images):
    return FrameSet(40_000_000 * frame, np.full(len(images), frame), images)


def test_it_is_the_density_of_each_patch_to_a_power():
    images = scene(1), scene(2)
    births = [Birth(0, 3, E), Birth(1, 3, E), Birth(1, 8, E + np.array([20, 10, 0, 0, 0]))]
    models = learn_appearance({}, [], frame_set(0, *images), births, PCA)
    particles = np.array([b.ellipse for b in births])[:, None] + np.random.default_rng(3).normal(0, 1, (3, 4, 5))
    jitter = np.random.default_rng(0).standard_normal((PATCHES, 5))
    for i, birth in enumerate(births):
        model = learn_target(images[birth.view], birth.ellipse, jitter, COMPONENTS)
        want = patch_log_likelihood(images[birth.view], particles[i], np.zeros(4, dtype=np.int64), model)
        own = [models[birth.view, birth.target_id]]
        got = log_patches(images[birth.view], particles[i], np.zeros(4, dtype=np.int64), own, PCA)
        assert got == pytest.approx(2.0 / len(disc_points()) * want, rel=1e-9)


def test_patches_lie_as_the_trackers_do():
    """An ellipse with its axes in another order is the same one: its patches are likely where the tracker starts."""
    image, turned = scene(1), E[[0, 1, 3, 2, 4]] + np.array([0, 0, 0, 0, np.pi / 2])
    found = []
    for ellipse in (E, turned):
        state = initial_state(VIEWS, NOWHERE, PCA)
        state = initiate_trackers(state, frame_set(0, image, image), [Birth(0, 1, ellipse)])
        models, owner = [state.appearance[0, 1]], np.zeros(1, dtype=np.int64)
        found.append(log_patches(image, state.trackers.estimate, owner, models, PCA)[0])
    assert found[1] == pytest.approx(found[0], rel=1e-6)


def test_only_trackers_that_are_left_are_remembered():
    image = scene(1)
    first = learn_appearance({}, [], frame_set(0, image, image), [Birth(0, 1, E), Birth(1, 2, E)], PCA)
    later = learn_appearance(first, [(1, 2)], frame_set(5, image, image), [Birth(1, 4, E)], PCA)
    assert sorted(later) == [(1, 2), (1, 4)]
    assert later[1, 2] is first[1, 2]
    assert learn_appearance({}, [], frame_set(0, image, image), [Birth(0, 1, E)], MipfConfig()) == {}


def test_colours_alone_are_the_default():
    assert all(config().model == "colour" for config in CONFIGS.values())


@pytest.mark.jit
@pytest.mark.parametrize("method", sorted(CONFIGS))
def test_every_method_takes_it_and_holds_a_target_by_it(method):
    """A grey pattern that moves; with its patches it is followed as well as by its shades, and estimates differ."""
    pattern = np.random.default_rng(4).integers(0, 256, (5, 5)).repeat(4, axis=0).repeat(4, axis=1)
    found = {}
    for model in ("colour", "pca"):
        config, rng = CONFIGS[method](model=model, particles=60), np.random.default_rng(5)
        state, errors = initial_state(VIEWS, NOWHERE, config), []
        for t in range(10):
            image = np.random.default_rng(t).integers(110, 140, (H, W)).astype(np.uint8)
            image[20:40, 20 + 3 * t : 40 + 3 * t] = pattern
            centre = np.array([29.5 + 3 * t, 29.5])
            if t == 0:
                state = initiate_trackers(
                    state, frame_set(0, image, image), [Birth(v, 1, np.array([*centre, 9, 9, 0])) for v in (0, 1)]
                )
                continue
            state, outlines = advance(state, frame_set(t, image, image), rng)
            errors.append(np.hypot(*(outlines.ellipse[:, :2] - centre).T))
        found[model] = np.array(errors)
    assert found["pca"].max() < 9.0
    assert not np.array_equal(found["pca"], found["colour"])
