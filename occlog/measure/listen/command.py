"""The `occlog listen` command."""

from __future__ import annotations

from pathlib import Path

import click

from occlog import console
from occlog.cli import options
from occlog.cli.setting_options import SettingsCommand, given, with_options
from occlog.cli.values import POSITIVE
from occlog.io.files.atomic import check_outputs

from .config import ListenConfig


class SourceCount(click.ParamType):  # type: ignore[type-arg,unused-ignore]
    """Number of directions a frame, or `auto`, which is 0."""

    name = "number"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """The number; a usage error for one that is not 1 to 100."""
        if value == "auto":
            return 0
        text = str(value)
        if not (text.isdecimal() and 1 <= int(text) <= 100):
            self.fail(f"{text}: must be 1 to 100, or auto", param, ctx)
        return int(text)


@click.command(
    name="listen",
    cls=SettingsCommand,
    short_help="Find directions of arrival in the sound of microphone arrays.",
)
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
    "--sources",
    "most",
    type=SourceCount(),
    default=None,
    metavar="N|auto",
    help="Directions a frame at most; auto: as many as there are peaks (srp). [default: 1]",
)
@click.option(
    "--band",
    type=(POSITIVE, POSITIVE),
    default=None,
    metavar="LOW HIGH",
    help="Frequencies to use [Hz]. [default: 300 4000]",
)
@with_options(ListenConfig)
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
    most: int | None,
    band: tuple[float, float] | None,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
    **values: object,
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
    from .run import ListenRequest, run_listen

    settings = given(ListenConfig, values)
    settings |= {} if most is None else {"sources": most}
    settings |= {} if band is None else {"low_hz": band[0], "high_hz": band[1]}
    request = ListenRequest.of(
        sounds=sounds, scene=scene, arrays=arrays, channels=channels, start_time=start_time, settings=settings
    )
    check_outputs(request.inputs(), [output], overwrite)
    summary, losses = run_listen(request, output, overwrite, quiet)
    return console.finish(summary, losses, as_json)
