"""What `occlog report A B` does: open two runs, lay them beside each other, write the page."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

from occlog.array_types import NS
from occlog.console.details import begin_work
from occlog.console.text import as_bytes
from occlog.errors import UsageError, option
from occlog.evaluate.compare.run import compare_runs
from occlog.records.tables import Truth
from occlog.report.request import BesideRequest
from occlog.report.run import write
from occlog.runner import Done, Job
from occlog.settings import configure

from .comparison.frames import common_times, laid
from .comparison.identities import by_each_other
from .comparison.pairs import pairs_of
from .comparison.partings import partings_of
from .config import BesideConfig
from .inputs import Run, check_scenes, names_of, open_run, truth_of
from .markdown import build_markdown
from .model import AgainstTruth, Beside, Side, lengths_of
from .page import build_page
from .stage import (
    followed_by_truth,
    notes_on_recordings,
    notes_on_scenes,
    notes_on_time,
    notes_on_truth,
    recordings_of,
    same_rows,
)
from .summary import summary_of


def run_beside(request: BesideRequest, job: Job) -> Done:
    """Read both runs, lay them beside each other, write the page and its words.

    Raises:
        UsageError: lengths have a unit without defaults, or something is asked for that is of one run.
        InputError: a run is missing, damaged, too long, or of another scene, truth or time than the other.
    """
    if request.output is None:
        raise UsageError("no output: give -o (the page)")
    if request.png is not None:
        raise UsageError(f"{option('png')}: of two runs there is a page alone; leave it out")
    assert request.tracks is not None
    files, names = request.runs, names_of(request.tracks, request.other)
    config = configure(BesideConfig(), request.settings)
    runs = [open_run(name, each) for name, each in zip(names, files, strict=True)]
    check_scenes(*runs)
    near, tolerance = lengths_of(config, runs[0].data.unit)
    truth = truth_of(files, runs[0].data.unit)
    begin_work()
    config = replace(config, match_distance=near, tolerance=tolerance)
    found = lay(runs[0], runs[1], truth, config, request.seed)
    found = replace(found, title=request.title, provenance=_provenance(request, job, found, config))
    made = {request.output: as_bytes(build_page(found))}
    if request.markdown is not None:
        made[request.markdown] = as_bytes(build_markdown(found))
    write(made, overwrite=job.overwrite)
    for whose, loss in found.losses:
        job.note(f"lost earlier in {whose}: {loss}")
    for letter, side in found.sides:
        for stage, check in side.data.findings:
            job.note(f"{letter}: {check.severity}: {stage}: {check.text}")
    return Done(summary_of(found, request))


def lay(a: Run, b: Run, truth: tuple[Path, Truth] | None, config: BesideConfig, seed: int) -> Beside:
    """Lay two runs beside each other.

    Args:
        a: run A.
        b: run B.
        truth: of both, and its file; None: it is not known.
        config: with lengths.
        seed: of the draws of the comparison.
    """
    near, tolerance, lasting = config.match_distance, config.tolerance, round(config.lasting_s * NS)
    assert near is not None
    assert tolerance is not None
    times = common_times(a.tracks, b.tracks)
    sides = [Side(run.name, run.data, run.tracks, laid(run.tracks, times)) for run in (a, b)]
    places = sides[0].laid, sides[1].laid
    pairs = pairs_of(*places, near)
    against = None
    if truth is not None:
        path, table = truth
        comparison = compare_runs((a.file, b.file), path, (), (), near, seed)
        of_a, of_b, switches, errors = followed_by_truth(a.tracks, b.tracks, table, near, a.data.unit, lasting)
        against = AgainstTruth(comparison, of_a, of_b, switches, errors)
        sides = [replace(side, data=replace(side.data, truth=table)) for side in sides]
    in_b, in_a = by_each_other(*places, pairs, times, lasting)
    return Beside(
        title="",
        a=sides[0],
        b=sides[1],
        near=near,
        tolerance=tolerance,
        lasting_s=config.lasting_s,
        times=times,
        pairs=pairs,
        partings=partings_of(*places, pairs, times, tolerance, (in_b, in_a)),
        in_b=in_b,
        in_a=in_a,
        against_truth=against,
        same=same_rows(a.tracks, b.tracks),
        notes=(
            *notes_on_time(a.tracks, b.tracks, truth=truth is not None),
            *notes_on_recordings(*(recordings_of(_made(run)) for run in (a, b))),
            *notes_on_scenes(a.data.scene, b.data.scene),
            *(() if against is None else notes_on_truth(against.over_time, near, a.data.unit)),
        ),
    )


def _made(run: Run) -> dict[str, object]:
    """How each table of a run was made."""
    made = run.data.provenance.get("made", {})
    return made if isinstance(made, dict) else {}


def _provenance(request: BesideRequest, job: Job, found: Beside, config: BesideConfig) -> dict[str, object]:
    """How this page and everything in both runs was made."""
    own = job.provenance({"title": request.title, **asdict(config)}, seed=request.seed)
    made = {f"{letter}: {side.name}": side.data.provenance.get("made", {}) for letter, side in found.sides}
    return {name: value for name, value in own.as_dict().items() if name != "losses"} | {"made": made}
