"""Where people come from and where they leave, learned on the way: a map of the floor.

Counts of arrivals, departures and of the time that people spent are kept in cells of the floor and are smoothed by a
Gaussian.  Where nothing was counted the rates of the whole place hold, so that a map that has seen little changes
little; no wall and no door is set by hand.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from occlog.array_types import Floats, Ints

CELL, SMOOTH = 0.5, 1.0
"""Side of a cell and deviation of the smoothing, in metres."""
PRIOR_LEFT = 1.0
"""The rate of the whole place is worth so many departures at each place."""
PRIOR_VELOCITY = 2.0
"""The first deviation of a velocity is worth so many arrivals at each place."""
LEAST_BIRTHS = 0.02
"""Wherever it is, arrivals are not rarer than this share of the first rate."""


@dataclass(frozen=True)
class PlaceMap:
    """Counts in G cells that anybody was in."""

    metre: float  # in the scene's unit
    row: dict[tuple[int, int], int]  # of a cell
    centre: Floats  # (G, 2)
    left: Floats  # (G,) departures
    spent: Floats  # (G,) person-seconds
    came: Floats  # (G,) arrivals
    velocity: Floats  # (G, 2) sum of the velocities of those who arrived
    square: Floats  # (G, 2, 2) sum of their squares
    watched: float  # seconds


def no_map(metre: float) -> PlaceMap:
    """Nothing was seen."""
    none = np.zeros(0)
    return PlaceMap(metre, {}, np.zeros((0, 2)), none, none, none, np.zeros((0, 2)), np.zeros((0, 2, 2)), 0.0)


def watch(
    known: PlaceMap, dt: float, *, people: Floats, existence: Floats, left: Floats, came: Floats, velocity: Floats
) -> PlaceMap:
    """The map after dt more seconds.

    Args:
        known: before.
        dt: seconds.
        people: (n, 2) where those are who are sure.
        existence: (n,) how surely.
        left: (k, 2) where people were last detected who left.
        came: (m, 2) where people were first detected who are sure by now.
        velocity: (m, 2) theirs.
    """
    places = np.concatenate([people, left, came])
    rows, cells = dict(known.row), []
    at = []
    for x, y in np.floor(places / (CELL * known.metre)).astype(np.int64).tolist():
        if (x, y) not in rows:
            rows[x, y] = len(rows)
            cells.append((x, y))
        at.append(rows[x, y])
    row, new = np.array(at, dtype=np.int64), len(cells)
    centre = (np.array(cells, dtype=np.float64).reshape(-1, 2) + 0.5) * CELL * known.metre
    n, k = len(people), len(people) + len(left)
    return PlaceMap(
        metre=known.metre,
        row=rows,
        centre=np.concatenate([known.centre, centre]),
        left=_added(known.left, new, row[n:k], np.ones(len(left))),
        spent=_added(known.spent, new, row[:n], dt * existence),
        came=_added(known.came, new, row[k:], np.ones(len(came))),
        velocity=_added(known.velocity, new, row[k:], velocity),
        square=_added(known.square, new, row[k:], velocity[:, :, None] * velocity[:, None, :]),
        watched=known.watched + dt,
    )


def leaving_at(known: PlaceMap, places: Floats, overall: float) -> Floats:
    """(n,) rates [1/s] at which people leave at (n, 2) places, where `overall` is the rate of all."""
    near = _near(known, places)
    return np.asarray((near @ known.left + PRIOR_LEFT) / (near @ known.spent + PRIOR_LEFT / overall))


def arrivals(known: PlaceMap, first: float, worth_s: float) -> tuple[float, Floats]:
    """Rate of arrivals a unit of area and second: everywhere, and (G,) at a cell's centre besides.

    Args:
        known: the map.
        first: rate before anything is known [1/area/s].
        worth_s: it is worth so many seconds of watching.
    """
    seconds = known.watched + worth_s
    smooth = 2.0 * np.pi * (SMOOTH * known.metre) ** 2
    return max(worth_s / seconds, LEAST_BIRTHS) * first, known.came / (smooth * seconds)


def first_velocity(known: PlaceMap, places: Floats, deviation: float) -> tuple[Floats, Floats]:
    """Mean (n, 2) and covariance (n, 2, 2) of the velocities of people who arrive at (n, 2) places."""
    near = _near(known, places)
    count = (near @ known.came + PRIOR_VELOCITY)[:, None]
    mean = near @ known.velocity / count
    square = np.einsum("ng,gij->nij", near, known.square) + PRIOR_VELOCITY * deviation**2 * np.eye(2)
    return mean, square / count[..., None] - mean[:, :, None] * mean[:, None, :]


def _near(known: PlaceMap, places: Floats) -> Floats:
    """(n, G) weights of the cells for places."""
    apart = places[:, None] - known.centre[None]
    return np.asarray(np.exp(-0.5 * np.sum(apart**2, axis=2) / (SMOOTH * known.metre) ** 2))


def _added(sums: Floats, new: int, rows: Ints, values: Floats) -> Floats:
    """The sums with so many new cells, and values added to some."""
    out = np.concatenate([sums, np.zeros((new, *sums.shape[1:]))])
    np.add.at(out, rows, values)
    return out
