"""The `occlog` command: commands are imported on use; errors become one line and an exit code."""

from __future__ import annotations

import errno
import importlib
import os
import sys
import warnings
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import click

from occlog import __version__
from occlog.console.collection import COLLECTION
from occlog.console.foreign_code import hidden
from occlog.console.interrupts import INTERRUPTS
from occlog.console.notes import DRY_RUN, NOTED_ONCE, QUIET, DryRunPlan, DryRunStop
from occlog.errors import ExitCode, OcclogError, OutputExistsError, nearest

from . import streams
from .startup import UnknownNameError, allow_open_files, open_files_limit


class Command(NamedTuple):
    """Entry of the table of commands.

    Attributes:
        where: module and name of the request class, as `module:NAME`, or a module with `command`.
        summary: one line.
        group: heading under which `occlog --help` lists it.
    """

    where: str
    summary: str
    group: str


PIPELINE = "Pipeline"
FILES = "Inspect files"
STUDIES = "Studies"
SPECIAL = "Special sensors and papers"
OTHERS = "Others"
COMMANDS = {
    "start": Command(
        "occlog.pipeline.start.command", "Inspect files, write a configuration for them, and run it.", PIPELINE
    ),
    "simulate": Command(
        "occlog.simulate.request:VERB", "Simulate a recording with ground truth from a scene.", PIPELINE
    ),
    "ingest": Command(
        "occlog.ingest.request:IngestRequest",
        "Collect video, detections, DOA logs and calibration into one recording.",
        PIPELINE,
    ),
    "detect": Command(
        "occlog.measure.detect.request:VERB", "Detect people in a recording: boxes, regions and bearings.", PIPELINE
    ),
    "calibrate": Command(
        "occlog.calibrate.request:CalibrateRequest",
        "Calibrate cameras and clocks from the boxes of people who walk.",
        PIPELINE,
    ),
    "track": Command(
        "occlog.track.catalogue:VERB", "Track targets from boxes, bearings, tag reads or video.", PIPELINE
    ),
    "evaluate": Command(
        "occlog.evaluate.request:EvaluateRequest",
        "Evaluate tracks against ground truth and the Cramer-Rao bound.",
        PIPELINE,
    ),
    "report": Command(
        "occlog.report.request:VERB", "Write a self-contained HTML report, a picture or an overlay video.", PIPELINE
    ),
    "run": Command("occlog.pipeline.run.command", "Run all stages of a configuration into a run folder.", PIPELINE),
    "batch": Command(
        "occlog.pipeline.batch.command", "Run the stages of a configuration on many recordings.", PIPELINE
    ),
    "info": Command("occlog.examine.info", "Describe a scene, recording, table or run folder.", FILES),
    "doctor": Command("occlog.examine.doctor.command", "Check recordings, tables and other files for errors.", FILES),
    "diff": Command("occlog.examine.diff.command", "Compare two outputs and list the differences.", FILES),
    "view": Command(
        "occlog.examine.viewers.command", "Show a run or a recording in Rerun, Foxglove or Lichtblick.", FILES
    ),
    "export": Command("occlog.examine.export.command", "Export a table to the format of another program.", FILES),
    "recover": Command("occlog.examine.recover", "Recover the intact parts of a damaged recording.", FILES),
    "plan": Command(
        "occlog.plan.request:PlanRequest",
        "Predict tracking errors of a sensor layout and rank positions for sensors.",
        STUDIES,
    ),
    "sweep": Command(
        "occlog.pipeline.sweep.command", "Run a Monte Carlo study over seeds and parameters, in parallel.", STUDIES
    ),
    "compare": Command(
        "occlog.evaluate.compare.request:CompareRequest", "Test whether runs on the same recordings differ.", STUDIES
    ),
    "reproduce": Command(
        "occlog.papers.command", "Reproduce the experiments of a paper and judge its statements.", STUDIES
    ),
    "pack": Command(
        "occlog.pipeline.pack.command", "Archive a run folder with its inputs and versions in one file.", STUDIES
    ),
    "verify": Command("occlog.pipeline.verify.command", "Repeat an archived run and compare the results.", STUDIES),
    "listen": Command(
        "occlog.measure.doa.request:DoaRequest",
        "Estimate directions of arrival from recordings of microphone arrays.",
        SPECIAL,
    ),
    "appearance": Command(
        "occlog.measure.appearance.request:VERBS", "Learn an appearance gallery for re-identification.", SPECIAL
    ),
    "priors": Command("occlog.measure.priors.request:VERBS", "Estimate the positions of moving occluders.", SPECIAL),
    "epipolar": Command(
        "occlog.measure.epipolar.request:EpipolarRequest",
        "Estimate or check fundamental matrices between views.",
        SPECIAL,
    ),
    "fuse": Command(
        "occlog.measure.fuse.request:VERB",
        "Fuse detections of several cameras, or tracks of several camera groups.",
        SPECIAL,
    ),
    "label": Command(
        "occlog.measure.associate.request:VERB",
        "Associate unlabelled bearings with tracks, or boxes with a gallery.",
        SPECIAL,
    ),
    "ground": Command(
        "occlog.track.methods.images.ground.request:GroundRequest",
        "Triangulate image tracks to the ground plane.",
        SPECIAL,
    ),
    "fit-motion": Command(
        "occlog.track.methods.map.fit_motion.request:FitMotionRequest", "Fit a motion model to trajectories.", SPECIAL
    ),
    "fit-readers": Command(
        "occlog.track.methods.readers.fit.request:FitReadersRequest",
        "Fit path loss and coverage of tag readers.",
        SPECIAL,
    ),
    "navigate": Command(
        "occlog.papers.lee.navigation.request:NavigateRequest",
        "Navigate a robot by potential fields among obstacles and tracked people.",
        SPECIAL,
    ),
    "traffic": Command(
        "occlog.papers.lee.traffic.request:TrafficRequest",
        "Simulate the network traffic of cooperating sensors.",
        SPECIAL,
    ),
    "plugin": Command("occlog.conformance.command", "List and check third-party plug-ins.", OTHERS),
    "schema": Command("occlog.examine.schema", "Print the JSON Schema of a table, a file format or settings.", OTHERS),
}
"""Every command, by group and in the order of a pipeline; a table of text, so that --help loads none of the modules."""


