"""The `occlog diff` command."""

from __future__ import annotations

import math
import re
from pathlib import Path

import click

from occlog import console
from occlog.cli import options
from occlog.errors import ExitCode, UsageError

from .result import RTOL, Limit, Tolerances, as_dict, report_lines

DURATIONS = {"ns": 1, "us": 1_000, "ms": 1_000_000, "s": 1_000_000_000}


@click.command(name="diff", short_help="Compare two outputs and list the differences.")
@click.argument("a", type=options.INPUT)
@click.argument("b", type=options.INPUT)
@click.option(
    "--rtol",
    type=click.FloatRange(min=0),
    default=RTOL,
    show_default=True,
    help="Relative tolerance RTOL of floating-point numbers: |a - b| <= ATOL + RTOL max(|a|, |b|).",
)
@click.option(
    "--atol",
    type=click.FloatRange(min=0),
    default=0.0,
    show_default=True,
    help="Absolute tolerance ATOL of floating-point numbers, in the unit of the column; see --rtol.",
)
@click.option(
    "--tol",
    multiple=True,
    metavar="COLUMN=ATOL[:RTOL]",
    help="Tolerance COLUMN=ATOL[:RTOL] of a column (or TABLE.COLUMN, or a JSON key) instead of --atol "
    "and --rtol; may be repeated.",
)
@click.option(
    "--tol-unit",
    multiple=True,
    metavar="UNIT=ATOL[:RTOL]",
    help="Tolerance UNIT=ATOL[:RTOL] of all columns in a unit (rad, m, cm, px, m^2, ...) instead of --atol "
    "and --rtol; may be repeated.",
)
@click.option(
    "--time-tol",
    default="0ns",
    show_default=True,
    metavar="DURATION",
    help="Largest difference in time of two rows that are compared with each other, with its unit: 1ms.",
)
@click.option(
    "--exclude",
    multiple=True,
    metavar="GLOB",
    help="Leave out files of the compared folders if their name, or their path in the folder, matches this pattern, "
    "such as 'report.*'; may be repeated.",
)
@click.option(
    "--pixels",
    is_flag=True,
    help="Compare frames of recordings by their decoded pixels, not by their compressed bytes.",
)
@click.option("--provenance", is_flag=True, help="Compare the provenance too: version, settings and inputs.")
@options.json_opt
def command(
    a: Path,
    b: Path,
    rtol: float,
    atol: float,
    tol: tuple[str, ...],
    tol_unit: tuple[str, ...],
    time_tol: str,
    exclude: tuple[str, ...],
    pixels: bool,
    provenance: bool,
    as_json: bool,
) -> int:
    """Compare A and B: tables, recordings, JSON files, or folders of them.

    Rows are joined by their key, not by their index. Two numbers are equal if |a - b| <= ATOL + RTOL max(|a|, |b|);
    angles are compared modulo a full turn, and NaN equals NaN. Integers and labels must be equal. Exit code 0:
    equal; 5: different.

    \b
      occlog diff tests/golden run/ --exclude 'report.*'
      occlog diff a/tracks.parquet b/tracks.parquet --tol-unit m=1e-6 --tol cov_xx=1e-4:1e-3
      occlog diff old.mcap new.mcap --time-tol 1ms --json | jq .first
    """
    from .result import DiffSettings
    from .run import compare_paths

    limits = make_tolerances(rtol, atol, tol, tol_unit, time_tol)
    found = compare_paths(a, b, DiffSettings(limits, provenance=provenance, pixels=pixels, exclude=exclude))
    same = all(part.same for part in found)
    if as_json:
        console.echo_summary(as_dict(found), True)
    else:
        click.echo("\n".join(report_lines(found)))
    return ExitCode.DONE if same else ExitCode.DIFFERENT


def make_tolerances(
    rtol: float, atol: float, tol: tuple[str, ...], tol_unit: tuple[str, ...], time_tol: str
) -> Tolerances:
    """Return the tolerances that the options state; UsageError for invalid ones.

    Args:
        rtol: relative tolerance of fractional numbers.
        atol: absolute tolerance of fractional numbers.
        tol: texts `COLUMN=ATOL[:RTOL]`.
        tol_unit: texts `UNIT=ATOL[:RTOL]`, for all columns in that unit.
        time_tol: largest difference in time of paired rows, with its unit, for example `20ms`.
    """
    for name, value in (("--rtol", rtol), ("--atol", atol)):
        if not math.isfinite(value):
            raise UsageError(f"{name} {value}: expected a finite number")
    columns = dict(_limit("--tol", text) for text in tol)
    units = dict(_limit("--tol-unit", text) for text in tol_unit)
    if units:
        from occlog.records.columns import in_length_unit
        from occlog.records.tables import TABLES
        from occlog.settings import METRES

        of_columns = {c.unit for table in TABLES.values() for c in table.columns()}
        known = {in_length_unit(unit, length) for unit in of_columns for length in (*METRES, "unit")}
        for unit in set(units) - known:
            raise UsageError(
                f"--tol-unit {unit}: no column has this unit; units: {', '.join(sorted(known))}", id="unknown-column"
            )
    return Tolerances(Limit(atol, rtol), columns, units, _duration(time_tol))


def _limit(option: str, text: str) -> tuple[str, Limit]:
    name, equals, value = text.rpartition("=")
    try:
        numbers = [float(part) for part in value.split(":")]
    except ValueError:
        numbers = []
    good = name and equals and len(numbers) in (1, 2) and all(math.isfinite(n) and n >= 0 for n in numbers)
    if not good:
        raise UsageError(f"{option} {text!r}: expected NAME=ATOL or NAME=ATOL:RTOL with numbers of at least 0")
    return name, Limit(*numbers)


def _duration(text: str) -> int:
    match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*(ns|us|ms|s)", text.strip())
    if match is None:
        raise UsageError(f"--time-tol {text!r}: expected a number with ns, us, ms or s, e.g. 1ms")
    return round(float(match[1]) * DURATIONS[match[2]])
