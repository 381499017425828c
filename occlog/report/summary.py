"""The few figures on top of a report, and how many rows it was made from."""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import NS
from occlog.records.tables import Bound, Errors, PeopleTracks
from occlog.report.content.metrics_in_words import Figure, number
from occlog.report.content.model import ReportInput
from occlog.report.plots.peopleplot import crowd
from occlog.words import noun


def plural(count: int, what: str) -> str:
    """`1 target`, `2 targets`."""
    return f"{number(count)} {noun(count, what)}"


def headline(data: ReportInput) -> list[Figure]:
    """The few figures on top of the page: accuracy first, then how much was processed."""
    out = _accuracy(data)
    if data.time.length > 0:
        out.append(Figure("recorded time", number(float(f"{data.time.length:.4g}")), data.time.unit))
    if data.everybody is not None:
        out += _people(data.everybody)
    elif data.tracks is not None:
        out.append(Figure("estimates", number(data.rows("tracks")), "", f"of {plural(len(data.targets), 'target')}"))
    if data.bearings is not None and len(data.bearings):
        share = 100.0 * float(data.bearings.seen.mean())
        out.append(Figure("target seen", number(round(share, 1)), "%", f"of {number(len(data.bearings))} looks"))
    if data.losses:
        lost = sum(loss.count for loss in data.losses)
        out.append(Figure("input lost", number(lost or len(data.losses)), "", "items" if lost else "stretches"))
    return out


def _people(tracks: PeopleTracks) -> list[Figure]:
    """How many people there were, all in all and at a time, and how many of them nobody saw."""
    found = crowd(tracks)
    at_a_time = number(float(f"{found.people.mean():.3g}"))
    unseen = 100.0 * (1.0 - float(found.seen.sum() / found.people.sum()))
    return [
        Figure("identities", number(len(np.unique(tracks.target_id))), "", f"{at_a_time} at a time"),
        Figure("predicted", number(round(unseen, 1)), "%", f"seen by no camera, of {number(len(tracks))} estimates"),
    ]


def _accuracy(data: ReportInput) -> list[Figure]:
    """RMSE, bound and their ratio over all targets; without truth, the distance from the sight lines."""
    if data.errors is None or not len(data.errors):
        return _sight(data)
    rmse = rms(data.errors.error) if data.of_all is None else data.of_all.rmse()
    out = [Figure("RMSE", number(rmse), data.unit, "estimate to truth")]
    if data.bound is not None and len(data.bound):
        rmse, bound = with_bound(data.errors, data.bound, smoothed=data.smoothed)
        if bound > 0:
            who = "smoother" if data.smoothed else "filter"
            out.append(Figure("bound", number(bound), data.unit, f"no {who} can do better"))
            out.append(Figure("RMSE / bound", number(round(rmse / bound, 3)), "", "1 is the best possible"))
    return out + _in_space(data, data.errors)


def _in_space(data: ReportInput, errors: Errors) -> list[Figure]:
    """RMSE in space and over its bound, where heights are known."""
    high = errors.error_space[np.isfinite(errors.error_space)]
    if not len(high):
        return []
    rmse, bound = (math.nan, math.nan)
    if data.bound is not None:
        rmse, bound = with_bound(errors, data.bound, "_space", smoothed=data.smoothed)
    note = f"{number(round(rmse / bound, 3))} × bound" if bound > 0 else "heights included"
    whole = rms(high) if data.of_all is None else data.of_all.rmse_in_space()
    return [Figure("RMSE in space", number(whole), data.unit, note)]


def rms(values: np.ndarray) -> float:
    """Root mean square; NaN of nothing."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def with_bound(errors: Errors, bound: Bound, where: str = "", *, smoothed: bool = False) -> tuple[float, float]:
    """RMSE and root mean square bound over the times and targets that have both; NaN where none has.

    On the ground; `where` "_space": in space.  `smoothed`: the bound of smoothing, where the table has it.
    """
    kind = "smoothed" if smoothed and np.isfinite(getattr(bound, f"smoothed{where}")).any() else "bound"
    errors = errors.take(np.isfinite(getattr(errors, f"error{where}")))
    bound = bound.take(np.isfinite(getattr(bound, f"{kind}{where}")))
    found, least = [np.empty(0)], [np.empty(0)]
    for target in np.unique(bound.target_id):
        mine, its = errors.target_id == target, bound.target_id == target
        _, e, b = np.intersect1d(errors.t_ns[mine], bound.t_ns[its], return_indices=True)
        found.append(getattr(errors, f"error{where}")[mine][e])
        least.append(getattr(bound, f"{kind}{where}")[its][b])
    return rms(np.concatenate(found)), rms(np.concatenate(least))


def _sight(data: ReportInput) -> list[Figure]:
    """RMS distance of the tracks from where the sight lines meet."""
    off = rms(np.concatenate([np.empty(0), *(distance for _, distance in data.sight.values())]))
    return [] if np.isnan(off) else [Figure("off sight lines", number(off), data.unit, "RMS; no truth is given")]


def row_counts(data: ReportInput) -> list[Figure]:
    """How many rows each table has, and the time it covers."""
    out = []
    for name in ("truth", "bearings", "tracks", "diagnostics", "events", "errors", "bound"):
        table = getattr(data, name)
        if table is None:
            continue
        if not len(table):
            out.append(Figure(name, "0", "rows", "empty"))
            continue
        seconds = number((int(table.t_ns[-1]) - int(table.t_ns[0])) / NS)
        moments = data.whole[name].times if name in data.whole else len(np.unique(table.t_ns))
        out.append(Figure(name, number(data.rows(name)), "rows", f"{seconds} s, {plural(moments, 'time')}"))
    return out
