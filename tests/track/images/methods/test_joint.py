"""The joint filters: weights against plain forms, two targets followed, what ends a tracker, what may not change."""

import copy

import numpy as np
import pytest
from view_reference import bins_of

from occlog.errors import InputError
from occlog.measure.epipolar.views import TrackedView, ViewGeometry
from occlog.track.methods.images.interface import LEFT, MODES, TERMINATED, Birth, FrameSet
from occlog.track.methods.images.kernels.appearance import colour_similarity
from occlog.track.methods.images.kernels.joint_samples import overlap
from occlog.track.methods.images.methods.config import McmcConfig
from occlog.track.methods.images.methods.joint import ViewFrame, run_mcmc, run_sir
from occlog.track.methods.images.methods.state import end_trackers, initial_state
from occlog.track.methods.images.methods.step import advance, initiate_trackers
from occlog.track.methods.images.methods.weigh import arrival_of

W, H, R = 120, 90, 9.0
VIEWS = (TrackedView("left", W, H), TrackedView("right", W, H))
NOWHERE = ViewGeometry(np.full((2, 2, 3, 3), np.nan), (None, None))
COLOURS = np.array([[30, 60, 220], [220, 80, 30]], dtype=np.uint8)
BOTH = pytest.mark.parametrize("sampler", ["mcmc", "sir"])


def picture(places, seed=0, colours=COLOURS):
    """Grey noise with discs of two colours."""
    image = np.random.default_rng(seed).integers(100, 140, (H, W, 1)).astype(np.uint8).repeat(3, axis=2)
    y, x = np.mgrid[:H, :W]
    for (cx, cy), colour in zip(places, colours, strict=False):
        image[np.hypot(x - cx, y - cy) <= R] = colour
    return image


def frame_set(frame, *images):
    have = np.array([frame if image is not None else -1 for image in images])
    return FrameSet(40_000_000 * frame, have, images)


def disc(place):
    return np.array([*place, R, R, 0.0])


def begin(places, views=(0, 1), image=None, **settings):
    config = McmcConfig(**{"particles": 100, **settings})
    state = initial_state(VIEWS, NOWHERE, config)
    births = [Birth(v, 10 + i, disc(p)) for v in views for i, p in enumerate(places)]
    image = picture(places) if image is None else image
    return initiate_trackers(state, frame_set(0, image, image), births)


def paths(frames):
    """Two discs that pass each other, one behind the other."""
    t = np.arange(frames)
    return np.stack([np.column_stack([20 + 2.0 * t, 40 + 0 * t]), np.column_stack([100 - 2.0 * t, 46 + 0 * t])], axis=1)


@pytest.mark.jit
@BOTH
def test_two_targets_are_followed_through_each_other(sampler):
    """Mean error in the last frames below half a radius, in each view."""
    way = paths(36)
    state, rng = begin(way[0], sampler=sampler), np.random.default_rng(1)
    errors = []
    for t in range(1, 36):
        image = picture(way[t], t)
        state, o = advance(state, frame_set(t, image, image), rng)
        assert o.view.tolist() == [0, 0, 1, 1]
        assert o.target_id.tolist() == [10, 11, 10, 11]
        assert (o.likelihood_mode == MODES.index("mcmc")).all()
        assert not o.lifecycle.any()
        assert ((o.ess >= 1) & (o.ess <= 100)).all()
        assert (o.covariance[:, [0, 2]] > 0).all()
        errors.append(np.hypot(*(o.ellipse[:, :2] - np.tile(way[t], (2, 1))).T))
    assert np.mean(errors[-8:], axis=0) == pytest.approx(np.zeros(4), abs=0.5 * R)
    touch = o.touching
    assert not touch[:2, 2:].any()


def first_frame(state, image):
    frames, rows = frame_set(1, image, None), np.flatnonzero(state.trackers.view == 0)
    return ViewFrame(state, state.config, frames, arrival_of(state, frames), rows)


def test_sir_weighs_by_the_product_over_targets_and_the_prior():
    way = [(40, 40), (52, 44), (80, 30)]
    image = picture(way)
    state = begin(way, image=image, sampler="sir", particles=30, overlap_penalty=1.5)
    frame = first_frame(state, image)
    samples = run_sir(frame, np.random.default_rng(3))
    whole, t = bins_of(image), state.trackers
    for k in range(30):
        sample, want = samples.particles[:, k], 0.0
        bc = colour_similarity(whole, sample, np.arange(3), t.colours, t.split, 2)
        want = sum((b - 1.0) / (2 * 0.1**2) for b in bc)
        want -= 1.5 * sum(overlap(sample[i], sample[j]) for i in range(3) for j in range(i))
        assert samples.log_weights[k] == pytest.approx(want, rel=1e-9)
    w = np.exp(samples.log_weights - samples.log_weights.max())
    assert samples.ess == pytest.approx(np.full(3, w.sum() ** 2 / (w * w).sum()))


@pytest.mark.jit
def test_both_samplers_have_the_same_posterior():
    """Means and spreads of two targets that overlap, over 12 runs each; 4 standard errors, and 0.1 px for burn-in."""
    way = [(40, 40), (50, 44)]
    image = picture(way)
    found = {}
    for sampler, count in (("mcmc", 1500), ("sir", 4000)):
        state = begin(way, image=image, sampler=sampler, particles=count)
        run, rows = run_mcmc if sampler == "mcmc" else run_sir, []
        for seed in range(12):
            samples = run(first_frame(state, image), np.random.default_rng(seed))
            w = np.exp(samples.log_weights - samples.log_weights.max())
            places = samples.particles[..., :2]
            middle = np.einsum("k,nkc->nc", w / w.sum(), places)
            spread = np.einsum("k,nkc->nc", w / w.sum(), (places - middle[:, None]) ** 2) ** 0.5
            rows.append(np.concatenate([middle.ravel(), spread.ravel()]))
        found[sampler] = np.mean(rows, axis=0), np.std(rows, axis=0, ddof=1) / 12**0.5
    gap = abs(found["mcmc"][0] - found["sir"][0])
    assert (gap < 4 * np.hypot(found["mcmc"][1], found["sir"][1]) + 0.1).all()


