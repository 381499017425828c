"""Options of `occlog evaluate` that are no settings, and the kinds of input that options are for."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from typing import Any, TypeVar

import click

from occlog.cli import options
from occlog.cli.values import Finite
from occlog.errors import UsageError
from occlog.ingest.plan import FRAMES
from occlog.settings import declaration, declared

from .matching.config import AZIMUTHS, GROUND, IMAGES, KINDS, OTHERS, WORLD, EvaluateConfig
from .mot.config import MANY, ManyConfig

F = TypeVar("F", bound=Callable[..., Any])


class KindOption(click.Option):
    """An option that is for some kinds of input only."""

    def __init__(self, *args: Any, kinds: Sequence[str], **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.kinds = tuple(kinds)


def input_option(name: str, *, kinds: Sequence[str], help: str) -> Callable[[F], F]:
    """An option that names an input."""
    return click.option(name, cls=KindOption, kinds=kinds, type=options.INPUT, default=None, help=help)


def output_option(name: str, *, kinds: Sequence[str], help: str, metavar: str | None = None) -> Callable[[F], F]:
    """An option that names a file or folder to write."""
    return click.option(name, cls=KindOption, kinds=kinds, type=options.PATH, default=None, help=help, metavar=metavar)


COMPARED = (
    input_option(
        "--truth",
        kinds=(IMAGES, GROUND, OTHERS),
        help="True positions or boxes: a recording or a table; for tracks in images also MOTChallenge text, XML "
        "(PETS), VATIC's or KITTI's text.",
    ),
    input_option("--bearings", kinds=WORLD, help="Bearings: for detections, bound, sight lines."),
    input_option(
        "--measurements",
        kinds=WORLD,
        help="Ranges, signal strengths, time differences: for the bound, with the settings that TRACKS were made with.",
    ),
    input_option(
        "--doa",
        kinds=(AZIMUTHS, *WORLD),
        help="Directions of arrival to use along with the bearings. [default: those of the same recording]",
    ),
    click.option(
        "--doa-labels",
        cls=KindOption,
        kinds=WORLD,
        is_flag=True,
        help="Identities in the log of directions are those of targets.",
    ),
    input_option(
        "--truth-azimuths",
        kinds=(AZIMUTHS,),
        help="True directions to compare those of --doa with: a log (time, azimuth_deg) or a table.",
    ),
    click.option(
        "--doa-gate",
        "doa_gate_deg",
        cls=KindOption,
        kinds=(AZIMUTHS,),
        type=Finite(0, 180),
        default=10.0,
        show_default=True,
        metavar="DEGREES",
        help="A direction further from the truth is a false one, and the true one missed.",
    ),
    input_option(
        "--views",
        kinds=WORLD,
        help="Views to compare with the true boxes of --truth; or, with --held-out, views or boxes of all people.",
    ),
    input_option("--cooperation", kinds=WORLD, help="What cameras were asked; gives its cost too."),
    input_option(
        "--diagnostics", kinds=WORLD, help="How the filter fared at each time, to judge whether TRACKS are plausible."
    ),
    input_option("--scene", kinds=(AZIMUTHS, *WORLD), help=options.SCENE_HELP),
)
"""Options that name what is compared."""

WRITTEN = (
    output_option("--errors", kinds=WORLD, help="Write the error of every estimate (Parquet)."),
    output_option("--bound", kinds=WORLD, help="Write the posterior Cramer-Rao bound (Parquet)."),
    output_option(
        "--write-scene",
        kinds=WORLD,
        help="Write the scene with each camera's noise as measured where the target's place is known; wants --bearings "
        "and --truth.",
    ),
)
"""Options that name tables to write."""

FRAMES_OPTION = click.option(
    "--frames",
    cls=KindOption,
    kinds=(IMAGES, *WORLD),
    type=FRAMES,
    default=None,
    metavar="A:B",
    help="Only frames A <= number < B; on the ground the times of the truth (without one, of the bearings) are "
    "numbered from 0.",
)

OF_MANY = (
    FRAMES_OPTION,
    click.option(
        "--also",
        cls=KindOption,
        kinds=MANY,
        type=options.INPUT,
        nargs=2,
        multiple=True,
        metavar="TRACKS TRUTH",
        help="Tracks and truth of one more recording: a row for each in one table, and one of all together; may be "
        "repeated.",
    ),
    output_option(
        "--failures", kinds=MANY, help="Write each failure of a tracker: frame, camera, target, cause (Parquet)."
    ),
    output_option(
        "--counts",
        kinds=(GROUND,),
        help="Write how many targets and tracks there are at each time of the truth (Parquet).",
    ),
    output_option(
        "--mot",
        kinds=(IMAGES,),
        metavar="DIR",
        help="Write truth and tracks as MOTChallenge files, as TrackEval wants them; DIR may hold tracks of "
        "others already.",
    ),
)
"""Options of the evaluation of many targets that are no settings with a type of their own."""


def with_all(added: Sequence[Callable[[F], F]]) -> Callable[[F], F]:
    """Decorator that gives a command several options, in order."""

    def decorate(command: F) -> F:
        for option in reversed(added):
            command = option(command)
        return command

    return decorate


def kinds_of(param: click.Parameter) -> tuple[str, ...]:
    """Kinds of input that an option is for; empty: all."""
    if isinstance(param, KindOption):
        return param.kinds
    settings = (*declared(EvaluateConfig), *declared(ManyConfig))
    return next((declaration(f).kinds for f in settings if f.name == param.name), ())


def check_kind(params: Iterable[click.Parameter], given: Collection[str], kind: str) -> None:
    """UsageError for an option that was given and is not for this kind of input; it names the kinds that have it.

    Args:
        params: of the command.
        given: names of those parameters that were given.
        kind: of the input.
    """
    for param in params:
        kinds = kinds_of(param)
        if param.name in given and kinds and kind not in kinds:
            wanted = ", or ".join(KINDS[name] for name in kinds)
            raise UsageError(f"{param.opts[0]} is for {wanted}; not for {KINDS[kind]}")


def given_in(context: click.Context) -> frozenset[str]:
    """Names of the parameters that the command line gives."""
    names = (param.name or "" for param in context.command.params)
    return frozenset(n for n in names if context.get_parameter_source(n) is click.core.ParameterSource.COMMANDLINE)
