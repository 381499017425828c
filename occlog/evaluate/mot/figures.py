"""Flat figures from truth and tracks: CLEAR-MOT, IDF1, HOTA, GOSPA, and failure rates.

For tracks with their own identities (not those of the truth), one-to-one pairs over the whole run count every identity
switch as an error of position. The figures listed first are then HOTA, IDF1, MOTA, identity switches, and RMSE and NEES
of the pairs of each frame.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from occlog.array_types import Bools
from occlog.core.metrics.errors import ratio_or_nan
from occlog.core.metrics.mot.clear_mot import CHALLENGE, CLASSIC, ClearCounts, ClearMot, MatchedPairs, Matcher
from occlog.core.metrics.mot.failure_rates import FailureRates
from occlog.core.metrics.mot.frame_pairs import MatchedFrames, Objects
from occlog.core.metrics.mot.gospa import GospaSums, gospa
from occlog.core.metrics.mot.hota import Alignment, HotaCounts, Identity, IdentityCounts

from .config import MultiTargetConfig

Metrics = dict[str, float]
RULES = {"classic": CLASSIC, "challenge": CHALLENGE}
"""Matching rules of CLEAR-MOT, by `MultiTargetConfig.clear_rule`."""


class MotFigures:
    """Accumulates CLEAR-MOT, IDF1, HOTA and GOSPA over parts of a recording, in two passes: `prepare`, then `update`.

    Targets and tracks have the same indices in all parts of a recording.
    """

    def __init__(self, frames: MatchedFrames, config: MultiTargetConfig) -> None:
        """Create figures without frames.

        Args:
            frames: any part, which has the keys of all targets and tracks, and the distance limit of points; points
                match from a similarity of 0.5 on, boxes from the IoU `match_iou` on.
            config: limits and rules of the figures.
        """
        targets, tracks = len(frames.truth_key), len(frames.track_key)
        self._config, points = config, not np.isnan(frames.limit)
        rule = RULES[config.clear_rule]._replace(threshold=0.5 if points else config.match_iou)
        self._matcher, self._clear = Matcher(targets, rule), ClearCounts(targets)
        self.identity = IdentityCounts(targets, tracks, rule.threshold)
        self._alignment = Alignment(targets, tracks)
        self._hota = HotaCounts(self._alignment)
        cutoff = config.gospa_cutoff or (frames.limit if points else 1.0 - rule.threshold or 1.0)
        self._gospa = GospaFigures(config, cutoff)

    def prepare(self, frames: MatchedFrames) -> None:
        """First pass: add the frames to the alignment of targets and tracks."""
        self._alignment.update(frames)

    def update(self, frames: MatchedFrames) -> MatchedPairs:
        """Second pass: add frames in the order of time; return their CLEAR-MOT pairs."""
        made = self._matcher.update(frames)
        self._clear.update(frames, made)
        self.identity.update(frames)
        self._hota.update(frames)
        self._gospa.update(frames)
        return made

    def merge(self, other: MotFigures) -> None:
        """Add another recording without common targets or tracks; no frame may be added afterwards."""
        self._clear.merge(other._clear)
        self.identity.merge(other.identity)
        self._hota.merge(other._hota)
        self._gospa.merge(other._gospa)

    def result(self, cells: int, suffix: str = "", unit: str = "") -> Metrics:
        """Return all figures by name.

        Args:
            cells: number of frames of all views, empty ones included, over which GOSPA is averaged.
            suffix: suffix of the names, such as `_sensor_NAME`.
            unit: unit of the distance; empty: it is 1 - IoU.
        """
        out = _clear(self._clear.result(), suffix, unit) | _identity(self.identity.result(), suffix)
        named = {"hota": "hota", "det_a": "deta", "ass_a": "assa", "loc_a": "loca"}
        named |= {"det_re": "detre", "det_pr": "detpr", "ass_re": "assre", "ass_pr": "asspr"}
        out |= {f"{named[name]}{suffix}": value for name, value in self._hota.result().means().items()}
        return out | self._gospa.result(cells, suffix, unit)


def _clear(got: ClearMot, suffix: str, unit: str) -> Metrics:
    end = f"{suffix}_{unit}" if unit else suffix
    out: Metrics = {
        f"objects{suffix}": got.objects,
        f"estimates_compared{suffix}": got.estimates,
        f"tp{suffix}": got.tp,
        f"fp{suffix}": got.fp,
        f"fn{suffix}": got.fn,
        f"id_switches{suffix}": got.switches,
        f"fragmentations{suffix}": got.fragmentations,
        f"mota{suffix}": got.mota,
        f"motp{end}": got.motp,
        f"recall{suffix}": got.recall,
        f"precision{suffix}": got.precision,
        f"mostly_tracked{suffix}": got.mostly_tracked,
        f"partly_tracked{suffix}": got.partly_tracked,
        f"mostly_lost{suffix}": got.mostly_lost,
    }
    return out if unit else out | {f"motp_iou{suffix}": got.motp_similarity}


def _identity(got: Identity, suffix: str) -> Metrics:
    names = ("idf1", "idp", "idr", "idtp", "idfp", "idfn")
    return {f"{name}{suffix}": getattr(got, name) for name in names}


class GospaFigures:
    """Accumulates the mean GOSPA over parts of a recording."""

    def __init__(self, config: MultiTargetConfig, cutoff: float) -> None:
        """Start without frames; `config` has exponent and alpha, `cutoff` is a distance (or 1 - IoU)."""
        self._config, self._cutoff, self._sums = config, cutoff, GospaSums(config.gospa_p)

    def update(self, frames: MatchedFrames) -> None:
        """Add the GOSPA of further frames."""
        self._sums.update(gospa(frames, self._cutoff, self._config.gospa_p, self._config.gospa_alpha))

    def merge(self, other: GospaFigures) -> None:
        """Add the sums of another recording to these."""
        self._sums.merge(other._sums)

    def result(self, cells: int, suffix: str, unit: str) -> Metrics:
        """Return the mean GOSPA over frames, in `unit`, and its parts, in that unit to the power p, by name.

        Args:
            cells: number of frames of all views.
            suffix: suffix of the names of the figures.
            unit: unit of distances; empty: distances are 1 - IoU.
        """
        means = self._sums.means(max(cells, 1))
        end = f"{suffix}_{unit}" if unit else suffix
        power = power_of(self._config, unit)
        out = {f"gospa{end}": means["gospa"]}
        return out | {f"gospa_{name}{end}{power}": means[name] for name in ("localisation", "missed", "false")}


def power_of(config: MultiTargetConfig, unit: str) -> str:
    """Suffix after the unit in the names of GOSPA's parts: its exponent, unless it is 1 or there is no unit."""
    return f"{config.gospa_p:g}".replace(".", "p") if unit and config.gospa_p != 1 else ""


