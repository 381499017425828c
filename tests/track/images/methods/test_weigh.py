"""Weights by the local likelihood, by neighbours that touch, and by the bands of good counterparts."""

import numpy as np
import pytest
from view_states import BLUE, RED, W, changed, disc, painted, state_of

from occlog.track.methods.images.interface import MODES
from occlog.track.methods.images.methods.config import BmctConfig, IdmotConfig, MipfConfig
from occlog.track.methods.images.methods.state import OwnRegions
from occlog.track.methods.images.methods.weigh import FrameContext, LocalWeights, weigh, weighing_model

MIPF, IDMOT, BMCT = (MODES.index(name) for name in ("mipf", "idmot", "bmct"))
COUNT = 25
IMAGE = painted((disc(40.0, 40.0), RED), (disc(80.0, 60.0), BLUE))


def rng():
    return np.random.default_rng(3)


def state_at(config, *places, views=None):
    """Trackers of targets 0, 1, ... with radius 8; places of view a, or of `views`."""
    views = views or [0] * len(places)
    target = [views[:i].count(v) for i, v in enumerate(views)]
    births = [(v, k, disc(*place)) for v, k, place in zip(views, target, places, strict=True)]
    return state_of(config, births, (IMAGE, IMAGE))


def local_at(state, spread=2.0, log_local=None):
    """Particles in a ring of this radius about each tracker, of equal local likelihood unless given."""
    t, n = state.trackers, len(state.trackers.view)
    angle = 2.0 * np.pi * np.arange(COUNT) / COUNT
    particles = np.repeat(t.estimate[:, None], COUNT, axis=1)
    particles[..., :2] += spread * np.column_stack([np.cos(angle), np.sin(angle)])
    return LocalWeights(particles, np.ones((n, COUNT)), np.zeros((n, COUNT)) if log_local is None else log_local)


def arrival(state, here=None, age=1.0, gap=1.0):
    """A frame of all views, or of those trackers that are `here`."""
    n = len(state.trackers.view)
    nowhere = OwnRegions(np.zeros(n, dtype=bool), np.full((n, 5), np.nan))
    here = np.ones(n, dtype=bool) if here is None else here
    return FrameContext(here, np.broadcast_to(age, n), np.broadcast_to(gap, n), nowhere)


def test_mipf_weighs_by_the_local_likelihood_alone():
    state = state_at(MipfConfig(particles=COUNT), (40.0, 40.0), (45.0, 40.0))
    log_local = rng().normal(-400.0, 2.0, (2, COUNT))
    local = local_at(state, log_local=log_local)
    weighed = weigh(state, arrival(state), local, rng())
    want = np.exp(log_local - log_local.max(axis=1, keepdims=True))
    want /= want.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(weighed.weights, want, rtol=1e-12)
    np.testing.assert_allclose(weighed.estimate[:, :2], np.einsum("np,npc->nc", want, local.particles[..., :2]))
    assert not weighed.touching.any()
    assert not weighed.helped.any()
    assert (weighed.mode == MIPF).all()


@pytest.mark.parametrize(("distance", "touch"), [(16.0 - 1e-6, True), (16.0 + 1e-6, False), (30.0, False)])
def test_trackers_touch_up_to_the_sum_of_their_radii(distance, touch):
    state = state_at(IdmotConfig(particles=COUNT), (40.0, 40.0), (40.0 + distance, 40.0))
    local = local_at(state)
    weighed = weigh(state, arrival(state), local, rng())
    assert weighed.touching.tolist() == [[False, touch], [touch, False]]
    assert (weighed.mode == (IDMOT if touch else MIPF)).all()
    assert np.allclose(weighed.weights, 1.0 / COUNT, rtol=1e-12) is not touch


def test_trackers_of_different_views_do_not_touch():
    state = state_at(IdmotConfig(particles=COUNT), (40.0, 40.0), (40.0, 40.0), views=[0, 1])
    assert not weigh(state, arrival(state), local_at(state), rng()).touching.any()


