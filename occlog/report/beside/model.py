"""What a page of two runs says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from occlog.array_types import Ints
from occlog.errors import UsageError
from occlog.evaluate.compare.model import Comparison
from occlog.records.losses import Loss
from occlog.records.tables import Tracks
from occlog.report.content.model import ReportInput, TimeAxis
from occlog.settings import METRES

from .comparison.accuracy import OverTime
from .comparison.frames import Laid
from .comparison.identities import Followed
from .comparison.pairs import Pairs
from .comparison.partings import Partings
from .config import BesideConfig


@dataclass(frozen=True, eq=False)
class Side:
    """One of two runs.

    Attributes:
        name: other than that of the other run.
        data: everything that a report shows of it.
        tracks: all its estimates.
        laid: those in the common frames.
    """

    name: str
    data: ReportInput
    tracks: Tracks
    laid: Laid


@dataclass(frozen=True, eq=False)
class AgainstTruth:
    """What the truth says of both.

    Attributes:
        comparison: figures with their differences, of `occlog compare`.
        a, b: tracks that follow each true target.
        switches: identity switches of A and of B, as CLEAR-MOT counts them.
        over_time: errors.
    """

    comparison: Comparison
    a: Followed
    b: Followed
    switches: tuple[int, int]
    over_time: OverTime


@dataclass(frozen=True, eq=False)
class Beside:
    """Two runs side by side.

    Attributes:
        title: heading of the page.
        a, b: the runs.
        near: a track meets a target, or a track of the other run, this near.
        tolerance: partners that are farther from each other have parted.
        lasting_s: changes of track that last less are not told.
        times: (T,) common frames [ns].
        pairs: of the runs.
        partings: where they part.
        in_b, in_a: tracks of B that follow each one of A, and the other way round.
        against_truth: what the truth says; None: there is none.
        same: every estimate is the same, to the last digit.
        notes: what does not fit: spans of time, sensors that stand elsewhere.
        provenance: how everything was made, as JSON-ready values.
    """

    title: str
    a: Side
    b: Side
    near: float
    tolerance: float
    lasting_s: float
    times: Ints
    pairs: Pairs
    partings: Partings
    in_b: Followed
    in_a: Followed
    against_truth: AgainstTruth | None
    same: bool
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, object] = field(default_factory=dict)

    @property
    def unit(self) -> str:
        """Unit of lengths."""
        return self.a.data.unit

    @property
    def sides(self) -> tuple[tuple[str, Side], tuple[str, Side]]:
        """Both, with their letters."""
        return ("A", self.a), ("B", self.b)

    @property
    def time(self) -> TimeAxis:
        """Time since the start of the common frames, or of the truth if that is earlier, to the end of either."""
        found = [self.times] if self.against_truth is None else [self.times, self.against_truth.over_time.t_ns]
        found = [times for times in found if len(times)]
        return TimeAxis(int(min(t[0] for t in found)), int(max(t[-1] for t in found)))

    @property
    def losses(self) -> tuple[tuple[str, Loss], ...]:
        """Input that was lost, with the letter of the run; what both lost in the same place stands once."""
        known: dict[Loss, str] = {}
        for letter, side in self.sides:
            for loss in side.data.losses:
                known[loss] = "both" if known.get(loss, letter) != letter else letter
        return tuple((whose, loss) for loss, whose in known.items())


def lengths_of(config: BesideConfig, unit: str) -> tuple[float, float]:
    """How near tracks meet, and the tolerance, in a scene's unit; UsageError where neither they nor defaults are known.

    Args:
        config: as given, in the scene's unit; None for a default.
        unit: of lengths.
    """
    if unit in METRES:
        usual = BesideConfig.in_unit(unit)
        near, tolerance = usual.match_distance, usual.tolerance
    else:
        near, tolerance = None, None
    near = near if config.match_distance is None else config.match_distance
    tolerance = tolerance if config.tolerance is None else config.tolerance
    if near is None or tolerance is None:
        raise UsageError(
            f"lengths are in {unit!r}: give match_distance, how near a track is that meets another, and tolerance"
        )
    return near, tolerance
