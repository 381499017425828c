"""The kit of metrics: each check tries one promise with a short walk of two people."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from occlog.evaluate.stage import fault_of
from occlog.plugins.interface import MetricInput

from .faults import FIRST, BrokenError, Check, called, defaults, manners, named, refuse
from .samples import START_NS, compared, errors

GROWTH_BYTES = 2_000
"""Memory that a comparison may leave behind."""
CLOSE = 1e-6
"""Relative difference of figures that are the same."""
POWERS = {"length": 1, "length^2": 2, "length2": 2, "length/s": 1}
"""Powers of length in units."""


def figures(of: Any, given: MetricInput, what: str = "figures") -> Mapping[str, float]:
    """Return the figures that a new metric of class `of` computes, by name.

    Args:
        of: class of the metric.
        given: tracks, truth and errors to compare.
        what: words for the call in messages.

    Raises:
        BrokenError: the metric raises, or returns impossible values.
    """
    with called(what):
        found = of(defaults(of, given.length_unit)).figures(given)
    refuse(fault_of(found, of.units), "" if what == "figures" else what)
    return found  # type: ignore[no-any-return]


def use(of: Any) -> list[tuple[str, str]]:
    """Return (name, value as text) of all figures of the metric class `of` for the sample tables, sorted by name."""
    return [(name, repr(float(value))) for name, value in sorted(figures(of, compared()).items())]


def _similar(of: Any, other: MetricInput, what: str, scale: float = 1.0) -> None:
    """Check that the figures of a metric for a transformed comparison are those of the plain sample tables.

    Args:
        of: class of the metric.
        other: the sample comparison in another world, with other units or identities.
        what: words for that world in messages.
        scale: factor of lengths; a figure is expected to grow by the power of length in its unit.

    Raises:
        BrokenError: a figure differs by more than `CLOSE`.
    """
    plain, found = figures(of, compared()), figures(of, other, what)
    for name, value in plain.items():
        want = float(value) * scale ** POWERS.get(of.units[name], 0)
        if not math.isclose(want, float(found[name]), rel_tol=CLOSE, abs_tol=CLOSE) and not (
            math.isnan(want) and math.isnan(float(found[name]))
        ):
            raise BrokenError(f"{what}: the metric's {name} is {float(found[name]):.6g}; {want:.6g} was expected")


def check_units(of: Any) -> None:
    """Check that a metric declares a unit for each figure, and names figures by small letters, digits and `_`."""
    if not isinstance(of.units, Mapping) or not of.units:
        raise BrokenError("the metric's units must be a mapping from names of figures to units, with one at least")
    for name, unit in of.units.items():
        if not re.fullmatch(r"[a-z][a-z0-9_]*", str(name)):
            raise BrokenError(f"the metric's figure {name!r} must be named by small letters, digits and _")
        if not isinstance(unit, str) or re.search(r"\s", unit):
            raise BrokenError(
                f"the metric's unit of {name} is {unit!r}; expected a text without blanks, as 'length', 's' or '1'"
            )


def check_figures(of: Any) -> None:
    """Check that a metric returns all figures that `units` declares, as numbers, and no others."""
    figures(of, compared())


def check_known(of: Any) -> None:
    """Check that at least one figure of an ordinary walk is a number."""
    if all(math.isnan(value) for value in figures(of, compared()).values()):
        raise BrokenError("the metric gives NaN for all figures of ordinary tracks; one number at least was expected")


def check_inputs(of: Any) -> None:
    """Check that a metric leaves the given tables unchanged."""
    given = compared()
    tables = (given.tracks, given.truth, given.errors)
    before = [{c.name: getattr(table, c.name).tobytes() for c in table.columns()} for table in tables]
    figures(of, given)
    for table, was in zip(tables, before, strict=True):
        changed = [name for name, data in was.items() if getattr(table, name).tobytes() != data]
        if changed:
            raise BrokenError(
                f"the metric's method figures changes {changed[0]} of the {table.NAME} that it is given; copy it"
            )


def check_reuse(of: Any) -> None:
    """Check that one metric object gives equal figures for two equal comparisons."""
    own = of(defaults(of))
    with called("figures"):
        first, second = dict(own.figures(compared())), dict(own.figures(compared()))
    if repr(first) != repr(second):
        raise BrokenError(
            "the metric gives other figures for the same tables the second time; keep nothing of the first comparison"
        )


def check_no_tracks(of: Any) -> None:
    """Check that a metric accepts tracks without rows."""
    given = compared()
    figures(of, given._replace(tracks=given.tracks.empty(), errors=given.errors.empty()), "without tracks")


def check_no_truth(of: Any) -> None:
    """Check that a metric accepts a truth without rows."""
    given = compared()
    figures(of, given._replace(truth=given.truth.empty(), errors=given.errors.empty()), "no truth")


def check_no_pairs(of: Any) -> None:
    """Check that a metric accepts tracks and truth without common identities, so that the errors have no rows."""
    given = compared()
    figures(of, given._replace(errors=given.errors.empty()), "tracks and truth of other people")


def check_one_row(of: Any) -> None:
    """Check that a metric accepts a single estimate."""
    given = compared()
    first = given.tracks.take(slice(0, 1))
    figures(of, MetricInput(first, given.truth, errors(first, given.truth), "m"), "a single estimate")


def check_no_covariance(of: Any) -> None:
    """Check that a metric accepts NaN as covariances, velocities and NEES."""
    given = compared()
    unknown = {
        c.name: np.full(len(given.tracks), np.nan)
        for c in given.tracks.columns()
        if c.name in ("vx", "vy", "cov_xx", "cov_xy", "cov_yy") and c.nan is not None
    }
    left = given.errors.with_columns(nees=np.full(len(given.errors), np.nan))
    bare = given._replace(tracks=given.tracks.with_columns(**unknown), errors=left)
    figures(of, bare, "tracks without covariances")


def check_numbers(of: Any) -> None:
    """Check that figures do not depend on the identity numbers of the targets."""
    given = compared()

    def renamed(table: Any) -> Any:
        return table.with_columns(target_id=np.where(table.target_id == 3, 40, 7))

    other = MetricInput(renamed(given.tracks), renamed(given.truth), renamed(given.errors), "m")
    _similar(of, other, "with other numbers of targets")


def check_shift(of: Any) -> None:
    """Check that figures do not depend on the origin of the world, by a shift of about 2 km."""
    _similar(of, compared(shift=(1000.0, -2000.0)), "in a world shifted by 2 km")


def check_unit(of: Any) -> None:
    """Check that in centimetres figures of length scale with the power of their unit, and others stay the same."""
    _similar(of, compared(scale=100.0, unit="cm"), "in centimetres", 100.0)


def check_epoch(of: Any) -> None:
    """Check that figures do not depend on the epoch of times: 1970, or the start of the recording."""
    _similar(of, compared(start_ns=START_NS % 10**9), "with times that begin near 0")


CHECKS: dict[str, Check] = {
    **FIRST,
    **named(globals()),
    **manners(use, "figures", growth_bytes=GROWTH_BYTES),
}
"""Every check by its name."""