def test_trackers_that_touch_repel_each_other():
    """Equation 8 with an estimate at the neighbour and no inertia, one iteration."""
    config = IdmotConfig(particles=COUNT, iterations=1, inertia=0.0, alpha=1.5, repulsion=0.5)
    state = state_at(config, (40.0, 40.0), (50.0, 40.0))
    local = local_at(state)
    weighed = weigh(state, arrival(state), local, rng())
    for i, neighbour in ((0, [50.0, 40.0]), (1, [40.0, 40.0])):
        distance = np.linalg.norm(local.particles[i, :, :2] - neighbour, axis=1)
        want = 1.0 - np.exp(-((distance / (0.5 * 8.0)) ** 2)) / 1.5
        np.testing.assert_allclose(weighed.weights[i], want / want.sum(), rtol=1e-9)
    assert weighed.estimate[1, 0] - weighed.estimate[0, 0] > 10.0


def test_inertia_expects_the_mean_of_the_path_over_the_gap():
    state = state_at(IdmotConfig(particles=COUNT, memory=2), (40.0, 40.0), (50.0, 40.0))
    path = np.array([[[1.0, 0.0], [3.0, 2.0]], [[0.0, 0.0], [0.0, -2.0]]])
    state = changed(state, path=path)
    model = weighing_model(state, arrival(state, gap=np.array([1.0, 3.0])), local_at(state))
    np.testing.assert_allclose(model.past.step, [[2.0, 1.0], [0.0, -3.0]])
    np.testing.assert_array_equal(model.past.centre, state.trackers.estimate[:, :2])


def pair(config, distance, far=50.0, **fields):
    """Two targets in both views: so far apart in view a and in view b, in rows 40 and 44."""
    near = [(40.0, 40.0), (40.0 + distance, 44.0)]
    apart = [(30.0, 40.0), (30.0 + far, 44.0)]
    state = state_at(config, *near, *apart, views=[0, 0, 1, 1])
    return changed(state, **fields) if fields else state


def close_at(factor):
    """Horizontal distance at which two discs of radius 8, 4 px apart in height, are `factor` radii sums apart."""
    return float(np.sqrt((16.0 * factor) ** 2 - 16.0))


@pytest.mark.parametrize(("distance", "helped"), [(-1e-6, True), (1e-6, False)])
def test_counterparts_help_trackers_that_are_close_to_others(distance, helped):
    state = pair(
        BmctConfig(particles=COUNT, collaboration_distance=1.25, clear_distance=1.25), close_at(1.25) + distance, 60.0
    )
    weighed = weigh(state, arrival(state), local_at(state), rng())
    assert weighed.helped.tolist() == [[False, helped]] * 2 + [[False, False]] * 2
    assert weighed.mode.tolist() == [BMCT if helped else MIPF] * 2 + [MIPF] * 2
    assert not weighed.touching.any()


def test_the_band_of_a_counterpart_is_normal_about_its_epipolar_line():
    """Equation 5 with a sigma of `band` radii; the line is the row of the counterpart."""
    state = pair(BmctConfig(particles=COUNT, epipolar_band=0.25), 20.0)
    moved = state.trackers.estimate.copy()
    moved[2, 1] += 3.0
    state = changed(state, estimate=moved, particles=np.repeat(moved[:, None], COUNT, axis=1))
    local = local_at(state)
    weighed = weigh(state, arrival(state), local, rng())
    for i, row in ((0, 43.0), (1, 44.0)):
        want = np.exp(-0.5 * ((local.particles[i, :, 1] - row) / (0.25 * 8.0)) ** 2)
        np.testing.assert_allclose(weighed.weights[i], want / want.sum(), rtol=1e-9)


