"""Request of `occlog compare`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from occlog.request import Request, sink, source
from occlog.settings import option_setting, setting


@dataclass(frozen=True, kw_only=True)
class CompareRequest(Request):
    """Compare METHODS, each a table of tracks, a run folder or a folder of run folders, with the first of them.

    Tracks are on the ground, of one target or of many. They are compared with the truth and with each other in the
    same frames. Verdicts and confidence intervals come from an exact sign-flip test over recordings of the runs if
    there are eight or more, else over time intervals.

    \b
      occlog compare run/old run/new --truth hall.mcap
      occlog compare results/jipda results/feet --truth recordings/ --fail-if 'idf1 worse' --markdown compare.md
    """

    OWNER: ClassVar[str] = "compare"
    RUN: ClassVar[str] = "occlog.evaluate.compare.run:run_compare"

    methods: tuple[Path, ...] = source(
        "Tables of tracks, run folders, or folders of run folders.", argument=True, there=False
    )
    truth: Path | None = source(
        "True positions: a recording or a table; or a folder of these, by the names of run folders. [default: "
        "recording.mcap of each run folder]",
        there=False,
    )
    metrics: tuple[str, ...] = setting(
        (),
        "Only this metric, such as idf1; may be repeated; a wrong name lists all.",
        option="--metric",
        metavar="NAME",
        repeat=True,
        shown="all",
    )
    fail_if: tuple[str, ...] = option_setting(
        (),
        "Exit with 6 if a later method is worse than the first, e.g. 'idf1 worse' or 'idf1 worse by 0.01', "
        "or if that cannot be decided; may be repeated.",
        metavar="CONDITION",
        repeat=True,
        whole=True,
        shown="",
    )
    match_distance: float | None = option_setting(
        None,
        "Match threshold: a track matches a target within this distance.",
        unit="length",
        above=0,
        at_most=1e9,
        shown="1 m",
    )
    markdown: Path | None = sink("Also write the table of the comparison as a Markdown file.")
    seed: int = option_setting(
        0,
        "Seed of the sign flips of the test, which are drawn at random for more than 15 recordings or intervals.",
        at_least=0,
    )

    @property
    def inputs(self) -> list[Path]:
        """All files that are named; files in folders are not included."""
        return [path for path in super().inputs if path.is_file()]
