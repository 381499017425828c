"""Method `rssi`: a tag that walks among readers is found, and the covariance can be believed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from occlog.array_types import NS, Floats, Ints
from occlog.core.numerics.seeds import RandomStream, generator
from occlog.track.interface import SmoothedState
from occlog.track.methods.readers.rssi import (
    PathLoss,
    ShadowingState,
    TagEstimate,
    TagFilterModel,
    TagParticles,
    begin,
    smoothed_states,
    step,
    tempered,
    trace_of,
)

ROOM = np.array([[0.0, 0.0], [12.0, 0.0], [12.0, 12.0], [0.0, 12.0]])
PLACES = np.array([[x, y, 1.0] for x in (1.0, 6.0, 11.0) for y in (1.0, 6.0, 11.0)])
MODEL = PathLoss(
    positions=PLACES,
    power=np.full(9, -60.0),
    exponent=2.0,
    noise_db=4.0,
    shadow_db=3.0,
    shadow_s=5.0,
    height=1.0,
    metre=1.0,
)
RULES = TagFilterModel(
    model=MODEL,
    ranges=np.full(9, np.inf),
    room=ROOM,
    particles=600,
    speed=0.5,
    turn_s=4.0,
    detection=0.95,
    stray=0.01,
)


class Walk(NamedTuple):
    """True places of a tag, and its reads."""

    xy: Floats  # (T, 2)
    count: Ints  # (T, R)
    rssi: Floats  # (T, R)


def walk(seed: int, steps: int = 60) -> Walk:
    """A walk of the filter's own motion, reflected by the walls, with shadowing and noise."""
    rng = np.random.default_rng(seed)
    xy, velocity, shadow = np.zeros((steps, 2)), 0.5 * rng.standard_normal(2), 3.0 * rng.standard_normal(9)
    here, decay, forget = rng.uniform(3.0, 9.0, 2), np.exp(-1.0 / 4.0), np.exp(-1.0 / 5.0)
    rssi = np.zeros((steps, 9))
    for k in range(steps):
        velocity = decay * velocity + 0.5 * np.sqrt(1.0 - decay**2) * rng.standard_normal(2)
        here = here + velocity
        velocity = np.where((here < 0.0) | (here > 12.0), -velocity, velocity)
        here = np.where(here < 0.0, -here, np.where(here > 12.0, 24.0 - here, here))
        shadow = forget * shadow + 3.0 * np.sqrt(1.0 - forget**2) * rng.standard_normal(9)
        xy[k] = here
        rssi[k] = MODEL.expected(here[None])[0] + shadow + 4.0 / np.sqrt(2.0) * rng.standard_normal(9)
    return Walk(xy, np.full((steps, 9), 2), rssi)


def filtered(rules: TagFilterModel, reads: Walk, seed: int = 0) -> list[TagEstimate]:
    rng = generator(seed, RandomStream.TRACK, 0)
    cloud = begin(rules, 0, rng)
    out = []
    for k in range(len(reads.xy)):
        cloud, found = step(rules, cloud, k * NS, reads.count[k], reads.rssi[k], rng)
        out.append(found)
    return out


def nees(reads: Walk, found: list[TagEstimate]) -> Floats:
    error = np.array([f.xy for f in found]) - reads.xy
    inverse = np.linalg.inv(np.array([f.covariance[:2, :2] for f in found]))
    return np.einsum("ni,nij,nj->n", error, inverse, error)


@pytest.mark.statistics
def test_the_covariance_is_that_of_the_errors_and_without_shadowing_it_would_be_too_small() -> None:
    walks = [walk(seed) for seed in range(8)]
    with_it = np.array([nees(w, filtered(RULES, w)).mean() for w in walks])
    as_noise = RULES._replace(model=MODEL._replace(noise_db=5.0 * np.sqrt(2.0), shadow_db=0.0))
    without = np.array([nees(w, filtered(as_noise, w)).mean() for w in walks])
    assert with_it.mean() < 2.0 + 3.0 * max(with_it.std() / np.sqrt(8.0), 0.2)
    assert with_it.mean() > 1.0
    worse = without - with_it
    assert worse.mean() > 2.0 * worse.std(ddof=1) / np.sqrt(8.0)


