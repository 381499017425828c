"""`occlog compare`: from tables to differences with confidence intervals.

Also resolves which tracks are compared with which truth: tables, run folders, and folders of runs.
"""

from __future__ import annotations

import glob
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.console.notes import begin_work
from occlog.console.text import as_bytes, in_seconds
from occlog.core.metrics.mot.frame_pairs import of_points
from occlog.core.metrics.mot.frame_sums import FIGURES, LASTING, LESS_IS_BETTER, frame_sums
from occlog.core.metrics.paired import MANY_RECORDINGS, MIN_SEGMENTS, PairedDifference, compare
from occlog.errors import InputError, UsageError, option
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.mot.config import MultiTargetConfig
from occlog.evaluate.mot.figures import RULES
from occlog.evaluate.mot.on_ground import points_in_true_frames, times_of
from occlog.io.files.atomic import write_bytes
from occlog.io.files.inputs import verdicts_of_file
from occlog.io.open import check_unit, common_unit, input_losses, open_if_ours, open_in_unit, open_input
from occlog.records.tables import Tracks, Truth
from occlog.records.verdicts import all_plausible, texts_of
from occlog.runner import Job, JobResult
from occlog.settings import METRES

from . import text
from .request import CompareRequest
from .text import ComparisonRow, Condition, Implausible, MetricComparison

TRACKS = "tracks.parquet"
RECORDING = "recording.mcap"
USUAL = (".mcap", ".parquet", ".csv")
"""Endings of truths; others count where none of these is there."""


class ComparedRun(NamedTuple):
    """Paths of a table of tracks and of the recording or table with its true positions."""

    tracks: Path
    truth: Path


def runs_of(method: Path, truth: Path | None) -> dict[str, ComparedRun]:
    """Return the runs of a method by recording name.

    The name is the path of the run folder in the folder; empty for a single table or run folder.

    Args:
        method: a table of tracks, a run folder, or a folder with run folders at any depth.
        truth: a recording or a table; or a folder of these, named as the run folders, with or without their subfolders;
            None: `recording.mcap` of each run folder.

    Raises:
        UsageError: no truth is given, and none is found.
        InputError: the folder has no tracks, or a run has no truth or two.
    """
    if not method.is_dir():
        return {"": ComparedRun(method, _truth(truth, None, ""))}
    found = {
        "" if path.parent == method else path.parent.relative_to(method).as_posix(): path
        for path in sorted(method.rglob(TRACKS))
    }
    if not found:
        raise InputError(
            f"{method}: holds no {TRACKS}; name a table of tracks, a run folder, or a folder of run folders",
            id="wrong-content",
        )
    runs = {name: ComparedRun(path, _truth(truth, path.parent, name)) for name, path in found.items()}
    if truth is not None and truth.is_dir():
        _check_apart(truth, runs)
    return runs


def _truth(truth: Path | None, folder: Path | None, name: str) -> Path:
    if truth is not None and truth.is_dir() and name:
        stem = Path(name).name
        for location in dict.fromkeys((truth / name, truth / stem)):
            if location.is_file():
                return location
            there = [path for path in sorted(location.parent.glob(f"{glob.escape(stem)}.*")) if path.is_file()]
            there = [path for path in there if path.suffix.lower() in USUAL] or there
            if len(there) > 1:
                names = " and ".join(path.name for path in there[:2])
                raise InputError(
                    f"{location.parent}: {names} could both be the truth of the run {name}; keep one",
                    id="duplicate-name",
                )
            if there:
                return there[0]
        raise InputError(
            f"{truth}: holds no truth of the run {name}; expected a file {stem}.mcap, {stem}.parquet or {stem}.csv",
            id="file-not-found",
        )
    if truth is not None:
        return truth
    if folder is not None and (folder / RECORDING).is_file():
        return folder / RECORDING
    raise UsageError(
        f"the true positions are unknown: no {RECORDING} with the tracks; give {option('truth')}", id="missing-option"
    )


def _check_apart(truth: Path, runs: dict[str, ComparedRun]) -> None:
    """Raise InputError if two of the `runs` (by name) have the same file as truth.

    `truth`: folder of the truths, for the message.
    """
    first: dict[Path, str] = {}
    for name, run in runs.items():
        other = first.setdefault(run.truth, name)
        if other != name:
            raise InputError(
                f"{run.truth}: is the truth of both runs {other} and {name}; give each its own: {other}.* and "
                f"{name}.* in {truth}",
                id="duplicate-name",
            )


def paired(methods: Sequence[Path], truth: Path | None) -> tuple[list[str], list[dict[str, ComparedRun]]]:
    """Return the recording names, and for each method its runs by these names.

    Args:
        methods: tables of tracks, run folders, or folders of run folders.
        truth: true positions (see `runs_of`).

    Raises:
        InputError: a method lacks a recording that another one has.
    """
    runs = [runs_of(method, truth) for method in methods]
    names = sorted(set().union(*runs))
    for method, own in zip(methods, runs, strict=True):
        lacking = [name for name in names if name not in own]
        if lacking:
            which = ", ".join(name or "(itself)" for name in lacking[:3]) + (" ..." if len(lacking) > 3 else "")
            raise InputError(
                f"{method}: holds no run of {which}, which another method has; runs are compared on the same "
                "recordings",
                id="disjoint-inputs",
            )
    return names, runs


