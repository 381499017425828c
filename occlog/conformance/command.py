"""The `occlog plugin` commands."""

from __future__ import annotations

from pathlib import Path

import click

from occlog import console
from occlog.cli import options
from occlog.errors import ExitCode
from occlog.plugins.loading import EXPORTER, METHOD, VIEW_TRACKER, installed, named


@click.group(name="plugin", short_help="List and check third-party plug-ins.")
def command() -> None:
    """List installed plug-ins, and check that they fulfil the interface.

    \b
      occlog plugin list
      occlog plugin check own
    """


@command.command(name="list")
@options.json_opt
def list_plugins(as_json: bool) -> int:
    """List the installed plug-ins, with what each is, its package and version.

    \b
      occlog plugin list
    """
    from occlog.examine.export.formats import FORMATS
    from occlog.track.catalogue import OURS

    ours = {METHOD: set(OURS), VIEW_TRACKER: set(OURS), EXPORTER: set(FORMATS)}
    lines = []
    for plugin in installed():
        summary = plugin.summary
        if plugin.name in ours.get(plugin.kind, ()):
            summary = f"is not used: occlog has one of that name itself; {summary}"
        lines.append((plugin, summary))
    if as_json:
        rows = [{"name": p.name, "kind": p.kind, "package": p.origin, "summary": note} for p, note in lines]
        console.echo_summary({"plugins": rows}, True)
        return ExitCode.DONE
    if not lines:
        click.echo("no plug-in is installed; see docs/how-to/plugins.md")
    width = max((len(plugin.name) for plugin, _ in lines), default=0)
    for plugin, note in lines:
        click.echo(f"{plugin.name:<{width}}  {plugin.kind}, {plugin.origin}: {note}")
    return ExitCode.DONE


@command.command(name="check")
@click.argument("name")
@click.option(
    "--sample",
    type=options.PATH,
    default=None,
    metavar="FILE",
    help="A valid file of a reader plug-in's format, with which it is checked; needed for readers.",
)
@options.json_opt
def check_plugin(name: str, sample: Path | None, as_json: bool) -> int:
    """Check that the plug-in NAME keeps what the interface promises; exit code 6 if it does not.

    \b
      occlog plugin check own
      occlog plugin check compass --sample walk.compass
    """
    from .faults import faults_by
    from .kits import kit_of

    broken, reported = False, []
    for plugin in named(name):
        checks = kit_of(plugin, sample)
        faults = faults_by(checks, plugin.load())
        broken |= bool(faults)
        rows = [{"check": fault.check, "message": fault.sentence} for fault in faults]
        reported.append({"plugin": name, "kind": plugin.kind, "checks": len(checks), "faults": rows})
        if not as_json:
            for fault in faults:
                click.echo(f"{fault.check}: {fault.sentence}")
            click.echo(f"{plugin.label}, {plugin.kind}: {len(checks)} checks, {len(faults)} faults")
    if as_json:
        console.echo_summary(reported[0] if len(reported) == 1 else {"plugins": reported}, True)
    return ExitCode.THRESHOLD if broken else ExitCode.DONE
