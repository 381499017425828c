from __future__ import annotations

import numpy as np
import pytest

from occlog.measure.clusters.merged_silhouettes import (
    AREA,
    CLUTTER_PROBABILITY,
    COLUMNS,
    MIN_LOG_LIKELIHOOD_GAIN,
    OUTLINE,
    ROWS,
    SPAN,
    fit_outlines,
    gain,
    not_covered,
)
from occlog.measure.clusters.person_size import constant_sizes, make_prior

SIDE, HEIGHT = 3, 36.0  # of a cell [px], of a person [cells]
SHAPE = (80, 100)
PRIOR = make_prior(constant_sizes((SIDE * SHAPE[1], SIDE * SHAPE[0]), SIDE * HEIGHT), 2.0, 0.1, 0.2)


def log_free(people: list[tuple[float, float, float]]) -> np.ndarray:
    """The definition, cell by cell: logs of the probability that none of the people covers a cell."""
    out = np.zeros(SHAPE)
    for x, y, height in people:
        for row, column in np.ndindex(SHAPE):
            if abs(row - y) <= 0.5 * height and abs(column - x) <= 0.5 * SPAN * height:
                down = int(min(max((row - y) / height + 0.5, 0.0) * ROWS, ROWS - 1))
                across = int(min(max((column - x) / (SPAN * height) + 0.5, 0.0) * COLUMNS, COLUMNS - 1))
                out[row, column] += OUTLINE[down, across]
    return out


def log_likelihood(foreground: np.ndarray, people: list[tuple[float, float, float]]) -> float:
    """Of all cells: foreground has the probability 1 - (1 - SPECKS) prod (1 - p)."""
    empty = (1.0 - CLUTTER_PROBABILITY) * np.exp(log_free(people))
    return float(np.sum(foreground * np.log1p(-empty) + (1.0 - foreground) * np.log(empty)))


def drawn(people: list[tuple[float, float, float]], seed: int) -> np.ndarray:
    """Foreground drawn from the model, by the blobs of two cells that come and go in video."""
    rng = np.random.default_rng(seed)
    chance = np.kron(rng.random((SHAPE[0] // 2, SHAPE[1] // 2)), np.ones((2, 2)))
    return (chance < 1.0 - np.exp(log_free(people))).astype(np.float64)


def test_one_more_person_is_worth_the_rise_of_the_likelihood() -> None:
    first, second = (40.0, 38.0, 36.0), (49.5, 42.25, 33.0)
    foreground = np.random.default_rng(3).random(SHAPE)
    want = log_likelihood(foreground, [first, second]) - log_likelihood(foreground, [first])
    assert gain(foreground, log_free([first]), *second) == pytest.approx(want, rel=1e-9)


def test_a_person_covers_the_share_of_a_square_of_their_height_that_is_reported() -> None:
    total = sum(
        1.0 - np.exp(not_covered(50.0, 40.0, HEIGHT, column, row)) for row in range(23, 58) for column in range(42, 59)
    )
    assert total / HEIGHT**2 == pytest.approx(AREA, rel=0.1)


@pytest.mark.parametrize(
    "people",
    [
        [(50.0, 40.0, 36.0)],
        [(40.0, 40.0, 36.0), (52.0, 36.0, 35.0)],
        [(34.0, 42.0, 37.0), (45.0, 38.0, 36.0), (56.0, 43.0, 36.0)],
    ],
)
def test_the_people_of_a_silhouette_are_found(people: list[tuple[float, float, float]]) -> None:
    got = fit_outlines(drawn(people, 1), PRIOR, SIDE, 0, 0)
    assert len(got) == len(people)
    np.testing.assert_allclose(got[np.argsort(got[:, 0])][:, 0], [p[0] for p in people], atol=1.5)
    np.testing.assert_allclose(got[np.argsort(got[:, 0])][:, 1:], [p[1:] for p in people], atol=2.5)


def test_no_one_is_added_who_explains_too_little() -> None:
    foreground = np.zeros(SHAPE)
    foreground[30:35, 40:45] = 1.0
    assert np.log(1.0 / CLUTTER_PROBABILITY) * 25 < MIN_LOG_LIKELIHOOD_GAIN * AREA * HEIGHT**2  # all that it is worth
    assert len(fit_outlines(foreground, PRIOR, SIDE, 0, 0)) == 0
    assert len(fit_outlines(np.zeros(SHAPE), PRIOR, SIDE, 0, 0)) == 0