@pytest.mark.parametrize("why", ["bad", "stale", "none"])
def test_no_help_from_counterparts_that_are_bad_stale_or_not_there(why):
    state = pair(BmctConfig(particles=COUNT), 12.0)
    t, here, age = state.trackers, np.ones(4, dtype=bool), 1.0
    if why == "bad":
        state = changed(state, good=np.zeros_like(t.good))
    elif why == "none":
        state = changed(state, counterpart=np.full_like(t.counterpart, -1))
    else:
        here[2:], age = False, 2.0
    local = local_at(state)
    weighed = weigh(state, arrival(state, here, age), local, rng())
    assert not weighed.helped.any()
    assert weighed.mode[:2].tolist() == [IDMOT, IDMOT]
    plain = state._replace(config=IdmotConfig(particles=COUNT))
    as_idmot = weigh(plain, arrival(plain, here, age), local, rng())
    np.testing.assert_array_equal(weighed.weights[:2], as_idmot.weights[:2])


@pytest.mark.parametrize(("far", "helped"), [(12.0, False), (20.0, True), (50.0, True)])
def test_a_counterpart_more_hidden_than_the_tracker_does_not_help(far, helped):
    """The targets are close in both views, 18 px apart in view a; then each view helps the other if it is as clear."""
    state = pair(BmctConfig(particles=COUNT, clear_distance=1.5), 18.0, far)
    weighed = weigh(state, arrival(state), local_at(state), rng())
    assert weighed.helped[:2, 1].tolist() == [helped, helped]
    state = pair(BmctConfig(particles=COUNT, clear_distance=0.0), 18.0, far)
    every = weigh(state, arrival(state), local_at(state), rng())
    assert every.helped[:2, 1].all()


def test_in_one_sweep_the_view_that_comes_first_gets_no_help_from_a_view_as_crowded():
    """Both targets are close in both views; a second sweep lets the later view help the earlier one too."""
    helped = []
    for sweeps in (1, 2):
        state = pair(BmctConfig(particles=COUNT, clear_distance=0.0, sweeps=sweeps), 18.0, 18.0)
        helped.append(weigh(state, arrival(state), local_at(state), rng()).helped.any(axis=1))
    first = rng().permutation(2)[0]
    assert helped[0].tolist() == [v != first for v in (0, 0, 1, 1)]
    assert helped[1].tolist() == [True] * 4


def test_bmct_collaborates_by_its_settings():
    config = BmctConfig(particles=COUNT, anchor="bottom", epipolar_band=0.7, clear_distance=0.4)
    state = pair(config, 20.0)
    cameras = weighing_model(state, arrival(state), local_at(state)).cameras
    assert (cameras.bottom, cameras.band, cameras.clear) == (True, 0.7, 0.4)
    assert cameras.helper.tolist() == [[-1, 2], [-1, 3], [0, -1], [1, -1]]
    np.testing.assert_array_equal(cameras.affine, np.tile([[1.0, 0, 0], [0, 1.0, 0]], (4, 1, 1)))
    assert cameras.fundamental.shape == (2, 2, 3, 3)


def test_distortion_is_linearised_at_the_estimates():
    """A map that scales columns quadratically: its slope at each estimate is that over one pixel."""

    def ideal(points):
        return np.column_stack([points[:, 0] ** 2 / W, points[:, 1]])

    state = pair(BmctConfig(particles=COUNT), 20.0)
    state = state._replace(geometry=state.geometry._replace(ideal=(ideal, None)))
    cameras = weighing_model(state, arrival(state), local_at(state, spread=0.0)).cameras
    x = state.trackers.estimate[:2, 0]
    np.testing.assert_allclose(cameras.affine[:2, 0, 0], (2 * x + 1) / W)
    np.testing.assert_allclose(cameras.affine[:2, 0, 0] * x + cameras.affine[:2, 0, 2], x**2 / W)
    np.testing.assert_array_equal(cameras.affine[2:], np.tile([[1.0, 0, 0], [0, 1.0, 0]], (2, 1, 1)))
