"""Options of `occlog track` that are not settings of a method: files, and which rows to use."""

from __future__ import annotations

import click

from occlog.cli.options import INPUT, PATH, STRICT_HELP
from occlog.cli.setting_options import options_of
from occlog.cli.values import LONGEST_WINDOW_S, Finite, NumberOrFile
from occlog.scans.config import MeasuredConfig
from occlog.track.apf.selection_config import SelectConfig
from occlog.track.catalogue import METHODS, settings_of

LISTED: tuple[click.Option, ...] = (
    click.Option(["--diagnostics"], type=PATH, default=None, help="How the filter fared at each time (Parquet)."),
    click.Option(
        ["--residuals"],
        type=PATH,
        default=None,
        help="How each bearing agrees with the estimate, and whether it is believed (Parquet).",
    ),
    click.Option(
        ["--cloud"],
        type=PATH,
        default=None,
        help="Where the particles of the filter are at each time, 200 at most, as before any smoothing (Parquet).",
    ),
    click.Option(
        ["--calibration"],
        type=PATH,
        default=None,
        help="Errors of the cameras' poses as estimated, with --set calibrate=joint or initial (Parquet).",
    ),
    click.Option(
        ["--doa"],
        type=INPUT,
        default=None,
        help="Directions of arrival to use too: a table, or a recording that holds them.",
    ),
    click.Option(
        ["--doa-labels"],
        is_flag=True,
        help="Identities in the log of directions are those of targets. [default: directions may be of anything]",
    ),
    click.Option(
        ["--measurements"],
        type=PATH,
        default=None,
        help="Ranges, signal strengths and time differences to use too: a table, or a recording with reads of tags.",
    ),
    *options_of(MeasuredConfig),
    click.Option(
        ["--occluders"],
        type=INPUT,
        default=None,
        help="Where moving occluders may be: `occluders` or `hulls` (Parquet, see `occlog priors`), "
        "or truth (known exactly).",
    ),
    *options_of(SelectConfig),
    click.Option(
        ["--start", "starts"],
        multiple=True,
        metavar="X,Y[,SIGMA]",
        help="Where the target is at first; SIGMA is 0.5 m, or 1 in units of its own, if left out. For --method imm "
        "also X,Y,SIGMA,VX,VY,SIGMA_V; may be repeated, once a target. [default: anywhere in the room, or where "
        "sensors see]",
    ),
    click.Option(
        ["--cooperation"], type=PATH, default=None, help="What cameras were asked, and what they said (Parquet)."
    ),
    click.Option(
        ["--answer-delay"],
        type=NumberOrFile(0),
        default=None,
        metavar="SECONDS|FILE",
        help="Cameras' answers take so long, or as long as the slowest router in the delays of `occlog traffic`, "
        "of one case (Parquet). [default: no time]",
    ),
    click.Option(
        ["--target", "targets"],
        multiple=True,
        type=click.IntRange(min=0),
        metavar="ID",
        help="Track only this target; may be repeated. The first also numbers a track without labels.",
    ),
    click.Option(["--labelled-only"], is_flag=True, help="Do not use candidates that are not assigned to a target."),
    click.Option(
        ["--use-recovered"],
        is_flag=True,
        help="Use what the fusion of detections recovered as if it had been measured. [default: not seen]",
    ),
    click.Option(
        ["--in-turn", "turn"],
        type=Finite(0, LONGEST_WINDOW_S, min_open=True),
        default=None,
        metavar="SECONDS",
        help="Use one sensor at a time, each for so long, in the order of the scene. [default: all at once]",
    ),
    click.Option(["--strict"], is_flag=True, help=STRICT_HELP),
    click.Option(
        ["--sights"],
        type=INPUT,
        default=None,
        help="Bearings of the cameras of --refine: a table, or a recording. [default: those of the recording]",
    ),
    click.Option(
        ["--path-loss"],
        type=INPUT,
        default=None,
        help="How strongly readers read tags (JSON, see `occlog fit-readers`). [default: settings]",
    ),
    click.Option(
        ["--virtual-sensors"],
        type=PATH,
        default=None,
        help="The regions that sets of readers cover, with area, centroid and covariance (Parquet).",
    ),
    click.Option(["--motion"], type=INPUT, default=None, help="How targets move, from `occlog fit-motion`."),
    click.Option(
        ["--initial"],
        type=INPUT,
        default=None,
        help="Where targets are in each view at first: CSV of ellipses, or boxes with identities (Parquet, or "
        "a recording that holds true boxes). [default: from detections]",
    ),
    click.Option(
        ["--detections"],
        type=INPUT,
        default=None,
        help="Boxes of a detector, or views of `occlog detect`, that trackers begin from. [default without "
        "--initial: boxes in the recording, or else what moves in it]",
    ),
    click.Option(
        ["--fundamental"],
        type=INPUT,
        default=None,
        help="Fundamental matrices (JSON, see `occlog epipolar`). [default: poses of --scene, "
        "those in the recording, poses of its scene]",
    ),
    click.Option(
        ["--world"],
        type=PATH,
        default=None,
        help="Where the targets are on the ground, from all views that track them (Parquet).",
    ),
    click.Option(
        ["--support"], type=PATH, default=None, help="Which box of which camera speaks for which row (Parquet)."
    ),
    click.Option(
        ["--events"],
        type=PATH,
        default=None,
        help="Births, deaths, and identities that may have been exchanged (Parquet).",
    ),
    click.Option(
        ["--gallery"],
        type=INPUT,
        default=None,
        help="How people look (Parquet, of `occlog appearance learn`): tracks get its identities, and parts of "
        "somebody who was lost and found are one track.",
    ),
    click.Option(
        ["--view-tracks"],
        type=PATH,
        default=None,
        help="Everybody in every image, hidden people too (Parquet).",
    ),
)
"""Every option by its parameter's name is taken by the methods whose entry in the catalogue names it."""


def method_params(name: str) -> list[click.Parameter]:
    """The options that a method takes beside the shared ones: those of its entry, then its settings'."""
    takes = METHODS[name].takes
    return [*(option for option in LISTED if option.name in takes), *options_of(settings_of(name))]
