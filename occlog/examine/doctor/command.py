"""The `occlog doctor` command: everything that is wrong in files."""

from __future__ import annotations

from pathlib import Path

import click

from occlog import console
from occlog.cli import options
from occlog.cli.input_paths import Input
from occlog.console.notes import log_detail


@click.command(name="doctor", short_help="Check recordings, tables and other files for errors.")
@click.argument("files", nargs=-1, required=True, type=Input(some=True))
@options.json_opt
@options.quiet_opt
def command(files: tuple[Path, ...], as_json: bool, quiet: bool) -> int:
    """Check FILES for errors: recordings, tables, scenes, calibrations, videos, and their clocks.

    Folders are searched recursively. Each finding is one line: severity, file, location, what is there, the
    permitted values, and the remedy. Nothing is changed, and the check continues after the first finding; a missing
    file of several is a finding too.

    The exit code is that of the worst finding: 4 for an error, at which a command that reads the file stops; 3 for
    a warning, with which it continues; 0 for notes or no findings.

    \b
      occlog doctor hall.mcap
      occlog doctor run/ --json | jq '.findings[] | select(.severity == "error")'
    """
    from occlog.console.text import counted
    from occlog.records.messages import Severity

    from .findings import exit_code
    from .run import check_files

    found = check_files(files, lambda path: log_detail(f"{path}: checked"))
    of = {severity: sum(f.severity is severity for f in found.findings) for severity in Severity}
    if as_json:
        counts = {f"{severity}s": count for severity, count in of.items()}
        listed = [finding.as_dict() for finding in found.findings]
        console.echo_summary(
            {"files": found.files, "others": dict(sorted(found.others.items())), **counts, "findings": listed}, True
        )
        return exit_code(found.findings)
    for finding in found.findings:
        click.echo(str(finding))
    if not quiet:
        words = ", ".join(counted(count, str(severity)) for severity, count in of.items() if count) or "nothing found"
        others = sum(found.others.values())
        more = f"; {counted(others, 'other file')} not checked" if others else ""
        console.note(f"{counted(found.files, 'file')}: {words}{more}")
    return exit_code(found.findings)
