"""The `occlog listen` command."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from occlog.cli import options
from occlog.errors import UsageError

ALGORITHMS = ("srp", "music", "normmusic", "cssm", "waves", "tops")
"""Those of `occlog.measure.listen.config`; a test keeps the two alike, so that --help need not load it."""
POSITIVE = click.FloatRange(min=0, min_open=True)


@click.command(name="listen", short_help="Find directions of arrival in the sound of microphone arrays.")
@click.argument("sounds", nargs=-1, required=True, metavar="[ARRAY=]FILE.wav...")
@options.output_opt("Directions of arrival (Parquet).")
@options.scene_opt
@click.option("--arrays", multiple=True, metavar="[NAME=]FILE", help="Microphones of an array: a table x, y, z [m].")
@click.option(
    "--channels",
    default="",
    metavar="A,B,...",
    help="Channels of the files, from 1, in the order of the microphones. [default: all]",
)
@click.option(
    "--start-time",
    multiple=True,
    metavar="[ARRAY=]TIME",
    help="Date and time (ISO 8601, UTC) or seconds since 1970 of the first sample. [default: 0]",
)
@click.option(
    "--algorithm",
    type=click.Choice(ALGORITHMS),
    default="srp",
    show_default=True,
    help="Of pyroomacoustics; srp is SRP-PHAT.",
)
@click.option(
    "--sources",
    default="1",
    show_default=True,
    metavar="N|auto",
    help="Directions a frame at most; auto: as many as there are peaks (srp).",
)
@click.option(
    "--band",
    type=(POSITIVE, POSITIVE),
    default=(300.0, 4000.0),
    show_default=True,
    metavar="LOW HIGH",
    help="Frequencies to use [Hz].",
)
@click.option(
    "--frame",
    "frame_s",
    type=POSITIVE,
    default=0.5,
    show_default=True,
    metavar="SECONDS",
    help="Sound that one set of directions is of.",
)
@click.option(
    "--hop",
    "hop_s",
    type=POSITIVE,
    default=None,
    metavar="SECONDS",
    help="From one frame to the next. [default: the frame's length]",
)
@click.option(
    "--window",
    "window_s",
    type=POSITIVE,
    default=0.04,
    show_default=True,
    metavar="SECONDS",
    help="Of one spectrum, at least.",
)
@click.option(
    "--grid",
    "grid_deg",
    type=POSITIVE,
    default=None,
    metavar="DEGREES",
    help="Step of the directions that are tried first. [default: 1 to 5, from the array's size]",
)
@click.option(
    "--apart",
    "apart_deg",
    type=click.FloatRange(0, 180),
    default=20.0,
    show_default=True,
    metavar="DEGREES",
    help="Directions of one frame are at least this far apart.",
)
@click.option(
    "--peak",
    type=click.FloatRange(0, 1),
    default=0.6,
    show_default=True,
    help="Leave out peaks lower than this share of the way from the map's median to its highest.",
)
@click.option(
    "--confidence",
    type=click.FloatRange(0, 1),
    default=0.15,
    show_default=True,
    help="Leave out directions with which phases agree less: 1 is one plane wave, 0 noise.",
)
@click.option(
    "--level",
    "level_db",
    type=float,
    default=-80.0,
    show_default=True,
    metavar="DB",
    help="Sound below this level is silence (a full-scale sine is 0).",
)
@click.option(
    "--above",
    "above_db",
    type=POSITIVE,
    default=None,
    metavar="DB",
    help="So is what is not this much above the quietest of the last half minute: for speech in noise.",
)
@click.option(
    "--speed-of-sound", type=POSITIVE, default=None, help="In lengths of the scene a second. [default: 343 m]"
)
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def command(
    sounds: tuple[str, ...],
    output: Path,
    scene: Path | None,
    arrays: tuple[str, ...],
    channels: str,
    start_time: tuple[str, ...],
    sources: str,
    band: tuple[float, float],
    overwrite: bool,
    quiet: bool,
    as_json: bool,
    **settings: Any,
) -> int:
    """Find directions of arrival in the sound that microphone arrays recorded (WAV, a channel a microphone).

    The places of the microphones are those of the scene's array (`microphones`), or of --arrays.
    Each frame of sound gives the directions from which it came, in the world's frame, with their
    standard deviations and how well the phases agree with them; silence gives none. A flat array
    cannot tell above from below: it gives the direction above. Wants the package pyroomacoustics:
    pip install 'occlog[sound]'.

    \b
      occlog listen --scene hall.yaml mic1=mic1.wav mic2=mic2.wav -o doa.parquet --start-time 2024-05-01T12:00:00Z
      occlog listen --arrays table=microphones.csv table=talk.wav -o doa.parquet --sources auto --above 10
    """
    from .run import Request, parse_channels, run_listen

    if sources != "auto" and not (sources.isdecimal() and 1 <= int(sources) <= 100):
        raise UsageError(f"--sources {sources}: must be 1 to 100, or auto")
    settings |= {"sources": 0 if sources == "auto" else int(sources), "low_hz": band[0], "high_hz": band[1]}
    request = Request.of(sounds, scene, arrays, parse_channels(channels), start_time, settings)
    options.check_outputs(request.inputs(), [output], overwrite)
    summary, losses = run_listen(request, output, overwrite, quiet)
    return options.finish(summary, losses, as_json)
