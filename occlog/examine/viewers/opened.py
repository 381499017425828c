"""Opening of an installed viewer with the file made for it."""

from __future__ import annotations

import shlex
import shutil
import subprocess
import tempfile
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from occlog.errors import OutputError, UsageError, option
from occlog.examine.export.formats import FOXGLOVE, PROGRAMS, RERUN, VIEWERS
from occlog.records.losses import Loss

from .inputs import viewer_format_of
from .run import ViewerTask, run_viewers

OTHERS = """install one: Rerun (`pip install rerun-sdk`), Foxglove or Lichtblick (programs with windows); or name the
program with --viewer; or write the file alone with `occlog export`"""
RERUN_OPTIONS = ("--bind", "127.0.0.1", "--new")
"""Rerun's viewer listens for programs that send it data: only for those of this machine, and in its own window."""


@dataclass(frozen=True)
class ViewRequest:
    """Request to view an input.

    Attributes:
        input: run folder, recording or table.
        output: the file that the viewer opens; None: a temporary one.
        recording: recording with images; None: that of the folder.
        scene: scene file; None: that of the recording.
        viewer: name or path of the program; None: the first that is installed.
        only_print: print the command of the viewer instead of starting it.
        overwrite: replace an existing output.
        every: least time between messages of a topic [s]; None: all are written.
    """

    input: Path
    output: Path | None = None
    recording: Path | None = None
    scene: Path | None = None
    viewer: str | None = None
    only_print: bool = False
    overwrite: bool = False
    every: float | None = None


def run_view(request: ViewRequest, *, quiet: bool = False) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Write the viewer's file, and show it until the viewer is closed; return the summary and data losses.

    Raises:
        UsageError: no viewer is installed, an option does not apply to an existing export, or a command is to be
            printed without an output.
        OutputError: the viewer could not be started.
    """
    made = None if request.input.is_dir() else viewer_format_of(request.input)
    program, viewer = find_viewer(request.viewer, started=not request.only_print, takes=made)
    if made is not None:
        if request.output is not None:
            raise UsageError(f"{request.input}: is an export for {made}; omit {option('output')}", id="wrong-content")
        if request.every is not None:
            raise UsageError(
                f"{request.input}: is an export for {made}; give {option('every')} to occlog export, which makes it",
                id="wrong-content",
            )
        return {"command": _start(program, viewer, request.input, started=not request.only_print)}, ()
    if request.only_print and request.output is None:
        raise UsageError(f"{option('print')}: the printed command needs the file; name it with -o", id="missing-option")
    with ExitStack() as stack:
        output = request.output
        if output is None:
            output = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="occlog-view-"))) / "occlog.mcap"
        layout = output.with_suffix(".layout.json") if viewer == FOXGLOVE and request.output is not None else None
        wanted = ViewerTask(
            request.input,
            output,
            viewer,
            request.recording,
            request.scene,
            layout,
            overwrite=request.overwrite,
            every=request.every,
        )
        summary, losses = run_viewers(wanted, quiet=quiet)
        summary["command"] = _start(program, viewer, output, started=not request.only_print)
    return summary, losses


def _start(program: str, viewer: str, file: Path, *, started: bool) -> str:
    """Run the viewer on a file until it is closed; return the command line.

    OutputError if it cannot be started, or fails.

    Args:
        program: path of its executable.
        viewer: name of the format it reads, by which it has options.
        file: to show.
        started: false: run nothing.
    """
    line = [program, *(RERUN_OPTIONS if viewer == RERUN else ()), str(file.resolve())]
    if started:
        try:
            code = subprocess.run(line, check=False, stdin=subprocess.DEVNULL).returncode
        except OSError as error:
            raise OutputError(f"{program}: cannot be started: {error.strerror or error}") from error
        if code:
            raise OutputError(f"{program}: ended with code {code}; its own messages are above")
    return shlex.join(line)


def find_viewer(named: str | None, *, started: bool, takes: str | None = None) -> tuple[str, str]:
    """Return the executable of a viewer, and the name of the format that it reads.

    Args:
        named: name or path of a program; None: the first of `PROGRAMS` that is installed.
        started: whether it must be installed.
        takes: format that it must read; None: any.

    Raises:
        UsageError: it is not installed, or does not read the format.
    """
    programs = {name: kind for name, kind in PROGRAMS.items() if takes in (None, VIEWERS, kind)}
    if named is not None:
        found = shutil.which(named)
        if found is None and started:
            raise UsageError(f"{option('viewer')} {named}: no such program; {_others()}", id="missing-package")
        kind = PROGRAMS.get(Path(named).stem.lower()) or (RERUN if "rerun" in named.lower() else FOXGLOVE)
        if takes not in (None, VIEWERS, kind):
            raise UsageError(
                f"{option('viewer')} {named}: the file is an export for {takes}; view the run that it was made from",
                id="wrong-content",
            )
        return found or named, kind
    for name, kind in programs.items():
        found = shutil.which(name)
        if found is not None:
            return found, kind
    if started:
        raise UsageError(f"no viewer is installed ({', '.join(programs)}); {_others()}", id="missing-package")
    return next(iter(programs.items()))


def _others() -> str:
    return " ".join(OTHERS.split())
