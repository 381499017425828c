"""The `occlog start` command."""

from __future__ import annotations

from pathlib import Path

import click

from occlog.cli import options


@click.command(name="start", short_help="Inspect files, write a configuration for them, and run it.")
@click.argument("sources", type=options.PATH, nargs=-1, required=True, metavar="FOLDER|BAG|FILE...")
@click.option("-o", "--output", type=options.PATH, required=True, help="Run folder; created if missing.")
@click.option(
    "--as",
    "kinds",
    multiple=True,
    metavar="PATH=KIND[:NAME]",
    help="State what an input file is: KIND is one of the kinds listed above, or `unused`; NAME is its camera or "
    "array. May be repeated.",
)
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="STAGE.KEY=VALUE",
    help="A key of the configuration, e.g. ingest.fps=25 or track.method=jipda; may be repeated.",
)
@click.option("--write-only", is_flag=True, help="Write the configuration, and stop.")
@click.option(
    "--overwrite",
    is_flag=True,
    help="Replace a run.yaml with other content in the run folder; an equal one is continued without this option.",
)
@options.strict_opt
@options.quiet_opt
@options.json_opt
def command(
    sources: tuple[Path, ...],
    output: Path,
    kinds: tuple[str, ...],
    settings: tuple[str, ...],
    write_only: bool,
    overwrite: bool,
    strict: bool,
    quiet: bool,
    as_json: bool,
) -> int:
    """Inspect folders, bags and files, choose what they are, write `run.yaml` into the run folder, and run it.

    Each choice is printed with the option that changes it, and stands in `run.yaml` as a comment; what is not used is
    listed with the reason. Nothing is guessed that would make a wrong result: a frame rate, the height of the ground or
    a unit that no file states is asked for in one line. With a ground truth the run evaluates.

    Kinds of files: recording, bag, dataset (WILDTRACK), scene, video, images, sound, boxes, positions, calibration,
    truth, doa, reads, table (bearings, ranges, signal strengths, time differences), stations, microphones, timestamps,
    sequence (seqinfo.ini).

    \b
      occlog start hall/ -o run/hall
      occlog start walk.mp4 -o run/walk
      occlog start yolo/ calib/ -o run/yolo --set ingest.fps=25
      occlog start data/ -o run/data --as old.yaml=unused --as front.mp4=video:cam0 --write-only
    """
    from .run import start

    return start(
        sources,
        output,
        kinds=kinds,
        settings=settings,
        write_only=write_only,
        overwrite=overwrite,
        strict=strict,
        quiet=quiet,
        as_json=as_json,
    )
