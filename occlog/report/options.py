"""Options of a page, and of tracks drawn over a video: the two things that `occlog report` makes."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import click

from occlog.cli import options
from occlog.cli.setting_options import Variant, options_of
from occlog.cli.values import Finite
from occlog.ingest.plan import FRAMES

from .beside.config import BesideConfig

PAGE, OVERLAY, BESIDE = "page", "overlay", "beside"
OUTPUT_HELP = "The page: one HTML file that needs nothing else."
MARKDOWN_HELP = "Also write words and figures as Markdown."


def page_options() -> list[click.Option]:
    """Options of a page."""

    def table(name: str, help: str) -> click.Option:
        return click.Option([name], type=options.INPUT, default=None, help=help)

    return [
        click.Option(
            ["-o", "--output"],
            type=options.PATH,
            default=None,
            help=OUTPUT_HELP,
        ),
        table("--bearings", "What each sensor saw: a table or a recording."),
        table("--errors", "Errors written by evaluate."),
        table("--bound", "Bound written by evaluate."),
        table("--diagnostics", "Diagnostics written by track."),
        table("--events", "Births, deaths and doubtful identities of everybody, written by track or fuse."),
        table("--occluders", "Moving occluders as the tracker was told: hulls or occluders, written by priors."),
        table("--metrics", "Figures written by evaluate (JSON)."),
        table("--images", "A recording whose images are shown small beside the plan, with the tracks drawn over them."),
        click.Option(
            ["--images-limit"],
            type=Finite(0.01, 500),
            default=5.0,
            show_default=True,
            metavar="MB",
            help="How much of the page the images may take; more of them are left out.",
        ),
        click.Option(["--markdown"], type=options.PATH, default=None, help=MARKDOWN_HELP),
        click.Option(["--strict"], is_flag=True, help=options.STRICT_HELP),
        click.Option(["--title"], default="Tracking report", show_default=True, help="Heading of the page."),
    ]


def beside_parameters() -> list[click.Parameter]:
    """The second run, and options of two runs side by side."""
    return [
        click.Argument(["other"], type=options.INPUT, required=True),
        click.Option(["-o", "--output"], type=options.PATH, default=None, help=OUTPUT_HELP),
        *options_of(BesideConfig),
        click.Option(["--seed"], type=click.IntRange(min=0), default=0, show_default=True, help="Of the draws."),
        click.Option(["--markdown"], type=options.PATH, default=None, help=MARKDOWN_HELP),
        click.Option(["--strict"], is_flag=True, help=options.STRICT_HELP),
        click.Option(["--title"], default="Two runs side by side", show_default=True, help="Heading of the page."),
    ]


def overlay_options() -> list[click.Option]:
    """Options of tracks that are drawn over a video."""
    return [
        click.Option(
            ["--recording"],
            type=options.INPUT,
            default=None,
            help="Draw over the video of this recording, instead of making a page.",
        ),
        click.Option(
            ["--video"],
            type=options.PATH,
            default=None,
            help="The video to make: .webm (VP8) for browsers; .mp4 (MPEG-4), which they may not play; .avi "
            "(Motion JPEG, larger, no smears).",
        ),
        click.Option(
            ["--frame"],
            type=click.IntRange(min=0),
            default=None,
            help="Number, in the first camera, of the frame for --png.",
        ),
        click.Option(
            ["--frames"],
            type=FRAMES,
            default=None,
            metavar="A:B",
            help="Video of frames A <= number < B of the first camera only.",
        ),
        click.Option(
            ["--camera", "cameras"],
            multiple=True,
            metavar="NAME",
            help="Only this camera; repeatable. The first one counts the frames. [default: all]",
        ),
        click.Option(
            ["--failures"], type=options.INPUT, default=None, help="Failures written by evaluate, drawn in red."
        ),
        click.Option(
            ["--world"],
            type=options.INPUT,
            default=None,
            help="Tracks of the world, for the plan beside the images.  [default: TRACKS, if of the world or a folder]",
        ),
        click.Option(
            ["--diagnostics"],
            type=options.INPUT,
            default=None,
            help="Which cameras see a target, where its tracks do not say: written by track.  [default: of the folder]",
        ),
        click.Option(
            ["--plan/--no-plan"], default=True, help="Tracks of the world get the plan, or not.  [default: plan]"
        ),
        click.Option(
            ["--trail"],
            type=Finite(0, 3600),
            default=2.0,
            show_default=True,
            metavar="SECONDS",
            help="How long a way is drawn behind each target.",
        ),
        click.Option(
            ["--fundamental"],
            type=options.INPUT,
            default=None,
            help="Geometry of the views as the tracker had it, if not that of the recording.",
        ),
        click.Option(
            ["--scale"],
            type=Finite(0.05, 16),
            default=None,
            help="Enlarge images. [default: by a whole number to about 360 px; no video is larger than 3840 x 2160 px]",
        ),
        click.Option(
            ["--fps"],
            type=Finite(0.1, 1000),
            default=None,
            metavar="HZ",
            help="Frames a second of the video. [default: those of the recording]",
        ),
    ]


VARIANTS = {
    PAGE: Variant("One offline page, and a picture of the main figures.", page_options, called="a page"),
    OVERLAY: Variant(
        "Tracks and true boxes drawn over the video of a recording.",
        overlay_options,
        called="--recording (tracks drawn over its video)",
    ),
    BESIDE: Variant(
        "Two runs side by side: differences, where they part, who became another one.",
        beside_parameters,
        called="TRACKS OTHER (two runs side by side)",
    ),
}


def chosen(args: Sequence[str], shared: Sequence[click.Parameter]) -> str | None:
    """What the arguments ask for: tracks over a video where they name a recording, else two runs where they name two.

    Args:
        args: of the command.
        shared: parameters that all kinds have.
    """
    if any(arg == "--recording" or arg.startswith("--recording=") for arg in args):
        return OVERLAY
    known = [*shared, *(param for variant in VARIANTS.values() for param in variant.params())]
    takes = {name for p in known if isinstance(p, click.Option) and not p.is_flag for name in p.opts}
    return BESIDE if _names(args, takes) > 1 else None


def _names(args: Sequence[str], takes: Collection[str]) -> int:
    """How many arguments are no options and no values of options; `takes` are options that take a value."""
    found = skip = 0
    for place, arg in enumerate(args):
        if skip:
            skip = 0
        elif arg == "--":
            return found + len(args) - place - 1
        elif arg.startswith("--"):
            skip = arg in takes
        elif arg.startswith("-") and arg != "-":
            # Short options may stand together (-qo FILE); a value follows at once (-oFILE) or next
            valued = next((k for k, letter in enumerate(arg[1:], 1) if f"-{letter}" in takes), 0)
            skip = valued == len(arg) - 1
        else:
            found += 1
    return found
