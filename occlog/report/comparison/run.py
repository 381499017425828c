"""`occlog report A B`: open two runs, compare them, and write the page."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import NamedTuple

from occlog.array_types import NS
from occlog.console.notes import begin_work
from occlog.console.text import as_bytes
from occlog.errors import InputError, UsageError, option
from occlog.evaluate.compare.run import compare_runs
from occlog.io.files.limits import Content, content_of
from occlog.io.files.tables.parquet import describe
from occlog.io.open import check_unit, open_input
from occlog.records.tables import Tracks, Truth
from occlog.report.content.model import ReportInput
from occlog.report.request import PageRequest, RunComparisonRequest
from occlog.report.run import read_input, write
from occlog.runner import Job, JobResult
from occlog.settings import configure

from .config import RunComparisonConfig
from .matching.divergences import divergences_of
from .matching.pairs import align_estimates, common_times, mutual_matches, pairs_of
from .page import build_markdown, build_page, summary_of
from .stage import (
    matched_by_truth,
    notes_on_recordings,
    notes_on_scenes,
    notes_on_time,
    notes_on_truth,
    recordings_of,
    same_room,
)
from .words import RunComparisonPage, RunSide, TruthComparison, lengths_of

MAX_ROWS = 1_000_000
"""Estimates of one run that are aligned with another: they are in memory as a whole."""


WHOLE = ("tracks", "diagnostics", "occluders")
"""Tables of which everything is aligned with another run's, or shown at its time steps."""


class ReportRun(NamedTuple):
    """One of two compared runs.

    Attributes:
        name: name of the run.
        file: path of its tracks.
        tracks: all tracks.
        data: content for the report.
    """

    name: str
    file: Path
    tracks: Tracks
    data: ReportInput


def names_of(a: Path, b: Path) -> tuple[str, str]:
    """Return names of two runs: the shortest ends of their paths in which they differ."""
    ways = []
    for path in (a, b):
        whole = Path(os.path.abspath(path))  # noqa: PTH100  # links keep their names
        ways.append((whole if path.is_dir() else whole.with_suffix("")).parts)
    for count in range(1, max(map(len, ways)) + 1):
        names = ["/".join(way[-count:]) for way in ways]
        if names[0] != names[1]:
            return names[0], names[1]
    return ways[0][-1], f"{ways[1][-1]}, again"


def files_of(run: Path, shared: PageRequest) -> PageRequest:
    """Return the request of a page of one run, with the files found in its folder.

    UsageError for a recording, InputError for tracks in images.

    Args:
        run: a run folder or a table of tracks.
        shared: request with further inputs, which are of both runs.
    """
    found = replace(shared, tracks=run).found
    if found.tracks is not None and content_of(found.tracks) is Content.RECORDING:
        raise UsageError(f"{run}: is a recording, not tracks; name run folders or tables of tracks", id="wrong-content")
    if found.in_images:
        raise InputError(
            f"{run}: has tracks in images; two runs can be shown side by side only with tracks on the ground",
            id="wrong-content",
        )
    return found


def open_run(name: str, paths: PageRequest) -> ReportRun:
    """Read all files of a run; InputError if it has no estimates, or more than `MAX_ROWS`.

    `name`: name of the run in the page; `paths`: request with its files.
    """
    file = paths.tracks
    assert file is not None
    opened = open_input(file)
    rows = describe(file)["rows"] if opened.recording is None and opened.external_table is None else 0
    data = read_input(replace(paths, title=name), whole=WHOLE) if rows <= MAX_ROWS else None
    tracks = None if data is None else data.tracks
    if data is None or tracks is None or len(tracks) > MAX_ROWS:
        raise InputError(
            f"{file}: has {rows if tracks is None else len(tracks):,} estimates, more than the {MAX_ROWS:,} that "
            "can be aligned; name runs of shorter recordings, or use occlog compare",
            id="problem-too-large",
        )
    if not len(tracks):
        raise InputError(f"{file}: holds no estimates, so there is nothing to compare", id="empty-input")
    return ReportRun(name, file, tracks, data)


def check_scenes(a: ReportRun, b: ReportRun) -> None:
    """Raise InputError if two runs have different length units or rooms."""
    if a.data.unit != b.data.unit:
        raise InputError(
            f"{b.file}: lengths are in {b.data.unit}, those of {a.file} in {a.data.unit}; name two runs of one scene",
            id="unit-mismatch",
        )
    if not same_room(a.data.scene, b.data.scene):
        raise InputError(
            f"{a.file} and {b.file} are of different scenes; name two runs of one scene", id="disjoint-inputs"
        )