@BOTH
def test_equal_seeds_give_equal_estimates_and_inputs_stay(sampler):
    way = paths(4)
    image = picture(way[1], 1)
    results = []
    for _ in range(2):
        state = begin(way[0], sampler=sampler)
        before, kept = copy.deepcopy(state.trackers), image.copy()
        for _ in range(2):
            after, o = advance(state, frame_set(1, image, image), np.random.default_rng(5))
            results.append(o)
        assert all(np.array_equal(a, b) for a, b in zip(before, state.trackers, strict=True))
        assert np.array_equal(image, kept)
        assert after.trackers.particles.shape == (4, 100, 5)
    for o in results[1:]:
        assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(results[0], o, strict=True))


def test_views_without_a_frame_wait():
    way = paths(8)
    state, rng = begin(way[0]), np.random.default_rng(2)
    for t in range(1, 4):
        state, _ = advance(state, frame_set(t, picture(way[t], t), picture(way[t], t)), rng)
    old = state.trackers
    for t in range(4, 7):
        state, o = advance(state, frame_set(t, picture(way[t], t), None), rng)
        assert o.view.tolist() == [0, 0]
        assert o.touching.shape == (2, 2)
    assert np.array_equal(state.trackers.particles[2:], old.particles[2:])
    state, o = advance(state, frame_set(7, None, picture(way[7], 7)), rng)
    assert o.view.tolist() == [1, 1]
    assert np.hypot(*(o.ellipse[:, :2] - way[7]).T).max() < R
    state, o = advance(state, frame_set(8, None, None), rng)
    assert len(o.view) == 0
    assert o.assisting_views.shape == (0, 2)


@pytest.mark.jit
def test_targets_leave_the_image_or_are_lost():
    out = np.stack([np.column_stack([20 - 3.0 * np.arange(20), np.full(20, 40)])], axis=1)
    state, rng, events = begin(out[0], views=(0,)), np.random.default_rng(3), []
    for t in range(1, 20):
        state, o = advance(state, frame_set(t, picture(out[t], t), None), rng)
        events += o.lifecycle[o.lifecycle > 0].tolist()
    assert events == [LEFT]
    state, events = begin([(60, 45)], views=(0,), max_lost_frames=4), []
    for t in range(1, 8):
        state, o = advance(state, frame_set(t, picture([], t), None), rng)
        events.append(o.lifecycle.tolist())
    assert events == [[0], [0], [0], [TERMINATED], [], [], []]


def test_targets_are_born_later_and_ended_from_outside():
    way = paths(3)
    state, rng = begin(way[0][:1], views=(0,)), np.random.default_rng(4)
    second = frame_set(1, picture(way[1], 1), None)
    state, _ = advance(state, second, rng)
    state = initiate_trackers(state, second, [Birth(0, 3, disc(way[1][1]))])
    state, o = advance(state, frame_set(2, picture(way[2], 2), None), rng)
    assert o.target_id.tolist() == [3, 10]
    assert np.hypot(*(o.ellipse[:, :2] - way[2][::-1]).T).max() < R
    state = end_trackers(state, [(0, 10)])
    assert advance(state, frame_set(3, picture(way[2], 2), None), rng)[1].target_id.tolist() == [3]


@pytest.mark.jit
def test_overlap_keeps_two_targets_of_one_colour_apart():
    """One disc, two trackers on it: with the prior they are further apart."""
    colours, apart = COLOURS[[0, 0]], {}
    for strength in (0.0, 6.0):
        state, rng, gaps = (
            begin([(60, 45), (60, 45)], views=(0,), overlap_penalty=strength),
            np.random.default_rng(6),
            [],
        )
        for t in range(1, 12):
            state, o = advance(state, frame_set(t, picture([(60, 45)], t, colours), None), rng)
            gaps.append(np.hypot(*(o.ellipse[0, :2] - o.ellipse[1, :2])))
        apart[strength] = np.mean(gaps[4:])
    assert apart[6.0] > 2.0 * apart[0.0]


@pytest.mark.parametrize(
    "wrong", [{"sampler": "gibbs"}, {"thin": 0}, {"burn_in": -0.1}, {"overlap_penalty": -1}, {"particles": 0}]
)
def test_settings_out_of_range_are_refused(wrong):
    with pytest.raises(InputError, match=f"mcmc: {next(iter(wrong))} is"):
        McmcConfig(**wrong)


def test_regions_of_a_detector_hold_targets():
    """Targets that no image shows, followed by their regions."""
    way = paths(12)
    frames = [frame_set(t, picture([], t), None) for t in range(len(way))]
    frames = [f._replace(regions=(np.array([disc(p) for p in way[t]]), None)) for t, f in enumerate(frames)]
    state = initial_state(VIEWS, NOWHERE, McmcConfig(particles=100))
    state = initiate_trackers(state, frames[0], [Birth(0, i, disc(p)) for i, p in enumerate(way[0])])
    rng = np.random.default_rng(7)
    for f in frames[1:]:
        state, o = advance(state, f, rng)
    assert np.hypot(*(o.ellipse[:, :2] - way[-1]).T).max() < 0.5 * R
