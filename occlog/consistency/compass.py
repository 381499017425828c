"""Whether bearings look like those of a compass: clockwise from north, and not from +x towards +y.

Sight lines of one moment meet near one place if their angles mean what they are taken for.  Taken for the others,
pi / 2 - b, lines of stations in general places do not meet, or behind the stations.  Both are tried, and a user is told
where the others fit much better; nothing is changed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from occlog.array_types import Floats
from occlog.records.scene import Scene
from occlog.records.tables import Bearings
from occlog.records.verdicts import Check, finding, outcome

FEWEST, MOST = 10, 500
"""Fewest moments that tell, and how many are looked at."""
BETTER, OFF = 0.1, 0.05
"""A median square misfit [rad^2] below this share of the other one's, where that is above `OFF`, is much better."""
CONVENTION = "convention of angles"
"""Name of the check."""
WORST = 1.0
"""Misfits of single lines count at most as this [rad^2]: false ones are not to decide."""


class Compass:
    """Tries both meanings of the bearings of stations that stream by; cameras' bearings are never of a compass."""

    def __init__(self, scene: Scene) -> None:
        """Nothing was seen yet."""
        self._places = {a.name: np.asarray(a.position[:2], dtype=np.float64) for a in scene.arrays}
        self._misfits: list[tuple[float, float]] = []

    def watch(self, chunks: Iterable[Bearings]) -> Iterator[Bearings]:
        """The same chunks."""
        for chunk in chunks:
            if len(self._places) > 1 and len(self._misfits) < MOST:
                self._look(chunk)
            yield chunk

    def checks(self) -> tuple[Check, ...]:
        """Whether they fit one another as angles of this program."""
        if len(self._misfits) < FEWEST:
            return outcome(CONVENTION, (), unless=f"fewer than {FEWEST} moments have bearings of several stations")
        plain, other = np.median(self._misfits, axis=0).tolist()
        if plain <= OFF or other > BETTER * plain:
            return outcome(CONVENTION, (), misfit_rad=float(np.sqrt(plain)))
        return (
            finding(
                CONVENTION,
                "warning",
                "compass",
                "the bearings fit one another much better as those of a compass, clockwise from north (+y): then the "
                f"lines of a moment miss one place by {np.degrees(np.sqrt(other)):.2g} degrees (median of "
                f"{len(self._misfits)} moments), and by {np.degrees(np.sqrt(plain)):.2g} as they are, from +x towards "
                "+y; name the column compass_deg, or ingest with the convention compass",
            ),
        )

    def _look(self, chunk: Bearings) -> None:
        use = chunk.seen & np.isfinite(chunk.bearing) & np.isin(chunk.sensor, list(self._places))
        own = chunk.take(use)
        order = np.lexsort((own.target_id, own.t_ns))
        t_ns, target = own.t_ns[order], own.target_id[order]
        cuts = np.flatnonzero((np.diff(t_ns) != 0) | (np.diff(target) != 0)) + 1
        for rows in np.split(order, cuts):
            names = own.sensor[rows].tolist()
            if len(names) > 1 and len(set(names)) == len(names) and len(self._misfits) < MOST:
                places = np.array([self._places[name] for name in names])
                bearings = own.bearing[rows]
                self._misfits.append((misfit(places, bearings), misfit(places, 0.5 * np.pi - bearings)))


def misfit(places: Floats, bearings: Floats) -> float:
    """Mean square angle [rad^2] by which n lines miss the place that is nearest to all of them, at most `WORST` each.

    Args:
        places: (n, 2) where the lines begin, n >= 2.
        bearings: (n,) [rad].
    """
    across = np.column_stack([-np.sin(bearings), np.cos(bearings)])
    normal, right = across.T @ across, across.T @ np.sum(across * places, axis=1)
    away = np.linalg.pinv(normal) @ right - places
    off = (bearings - np.arctan2(away[:, 1], away[:, 0]) + np.pi) % (2.0 * np.pi) - np.pi
    return float(np.minimum(off**2, WORST).mean())
