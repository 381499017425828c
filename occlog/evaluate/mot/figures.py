"""Truth and tracks to flat figures: CLEAR-MOT, IDF1, HOTA, GOSPA, and failure rates."""

from __future__ import annotations

import numpy as np

from occlog.array_types import Bools
from occlog.core.metrics.clear_mot import CHALLENGE, CLASSIC, ClearRule, clear_mot
from occlog.core.metrics.errors import ratio
from occlog.core.metrics.failure_rates import Failures
from occlog.core.metrics.frame_pairs import Frames, Objects, of_boxes
from occlog.core.metrics.gospa import gospa
from occlog.core.metrics.hota import hota
from occlog.core.metrics.idf1 import identity

from .config import ManyConfig

Metrics = dict[str, float]
RULES = {"classic": CLASSIC, "challenge": CHALLENGE}
"""How CLEAR-MOT pairs objects, by `ManyConfig.clear_rule`."""


def mot_figures(frames: Frames, config: ManyConfig, cells: int, whose: str = "", unit: str = "") -> Metrics:
    """CLEAR-MOT, IDF1, HOTA and GOSPA.

    Args:
        frames: truth and tracks; points meet where their similarity reaches 0.5, boxes where it reaches the overlap.
        config: how.
        cells: number of frames, empty ones included, over which GOSPA is averaged.
        whose: ending of the names, such as `_sensor_NAME`.
        unit: of the distance; empty: 1 - IoU.
    """
    points = not np.isnan(frames.limit)
    rule = RULES[config.clear_rule]._replace(threshold=0.5 if points else config.overlap)
    out = _clear(frames, rule, whose, unit) | _identity(frames, rule.threshold, whose)
    named = {"hota": "hota", "det_a": "deta", "ass_a": "assa", "loc_a": "loca"}
    named |= {"det_re": "detre", "det_pr": "detpr", "ass_re": "assre", "ass_pr": "asspr"}
    out |= {f"{named[name]}{whose}": value for name, value in hota(frames).means().items()}
    cutoff = config.gospa_cutoff or (frames.limit if points else 1.0 - rule.threshold or 1.0)
    return out | gospa_figures(frames, config, cutoff, cells, whose, unit)


def _clear(frames: Frames, rule: ClearRule, whose: str, unit: str) -> Metrics:
    got = clear_mot(frames, rule)
    end = f"{whose}_{unit}" if unit else whose
    out: Metrics = {
        f"objects{whose}": got.objects,
        f"estimates_compared{whose}": got.estimates,
        f"tp{whose}": got.tp,
        f"fp{whose}": got.fp,
        f"fn{whose}": got.fn,
        f"id_switches{whose}": got.switches,
        f"fragmentations{whose}": got.fragmentations,
        f"mota{whose}": got.mota,
        f"motp{end}": got.motp,
        f"recall{whose}": got.recall,
        f"precision{whose}": got.precision,
        f"mostly_tracked{whose}": got.mostly_tracked,
        f"partly_tracked{whose}": got.partly_tracked,
        f"mostly_lost{whose}": got.mostly_lost,
    }
    return out if unit else out | {f"motp_iou{whose}": got.motp_similarity}


def _identity(frames: Frames, threshold: float, whose: str) -> Metrics:
    got = identity(frames, threshold)
    names = ("idf1", "idp", "idr", "idtp", "idfp", "idfn")
    return {f"{name}{whose}": getattr(got, name) for name in names}


def gospa_figures(frames: Frames, config: ManyConfig, cutoff: float, cells: int, whose: str, unit: str) -> Metrics:
    """Mean GOSPA over frames, in the unit of the distance, and its parts, in that unit to the power of p."""
    made = gospa(frames, cutoff, config.gospa_p, config.gospa_alpha)
    means = made.means(max(cells, 1))
    end = f"{whose}_{unit}" if unit else whose
    power = power_of(config, unit)
    out = {f"gospa{end}": means["gospa"]}
    return out | {f"gospa_{name}{end}{power}": means[name] for name in ("localisation", "missed", "false")}


def power_of(config: ManyConfig, unit: str) -> str:
    """What follows the unit in the names of parts of GOSPA: its exponent, unless that is 1 or there is no unit."""
    return f"{config.gospa_p:g}".replace(".", "p") if unit and config.gospa_p != 1 else ""


def across_views(truth: Objects, tracks: Objects, threshold: float) -> Metrics:
    """IDF1 of identities that are the same in all views, as for several cameras of one place."""
    sides = []
    for side in (truth, tracks):
        view = np.zeros(len(side.frame), dtype=np.int64) if side.view is None else side.view
        sides.append(Objects(side.frame + (view << 40), side.label, side.place))
    got = identity(of_boxes(*sides), threshold)
    return {"idf1_across_views": got.idf1, "idp_across_views": got.idp, "idr_across_views": got.idr}


def of_view(side: Objects, view: int) -> Objects:
    """The objects of one view."""
    mine = np.zeros(len(side.frame), dtype=np.int64) == view if side.view is None else side.view == view
    return Objects(side.frame[mine], side.label[mine], side.place[mine])


def centres(side: Objects) -> Objects:
    """Middles of boxes in their stead."""
    return side._replace(place=side.place[:, :2] + 0.5 * side.place[:, 2:])


def failure_figures(found: Failures, rows: Bools, total: int, whose: str = "") -> Metrics:
    """Failure rates of some of the failures, over `total` true rows."""
    label = int(np.count_nonzero(found.label[rows]))
    position = int(np.count_nonzero(rows)) - label
    return {
        f"fr_p{whose}": ratio(position, total),
        f"fr_l{whose}": ratio(label, total),
        f"position_failures{whose}": position,
        f"label_failures{whose}": label,
    }
