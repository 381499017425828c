"""The `occlog fit-motion` command: a motion model from trajectories."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from occlog.cli import options
from occlog.errors import UsageError

POSITIVE = click.FloatRange(min=0, min_open=True)


def parse_noise(text: str) -> float | str:
    """A length, or `estimated` or `covariance`; UsageError otherwise."""
    if text in ("estimated", "covariance"):
        return text
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value < float("inf"):
        raise UsageError(f"--noise {text}: want a length of at least 0, `estimated` or `covariance`")
    return value


@click.command(name="fit-motion", short_help="Identify a motion model from trajectories, for `track --method map`.")
@click.argument("positions", type=options.PATH, nargs=-1, required=True)
@options.output_opt("The model (JSON).")
@click.option(
    "--form",
    type=click.Choice(["cv", "damped", "full"]),
    default="cv",
    show_default=True,
    help="A: constant velocity, velocity that dies out, or free.",
)
@click.option(
    "--sigma",
    "disturbance",
    type=click.Choice(["white", "diagonal", "full"]),
    default="white",
    show_default=True,
    help="Sigma: white acceleration and jitter of the position, a diagonal, or free.",
)
@click.option(
    "--axes",
    type=click.Choice(["same", "each"]),
    default="same",
    show_default=True,
    help="One disturbance for x and y, or one for each.",
)
@click.option(
    "--method",
    type=click.Choice(["em", "differences"]),
    default="em",
    show_default=True,
    help="Most likely model of noisy positions, or regression on differences of exact ones.",
)
@click.option(
    "--noise",
    default="estimated",
    show_default=True,
    metavar="LENGTH|estimated|covariance",
    help="Standard deviation of positions' errors, per axis; `covariance`: that of tracks.",
)
@click.option(
    "--step",
    "step_s",
    type=POSITIVE,
    default=None,
    metavar="SECONDS",
    help="Step of the model. [default: the median time between positions]",
)
@click.option(
    "--gap",
    "gap_s",
    type=POSITIVE,
    default=None,
    metavar="SECONDS",
    help="Cut trajectories where positions are farther apart in time. [default: 5 steps]",
)
@click.option(
    "--target",
    "targets",
    type=int,
    multiple=True,
    metavar="ID",
    help="Use this object only; may be repeated. [default: all, of truth those of role target]",
)
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def command(
    positions: tuple[Path, ...], output: Path, noise: str, overwrite: bool, quiet: bool, as_json: bool, **values: Any
) -> int:
    """Identify A and Sigma of linear Gaussian motion from POSITIONS: truth or tracks, tables or recordings.

    The model says how a target moves: x' = A x + noise of covariance Sigma, x position and velocity of both axes.
    Positions may be noisy, at unequal times and with gaps; the noise is told apart from the motion.

    \b
      occlog fit-motion room.mcap -o motion.json --step 0.25
      occlog fit-motion monday.parquet tuesday.parquet -o motion.json --form damped --noise 0.1
    """
    from .run import FitRequest, run_fit

    request = FitRequest(positions=positions, noise=parse_noise(noise), **values)
    options.check_outputs(positions, [output], overwrite)
    summary, losses = run_fit(request, output, overwrite, quiet)
    return options.finish(summary, losses, as_json)
