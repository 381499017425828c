"""OSPA(2) and trajectory GOSPA: scenes that are worked by hand, the definitions written plainly, brute force."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable

import numpy as np
import pytest
from scipy.optimize import linprog

from occlog.core.metrics.mot.frame_pairs import MatchedFrames, Objects, of_points
from occlog.core.metrics.mot.gospa import Ospa2, Ospa2Sums, Ospa2Windows, ospa2
from occlog.core.metrics.mot.trajectory_gospa import (
    TrajectoryCosts,
    pieces_of,
    rows_within_cutoff,
    sure_segments,
    trajectory_gospa,
)


def rows(*values: tuple[float, ...]) -> Objects:
    """Objects from rows frame, label, place."""
    table = np.array(values, dtype=np.float64).reshape(len(values), len(values[0]) if values else 4)
    return Objects(table[:, 0].astype(np.int64), table[:, 1].astype(np.int64), table[:, 2:])


def line(label: int, frames: range, y: float = 0.0) -> list[tuple[float, ...]]:
    return [(frame, label, 0.0, y) for frame in frames]


def swapped() -> MatchedFrames:
    """Two targets 5 m apart for ten frames; the tracks change hands after six."""
    truth = rows(*line(1, range(10)), *line(2, range(10), 5.0))
    tracks = rows(*line(7, range(6)), *line(7, range(6, 10), 5.0), *line(8, range(6), 5.0), *line(8, range(6, 10)))
    return of_points(truth, tracks, 1.0)


def random_frames(seed: int, targets: int, tracks: int, times: int) -> MatchedFrames:
    """Points of a strip in which everybody is near everybody; rows are missing at random."""
    rng = np.random.default_rng(seed)
    sides = []
    for count in (targets, tracks):
        frame, label = (a.ravel() for a in np.meshgrid(range(times), range(count), indexing="ij"))
        there = rng.random(len(frame)) < 0.8
        sides.append(Objects(frame[there], label[there], rng.uniform(0, 1.5, (int(there.sum()), 2))))
    return of_points(sides[0], sides[1], 1.0)


def distances(frames: MatchedFrames, t: int) -> tuple[dict[int, bool], dict[int, bool], dict[tuple[int, int], float]]:
    left, right = frames.rows(t)
    i, j = frames.truth[left].tolist(), frames.track[right].tolist()
    d = frames.compare(t)[0]
    pairs = {(a, b): float(d[n, m]) for n, a in enumerate(i) for m, b in enumerate(j)}
    return dict.fromkeys(i, True), dict.fromkeys(j, True), pairs


def frame_costs(frames: MatchedFrames, c: float, p: float) -> np.ndarray:
    """(T, n + 1, m + 1) costs of the definition: pairs, targets alone in the last column, tracks in the last row."""
    n, m = len(frames.truth_key), len(frames.track_key)
    out = np.zeros((len(frames.frame), n + 1, m + 1))
    for t in range(len(frames.frame)):
        here, there, d = distances(frames, t)
        for i in range(n + 1):
            for j in range(m + 1):
                if i in here and j in there:
                    out[t, i, j] = min(d[i, j], c) ** p
                elif i in here or j in there:
                    out[t, i, j] = c**p / 2
    return out


def plain_program(frames: MatchedFrames, c: float, gamma: float, p: float) -> float:
    """The linear program as the paper writes it, with every weight of every frame."""
    cost = frame_costs(frames, c, p)
    T, n, m = cost.shape
    weights, pairs = cost.size, (n - 1) * (m - 1)
    price = np.concatenate([cost.ravel(), np.full((T - 1) * pairs, gamma**p / 2)])
    number = np.arange(weights).reshape(T, n, m)
    equal, unequal = [], []
    for t in range(T):
        for side in [*(number[t, i, :] for i in range(n - 1)), *(number[t, :, j] for j in range(m - 1))]:
            row = np.zeros(len(price))
            row[side] = 1
            equal.append(row)
    for t, i, j in itertools.product(range(T - 1), range(n - 1), range(m - 1)):
        for sign in (1, -1):
            row = np.zeros(len(price))
            row[number[t + 1, i, j]], row[number[t, i, j]] = sign, -sign
            row[weights + t * pairs + i * (m - 1) + j] = -1
            unequal.append(row)
    bounds = [(0, None)] * len(price)
    found = linprog(
        price,
        A_ub=np.array(unequal) if unequal else None,
        b_ub=np.zeros(len(unequal)) if unequal else None,
        A_eq=np.array(equal),
        b_eq=np.ones(len(equal)),
        bounds=bounds,
    )
    return float(found.fun)


def brute_force(frames: MatchedFrames, c: float, gamma: float, p: float) -> float:
    """The combinatorial form: every sequence of assignments."""
    cost = frame_costs(frames, c, p)
    T, n, m = cost.shape
    assignments = [
        a
        for a in itertools.product(range(m), repeat=n - 1)  # m - 1: no track
        if all(a.count(j) <= 1 for j in range(m - 1))
    ]

    def alone(t: int, a: tuple[int, ...]) -> float:
        return sum(cost[t, i, j] for i, j in enumerate(a)) + sum(cost[t, n - 1, j] for j in set(range(m - 1)) - set(a))

    def change(a: tuple[int, ...], b: tuple[int, ...]) -> float:
        moved = [(x, y) for x, y in zip(a, b, strict=True) if x != y]
        return sum(gamma**p * (0.5 if m - 1 in pair else 1.0) for pair in moved)

    best = {a: alone(0, a) for a in assignments}
    for t in range(1, T):
        best = {b: alone(t, b) + min(best[a] + change(a, b) for a in assignments) for b in assignments}
    return min(best.values())


def test_tracks_that_change_hands_cost_four_half_switches() -> None:
    got = trajectory_gospa(swapped(), cutoff=1.0, switch=1.0)
    assert (got.localisation, got.missed, got.false) == pytest.approx((0.0, 0.0, 0.0))
    assert got.switch == got.total == pytest.approx(2.0)
    assert trajectory_gospa(swapped(), cutoff=1.0, switch=0.5).total == pytest.approx(0.5)


def test_a_dear_switch_is_not_made_and_four_frames_are_missed_and_false() -> None:
    got = trajectory_gospa(swapped(), cutoff=1.0, switch=9.0)
    assert got.switch == pytest.approx(0.0)
    assert (got.missed, got.false) == pytest.approx((4.0, 4.0))


def test_a_target_that_gets_a_second_track_after_a_gap_changes_once() -> None:
    truth = rows(*line(1, range(10)))
    tracks = rows(*line(7, range(4)), *line(8, range(5, 10)))
    got = trajectory_gospa(of_points(truth, tracks, 1.0), cutoff=1.0, switch=0.3)
    assert (got.missed, got.false, got.switch) == pytest.approx((0.5, 0.0, 0.09))


def test_a_gap_of_one_track_is_no_switch() -> None:
    truth = rows(*line(1, range(10)))
    tracks = rows(*line(7, range(4)), *line(7, range(6, 10)))
    got = trajectory_gospa(of_points(truth, tracks, 1.0), cutoff=1.0, switch=0.3)
    assert (got.total, got.missed, got.switch) == pytest.approx((1.0, 1.0, 0.0))


def test_a_track_at_the_cutoff_is_a_missed_target_and_a_false_track() -> None:
    truth = rows(*line(1, range(4)))
    at, near = (of_points(truth, rows(*line(7, range(4), y)), 1.0) for y in (1.0, 0.999))
    assert trajectory_gospa(at, 1.0, 1.0).missed == trajectory_gospa(at, 1.0, 1.0).false == pytest.approx(2.0)
    assert trajectory_gospa(near, 1.0, 1.0).localisation == pytest.approx(4 * 0.999**2)


@pytest.mark.parametrize("length", [1e-9, 1e-5, 1e-3, 1e6])
def test_it_grows_with_the_unit_of_lengths(length: float) -> None:
    frames = random_frames(1, 3, 3, 6)
    same = frames._replace(truth_position=frames.truth_position * length, track_position=frames.track_position * length)
    got, want = trajectory_gospa(same, 0.8 * length, 0.4 * length), trajectory_gospa(frames, 0.8, 0.4)
    assert np.array(got[:5]) / length**2 == pytest.approx(np.array(want[:5]), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_the_short_program_has_the_value_of_the_whole_one(seed: int) -> None:
    frames = random_frames(seed, 3, 3, 6)
    for p, gamma in ((2.0, 0.4), (1.0, 0.2)):
        got = trajectory_gospa(frames, 0.8, gamma, p)
        assert got.total == pytest.approx(plain_program(frames, 0.8, gamma, p), rel=1e-7)
        assert got.total == pytest.approx(got.localisation + got.missed + got.false + got.switch)


def walkers(seed: int, people: int, times: int) -> MatchedFrames:
    """People who wander in a room, tracks that are exchanged where they meet, begin again, and miss them at times."""
    rng = np.random.default_rng(seed)
    walked = np.cumsum(rng.normal(0, 0.25, (times, people, 2)), axis=0) + rng.uniform(0, 3, (people, 2))
    x = np.abs((walked + 3) % 6 - 3)
    frame, label = (a.ravel() for a in np.meshgrid(range(times), range(people), indexing="ij"))
    names, track = np.arange(people), label.reshape(times, people).copy()
    for t in range(times):
        apart = np.hypot(*(x[t][:, None] - x[t][None]).transpose(2, 0, 1)) + 9 * np.eye(people)
        i, j = np.unravel_index(apart.argmin(), apart.shape)
        if apart[i, j] < 0.5 and rng.random() < 0.3:
            names[[i, j]] = names[[j, i]]
        if rng.random() < 0.01:
            names[rng.integers(people)] = names.max() + 1
        track[t] = names
    seen, found = rng.random((2, times * people)) < 0.94
    y = (x + rng.normal(0, 0.15, x.shape)).reshape(-1, 2)
    return of_points(
        Objects(frame[seen], label[seen], x.reshape(-1, 2)[seen]),
        Objects(frame[found], track.ravel()[found], y[found]),
        1.0,
    )


@pytest.mark.parametrize("seed", range(5))
def test_cut_into_pieces_of_time_it_is_that_of_the_whole_program(seed: int) -> None:
    frames = walkers(seed, 3, 60)
    pairs = rows_within_cutoff(frames, 1.0, 2.0)
    sure = sure_segments(pairs, 1.0, 0.25)
    assert len(sure.first) > 5
    assert len(list(pieces_of(pairs, sure.pins(pairs), 60).blocks())) > 2
    assert trajectory_gospa(frames, 1.0, 0.5).total == pytest.approx(plain_program(frames, 1.0, 0.5, 2.0), rel=1e-9)


@pytest.mark.parametrize(("switch", "sure"), [(0.7499, [2, 3]), (0.7501, []), (0.4999, [1, 2, 3, 4]), (1e-3, range(6))])
def test_a_pair_is_sure_where_both_sides_gain_three_changes(switch: float, sure: list[int]) -> None:
    """Six frames that gain 0.75 each: three of them pay three changes of 0.75, two of them three of 0.5."""
    frames = of_points(rows(*line(1, range(6))), rows(*line(7, range(6), 0.5)), 1.0)
    found = sure_segments(rows_within_cutoff(frames, 1.0, 2.0), 1.0, switch)
    assert np.flatnonzero(found.rows).tolist() == list(sure)


@pytest.mark.parametrize("seed", range(6))
def test_brute_force_is_never_below_and_seldom_above(seed: int) -> None:
    frames = random_frames(100 + seed, 2, 3, 5)
    got, exact = trajectory_gospa(frames, 0.8, 0.4).total, brute_force(frames, 0.8, 0.4, 2.0)
    assert got <= exact + 1e-7
    assert got == pytest.approx(exact, rel=1e-6)  # these six have solutions in whole numbers


def test_it_is_the_same_from_both_sides() -> None:
    truth, tracks = rows(*line(1, range(9)), *line(2, range(4), 0.5)), rows(*line(5, range(2, 9), 0.3))
    there, back = of_points(truth, tracks, 1.0), of_points(tracks, truth, 1.0)
    assert trajectory_gospa(there, 1.0, 1.0).total == pytest.approx(trajectory_gospa(back, 1.0, 1.0).total)
    assert ospa2(there, 1.0, 2.0).ospa2 == pytest.approx(ospa2(back, 1.0, 2.0).ospa2)


def test_nothing_on_one_side_is_all_missed_or_all_false() -> None:
    truth, nothing = rows(*line(1, range(3))), rows()
    got = trajectory_gospa(of_points(truth, nothing, 1.0), 2.0, 1.0)
    assert (got.missed, got.false, got.total) == (6.0, 0.0, 6.0)
    assert trajectory_gospa(of_points(nothing, nothing, 1.0), 2.0, 1.0).total == 0.0
    assert ospa2(of_points(truth, nothing, 1.0), 2.0) == (2.0, 0.0, 2.0)
    assert ospa2(of_points(nothing, nothing, 1.0), 2.0) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("wrong", [(0.0, 1.0, 2.0), (1.0, 0.0, 2.0), (1.0, 1.0, 0.99)])
def test_options_outside_their_range_are_refused(wrong: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match="must be above 0"):
        trajectory_gospa(swapped(), *wrong)
    if wrong[1]:
        with pytest.raises(ValueError, match="must be above 0"):
            ospa2(swapped(), wrong[0], wrong[2])


def test_swapped_tracks_are_far_away_while_they_are_on_the_other_target() -> None:
    got = ospa2(swapped(), cutoff=1.0)
    assert got.ospa2 == got.localisation == pytest.approx(0.4)  # four frames of ten at the cutoff
    assert ospa2(swapped(), cutoff=1.0, p=2.0).ospa2 == pytest.approx(math.sqrt(0.4))
    assert ospa2(swapped(), cutoff=3.0).ospa2 == pytest.approx(1.2)


def test_a_gap_and_a_false_track_in_ospa2() -> None:
    """One track 0.2 m off, absent in two frames of ten; another is of no one."""
    truth = rows(*line(1, range(10)))
    tracks = rows(*line(7, range(8), 0.2), *line(8, range(3), 9.0))
    got = ospa2(of_points(truth, tracks, 1.0), cutoff=1.0)
    assert got.localisation == pytest.approx((8 * 0.2 + 2 * 1.0) / 10 / 2)
    assert got.cardinality == pytest.approx(1 / 2)
    assert got.ospa2 == pytest.approx(got.localisation + got.cardinality)


def plain_ospa2(frames: MatchedFrames, c: float, p: float) -> float:
    """OSPA(2) from its definition, over every assignment."""
    n, m = len(frames.truth_key), len(frames.track_key)
    base = np.zeros((n, m))
    for i, j in itertools.product(range(n), range(m)):
        values = []
        for t in range(len(frames.frame)):
            here, there, d = distances(frames, t)
            if i in here and j in there:
                values.append(min(d[i, j], c) ** p)
            elif i in here or j in there:
                values.append(c**p)
        base[i, j] = np.mean(values)
    few, many = min(n, m), max(n, m)
    side = base if n <= m else base.T
    best = min(sum(side[i, j] for i, j in enumerate(chosen)) for chosen in itertools.permutations(range(many), few))
    return float(((best + c**p * (many - few)) / many) ** (1 / p))


@pytest.mark.parametrize("seed", range(4))
def test_ospa2_is_that_of_every_assignment(seed: int) -> None:
    frames = random_frames(seed, 3, 4, 6)
    for p in (1.0, 2.0):
        assert ospa2(frames, 0.9, p).ospa2 == pytest.approx(plain_ospa2(frames, 0.9, p))


def over_time(frames: MatchedFrames, cutoff: float, p: float, window: int, ends: Iterable[int]) -> list[Ospa2]:
    """OSPA(2) of the windows that end at the frames `ends`, from one update."""
    return list(Ospa2Windows(len(frames.truth_key), len(frames.track_key), cutoff, p, window).update(frames, ends))


def test_windows_end_where_they_are_reported_and_are_cut_at_the_beginning() -> None:
    frames = random_frames(5, 3, 3, 12)
    got = over_time(frames, 0.9, 1.0, 4, range(12))
    for end, value in enumerate(got):
        low = max(0, end - 3)
        truth, track = (
            np.repeat(frames.frame, np.diff(frames.truth_start)),
            np.repeat(frames.frame, np.diff(frames.track_start)),
        )
        in_truth, in_track = (truth >= low) & (truth <= end), (track >= low) & (track <= end)
        part = of_points(
            Objects(truth[in_truth], frames.truth[in_truth], frames.truth_position[in_truth]),
            Objects(track[in_track], frames.track[in_track], frames.track_position[in_track]),
            1.0,
        )
        assert value.ospa2 == pytest.approx(ospa2(part, 0.9, 1.0).ospa2)


def test_a_window_of_one_frame_has_no_switch() -> None:
    assert over_time(swapped(), 1.0, 1.0, 1, [6])[0].ospa2 == 0.0


def part_of(frames: MatchedFrames, first: int, stop: int) -> MatchedFrames:
    """Some of the frames, with the numbers of targets and tracks that they have in the whole."""
    left = slice(int(frames.truth_start[first]), int(frames.truth_start[stop]))
    right = slice(int(frames.track_start[first]), int(frames.track_start[stop]))
    return frames._replace(
        frame=frames.frame[first:stop],
        view=frames.view[first:stop],
        truth=frames.truth[left],
        track=frames.track[right],
        truth_start=frames.truth_start[first : stop + 1] - left.start,
        track_start=frames.track_start[first : stop + 1] - right.start,
        truth_position=frames.truth_position[left],
        track_position=frames.track_position[right],
        truth_row=frames.truth_row[left],
        track_row=frames.track_row[right],
    )


@pytest.mark.parametrize(
    ("step", "ends_known", "switch"),
    [(1, True, 0.2), (2, False, 0.6), (7, True, 0.6), (7, False, 0.2), (59, True, 0.6)],
)
def test_in_parts_trajectory_gospa_is_that_of_the_whole(step: int, ends_known: bool, switch: float) -> None:
    for seed in range(2):
        frames = walkers(seed, 3, 60)
        whole, count = trajectory_gospa(frames, 1.0, switch), len(frames.frame)
        sums = TrajectoryCosts(count, len(frames.truth_key), len(frames.track_key), 1.0, switch)
        last = [np.full(len(key), -1) for key in (frames.truth_key, frames.track_key)]
        for t in range(count):
            left, right = frames.rows(t)
            last[0][frames.truth[left]] = last[1][frames.track[right]] = t
        for first in range(0, count, step):
            stop = min(first + step, count)
            over = (last[0] < stop, last[1] < stop) if ends_known else None
            sums.update(part_of(frames, first, stop), first, over)
        assert sums.result() == pytest.approx(whole, rel=1e-12, abs=1e-12)
        assert whole.switch > 0


@pytest.mark.parametrize("window", [1, 4, 100])
def test_in_parts_ospa2_is_that_of_the_whole(window: int) -> None:
    frames = walkers(3, 3, 40)
    size = len(frames.truth_key), len(frames.track_key)
    sums, windows, found = Ospa2Sums(*size, 1.0, 2.0), Ospa2Windows(*size, 1.0, 2.0, window), []
    for first in range(0, 40, 7):
        part = part_of(frames, first, min(first + 7, 40))
        sums.update(part)
        found += list(windows.update(part, range(first, min(first + 7, 40))))
    assert sums.result() == ospa2(frames, 1.0, 2.0)
    assert found == over_time(frames, 1.0, 2.0, window, range(40))
