"""Options of the fusion of detections, for the commands that fuse, and the figures that they print."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

import click

from occlog.cli import options

if TYPE_CHECKING:
    from .stage import Fused

POSITIVE = click.FloatRange(min=0, min_open=True)
PROBABILITY = click.FloatRange(min=0, max=1, min_open=True, max_open=True)

# Every option of these lists is a field of FuseConfig, where its default stands.
SIGMA: dict[str, Any] = {
    "type": POSITIVE,
    "default": None,
    "metavar": "LENGTH",
    "help": "Spread of a position about its prediction. [default: 0.5 m, or 3.33]",
}
WINDOW: dict[str, Any] = {
    "type": click.FloatRange(min=0),
    "default": None,
    "metavar": "SECONDS",
    "help": "Frames this close together in time are fused. [default: equal times]",
}
CHANCES = (
    click.option(
        "--p-miss",
        type=PROBABILITY,
        default=None,
        help="That a camera misses what it could see, unless the scene says. [default: 0.2]",
    ),
    click.option(
        "--p-false",
        type=PROBABILITY,
        default=None,
        help="That a camera reports what is not there, unless the scene says. [default: 0.2]",
    ),
)
REST = (
    click.option(
        "--reach",
        type=POSITIVE,
        default=None,
        help="A detection this many spreads from the prediction counts as missed. [default: 4]",
    ),
    click.option(
        "--gate",
        type=POSITIVE,
        default=None,
        help="One this many standard deviations from the global position is removed. [default: 3]",
    ),
    click.option(
        "--hold",
        type=click.IntRange(min=1),
        default=None,
        metavar="TIMES",
        help="Times without a declaration after which a prediction is dropped. [default: 5]",
    ),
    click.option(
        "--person-height",
        type=POSITIVE,
        default=None,
        metavar="LENGTH",
        help="Of a person, to find feet in boxes. [default: 1.7 m]",
    ),
)


def of_detect(command: Any) -> Any:
    """The options of `occlog detect`."""
    own = (
        click.option("--fuse", is_flag=True, help="Fuse the detections of the cameras: remove false, recover missed."),
        click.option("--fuse-sigma", **SIGMA),
        click.option("--fuse-window", **WINDOW),
    )
    return _all((*own, *CHANCES), command)


def of_fuse(command: Any) -> Any:
    """The options of `occlog fuse`."""
    own = (click.option("--sigma", **SIGMA), click.option("--window", "window_s", **WINDOW))
    return _all((*own, *CHANCES, *REST), command)


def _all(listed: tuple[Any, ...], command: Any) -> Any:
    for option in reversed(listed):
        command = option(command)
    return command


class FuseTally:
    """Figures of the summary, gathered while streaming."""

    def __init__(self) -> None:
        """Nothing yet."""
        self.totals: Counter[str] = Counter()
        self.cameras: dict[str, Counter[str]] = {}

    def add(self, part: Fused) -> None:
        """Count some more rows."""
        for name, counts in part.counts.items():
            self.cameras.setdefault(name, Counter()).update(counts)
        self.totals.update(moments=part.moments, declared=part.declared, not_declared=part.absent, alone=part.alone)

    def summary(self) -> dict[str, Any]:
        """Figures of all cameras, and of each.

        declared: objects, one a moment and object; not_declared: those with detections that were not.
        """
        whole: Counter[str] = Counter()
        for counts in self.cameras.values():
            whole.update(counts)
        out: dict[str, Any] = {k: self.totals[k] for k in ("moments", "declared", "not_declared")}
        out |= {k: whole[k] for k in ("kept", "recovered", "removed")}
        return out | {"cameras": {name: dict(counts) for name, counts in self.cameras.items()}}

    def warn(self, quiet: bool) -> None:
        """A note if most moments have a single camera, which nothing can be fused with."""
        alone, moments = self.totals["alone"], self.totals["moments"]
        if 2 * alone > moments:
            options.note(
                f"warning: at {alone} of {moments} times only one camera delivered a frame; bring frames that are "
                "close in time together with --window SECONDS (detect: --fuse-window)",
                quiet,
            )
