"""Boxes of two people: pairs who touch, their outline, and marginals against the sum over all associations."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from jipda_reference import belief_propagation

from occlog.array_types import Floats, Ints
from occlog.track.methods.jipda.kernels.marginals import box_messages
from occlog.track.methods.jipda.kernels.merged_detections import (
    add_edges_of_one,
    merged_box,
    overlapping_pairs,
    pair_messages,
)

BOX = np.array([[100.0, 50.0, 140.0, 170.0], [135.0, 60.0, 175.0, 160.0], [300.0, 50.0, 340.0, 170.0]])


def test_people_touch_whose_boxes_overlap_or_nearly_do() -> None:
    depth, across, there = np.ones(3), np.zeros(3), np.ones(3)
    assert overlapping_pairs(BOX, depth, across, there).tolist() == [[0, 1]]
    # 10 % of the narrower width apart, and more
    apart = BOX.copy()
    apart[1, [0, 2]] = 143.9, 183.9
    assert len(overlapping_pairs(apart, depth, across, there)) == 1
    apart[1, [0, 2]] = 144.1, 184.1
    assert len(overlapping_pairs(apart, depth, across, there)) == 0
    # Not at all: one above the other, one who is behind the camera, one who hardly exists
    above = BOX.copy()
    above[1, [1, 3]] = 171.0, 260.0
    assert len(overlapping_pairs(above, depth, across, there)) == 0
    assert len(overlapping_pairs(BOX, np.array([1.0, -1.0, 1.0]), across, there)) == 0
    assert len(overlapping_pairs(BOX, np.array([-1.0, 1.0, 1.0]), across, there)) == 0
    for existence, count in ((0.19, 0), (0.2, 1)):
        assert len(overlapping_pairs(BOX, depth, across, np.array([1.0, existence, 1.0]))) == count
        assert len(overlapping_pairs(BOX, depth, across, np.array([existence, 1.0, 1.0]))) == count
    # One that begins where the other ends, and the deviations of both middles
    above[1, 1] = 170.0
    assert len(overlapping_pairs(above, depth, across, there)) == 1
    for deviation, count in ((0.49, 0), (0.51, 1)):
        apart[1, [0, 2]] = 149.0, 189.0
        assert len(overlapping_pairs(apart, depth, 10.0 * deviation * np.array([0.6, 0.8, 0.0]), there)) == count


def test_the_edges_of_an_outline_are_those_of_whoever_is_farther_out() -> None:
    noise = np.repeat(np.diag([4.0, 4.0, 4.0, 4.0])[None], 3, axis=0)
    spread = np.zeros((3, 4, 4))
    box, whole, wide, own = np.empty(4), np.empty((4, 4)), np.empty((4, 4)), np.empty(4)
    merged_box(0, 1, BOX, noise, spread, box, whole, wide, own)
    assert box.tolist() == [100.0, 50.0, 175.0, 170.0]
    np.testing.assert_allclose(own, [1.0, 1.0, 0.0, 1.0], atol=1e-3)
    # Each tells of its own person alone
    first, second, every = np.zeros((4, 4)), np.zeros((4, 4)), np.ones(4, dtype=bool)
    add_edges_of_one(noise[0], every, own, True, 1.0, first)
    add_edges_of_one(noise[1], every, own, False, 1.0, second)
    np.testing.assert_allclose(np.diag(first), [0.25, 0.25, 0.0, 0.25], atol=1e-3)
    np.testing.assert_allclose(np.diag(second), [0.0, 0.0, 0.25, 0.0], atol=1e-3)


def beliefs(weight: Floats, pair: Ints, joint: Floats) -> tuple[Floats, Floats]:
    """Probabilities (N, M) of boxes of one and (K, M) of boxes of two, from the messages."""
    nu = pair_messages(weight, pair, joint)
    alone = weight * nu.single
    total = 1.0 + alone.sum(axis=1)
    both = np.zeros_like(joint)
    for k, (a, b) in enumerate(pair):
        of_a, of_b = joint[k] * nu.partner[k, 1] * nu.pair[k], joint[k] * nu.partner[k, 0] * nu.pair[k]
        total[a] += of_a.sum()
        total[b] += of_b.sum()
        both[k] = of_a
    return alone / total[:, None], both / total[pair[:, 0], None]


def enumerated(weight: Floats, pair: Ints, joint: Floats) -> tuple[Floats, Floats]:
    """The same, summed over all sets of hypotheses that exclude each other."""
    every = [((i,), j, weight[i, j]) for i, j in np.argwhere(weight > 0.0)]
    every += [(tuple(pair[k]), j, joint[k, j]) for k, j in np.argwhere(joint > 0.0)]
    one, two, total = np.zeros_like(weight), np.zeros_like(joint), 0.0
    for chosen in itertools.product([False, True], repeat=len(every)):
        taken = [h for h, yes in zip(every, chosen, strict=True) if yes]
        people, boxes = [i for h in taken for i in h[0]], [h[1] for h in taken]
        if len(set(people)) < len(people) or len(set(boxes)) < len(boxes):
            continue
        w = float(np.prod([h[2] for h in taken]))
        total += w
        for who, j, _ in taken:
            if len(who) == 1:
                one[who[0], j] += w
            else:
                two[next(k for k in range(len(pair)) if tuple(pair[k]) == who), j] += w
    return one / total, two / total


def test_marginals_of_one_pair_and_one_box_are_near_the_exact_sum() -> None:
    weight, pair, joint = np.array([[2.0], [0.5]]), np.array([[0, 1]]), np.array([[6.0]])
    found, exact = beliefs(weight, pair, joint), enumerated(weight, pair, joint)
    np.testing.assert_allclose(found[0], exact[0], atol=0.15)
    np.testing.assert_allclose(found[1], exact[1], atol=0.2)


@pytest.mark.parametrize("seed", range(4))
def test_marginals_of_several_pairs_are_near_the_exact_sum(seed: int) -> None:
    rng = np.random.default_rng(seed)
    weight, pair = np.exp(rng.normal(0.0, 2.0, (3, 2))), np.array([[0, 1], [1, 2]])
    joint = np.exp(rng.normal(0.0, 2.0, (2, 2)))
    found, exact = beliefs(weight, pair, joint), enumerated(weight, pair, joint)
    assert np.abs(found[0] - exact[0]).max() < 0.15
    assert np.abs(found[1] - exact[1]).max() < 0.15


@pytest.mark.parametrize("seed", range(4))
def test_messages_are_those_of_belief_propagation_on_all_hypotheses(seed: int) -> None:
    rng = np.random.default_rng(seed)
    weight, joint = rng.uniform(0.1, 1.5, (4, 3)), rng.uniform(0.1, 1.5, (3, 3))
    weight[rng.random(weight.shape) < 0.3], joint[rng.random(joint.shape) < 0.3] = 0.0, 0.0
    pair = np.array([[0, 1], [0, 2], [1, 3]])
    members = [(i, 4 + j) for i, j in np.ndindex(4, 3)] + [(*pair[k], 4 + j) for k, j in np.ndindex(3, 3)]
    x = belief_propagation(np.append(weight, joint), members, 7)
    nu = pair_messages(weight, pair, joint)
    np.testing.assert_allclose(weight * nu.single, [[x[3 * i + j, i] for j in range(3)] for i in range(4)], atol=1e-4)
    for k, j in np.ndindex(3, 3):
        for s in range(2):
            got = joint[k, j] * nu.partner[k, 1 - s, j] * nu.pair[k, j]
            assert got == pytest.approx(x[12 + 3 * k + j, pair[k, s]], abs=1e-4)


def test_without_pairs_messages_are_those_of_one_person_a_box() -> None:
    weight = np.exp(np.random.default_rng(0).normal(0.0, 2.0, (4, 5)))
    none = pair_messages(weight, np.zeros((0, 2), dtype=np.int64), np.zeros((0, 5)))
    np.testing.assert_array_equal(none.single, box_messages(weight))