@cache
def load_command(name: str) -> click.Command:
    """Import and return the command of that name in `COMMANDS`, as a click command."""
    where, summary, _ = COMMANDS[name]
    if ":" not in where:
        command: click.Command = importlib.import_module(where).command
        COLLECTION.resume()
        return command
    from occlog.request import load

    from .request_command import command_of

    return command_of(load(where), name, summary)


DEBUG = "OCCLOG_DEBUG"
"""Variable of the environment that shows the traceback of a bug."""
WORDS = "occlog.console.text"
"""Key of the words of the command line in the metadata of click's context."""
EPILOG = """\b
Exit codes: 0 done; 1 a bug; 2 usage; 3 finished, but input was lost (it is listed);
4 bad or unreadable input, or an output that cannot be written; 5 diff found a difference;
6 not plausible (--strict), or a threshold not met (--fail-if); 7 the output exists; 130 interrupted;
141 the reader of standard output has closed it; 143 terminated (SIGTERM).

\b
  occlog run sample_data/room/run.yaml -o run/   all stages, from video to report
  occlog info run/tracks.parquet                 describe a file
"""


class LazyGroup(click.Group):
    """Click group of all commands, which imports a command when it is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """Return the names of all commands, by their groups and in the order of a pipeline."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return the command `cmd_name`, with the options that all commands have; None if unknown."""
        if cmd_name not in COMMANDS:
            return None
        from .common import add_common, with_reader

        command = load_command(cmd_name)
        add_common(command)
        return with_reader(command, ctx.meta.get(WORDS, ()))

    def invoke(self, ctx: click.Context) -> object:
        """Call the command, then check that stated units, origin and reader were used."""
        from .common import check_common
        from .startup import with_compile_notice

        try:
            with with_compile_notice():
                result = super().invoke(ctx)
        except KeyboardInterrupt:
            # click would write an empty line wherever standard error goes
            if sys.stderr is not None and sys.stderr.isatty():
                click.echo(err=True)  # after the terminal's ^C
            raise click.exceptions.Abort from None
        except DryRunStop:
            _show_plan("--json" in ctx.meta.get(WORDS, ()))
            result = ExitCode.DONE
        check_common(ctx)
        return result

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return name, command and remaining arguments of the words `args`.

        An error on an unknown name suggests another.
        """
        if args and args[0] not in COMMANDS and not args[0].startswith("-"):
            near = nearest(args[0], COMMANDS)
            hint = f"Did you mean {near[0]!r}?" if near else f"Commands: {', '.join(COMMANDS)}."
            raise UnknownNameError(f"No such command {args[0]!r}. {hint}", ctx)
        return super().resolve_command(ctx, args)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse `args` up to the command name.

        Usage error for an unknown option before it, since options go after it.
        """
        ctx.meta[WORDS] = tuple(args)
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            option = error.option_name
            ctx.fail(f"{option} before the command is unknown; options go after it: occlog COMMAND {option}")

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        """Write the list of commands by their groups into the help, without importing them."""
        width = max(map(len, COMMANDS))
        for group in dict.fromkeys(command.group for command in COMMANDS.values()):
            with formatter.section(group):
                rows = [(f"{name:{width}}", each.summary) for name, each in COMMANDS.items() if each.group == group]
                formatter.write_dl(rows)