def test_a_tag_in_range_of_one_reader_is_found_by_reads_without_strengths() -> None:
    rules = RULES._replace(ranges=np.full(9, 2.5))
    inside = np.linalg.norm(PLACES[:, :2] - np.array([6.0, 6.0]), axis=1) <= 2.5
    reads = Walk(np.full((6, 2), 6.0), np.repeat(inside[None].astype(np.int64), 6, axis=0), np.full((6, 9), np.nan))
    last = filtered(rules, reads)[-1]
    assert np.linalg.norm(last.xy - 6.0) < 1.0
    assert last.covariance[0, 0] < 4.0


def test_particles_stay_in_the_room() -> None:
    reads = walk(1, 5)
    assert all(((f.xy > 0.0) & (f.xy < 12.0)).all() for f in filtered(RULES, reads))


def test_reads_that_no_particle_explains_begin_again() -> None:
    rng = np.random.default_rng(0)
    cloud = begin(RULES, 0, rng)
    far = cloud._replace(xy=cloud.xy + 100.0)
    reads = walk(2, 1)
    _, found = step(RULES, far, NS, reads.count[0], reads.rssi[0], rng)
    assert found.restarted
    assert np.isfinite(found.xy).all()


@pytest.mark.parametrize("seed", [0, 5])
def test_the_same_seed_gives_the_same_track(seed: int) -> None:
    reads = walk(3, 4)
    a, b = filtered(RULES, reads, seed), filtered(RULES, reads, seed)
    assert all(np.array_equal(x.xy, y.xy) for x, y in zip(a, b, strict=True))


def smoothed(rules: TagFilterModel, found: list[TagEstimate]) -> list[SmoothedState]:
    """The states of a walk given all of its reads."""
    return smoothed_states(rules, [trace_of(rules, f, max(k - 1, 0) * NS) for k, f in enumerate(found)])


@pytest.mark.statistics
def test_smoothing_lowers_errors_and_its_covariances_hold() -> None:
    walks = [walk(seed) for seed in range(8)]
    before = [filtered(RULES, w) for w in walks]
    after = [smoothed(RULES, f) for f in before]

    def squares(found: list[list[TagEstimate]] | list[list[SmoothedState]]) -> Floats:
        """(8,) mean squared errors."""
        return np.array(
            [(np.linalg.norm([s.xy for s in f] - w.xy, axis=1) ** 2).mean() for w, f in zip(walks, found, strict=True)]
        )

    gain = squares(before) - squares(after)
    assert gain.mean() > 3.0 * gain.std(ddof=1) / np.sqrt(8.0)
    assert np.sqrt(squares(after).mean() / squares(before).mean()) < 0.93
    error = [np.array([s.xy for s in f]) - w.xy for w, f in zip(walks, after, strict=True)]
    inverse = [np.linalg.inv(np.array([s.covariance[:2, :2] for s in f])) for f in after]
    own = np.array([np.einsum("ni,nij,nj->n", e, i, e).mean() for e, i in zip(error, inverse, strict=True)])
    # Truth is reflected by walls, and the filter has 2.4
    assert 1.0 < own.mean() < 4.5


