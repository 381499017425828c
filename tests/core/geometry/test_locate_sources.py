"""Where sources of directions are: people found, ghosts refused, and the limits of gate, crossing and room."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.core.geometry.camera import wrap_angle
from occlog.core.geometry.triangulate import SourceDirections, localise

ROOM = np.array([[0.0, 0.0], [8.0, 0.0], [8.0, 6.0], [0.0, 6.0]])
PLACES = np.array([[0.5, 0.5], [7.5, 0.5], [4.0, 5.5]])
SIGMA = np.radians(2.0)
NONE = np.empty((0, 2)), np.empty((0, 2, 2))


def directions(people, arrays: int, rng=None) -> SourceDirections:
    rows = [(a, p) for a in range(arrays) for p in people]
    array = np.array([a for a, _ in rows], dtype=np.int64)
    away = np.array([p for _, p in rows], dtype=float).reshape(-1, 2) - PLACES[array]
    noise = 0.0 if rng is None else rng.normal(0, SIGMA, len(rows))
    return SourceDirections(
        array, PLACES[array], wrap_angle(np.arctan2(away[:, 1], away[:, 0]) + noise), np.full(len(rows), SIGMA)
    )


def test_three_arrays_find_two_people_without_ghosts() -> None:
    people = np.array([[3.0, 2.0], [5.5, 3.5]])
    found = localise(directions(people, 3), *NONE, ROOM, 3.0, 0.1)
    assert found.arrays.tolist() == [3, 3]
    assert np.allclose(np.sort(found.xy, axis=0), np.sort(people, axis=0), atol=1e-6)


def test_two_arrays_need_to_know_where_people_were() -> None:
    """Four crossings, two of them ghosts: what is near known places is taken."""
    people = np.array([[3.0, 2.0], [5.5, 3.5]])
    known = people + 0.1
    found = localise(directions(people, 2), known, np.tile(0.04 * np.eye(2), (2, 1, 1)), ROOM, 3.0, 0.1)
    assert np.allclose(np.sort(found.xy, axis=0), np.sort(people, axis=0), atol=1e-6)


def test_covariance_is_that_of_the_errors() -> None:
    """Mean NEES of 400 places is 2 within 4 standard errors (each has variance 4)."""
    rng, person = np.random.default_rng(2), np.array([3.0, 3.0])
    nees = []
    for _ in range(400):
        found = localise(directions(person[None], 3, rng), *NONE, ROOM, 4.0, 0.1)
        if len(found.xy):
            e = found.xy[0] - person
            nees.append(e @ np.linalg.solve(found.covariance[0], e))
    assert len(nees) > 390
    assert abs(np.mean(nees) - 2.0) < 4 * 2 / len(nees) ** 0.5


def test_no_place_from_one_array_parallel_lines_or_outside() -> None:
    assert not len(localise(directions([(3.0, 2.0)], 1), *NONE, ROOM, 3.0, 0.1).xy)
    along = SourceDirections(np.array([0, 1]), PLACES[:2], np.array([0.0, 0.01]), np.full(2, SIGMA))
    assert not len(localise(along, *NONE, ROOM, 3.0, 0.1).xy)
    assert not len(localise(directions([(4.0, 9.0)], 2), *NONE, ROOM, 3.0, 0.1).xy)


def test_directions_that_cross_at_the_least_angle_give_a_place_and_flatter_ones_do_not() -> None:
    d = directions([(4.0, 2.0)], 2)
    crossing = float(wrap_angle(d.azimuth[1] - d.azimuth[0]))
    crossing = min(crossing, np.pi - crossing)
    assert len(localise(d, *NONE, ROOM, 3.0, crossing * (1 - 1e-9)).xy) == 1
    assert len(localise(d, *NONE, ROOM, 3.0, crossing * (1 + 1e-9)).xy) == 0


@pytest.mark.parametrize(("deviations", "arrays"), [(2.99, [3]), (3.2, [2])])
def test_a_third_direction_supports_a_place_up_to_the_gate(deviations: float, arrays: list[int]) -> None:
    """Two directions are exact, so that the third passes their crossing by so many standard deviations of its own.

    Other crossings see the same misfit to the first order only: just above 3 some still support the place.
    """
    d = directions([(4.0, 2.0)], 3)
    off = np.array([0.0, 0.0, deviations * SIGMA])
    exact = d._replace(sigma=SIGMA * np.array([1e-6, 1e-6, 1.0]), azimuth=d.azimuth + off)
    assert localise(exact, *NONE, ROOM, 3.0, 0.1).arrays.tolist() == arrays


@pytest.mark.parametrize(("deviations", "found"), [(2.33, True), (2.36, False)])
def test_four_directions_fit_up_to_the_gate_and_their_degrees_of_freedom(deviations: float, found: bool) -> None:
    """Two are exact, and each of the others is off by `deviations`: 2 d^2 against 3^2 + 2."""
    places, at = np.vstack([PLACES, [[0.5, 5.5]]]), np.array([4.0, 2.0])
    azimuth = np.arctan2(*(at - places).T[::-1]) + np.array([0.0, 0.0, deviations * SIGMA, -deviations * SIGMA])
    d = SourceDirections(np.arange(4), places, azimuth, SIGMA * np.array([1e-6, 1e-6, 1.0, 1.0]))
    assert (localise(d, *NONE, ROOM, 3.0, 0.1).arrays.tolist() == [4]) == found


def test_every_direction_is_used_once() -> None:
    people = np.array([[3.0, 2.0], [5.5, 3.5], [2.0, 5.0]])
    found = localise(directions(people, 3), *NONE, ROOM, 3.0, 0.1)
    assert found.arrays.sum() <= 9
    assert len(found.xy) == 3
