"""Errors of one track against one target, in memory that does not grow with their length.

The tables are gone through twice: for what must be known of the whole (`survey`), then side by side in stretches of
time (`compare_streams`).  Figures are those of `compare` and `error_metrics` of whole tables, up to the rounding of
sums.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from occlog.core.metrics.errors import quantile, ratio
from occlog.core.metrics.sums import quantiles
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.matching.paths import Path, paths_of, usual_gap_ns
from occlog.io.files.spool import IN_MEMORY, Spool
from occlog.records.pieces import windows
from occlog.records.tables import Errors, Tracks, Truth

from .on_ground import Gaps, apart, errors_of, settled
from .sums import ErrorFigures

Metrics = dict[str, float]


@dataclass
class Survey:
    """What a pass over tracks and truth finds.

    Attributes:
        tracks: identities of the tracks.
        targets: identities of the true targets.
        estimates: number of rows of the tracks.
        unknown: whether the covariance of an estimate is not known.
        tracks_ns: first and last time of the tracks; None: they have no rows.
        truth_ns: first and last time of the truth with all its roles; None: it has no rows.
        target_ns: first and last time of true targets.
        gap_ns: widest gap of the truth that is bridged unless one is given, where there is one target.
    """

    tracks: set[int] = field(default_factory=set)
    targets: set[int] = field(default_factory=set)
    estimates: int = 0
    unknown: bool = False
    tracks_ns: tuple[int, int] | None = None
    truth_ns: tuple[int, int] | None = None
    target_ns: tuple[int, int] | None = None
    gap_ns: int = 0

    @property
    def single(self) -> tuple[int, int] | None:
        """The track and the target, where there is one of each; else None."""
        return (min(self.tracks), min(self.targets)) if len(self.tracks) == len(self.targets) == 1 else None


def survey(tracks: Iterable[Tracks], truth: Iterable[Truth], in_memory: int = IN_MEMORY) -> Survey:
    """Go through tracks and truth once, as far as it takes to see that there are several of one of them."""
    found, steps, last = Survey(), Spool(in_memory), None
    for rows in truth:
        if not len(rows):
            continue
        found.truth_ns = _span(found.truth_ns, rows.t_ns)
        own = rows.role == "target"
        found.targets.update(np.unique(rows.target_id[own]).tolist())
        if len(found.targets) > 1:
            return found
        t_ns = rows.t_ns[own]
        if len(t_ns):
            found.target_ns = _span(found.target_ns, t_ns)
            steps.add(np.diff(t_ns if last is None else np.insert(t_ns, 0, last)).astype(np.float64))
            last = t_ns[-1]
    for part in tracks:
        if not len(part):
            continue
        found.tracks_ns = _span(found.tracks_ns, part.t_ns)
        found.tracks.update(np.unique(part.target_id).tolist())
        if len(found.tracks) > 1:
            return found
        found.estimates += len(part)
        found.unknown = found.unknown or bool(np.isnan(part.cov_xx).any())
    found.gap_ns = usual_gap_ns(_median(steps))
    return found


def _span(before: tuple[int, int] | None, t_ns: np.ndarray) -> tuple[int, int]:
    return (int(t_ns[0]) if before is None else before[0], int(t_ns[-1]))


def _median(steps: Spool) -> float:
    """Their median; infinite without any."""
    if not steps.count:
        return math.inf
    whole = steps.whole
    if whole is not None:
        return quantile(whole, 0.5)
    # A rounded mean of two steps is what the median of whole numbers of nanoseconds is
    return quantiles(steps.blocks, steps.count, [0.5])[0]


def compare_streams(
    tracks: Iterable[Tracks],
    truth: Iterable[Truth],
    known: Survey,
    config: EvaluateConfig,
    unit: str,
    take: Callable[[Errors], None],
    in_memory: int = IN_MEMORY,
) -> tuple[Metrics, str | None]:
    """All figures of the errors of a track against a target, and a line on gaps of the truth where there is one.

    Args:
        tracks: chunks in the order of time.
        truth: likewise.
        known: what `survey` found in the same chunks; there is one track and one target.
        config: limits in time, length of the transient.
        unit: of lengths.
        take: gets the errors of each stretch, in the order of time.
        in_memory: how many distances are kept in memory.

    Raises:
        InputError: the truth covers the time of no estimate.
    """
    assert known.single is not None
    assert known.target_ns is not None
    _, target = known.single
    figures, late, gaps = ErrorFigures(unit, in_memory), ErrorFigures(unit, in_memory), Gaps()
    transient = config.skip_s > 0 or config.from_ns is not None
    begun: dict[int, int] = {}
    left_out = interpolated = covered = true_rows = 0
    for rows, true, path, estimated in _stretches(tracks, truth, known, config):
        part, good = errors_of(rows, target, path, config)
        gaps.add(rows.t_ns, path, known.target_ns, config)
        left_out += int(np.count_nonzero(~good))
        interpolated += int(np.count_nonzero(~path.sampled(part.t_ns)))
        true_rows += len(true)
        covered += int(np.count_nonzero(estimated.at(true, config.bridge_ns)[1]))
        figures.add(part)
        if transient and len(part):
            late.add(part.take(settled(part, config, begun)))
        take(part)
    if not figures.rows:
        raise apart(known.tracks_ns or (0, 0), known.truth_ns or (0, 0), config)
    metrics: Metrics = {
        "estimates": figures.rows,
        "estimates_without_truth": left_out,
        "estimates_interpolated_truth": interpolated,
        "estimates_unmatched": 0,
        "tracks": 1,
        "tracks_unmatched": 0,
        "targets": 1,
        "targets_unmatched": 0,
        "time_coverage": ratio(covered, true_rows),
        **figures.metrics(),
    }
    if known.unknown:
        metrics = {name: value for name, value in metrics.items() if not name.startswith("nees_")}
    if transient:
        after = {**late.metrics(), "estimates": late.rows}
        metrics |= {f"settled_{name}": value for name, value in after.items()}
    return {name: float(value) for name, value in metrics.items()}, gaps.note


def _stretches(
    tracks: Iterable[Tracks], truth: Iterable[Truth], known: Survey, config: EvaluateConfig
) -> Iterator[tuple[Tracks, np.ndarray, Path, Path]]:
    """Of each stretch: estimates, times of true positions, and the paths of target and track about it.

    A stretch has about it as much as gaps are bridged, so that what is interpolated in it is the same as in the whole.
    """
    limit = known.gap_ns if config.limit_ns is None else config.limit_ns
    nothing = np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros(0)
    for found in windows(tracks, truth, (Tracks, Truth), max(limit, config.bridge_ns)):
        path = next(iter(paths_of(found.about_b, "target").values()), Path(*nothing))
        estimated = next(iter(paths_of(found.about_a).values()), Path(*nothing))
        times = found.b.t_ns[found.b.role == "target"]
        yield found.a, times, Path(path.t_ns, path.xy, path.z, known.gap_ns), estimated