@click.group(cls=LazyGroup, epilog=EPILOG, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="occlog")
def cli() -> None:
    """From recorded multi-camera video and acoustic logs to evaluated tracks."""


def main(args: list[str] | None = None) -> None:
    """Run the command line, and leave the process with its exit code; `args`: its words, None: those of the process."""
    COLLECTION.pause()
    INTERRUPTS.install()
    streams.install()
    allow_open_files()
    _only_own_lines()
    try:
        code = run(args)
    finally:
        COLLECTION.resume()
    INTERRUPTS.end()
    sys.exit(code)


def _only_own_lines() -> None:
    """Hide warnings of libraries unless the user asks for them."""
    if not sys.warnoptions and not os.environ.get(DEBUG):
        warnings.simplefilter("ignore")


def run(args: list[str] | None = None) -> int:
    """Run the command line, and return the exit code; `args`: its words, None: those of the process."""
    words = sys.argv[1:] if args is None else args
    NOTED_ONCE.clear()
    loud = QUIET.set(False)
    try:
        try:
            with hidden("matplotlibrc"):
                result: object = cli.main(args=args, prog_name="occlog", standalone_mode=False)
        finally:
            # Words that cannot be parsed leave no context that would be closed
            QUIET.reset(loud)
            if sys.stdout is not None:
                sys.stdout.flush()
        return int(result) if isinstance(result, int) else ExitCode.DONE
    except (click.exceptions.Abort, KeyboardInterrupt):
        INTERRUPTS.end()
        if INTERRUPTS.terminated:
            return _fail(Explained("terminated", ExitCode.TERMINATED, "terminated"), words)
        return _fail(Explained("interrupted", ExitCode.INTERRUPTED, "interrupted"), words)
    except click.exceptions.Exit as stop:
        return int(stop.exit_code)
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message(), err=True)
        return ExitCode.USAGE
    except streams.ReaderGoneError as error:
        return error.exit_code
    except Exception as error:
        explained = explain(error)
        if explained.code == ExitCode.BUG and os.environ.get(DEBUG):
            raise
        return _fail(explained, words)


class Explained(NamedTuple):
    """An error as reported to the user: message in one line, exit code, and id in `occlog.records.error_ids.ERRORS`."""

    message: str  # one line
    code: ExitCode
    id: str  # one of `occlog.records.error_ids.ERRORS`


