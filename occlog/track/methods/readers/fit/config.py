"""Settings of `occlog fit-readers`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import Settings, option_setting, setting


@dataclass(frozen=True)
class FitReadersConfig(Settings):
    """Settings of `occlog fit-readers`: windows of reads, height of tags, and the ranges to try."""

    OWNER: ClassVar[str] = "fit-readers"

    window_s: float = setting(
        1.0, "Window: reads within this time make one time step.", unit="s", above=0, at_most=1e9, option="--window"
    )
    tag_height: float = option_setting(0.0, "Height of tags above the floor.", unit="length", people=1.2)
    max_gap_s: float = setting(
        2.0,
        "Maximum gap in time between two true positions to interpolate.",
        unit="s",
        at_least=0,
        at_most=1e9,
        option="--max-gap",
    )
    ranges: tuple[float, ...] | None = option_setting(
        None,
        "Ranges to try for the virtual sensors [m, or scene unit], separated by commas; the one with the least error "
        "is used.",
        unit="length",
        metavar="A,B,...",
        nothing="ten, from half of the readers' usual distance to their neighbours to twice it",
    )

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """Generate (setting, whether it fits, limit as text): ranges are above 0."""
        yield "ranges", self.ranges is None or min(self.ranges) > 0, "lengths above 0"
