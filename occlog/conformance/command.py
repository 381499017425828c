"""The `occlog plugin` commands."""

from __future__ import annotations

import click

from occlog.cli import options
from occlog.errors import ExitCode


@click.group(name="plugin", short_help="List installed plug-ins, and check that they keep their promises.")
def command() -> None:
    """List installed plug-ins, and check that they keep what the interface promises.

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
    from occlog.errors import PluginError
    from occlog.plugins.loading import METHOD, installed
    from occlog.track.catalogue import OURS

    found: dict[str, object] = {}
    for plugin in installed():
        try:
            summary = str(plugin.load().summary)
        except PluginError as error:
            summary = str(error)
        if plugin.kind == METHOD and plugin.name in OURS:
            summary = f"is not used: occlog has a method of that name itself; {summary}"
        found[plugin.name] = {"kind": plugin.kind, "package": f"{plugin.package} {plugin.version}", "summary": summary}
    if as_json:
        options.echo_summary({"plugins": found}, True)
        return ExitCode.DONE
    if not found:
        click.echo("no plug-in is installed; see docs/plugins.md")
    width = max((len(name) for name in found), default=0)
    for plugin, said in zip(installed(), found.values(), strict=True):
        assert isinstance(said, dict)
        click.echo(f"{plugin.name:<{width}}  {plugin.kind}, {said['package']}: {said['summary']}")
    return ExitCode.DONE


@command.command(name="check")
@click.argument("name")
@options.json_opt
def check_plugin(name: str, as_json: bool) -> int:
    """Check that the plug-in NAME keeps what the interface promises; exit code 6 if it does not.

    \b
      occlog plugin check own
    """
    from occlog.plugins.loading import required

    from .kit import CHECKS, faults_of

    plugin = required(name)
    faults = faults_of(plugin.load())
    if as_json:
        told = [{"check": fault.check, "sentence": fault.sentence} for fault in faults]
        options.echo_summary({"plugin": plugin.name, "checks": len(CHECKS), "faults": told}, True)
    else:
        for fault in faults:
            click.echo(f"{fault.check}: {fault.sentence}")
        click.echo(f"{plugin.label}: {len(CHECKS)} checks, {len(faults)} faults")
    return ExitCode.THRESHOLD if faults else ExitCode.DONE