def explain(error: Exception) -> Explained:
    """Return message, exit code and id for the error that ends a command; also for an unexpected one (a bug)."""
    if isinstance(error, click.UsageError):
        path = error.ctx.command_path if error.ctx else "occlog"
        message = error.format_message().rstrip(".")
        if isinstance(error, click.NoSuchOption) and error.ctx:
            from .setting_options import unknown_option

            message = unknown_option(error.option_name, error.ctx.command.params)
        return Explained(f"{message}; see {path} --help", ExitCode.USAGE, _id_of(error))
    if isinstance(error, click.ClickException):
        return Explained(error.format_message(), ExitCode.BAD_INPUT, "unreadable-file")
    if isinstance(error, OutputExistsError):
        return Explained(f"{error}; give --overwrite to replace it", error.exit_code, error.id)
    if isinstance(error, OcclogError):
        return Explained(str(error), error.exit_code, error.id)
    if isinstance(error, MemoryError):
        remedy = "use fewer particles, a shorter lag (track --lag) or smaller images, or free memory"
        return Explained(f"out of memory; {remedy}", ExitCode.BAD_INPUT, "out-of-memory")
    if isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE):
        limit = open_files_limit()
        remedy = "raise it (ulimit -n), or take fewer cameras or workers at a time"
        message = f"too many open files{f', limit: {limit}' if limit else ''}; {remedy}"
        return Explained(message, ExitCode.BAD_INPUT, "too-many-open-files")
    return Explained(_bug(error), ExitCode.BUG, "bug")


def _id_of(error: click.UsageError) -> str:
    """Return the id (of `docs/reference/errors.md`) of an error in the command line."""
    for each in (error, error.__cause__):
        if isinstance(each, click.NoSuchOption | UnknownNameError):
            return "unknown-name"
        if isinstance(each, click.MissingParameter):
            return "missing-option"
        if isinstance(each, OcclogError):
            return each.id
    return "invalid-option"


def _bug(error: Exception) -> str:
    """Return the message about an unexpected error: kind, location, and what to report."""
    import traceback

    frames = [f for f in traceback.extract_tb(error.__traceback__) if f"{os.sep}occlog{os.sep}" in f.filename]
    frame = frames[-1] if frames else None
    where = f" ({frame.filename.rpartition(f'{os.sep}occlog{os.sep}')[2]}:{frame.lineno})" if frame else ""
    text = " ".join(str(error).split())[:200]
    return (
        f"a bug of occlog {__version__}: {type(error).__name__}: {text}{where}; report it with this line, the command "
        f"and the output of the same command with {DEBUG}=1"
    )


def _show_plan(as_json: bool) -> None:
    """Print the files that a dry run would have read, written and replaced; `as_json`: as one JSON object."""
    from occlog.console.notes import named
    from occlog.console.summary import echo_summary

    plan = DRY_RUN.get() or DryRunPlan()
    replaced = [path for path in plan.writes if path.exists()]
    found = {"reads": plan.reads, "would_write": plan.writes, "would_replace": replaced}
    echo_summary({name: [named(str(path)) for path in paths] for name, paths in found.items()}, as_json)


def _fail(error: Explained, words: Sequence[str]) -> int:
    """Print an error on standard error, as a line or, with `--json` in `words`, as a JSON object.

    Return the exit code.
    """
    from occlog.console.notes import named
    from occlog.console.text import shortened

    message = shortened(named(" ".join(error.message.split())))
    if "--json" in words:
        import json

        click.echo(json.dumps({"id": error.id, **_as_object(message, error.code, words)}), err=True)
    else:
        ended = error.code in (ExitCode.INTERRUPTED, ExitCode.TERMINATED)
        click.echo(f"occlog: {message}" if ended else f"occlog: error: {message}", err=True)
    return error.code


def _as_object(message: str, code: ExitCode, words: Sequence[str]) -> dict[str, object]:
    """Return an error message as an object with `error`, `file`, `hint` and `exit_code`.

    Args:
        message: `FILE: TEXT; HINT`; its begin is the file if it is an argument or exists.
        code: exit code of the command.
        words: arguments of the command.
    """
    from .input_paths import NAME

    before = [message[:n] for n in range(len(message)) if message.startswith(": ", n)]
    typed = {part for word in words for part in (word, word.partition("=")[2]) if Path(part).suffix or "/" in part}
    file = next((part for part in reversed(before) if part in typed or part == NAME or os.path.exists(part)), None)  # noqa: PTH110 -- Path.exists fails on long names
    rest, semicolon, hint = message.rpartition("; ")
    return {
        "error": (rest if semicolon else message).removeprefix(f"{file}: "),
        "file": file,
        "hint": hint if semicolon else None,
        "exit_code": int(code),
    }
