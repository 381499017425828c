"""Options that several commands share, so that they mean the same everywhere.

-o, --output PATH      the main output                          all that write
--overwrite            replace outputs that exist               all that write
--scene PATH           scene file, instead of the recording's   detect track evaluate report
--seed N               seed of all random numbers               simulate track run
--json                 the summary as JSON on standard output   all
-v / -q                more / fewer messages                    all
--workers N            threads; the result does not depend on it   detect run
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import click

from .first_run import note_quiet
from .input_paths import Input

F = TypeVar("F", bound=Callable[..., object])
PATH = click.Path(path_type=Path)
"""Of an output, a folder or a configuration."""
INPUT = Input()
"""Of an input; `-` is standard input."""

overwrite_opt = click.option("--overwrite", is_flag=True, help="Replace outputs that exist.")
json_opt = click.option("--json", "as_json", is_flag=True, help="Print the summary as one JSON object.")
seed_opt = click.option(
    "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of all random numbers."
)
SCENE_HELP = "Scene file (YAML), a recording that holds one, or a text table of stations."
scene_opt = click.option("--scene", type=INPUT, default=None, help=SCENE_HELP)
STRICT_HELP = "Exit code 6 if warnings say that the estimates are not plausible. Outputs are written all the same."
strict_opt = click.option("--strict", is_flag=True, help=STRICT_HELP)
quiet_opt = click.option(
    "-q", "--quiet", is_flag=True, callback=note_quiet, help="No progress and no notes on standard error."
)
workers_opt = click.option(
    "--workers",
    type=click.IntRange(min=1),
    default=None,
    help="Threads; default: one a processor. The result is the same.",
)


def set_opt(example: str) -> Callable[[F], F]:
    """`--set`, repeated, for settings that have no option of their own."""
    return click.option(
        "--set", "settings", multiple=True, metavar="NAME=VALUE", help=f"A setting, e.g. {example}; may be repeated."
    )


def output_opt(help_text: str, *, required: bool = True) -> Callable[[F], F]:
    """`-o/--output` with its meaning for this command."""
    return click.option("-o", "--output", type=PATH, required=required, help=help_text)