ALPHA = 0.01
"""Chance of a false alarm of `--fail-if`."""
LEVEL = 0.05
"""Chance that any verdict of a table is wrong of methods that do not differ."""
MATCH_M = 1.0
"""A track meets a target this near [m], unless a distance is given."""
CONDITION = re.compile(r"\s*(\w+)\s+worse(?:\s+by\s+(\S+))?\s*")


def parse_condition(condition: str) -> Condition:
    """Return the condition in a text such as `idf1 worse by 0.01`; UsageError for any other text."""
    found = CONDITION.fullmatch(condition)
    try:
        margin = float(found[2] or 0.0) if found else np.nan
    except ValueError:
        margin = np.nan
    if not found or not (np.isfinite(margin) and margin >= 0):
        raise UsageError(
            f"{option('fail_if')} {condition!r}: must be 'FIGURE worse' or 'FIGURE worse by NUMBER', as in 'idf1 worse'"
        )
    if found[1] not in FIGURES:
        raise UsageError(
            f"{option('fail_if')} {condition!r}: there is no figure {found[1]!r}; write 'FIGURE worse' with one of "
            f"{', '.join(FIGURES)}",
            id="unknown-name",
        )
    return Condition(found[1], margin)


def run_compare(request: CompareRequest, job: Job) -> JobResult:
    """Compare the runs of the request, write the table as Markdown, and return the summary and failed conditions."""
    methods = request.methods
    if len(methods) < 2:
        raise UsageError("name at least two methods; the others are compared with the first one", id="missing-option")
    conditions = [parse_condition(each) for each in request.fail_if]
    found = compare_runs(methods, request.truth, request.metrics, conditions, request.match_distance, request.seed)
    if request.markdown is not None:
        write_bytes(request.markdown, as_bytes(text.markdown(found, methods)), job.overwrite)
    summary = text.as_dict(found, methods)

    def shown(as_json: bool) -> str:
        return json.dumps(summary, indent=2) if as_json else text.table(found, methods)

    return JobResult(summary, earlier=found.losses, failed=found.failed, shown=shown)


def compare_runs(
    methods: Sequence[Path],
    truth: Path | None,
    figures: Sequence[str],
    conditions: Sequence[Condition],
    match_distance: float | None,
    seed: int,
) -> MetricComparison:
    """Compare each later method with the first one, figure by figure, with intervals and tests.

    Args:
        methods: two or more: tables of tracks, run folders or folders of those.
        truth: recording, table or folder of these (see `runs_of`).
        figures: names of the metrics; empty: all.
        conditions: what makes the comparison fail.
        match_distance: gate of a match of track and target, in the unit of the tracks; None: 1 m.
        seed: seed of the random draws.
    """
    for name in figures:
        if name not in FIGURES:
            raise UsageError(
                f"{option('metric')} {name}: unknown figure; there are {', '.join(FIGURES)}", id="unknown-name"
            )
    names, runs = paired(methods, truth)
    unit = _unit([run for own in runs for run in own.values()])
    if match_distance is None and unit not in METRES:
        raise UsageError(
            f"lengths are in {unit!r}: give {option('match_distance')}, the largest distance between a target and "
            "its track",
            id="missing-unit",
        )
    limit = MATCH_M / METRES[unit] if match_distance is None else match_distance
    begin_work()
    sums = [[_sums(runs[m][name], runs[0][name], limit, unit) for name in names] for m in range(len(methods))]
    wanted = [*dict.fromkeys([*(figures or FIGURES), *(c.figure for c in conditions)])]
    found = {
        (m, figure): compare(
            sums[0], sums[m], FIGURES[figure], np.random.default_rng([seed, m, k]), lasting=figure in LASTING
        )
        for m in range(1, len(methods))
        for k, figure in enumerate(FIGURES)
        if figure in wanted
    }
    holm = _holm({key: each.p for key, each in found.items()})
    known = sum(np.isfinite(each.p) for each in found.values())
    rows = tuple(
        ComparisonRow(*key, each, holm[key], _verdict(key[1], each, holm[key], known)) for key, each in found.items()
    )
    failed = tuple(
        sentence
        for row in rows
        for condition in conditions
        if condition.figure == row.figure and (sentence := _failure(condition, row, len(methods) - 1))
    )
    read = dict.fromkeys(path for own in runs for run in own.values() for path in run)
    losses = input_losses(each for path in read if (each := open_if_ours(path)) is not None)
    implausible = tuple(
        Implausible(m, name, texts_of(verdicts, "compare"))
        for m, own in enumerate(runs)
        for name in names
        if all_plausible(verdicts := verdicts_of_file(own[name].tracks)) is False
    )
    return MetricComparison(rows, tuple(names), sum(len(each) for each in sums[0]), unit, failed, losses, implausible)