def of_view(side: Objects, view: int) -> Objects:
    """Return the objects of the view with the index `view`, without the column of views."""
    mine = np.zeros(len(side.frame), dtype=np.int64) == view if side.view is None else side.view == view
    return Objects(side.frame[mine], side.label[mine], side.position[mine])


def centres(side: Objects) -> Objects:
    """Return a copy of the objects in which boxes (left, top, width, height) are replaced by their centres."""
    return side._replace(position=side.position[:, :2] + 0.5 * side.position[:, 2:])


class FailureCounts:
    """Accumulated numbers of label failures, position failures and true rows."""

    def __init__(self) -> None:
        """Create counts without rows and failures."""
        self._label = self._position = self._total = 0

    def update(self, found: FailureRates, rows: Bools, total: int) -> None:
        """Add failures.

        Args:
            found: failures of trackers, of which some are label failures and the others position failures.
            rows: mask of those that count.
            total: number of true rows.
        """
        label = int(np.count_nonzero(found.label[rows]))
        self._label += label
        self._position += int(np.count_nonzero(rows)) - label
        self._total += total

    def merge(self, other: FailureCounts) -> None:
        """Add the counts of another recording to these."""
        self._label, self._position = self._label + other._label, self._position + other._position
        self._total += other._total

    def result(self, suffix: str = "") -> Metrics:
        """Return the rates of position and label failures over all true rows, FR_p and FR_l [Qu], and their numbers.

        `suffix`: suffix of the names.
        """
        return {
            f"fr_p{suffix}": ratio_or_nan(self._position, self._total),
            f"fr_l{suffix}": ratio_or_nan(self._label, self._total),
            f"position_failures{suffix}": self._position,
            f"label_failures{suffix}": self._label,
        }