def test_smoothing_is_gaussian_regression_where_traces_are_those_of_a_kalman_filter() -> None:
    """Two windows whose second knows the position: the first is the conditional Gaussian of the joint motion."""
    rules = RULES._replace(model=MODEL._replace(shadow_db=0.0))
    rng = np.random.default_rng(4)
    prior = np.diag([4.0, 1.0, 0.25, 0.25])

    # Particles with exact moments: sigma points of the first window, and of the second
    def cloud(t_ns: int, mean: Floats, covariance: Floats) -> TagParticles:
        root = np.sqrt(4.0) * np.linalg.cholesky(covariance)
        points = mean + np.concatenate([root.T, -root.T])
        none = ShadowingState(np.zeros((8, 9)), np.zeros(9))
        return TagParticles(t_ns, points[:, :2], points[:, 2:], np.full(8, 0.125), none)

    mean = rng.uniform(3.0, 5.0, 4)
    decay = np.exp(-1.0 / 4.0)
    F = np.eye(4)
    F[:2, 2:], F[2:, 2:] = 0.5 * (1.0 + decay) * np.eye(2), decay * np.eye(2)
    G = np.vstack([0.5 * np.eye(2), np.eye(2)]) * 0.5 * np.sqrt(1.0 - decay**2)
    H = np.eye(4)[:2]
    ahead = F @ prior @ F.T + G @ G.T
    S = H @ ahead @ H.T + 0.1 * np.eye(2)
    measured = F[:2] @ mean + np.array([0.7, -0.4])
    gain = ahead @ H.T @ np.linalg.inv(S)
    last = F @ mean + gain @ (measured - F[:2] @ mean), ahead - gain @ H @ ahead
    clouds = [cloud(0, mean, prior), cloud(NS, *last)]
    found = [TagEstimate(c.xy.mean(0), c.velocity.mean(0), np.eye(4), 8.0, False, c) for c in clouds]
    first, _ = smoothed(rules, found)
    # Directly: the first state given the measurement of the second
    across = prior @ F.T @ H.T @ np.linalg.inv(S)
    np.testing.assert_allclose(
        np.concatenate([first.xy, first.velocity]), mean + across @ (measured - F[:2] @ mean), atol=1e-5
    )
    np.testing.assert_allclose(first.covariance, prior - across @ H @ F @ prior, atol=1e-5)


def test_a_restart_separates_what_is_before_it_and_one_particle_is_no_error() -> None:
    found = filtered(RULES, walk(5, 6))
    apart = [*found[:3], found[3]._replace(restarted=True), *found[4:]]
    assert np.allclose(smoothed(RULES, apart)[2].xy, found[2].xy)
    one = np.zeros(600)
    one[0] = 1.0
    alone = [f._replace(cloud=f.cloud._replace(weights=one)) for f in found]
    assert all(np.isfinite(s.covariance).all() for s in smoothed(RULES, alone))
    silent = RULES._replace(model=MODEL._replace(shadow_db=0.0))
    assert all(np.isfinite(s.covariance).all() for s in smoothed(silent, filtered(silent, walk(5, 6))))


def test_few_effective_particles_are_tempered_until_they_have_a_spread() -> None:
    even = np.full(50, 0.02)
    assert tempered(even, even > 0.0, 10.0) is even
    found = tempered(np.exp(-(np.arange(50.0) ** 2)) / np.exp(-(np.arange(50.0) ** 2)).sum(), even > 0.0, 10.0)
    assert 1.0 / (found @ found) == pytest.approx(10.0, rel=1e-3)
    assert (np.diff(found) <= 0.0).all()
    assert found.sum() == pytest.approx(1.0)
    one = np.zeros(50)
    one[7] = 1.0
    spread = tempered(one, np.arange(50) < 40, 10.0)
    assert np.isfinite(spread).all()
    assert not spread[40:].any()
    assert spread.argmax() == 7
    # A window that hardly a particle explains: the filter states metres, not millimetres
    reads = walk(1, 12)
    odd = reads.rssi + np.where(np.arange(12) == 8, 25.0, 0.0)[:, None] * np.where(np.arange(9) < 4, 1.0, -1.0)
    sharp = RULES._replace(model=MODEL._replace(noise_db=0.3, shadow_db=0.0), particles=200)
    found_all = filtered(sharp, reads._replace(rssi=odd))
    assert min(f.effective for f in found_all) < 2.0
    assert min(np.sqrt(f.covariance[0, 0]) for f in found_all) > 1e-3