def _unit(runs: Sequence[ComparedRun]) -> str:
    """Return the length unit of all tracks and truths; InputError if they differ."""
    tracks = [open_input(run.tracks) for run in runs]
    truths = [open_input(path) for path in dict.fromkeys(run.truth for run in runs)]
    unit, source = common_unit([*tracks, *truths])
    for each in (*tracks, *truths):
        check_unit(each, unit, source, InputError)
    return unit


def _sums(run: ComparedRun, first: ComparedRun, limit: float, unit: str) -> Floats:
    """Return the sums (F, k) that each of F true frames of a recording adds to the metrics of a run.

    Args:
        run: tracks and truth.
        first: run of the first method on the same recording; InputError unless its truth is equal.
        limit: largest distance of a pair, in `unit`.
        unit: unit of lengths.
    """
    tracks, truth = open_in_unit(run.tracks, unit).read(Tracks), open_in_unit(run.truth, unit).read(Truth)
    if run.truth != first.truth and not truth.same_rows(open_in_unit(first.truth, unit).read(Truth)):
        raise InputError(
            f"{run.truth}: differs from {first.truth}, the truth of the first method; give one truth for all "
            f"({option('truth')})",
            id="disjoint-inputs",
        )
    times: Ints = times_of(tracks, truth)
    if not len(truth):
        raise InputError(
            f"{run.truth}: holds no true positions, so there are no frames to compare runs in", id="wrong-content"
        )
    if len(tracks) and len(times):
        _check_clocks(run, tracks.t_ns, times)
    config = MultiTargetConfig(match_distance=limit)
    points = points_in_true_frames(tracks, truth, times, config, EvaluateConfig().limit_ns, unit)
    return frame_sums(of_points(points.truth, points.tracks, limit), len(times), RULES[config.clear_rule])


def _check_clocks(run: ComparedRun, tracks: Ints, truth: Ints) -> None:
    """Raise InputError if all times of the tracks (n,) are before or after those of the truth (m,) [ns].

    Clocks then differ, probably. `run`: names the files in the message.
    """
    (a, b), (c, d) = ((int(times.min()), int(times.max())) for times in (tracks, truth))
    if b < c or d < a:
        raise InputError(
            f"{run.tracks}: no estimate is from the time of the truth {run.truth}: tracks {in_seconds(a)} to "
            f"{in_seconds(b)} s, truth {in_seconds(c)} to {in_seconds(d)} s; check the clocks",
            id="disjoint-inputs",
        )


def _holm(p: Mapping[tuple[int, str], float]) -> dict[tuple[int, str], float]:
    """Return the p-values by (method, metric), corrected for multiple tests (Holm 1979).

    NaN stays NaN and does not count as a test.
    """
    known = sorted((value, key) for key, value in p.items() if np.isfinite(value))
    out, most = dict.fromkeys(p, float("nan")), 0.0
    for k, (value, key) in enumerate(known):
        most = max(most, min(1.0, value * (len(known) - k)))
        out[key] = most
    return out


def _verdict(figure: str, found: PairedDifference, holm: float, rows: int) -> str:
    """Return `better`, `worse`, `no difference shown` or `not decided` for one metric of a method.

    Args:
        figure: name of the metric, which decides whether less or more is better.
        found: difference from the first method.
        holm: p-value after Holm's correction.
        rows: number of comparisons tested together.
    """
    if not np.isfinite(holm) or 2 * found.least * rows >= LEVEL:
        return "not decided"
    if holm >= LEVEL:
        return "no difference shown"
    return "better" if (found.difference < 0) == (figure in LESS_IS_BETTER) else "worse"


def _failure(condition: Condition, row: ComparisonRow, later: int) -> str:
    """Return the message if a comparison meets the condition of failure, or is undecided; empty if it does not.

    `later`: number of methods after the first. The probability that any of them fails without being worse is at most
    `ALPHA` (Bonferroni).
    """
    found, less = row.found, row.figure in LESS_IS_BETTER
    if not np.isfinite(found.p) or found.least >= ALPHA / later:
        return f"{condition}: method {row.method + 1}: not decided; {_why(row, later)}"
    p = found.above(condition.margin) if less else found.below(-condition.margin)
    if p >= ALPHA / later:
        return ""
    return (
        f"{condition}: method {row.method + 1} has {found.b:.4g}, the first {found.a:.4g}, "
        f"difference {found.difference:+.3g} (p {p:.2g})"
    )


def _why(row: ComparisonRow, later: int) -> str:
    """Return the reason why a comparison is undecided; `later`: number of methods after the first one."""
    found = row.found
    if np.isfinite(found.p):
        return f"of {found.segments} recordings nothing can be shown of {later} methods; take more recordings"
    if row.figure in LASTING:
        return f"identities that were exchanged stay so: that takes {MANY_RECORDINGS} recordings or more"
    return f"{found.segments} independent time intervals, fewer than {MIN_SEGMENTS}"
