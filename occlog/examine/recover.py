"""`occlog recover`: make a truncated or damaged recording readable again."""

from __future__ import annotations

from pathlib import Path

import click

from occlog import console
from occlog.cli import options
from occlog.errors import InputError, UsageError
from occlog.io.files.atomic import check_outputs


@click.command(name="recover", short_help="Recover the intact parts of a damaged recording.")
@click.argument("file", type=options.INPUT)
@options.output_opt("Recovered recording (MCAP).")
@click.option(
    "--video",
    "videos",
    multiple=True,
    metavar="CAMERA=FILE",
    help="Video file of a camera, where the damaged recording has lost the link to it; may be repeated.",
)
@options.overwrite_opt
@options.json_opt
def command(file: Path, output: Path, videos: tuple[str, ...], overwrite: bool, as_json: bool) -> int:
    """Recover the intact parts of FILE, a truncated or damaged recording, so that every command reads it.

    All messages with a correct check sum are kept, and all before a cut. Losses are listed, with times and frame
    numbers where they are known; the list goes into the new file, and from there into every output made from it.
    The exit code is 3 if anything is lost. Repeat the command that made a damaged table.

    \b
      occlog recover hall.mcap -o whole.mcap
      occlog recover hall.mcap -o whole.mcap --video cam1=hall.cam1.avi
    """
    from occlog.io.files.limits import Content, content_of, describe_unsupported

    given = dict(map(_named, videos))
    check_outputs([file, *given.values()], [output], overwrite)
    content = content_of(file)
    if content is Content.OTHER:
        if (known := describe_unsupported(file)) is not None:
            raise InputError(f"{file}: is {known}", id="damaged-file")
        raise InputError(
            f"{file}: is {content.value}; nothing of it can be salvaged here: copy it again, or make it again",
            id="damaged-file",
        )
    if content is Content.TABLE:
        raise InputError(_made_again(file), id="damaged-file")
    from occlog.io.recording.salvage.recover import recover_recording

    found = recover_recording(file, output, given, overwrite=overwrite)
    summary = {"recording": str(output), "messages": sum(found.messages.values()), **_times(found.span)}
    summary |= {f"messages of {topic}": count for topic, count in found.messages.items()}
    return console.finish(summary, found.losses, as_json)


def _made_again(path: Path) -> str:
    """Return the message that a table is not salvaged, with the command and inputs that made it, if known."""
    from occlog.io.files.tables.parquet import read_header

    try:
        header = read_header(path)
    except InputError as error:
        return f"{error}; tables are not salvaged, since a table can be made again from its inputs"
    made = header.provenance
    inputs = ", ".join(name for name, _ in made.inputs[:3]) + (", ..." if len(made.inputs) > 3 else "")
    return (
        f"{path}: is a table ({header.table}); tables are not salvaged: make it again by `occlog {made.command}`"
        f"{f' from {inputs}' if inputs else ''}"
    )


def _times(span: tuple[int, int] | None) -> dict[str, object]:
    """Return the summary entries for the first and last time `span` [ns]; empty for None."""
    from occlog.io.files.timing.utc import utc

    return {} if span is None else {"from": utc(span[0]), "to": utc(span[1]), "seconds": (span[1] - span[0]) / 1e9}


def _named(text: str) -> tuple[str, Path]:
    """Return camera and path of a text `CAMERA=FILE`; UsageError for other text."""
    camera, given, path = text.partition("=")
    if not (camera and given and path):
        raise UsageError(f"--video {text}: expected CAMERA=FILE")
    return camera, Path(path)
