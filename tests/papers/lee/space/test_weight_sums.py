"""Sums of unnormalised weights in a plane and in space."""

from __future__ import annotations

import math

import numpy as np
import pytest

from occlog.papers.lee.space.weight_sums import PARTICLES, VARIANCES, judge_sums, sums, weight_trial
from occlog.papers.lee.space.worlds import world
from occlog.papers.verdicts import Size


def test_sums_in_space_are_those_of_the_products_of_two_densities() -> None:
    found = weight_trial({"seed": 3, "run": 0, "steps": 1})
    rng = np.random.default_rng(np.random.SeedSequence(3, spawn_key=(0, 2009, 27)))
    place = world(1, 1).states[0, :3]
    cloud = place + 0.3 * rng.standard_normal((PARTICLES, 3))
    noise = rng.standard_normal(2)
    s = math.sqrt(3.0)
    heard = [math.degrees(f(place)) + s * n for f, n in zip(ANGLES, noise, strict=True)]
    density = [
        math.prod(math.exp(-0.5 * ((math.degrees(f(p)) - h) / s) ** 2) / (s * math.sqrt(2 * math.pi)) for f, h in pairs)
        for p in cloud
        for pairs in [list(zip(ANGLES, heard, strict=True))]
    ]
    assert found["space_3"] == pytest.approx(sum(density), rel=1e-9)


ANGLES = (lambda p: math.atan2(p[1], p[0]), lambda p: math.atan2(math.hypot(p[0], p[1]), p[2]))


def test_the_order_of_the_sums_depends_on_the_unit_and_their_relative_change_does_not() -> None:
    table = sums(Size(30, 20, True), lambda specs: [weight_trial(s) for s in specs])
    assert len(table) == 6 * len(VARIANCES)
    words = {x.id: x.verdict for x in judge_sums(table)}
    assert words == {
        "fig2.7-larger": "reproduced",
        "fig2.7-unit": "not reproduced",
        "fig2.7-sensitive": "reproduced",
    }
