"""Policies of camera selection against enumeration, counts and known orders."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from scipy.special import chdtrc
from tracker_scenes import PLACES, room100

from occlog.cli import track as cli
from occlog.core.priors import gaussian_priors, no_priors
from occlog.core.selection import mean_square_errors
from occlog.errors import InputError, UsageError
from occlog.trackers import select
from occlog.trackers.method import Cloud
from occlog.trackers.select import SelectConfig, choose, greedy, network

pytestmark = pytest.mark.jit
SCENE = room100()
NAMES = frozenset(c.name for c in SCENE.cameras)


def cloud(seed=0, L=300, spread=4.0):
    rng = np.random.default_rng(seed)
    return Cloud(rng.uniform(25, 75, 2) + spread * rng.standard_normal((L, 2)), rng.dirichlet(np.full(L, 2.0)))


def people(seed):
    rng = np.random.default_rng(seed + 4)
    return gaussian_priors(rng.uniform(0, 100, (20, 2)), np.tile(25.0 * np.eye(2), (20, 1, 1)), 3.33)


def chosen(config, seed=0, priors=None, scene=SCENE, usable=NAMES, rng=None):
    net = network(scene, config, usable, None)
    return choose(cloud(seed), priors, net, config, rng or np.random.default_rng(0))


def test_names_are_those_of_the_command_line():
    assert cli.POLICIES == select.POLICIES
    assert cli.MODELS == select.MODELS


@pytest.mark.parametrize("model", select.MODELS)
@pytest.mark.parametrize("seed", range(6))
def test_brute_force_is_the_least_of_all_subsets_and_greedy_not_below(seed, model):
    priors = people(seed)
    for count in (1, 2, 3):
        config = SelectConfig("brute-force", count, model=model)
        net = network(SCENE, config, NAMES, None)
        moments = select._moments(cloud(seed), priors, net, model)
        values = {s: mean_square_errors(moments, np.array([s]))[0] for s in combinations(range(8), count)}
        best = chosen(config, seed, priors)
        assert best.mse == pytest.approx(min(values.values()))
        assert values[best.cameras] == pytest.approx(best.mse)
        found = chosen(replace(config, policy="greedy"), seed, priors)
        assert found.mse >= best.mse * (1 - 1e-9)
        if count == 1:
            assert found.mse == pytest.approx(best.mse)


def test_greedy_adds_the_best_camera_each_time():
    for seed in range(5):
        config = SelectConfig("greedy", 4)
        net = network(SCENE, config, NAMES, None)
        moments = select._moments(cloud(seed), people(seed), net, "perspective")
        order = greedy(moments, 4)
        for k in range(4):
            errors = {
                n: mean_square_errors(moments, np.array([[*order[:k], n]]))[0] for n in set(range(8)) - {*order[:k]}
            }
            assert errors[order[k]] <= min(errors.values()) * (1 + 1e-9)
        assert chosen(config, seed, people(seed)).cameras == tuple(sorted(order))


def test_closest_are_nearest_to_the_mean():
    for seed in range(5):
        given = cloud(seed)
        away = np.hypot(*(np.array(PLACES) - given.weights @ given.xy).T)
        assert chosen(SelectConfig("closest", 3), seed).cameras == tuple(sorted(np.argsort(away)[:3].tolist()))


def test_fixed_takes_the_given_order_or_that_of_the_scene():
    assert chosen(SelectConfig("fixed", 3)).cameras == (0, 1, 2)
    assert chosen(SelectConfig("fixed", 2, order=("cam7", "cam3", "cam1"))).cameras == (2, 6)
    # Cameras that may not be used are passed over.
    assert chosen(SelectConfig("fixed", 2, order=("cam7", "cam3", "cam1")), usable=NAMES - {"cam3"}).cameras == (0, 6)


def test_random_takes_every_subset_equally_often():
    config, rng = SelectConfig("random", 2), np.random.default_rng(11)
    net = network(SCENE, config, NAMES, None)
    few = Cloud(np.array([[30.0, 30.0], [31.0, 30.0]]), np.array([0.5, 0.5]))
    drawn = [choose(few, None, net, config, rng).cameras for _ in range(1400)]
    counts = np.array([drawn.count(s) for s in combinations(range(8), 2)])
    assert counts.sum() == 1400
    statistic = np.sum((counts - 50.0) ** 2 / 50.0)
    assert chdtrc(27, statistic) > 1e-3  # a chance of 1 in 1000, with a fixed seed
    again = np.random.default_rng(11)
    assert [choose(few, None, net, config, again).cameras for _ in range(20)] == drawn[:20]


def test_all_takes_all_that_may_be_used():
    assert chosen(SelectConfig("all", 1)).cameras == tuple(range(8))
    assert chosen(SelectConfig("all", 1), usable=frozenset({"cam2", "cam5"})).cameras == (1, 4)


def test_people_in_the_way_change_the_choice_and_raise_the_error():
    free, among = chosen(SelectConfig("greedy", 3), 1, no_priors()), chosen(SelectConfig("greedy", 3), 1, people(1))
    assert among.mse > free.mse
    best = free.cameras[0]
    target = cloud(1)
    blocked = 0.5 * (target.weights @ target.xy + np.array(PLACES[best]))
    wall = gaussian_priors(blocked[None], 0.01 * np.eye(2)[None], 30.0)
    assert best not in chosen(SelectConfig("greedy", 3), 1, wall).cameras


def test_a_large_cloud_is_thinned_without_changing_much():
    config = SelectConfig("greedy", 3)
    net = network(SCENE, config, NAMES, None)
    rng = np.random.default_rng(2)
    large = Cloud(np.array([40.0, 30.0]) + 4 * rng.standard_normal((8000, 2)), np.full(8000, 1 / 8000))
    found = choose(large, None, net, config, rng)
    thin = choose(Cloud(large.xy[:1000].copy(), np.full(1000, 1e-3)), None, net, config, rng)
    assert found.cameras == thin.cameras
    assert found.mse == pytest.approx(thin.mse, rel=0.15)  # 1000 draws: about 5 %


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"policy": "best"}, "one of greedy"),
        ({"model": "flat"}, "one of perspective"),
        ({"count": 0}, "at least 1"),
        ({"every": 0.0}, "above 0"),
        ({"every": float("nan")}, "above 0"),
    ],
)
def test_settings_that_make_no_sense_are_refused(values, said):
    with pytest.raises(InputError, match=said):
        SelectConfig(**values)


def test_selections_that_the_scene_does_not_allow_are_refused():
    with pytest.raises(UsageError, match="9 cameras of 8"):
        network(SCENE, SelectConfig("greedy", 9), NAMES, None)
    with pytest.raises(UsageError, match="no camera 'door'"):
        network(SCENE, SelectConfig("fixed", 1, order=("door",)), NAMES, None)
    with pytest.raises(UsageError, match="order has 1 usable cameras, want 2"):
        network(SCENE, SelectConfig("fixed", 2, order=("cam1",)), NAMES, None)
    many = replace(SCENE, cameras=tuple(replace(SCENE.cameras[0], name=f"c{i}") for i in range(30)))
    with pytest.raises(UsageError, match="use greedy"):
        network(many, SelectConfig("brute-force", 8), frozenset(c.name for c in many.cameras), None)