INDEPENDENT_IDS = "tracks_independent_ids"
"""Figure that is 1 where tracks have their own identities and several tracks or targets were compared."""
MIN_RMSE_RATIO = 2.0
"""Ratio of the RMSE of whole tracks to that of the pairs of each frame from which on a note states what each is of."""
MIN_MATCHED_SHARE = 0.5
"""Share of the true positions that must be met for the errors of pairs to describe the tracks."""


def independent_ids(metrics: Mapping[str, object]) -> bool:
    """Return whether the figures are of tracks with identities of their own, unrelated to those of the targets.

    Figures of pairs matched in each frame are then more important than those by identity.
    """
    return metrics.get(INDEPENDENT_IDS) == 1.0


def first_of(metrics: Mapping[str, object]) -> dict[str, object]:
    """Return only the headline figures of `metrics` (such as HOTA, IDF1, MOTA), in any unit of length."""
    begin = "matched_rmse_"
    unit = next((name.removeprefix(begin) for name in metrics if name.startswith(begin)), "")
    return {name: metrics[name] for name in names(unit) if name in metrics}


def names(unit: str) -> tuple[str, ...]:
    """Return the names of the headline figures of tracks with their own identities.

    `unit`: unit of lengths, part of names.
    """
    pairs = (f"matched_rmse_{unit}", "matched_nees_mean", "matched_nees_share_95", f"matched_gate_{unit}")
    return ("hota", "idf1", "mota", "id_switches", *pairs)


def first(metrics: Mapping[str, float], unit: str) -> dict[str, float]:
    """Return all figures, reordered so that the headline figures come first; `unit`: unit of lengths, part of names."""
    return {name: metrics[name] for name in names(unit) if name in metrics} | dict(metrics)


def matchings_differ(metrics: Mapping[str, float], unit: str) -> bool:
    """Return whether the RMSE of whole-run pairs exceeds that of per-frame pairs by more than `MIN_RMSE_RATIO`.

    `unit`: unit of lengths, part of the names in `metrics`.
    """
    whole, pairs = metrics.get(f"rmse_{unit}", math.nan), metrics.get(f"matched_rmse_{unit}", math.nan)
    return whole > MIN_RMSE_RATIO * pairs


def notes(metrics: Mapping[str, float], unit: str, match: str) -> tuple[str, ...]:
    """Return a note that explains two RMSEs (whole-run and per-frame pairs) if they differ much; else empty.

    Args:
        metrics: all figures by name.
        unit: unit of lengths.
        match: how tracks are paired with targets over the whole run, `id` or `optimal`.
    """
    if not matchings_differ(metrics, unit):
        return ()
    whole, pairs = metrics[f"rmse_{unit}"], metrics[f"matched_rmse_{unit}"]
    if independent_ids(metrics):
        gate = metrics[f"matched_gate_{unit}"]
        return (
            f"RMSE {pairs:.3g} {unit} with matching per frame ({gate:g} {unit} gate); {whole:.3g} {unit} with "
            "one-to-one matching over the whole run, which counts identity switches as errors",
        )
    met = metrics["recall"]
    read = (
        f"{met:.0%} of the true positions are met: read the pairs for errors and NEES, and IDF1 and identity switches "
        f"({metrics['id_switches']:.0f}) for tracks that change people"
        if met >= MIN_MATCHED_SHARE
        else f"only {met:.0%} of the true positions are met: read the first"
    )
    return (
        f"the RMSE of {whole:.3g} {unit} holds each track to one target for all its time (match {match}), the RMSE of "
        f"the pairs, {pairs:.3g} {unit}, to whom it is on at each time; {read}",
    )
