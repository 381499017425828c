"""Priors from positions, and the feed that gives them to a filter."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from places import EXAMPLES

from occlog.core.occlusion.priors import Priors
from occlog.errors import InputError
from occlog.io.formats.scenes.scene import read_scene
from occlog.measure.priors.config import PositionPriorConfig
from occlog.measure.priors.from_positions import kalman_priors, virtual_priors
from occlog.records.tables import Hulls, Occluders, Tracks, Truth
from occlog.scans.occluder_priors import OccluderFeed, known_positions
from occlog.simulate.config import WorldConfig
from occlog.simulate.stage import simulate_truth

ROOM = EXAMPLES / "room100.yaml"
S = 1_000_000_000


@pytest.fixture(scope="module")
def truth() -> Truth:
    config = WorldConfig(steps=300, targets=1, occluders=40)
    return Truth.concat(simulate_truth(read_scene(ROOM), config, 5))


def rmse_occ(truth: Truth, priors: Occluders) -> tuple[float, float]:
    """RMS distance of the means from the truth after 20 steps, and its standard error over the occluders."""
    true = truth.take(truth.role == "occluder").sorted()
    assert np.array_equal(true.t_ns, priors.t_ns)
    assert np.array_equal(true.target_id, priors.occluder_id)
    squared = ((true.x - priors.x) ** 2 + (true.y - priors.y) ** 2).reshape(-1, 40)[20:].mean(axis=0)
    mean = float(squared.mean())
    return mean**0.5, float(squared.std(ddof=1) / 40**0.5 / (2 * mean**0.5))


@pytest.mark.jit
@pytest.mark.jit
def test_reference_world_gives_6_67(truth: Truth) -> None:
    """q = 1.2 and sigma_psi = 8 give RMSE_occ 6.67: within 3 standard errors and 2 % (the world is our own)."""
    got, error = rmse_occ(truth, Occluders.concat(virtual_priors([truth], 8.0, 1.2, 1)).sorted())
    assert error < 0.1
    assert abs(got - 6.67) < 3 * error + 0.02 * 6.67


@pytest.mark.jit
def test_prior_is_isotropic_and_settles(truth: Truth) -> None:
    priors = Occluders.concat(virtual_priors([truth], 8.0, 1.2, 1))
    assert np.allclose(priors.cov_xx, priors.cov_yy)
    assert np.allclose(priors.cov_xy, 0)
    # Steady state of the textbook's Riccati recursion.
    P, A, Q = np.diag([64.0, 1.44]), np.array([[1.0, 1.0], [0.0, 1.0]]), 1.44 * np.array([[0.25, 0.5], [0.5, 1.0]])
    for _ in range(200):
        P = A @ P @ A.T + Q
        P = P - np.outer(P[:, 0], P[0]) / (P[0, 0] + 64.0)
    assert priors.cov_xx[-1] == pytest.approx(P[0, 0], rel=1e-9)


def test_chunks_do_not_matter(truth: Truth) -> None:
    whole = Occluders.concat(virtual_priors([truth], 8.0, 1.2, 1))
    cuts = [0, 1, 57, 41 * 100, 41 * 100 + 13, len(truth)]
    parts = [truth.take(slice(a, b)) for a, b in pairwise(cuts)]
    cut = Occluders.concat(virtual_priors(parts, 8.0, 1.2, 1))
    assert all(np.array_equal(getattr(whole, c.name), getattr(cut, c.name)) for c in Occluders.columns())


def test_known_positions_do_not_depend_on_chunks(truth: Truth) -> None:
    """Also where a chunk ends between the rows of a target and of an occluder."""
    some = truth.take(slice(0, 41 * 4))
    cut = Occluders.concat(known_positions([some.take(slice(0, 42)), some.take(slice(42, None))]))
    assert (cut.occluder_id >= 0).all()
    assert len(cut) == 40 * 4


def test_noise_of_an_occluder_is_its_own(truth: Truth) -> None:
    some = truth.take(np.isin(truth.target_id, (3, 7)))
    few, all_ = (Occluders.concat(virtual_priors([t], 8.0, 1.2, 1)) for t in (some, truth))
    assert np.array_equal(few.x, all_.x[np.isin(all_.occluder_id, (3, 7))])
    other = Occluders.concat(virtual_priors([some], 8.0, 1.2, 1, run=1))
    assert not np.any(other.x == few.x)


def test_sigma_0_is_the_truth(truth: Truth) -> None:
    known = Occluders.concat(virtual_priors([truth], 0.0, 1.2, 1))
    true = truth.take(truth.role == "occluder")
    assert np.array_equal(known.x, true.x)
    assert not known.cov_xx.any()
    priors = OccluderFeed([known], 3.33, S).at(int(true.t_ns[0]))
    assert priors is not None
    assert not priors.sigma.any()


def test_a_time_without_occluders_says_so() -> None:
    alone = Truth.of(
        t_ns=[0, S], target_id=np.zeros(2, np.int32), role=["target"] * 2, x=[0.0, 0], y=[0.0, 0], z=[0.0, 0]
    )
    for priors in (known_positions([alone]), virtual_priors([alone], 1.0, 1.0, 0)):
        table = Occluders.concat(priors)
        assert table.occluder_id.tolist() == [-1, -1]
        assert np.isnan(table.x).all()


def positions(rows) -> Truth:
    """(t [s], id, x) of occluders."""
    n = len(rows)
    return Truth.of(
        t_ns=np.array([round(r[0] * S) for r in rows]),
        target_id=np.array([r[1] for r in rows], np.int32),
        role=["occluder"] * n,
        x=[float(r[2]) for r in rows],
        y=np.zeros(n),
        z=np.full(n, np.nan),
    )


def test_occluders_measured_at_other_times_are_predicted() -> None:
    config = PositionPriorConfig(measurement_noise=0.1, process_noise_velocity=0.1, max_coasting_s=2.0)
    rows = [(0, 0, 0.0), (1, 0, 1.0), (1, 1, 9.0), (2, 0, 2.0), (3, 1, 9.0), (6, 1, 9.0)]
    table = Occluders.concat(kalman_priors([positions(rows)], config))
    seen = [(t // S, k) for t, k in zip(table.t_ns.tolist(), table.occluder_id.tolist(), strict=True)]
    assert seen == [(0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (3, 0), (3, 1), (6, 1)]
    predicted = table.take((table.t_ns == 3 * S) & (table.occluder_id == 0))
    assert predicted.x[0] > 2.2  # it was walking
    assert predicted.cov_xx[0] > 0.1**2


def test_tracks_bring_their_own_covariance() -> None:
    one, zero = np.ones(2), np.zeros(2)
    tracks = Tracks.of(
        t_ns=np.array([0, S]),
        target_id=np.zeros(2, np.int32),
        x=zero,
        y=zero,
        vx=zero,
        vy=zero,
        cov_xx=4 * one,
        cov_xy=zero,
        cov_yy=one,
    )
    table = Occluders.concat(
        kalman_priors([tracks], PositionPriorConfig(measurement_noise=0.0, process_noise_velocity=1.0))
    )
    assert (table.cov_xx[0], table.cov_yy[0]) == pytest.approx((4.0, 1.0))
    assert not len(Occluders.concat(kalman_priors([tracks], PositionPriorConfig(measurement_noise=1.0), without=[0])))


def test_bad_positions_are_named() -> None:
    with pytest.raises(InputError, match="two positions"):
        list(kalman_priors([positions([(0, 1, 0.0), (0, 1, 1.0)])], PositionPriorConfig()))
    with pytest.raises(InputError, match="sort"):
        list(kalman_priors([positions([(5, 1, 0.0)]), positions([(1, 1, 1.0)])], PositionPriorConfig()))
    with pytest.raises(InputError, match="measurement_noise is -1"):
        PositionPriorConfig(measurement_noise=-1.0)


def gaussians(times) -> Occluders:
    n = len(times)
    return Occluders.of(
        t_ns=np.array(times) * S,
        occluder_id=np.arange(n, dtype=np.int32),
        x=np.array(times, float),
        y=np.zeros(n),
        cov_xx=np.ones(n),
        cov_xy=np.zeros(n),
        cov_yy=np.ones(n),
    )


def test_feed_gives_the_latest() -> None:
    table = gaussians([1, 1, 2, 4])
    for chunks in ([table], [table.take(slice(k, k + 1)) for k in range(4)]):
        feed = OccluderFeed(chunks, 1.0, 3 * S)
        assert feed.at(0) is None
        sizes = [len(p.mean) if isinstance(p := feed.at(round(t * S)), Priors) else None for t in (1, 1.5, 2, 3, 4, 7)]
        assert sizes == [2, 2, 1, 1, 1, 1]
        assert feed.at(7 * S + 1) is None
        assert (feed.asked, feed.early, feed.stale) == (8, 1, 1)


def test_feed_knows_that_there_is_none() -> None:
    none = Occluders.of(
        t_ns=[3 * S],
        occluder_id=np.array([-1], np.int32),
        x=[np.nan],
        y=[np.nan],
        cov_xx=[np.nan],
        cov_xy=[np.nan],
        cov_yy=[np.nan],
    )
    feed = OccluderFeed([gaussians([1]), none], 1.0, 10 * S)
    assert len(feed.at(S).mean) == 1
    assert len(feed.at(3 * S).mean) == 0


def test_feed_of_polygons() -> None:
    square = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]])
    both = np.concatenate([square, square[:3] + 5.0])
    hulls = Hulls(
        np.zeros(7, np.int64),
        np.repeat([0, 1], [4, 3]).astype(np.int32),
        np.array([0, 1, 2, 3, 0, 1, 2], np.int32),
        both[:, 0].copy(),
        both[:, 1].copy(),
    )
    priors = OccluderFeed([hulls], 0.5, S).at(0)
    assert np.allclose(priors.mean, [[1.0, 1.0], both[4:].mean(axis=0)])
    assert np.diff(priors.first).tolist() == [4, 3]
    assert priors.radius.tolist() == [0.25, 0.25]


def test_feed_refuses_times_that_go_back() -> None:
    with pytest.raises(InputError, match="sort"):
        OccluderFeed([gaussians([5]), gaussians([1])], 1.0, S).at(9 * S)
    flat = Hulls(
        np.zeros(3, np.int64), np.zeros(3, np.int32), np.arange(3, dtype=np.int32), np.arange(3.0), np.zeros(3)
    )
    with pytest.raises(InputError, match="no area"):
        OccluderFeed([flat], 1.0, S).at(0)