def truth_of(files: Sequence[PageRequest], unit: str) -> tuple[Path, Truth] | None:
    """Return path and content of the truth of two runs, which one or both of them name.

    None if none does, or if the truth has no targets. InputError if they name truths that differ, or if its length
    unit is not `unit`, that of the runs.
    """
    first: tuple[Path, Truth] | None = None
    for path in dict.fromkeys(each.truth for each in files if each.truth is not None):
        opened = open_input(path)
        if opened.recording is None:
            check_unit(opened, unit, "the runs", InputError)
        elif not opened.has(Truth):
            continue
        truth = opened.read(Truth)
        if first is not None and not truth.same_rows(first[1]):
            raise InputError(
                f"{path}: differs from {first[0]}, the truth of the other run; name two runs of one recording, or "
                f"give one truth for both ({option('truth')})",
                id="disjoint-inputs",
            )
        first = first or (path, truth)
    return None if first is None or not (first[1].role == "target").any() else first


def run_beside(request: RunComparisonRequest, job: Job) -> JobResult:
    """Read both runs, compare them, and write the page.

    Raises:
        UsageError: a length unit without defaults, or an option for a single run.
        InputError: a run is missing, damaged, too long, or of another scene, truth or time than the other.
    """
    if request.output is None:
        raise UsageError("no output: give -o (the page)", id="missing-option")
    if request.png is not None:
        raise UsageError(f"{option('png')}: two runs are shown as a page only; leave it out", id="not-applicable")
    assert request.tracks is not None
    files, names = request.runs, names_of(request.tracks, request.other)
    config = configure(RunComparisonConfig(), request.settings)
    runs = [open_run(name, each) for name, each in zip(names, files, strict=True)]
    check_scenes(*runs)
    near, tolerance = lengths_of(config, runs[0].data.unit)
    truth = truth_of(files, runs[0].data.unit)
    begin_work()
    config = replace(config, match_distance=near, divergence_distance=tolerance)
    found = align_runs(runs[0], runs[1], truth, config, request.seed)
    found = replace(found, title=request.title, provenance=_provenance(request, job, found, config))
    made = {request.output: as_bytes(build_page(found))}
    if request.markdown is not None:
        made[request.markdown] = as_bytes(build_markdown(found))
    write(made, overwrite=job.overwrite)
    for owner, loss in found.losses:
        job.note(f"lost earlier in {owner}: {loss}")
    for letter, side in found.sides:
        for stage, check in side.data.findings:
            job.note(f"{letter}: {check.severity}: {stage}: {check.text}")
    return JobResult(summary_of(found, request))


def align_runs(
    a: ReportRun, b: ReportRun, truth: tuple[Path, Truth] | None, config: RunComparisonConfig, seed: int
) -> RunComparisonPage:
    """Compare two runs: pairs, divergences, identity changes, and figures against the truth; return the page's content.

    Args:
        a: run A.
        b: run B.
        truth: file and content of the truth of both; None: unknown.
        config: match threshold, divergence distance, and least duration of changes.
        seed: seed of the random draws of the statistical comparison.
    """
    near, tolerance, lasting = config.match_distance, config.divergence_distance, round(config.min_duration_s * NS)
    assert near is not None
    assert tolerance is not None
    times = common_times(a.tracks, b.tracks)
    sides = [RunSide(run.name, run.data, run.tracks, align_estimates(run.tracks, times)) for run in (a, b)]
    positions = sides[0].laid, sides[1].laid
    pairs = pairs_of(*positions, near)
    against = None
    if truth is not None:
        path, table = truth
        comparison = compare_runs((a.file, b.file), path, (), (), near, seed)
        of_a, of_b, switches, errors = matched_by_truth(a.tracks, b.tracks, table, near, a.data.unit, lasting)
        against = TruthComparison(comparison, of_a, of_b, switches, errors)
        sides = [replace(side, data=replace(side.data, truth=table)) for side in sides]
    in_b, in_a = mutual_matches(*positions, pairs, times, lasting)
    return RunComparisonPage(
        title="",
        a=sides[0],
        b=sides[1],
        near=near,
        tolerance=tolerance,
        lasting_s=config.min_duration_s,
        times=times,
        pairs=pairs,
        frame_divergences=divergences_of(*positions, pairs, times, tolerance, (in_b, in_a)),
        in_b=in_b,
        in_a=in_a,
        against_truth=against,
        same=a.tracks.same_rows(b.tracks),
        notes=(
            *notes_on_time(a.tracks, b.tracks, truth=truth is not None),
            *notes_on_recordings(*(recordings_of(_made(run)) for run in (a, b))),
            *notes_on_scenes(a.data.scene, b.data.scene),
            *(() if against is None else notes_on_truth(against.over_time, near, a.data.unit)),
        ),
    )


def _made(run: ReportRun) -> dict[str, object]:
    """Return the provenance of each table of a run, by file name."""
    made = run.data.provenance.get("made", {})
    return made if isinstance(made, dict) else {}


def _provenance(
    request: RunComparisonRequest, job: Job, found: RunComparisonPage, config: RunComparisonConfig
) -> dict[str, object]:
    """Return the provenance of this page and of the tables of both runs, as JSON-ready values."""
    own = job.provenance({"title": request.title, **asdict(config)}, seed=request.seed)
    made = {f"{letter}: {side.name}": side.data.provenance.get("made", {}) for letter, side in found.sides}
    return {name: value for name, value in own.as_dict().items() if name != "losses"} | {"made": made}
