"""What groups of people add: the figures of the whole, by groups that exchanges do not cross."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.core.metrics.clear_mot import CHALLENGE, CLASSIC, ClearRule
from occlog.core.metrics.frame_pairs import Frames, Objects, of_points
from occlog.core.metrics.frame_sums import PLACE, frame_sums
from occlog.core.metrics.group_sums import group_sums, groups_of

PEOPLE, FRAMES = 6, 30


def run(seed: int, exchange: tuple[int, int] | None = None, false: int = 0) -> Frames:
    """People far apart; two of them exchange their tracks half way, and false tracks are of nobody."""
    rng = np.random.default_rng(seed)
    cell, label = np.repeat(np.arange(FRAMES), PEOPLE), np.tile(np.arange(PEOPLE), FRAMES)
    place = np.column_stack([label * 10.0, 0.1 * cell])
    name = label + 100
    if exchange is not None:
        a, b = exchange
        late = cell >= FRAMES // 2
        name = np.where(late & (label == a), 100 + b, np.where(late & (label == b), 100 + a, name))
    kept = rng.random(len(cell)) < 0.8
    found = place + rng.normal(0, 0.2, place.shape)
    far = np.column_stack([np.full(false * FRAMES, 500.0), np.repeat(np.arange(false) * 10.0, FRAMES)])
    tracks = Objects(
        np.concatenate([cell[kept], np.tile(np.arange(FRAMES), false)]),
        np.concatenate([name[kept], 200 + np.repeat(np.arange(false), FRAMES)]),
        np.concatenate([found[kept], far]),
    )
    return of_points(Objects(cell, label, place), tracks, 1.0)


@pytest.mark.parametrize("rule", [CLASSIC, CHALLENGE])
def test_groups_and_frames_add_up_to_the_same(rule: ClearRule) -> None:
    a, b = run(1, (0, 1), false=2), run(2, (2, 3))
    for frames, groups in zip((a, b), groups_of(a, b), strict=True):
        by_group = group_sums(frames, groups, rule)
        assert len(by_group) == groups.number
        np.testing.assert_allclose(by_group.sum(axis=0), frame_sums(frames, FRAMES, rule).sum(axis=0))


def test_who_is_exchanged_in_either_run_is_of_one_group() -> None:
    of_a, of_b = groups_of(run(1, (0, 1)), run(2, (1, 2)))
    assert (of_a.target == of_b.target).all()
    assert len(set(of_a.target[[0, 1, 2]])) == 1
    assert len(set(of_a.target)) == of_a.number == PEOPLE - 2
    # A track is of the group of its person
    assert (of_a.track == of_a.target[np.arange(PEOPLE)]).all()


def test_tracks_of_nobody_are_groups_of_their_own() -> None:
    a, b = run(1, false=3), run(2, false=1)
    of_a, of_b = groups_of(a, b)
    assert of_a.number == PEOPLE + 3 + 1
    alone = of_a.track[PEOPLE:]
    assert len({*alone, *of_b.track[PEOPLE:], *of_a.target}) == of_a.number
    sums = group_sums(a, of_a)
    assert (sums[alone, PLACE["estimates"]] == FRAMES).all()
    assert not sums[alone, PLACE["objects"]].any()


def test_an_exchange_is_the_loss_of_its_group_alone() -> None:
    a, b = run(1), run(1, (4, 5))
    of_a, of_b = groups_of(a, b)
    lost = (group_sums(a, of_a) - group_sums(b, of_b))[:, PLACE["idtp"]]
    assert np.flatnonzero(lost).tolist() == [of_a.target[4]]
    assert lost.max() > FRAMES // 2


def test_without_tracks_everybody_is_a_group() -> None:
    nothing = Objects(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2)))
    cell, label = np.repeat(np.arange(4), 3), np.tile(np.arange(3), 4)
    frames = of_points(Objects(cell, label, np.column_stack([label * 9.0, cell])), nothing, 1.0)
    groups, _ = groups_of(frames, frames)
    assert groups.number == 3
    assert group_sums(frames, groups)[:, PLACE["objects"]].tolist() == [4.0, 4.0, 4.0]
