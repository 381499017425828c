"""The `occlog recover` command: makes a recording that was cut off or damaged readable again."""

from __future__ import annotations

from pathlib import Path

import click

from occlog.cli import options
from occlog.errors import UsageError


@click.command(name="recover", short_help="Salvage what is whole in a recording that was cut off or damaged.")
@click.argument("recording", type=options.INPUT)
@options.output_opt("The recording that is whole again (MCAP).")
@click.option(
    "--video",
    "videos",
    multiple=True,
    metavar="CAMERA=FILE",
    help="File of the video of a camera, where the link to it is lost; may be repeated.",
)
@options.overwrite_opt
@options.json_opt
def command(recording: Path, output: Path, videos: tuple[str, ...], overwrite: bool, as_json: bool) -> int:
    """Write what is whole in RECORDING, which was cut off or damaged, as a recording that every command reads.

    All messages whose check sums are right are kept, and all before a cut.  What is lost is listed, with times and
    numbers of frames where they are known; the list goes into the new recording, and from there into everything
    that is made of it.  The exit code is 3 if anything is lost.

    \b
      occlog recover hall.mcap -o whole.mcap
      occlog recover hall.mcap -o whole.mcap --video cam1=hall.cam1.avi
    """
    from occlog.io.files.utc import utc
    from occlog.io.recording.recover import recover_recording

    given = dict(map(_named, videos))
    options.check_outputs([recording, *given.values()], [output], overwrite)
    found = recover_recording(recording, output, given, overwrite=overwrite)
    span = found.span
    summary: dict[str, object] = {"recording": str(output), "messages": sum(found.messages.values())}
    if span is not None:
        summary |= {"from": utc(span[0]), "to": utc(span[1]), "seconds": (span[1] - span[0]) / 1e9}
    summary |= {f"messages of {topic}": count for topic, count in found.messages.items()}
    return options.finish(summary, found.losses, as_json)


def _named(text: str) -> tuple[str, Path]:
    """Camera and file of CAMERA=FILE."""
    camera, given, path = text.partition("=")
    if not (camera and given and path):
        raise UsageError(f"--video {text}: want CAMERA=FILE")
    return camera, Path(path)
