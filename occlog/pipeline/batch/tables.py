"""The tables of a batch: what became of each recording, its figures, and its rows beside those of the others."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from occlog.errors import InputError
from occlog.io.files.inputs import hash_inputs
from occlog.io.files.provenance import Provenance
from occlog.io.files.texts.json_file import read_json
from occlog.io.gathered.joined import join_tables
from occlog.io.gathered.runs import write_metrics, write_runs
from occlog.pipeline.run.stages import Config
from occlog.records.losses import Loss
from occlog.records.verdicts import Check, finding, outcome

from .recording import FAILED, Outcome

RUNS_TABLE, METRICS_TABLE = "runs.parquet", "metrics.parquet"
VERDICTS = "verdicts of the recordings"
"""Name of the check of a batch."""
METRICS_FILES = ("metrics.json", "metrics_in_images.json")
MOST_LOSSES = 20
"""Losses of a recording that the provenance of each table has; the table of runs has all."""
WHOLE = "the whole recording"
"""Place of the loss of a recording that failed."""


@dataclass(frozen=True)
class Gathered:
    """What was written over all recordings.

    Attributes:
        rows: number of rows by the name of the table.
        losses: tables that could not be made, and why.
    """

    rows: Mapping[str, int]
    losses: tuple[Loss, ...]


def gather(folder: Path, runs: Path, outcomes: Sequence[Outcome], tables: Sequence[str], config: Config) -> Gathered:
    """Write the tables over all recordings, which replace older ones.

    Args:
        folder: of the batch.
        runs: folder of the run folders.
        outcomes: of all recordings, in the order of rows.
        tables: names of those that are joined, e.g. `tracks`.
        config: the configuration of every run.
    """
    provenance = _provenance(outcomes, tables, config)
    rows = {
        "runs": write_runs(folder / RUNS_TABLE, (_row(each) for each in outcomes), provenance),
        "metrics": write_metrics(folder / METRICS_TABLE, _figures(runs, outcomes), provenance),
    }
    losses = []
    for name in tables:
        file = f"{name}.parquet"
        parts = {each.name: runs / each.name / file for each in outcomes if file in each.outputs}
        try:
            if parts:
                rows[name] = join_tables(folder / file, parts, name, provenance)
        except InputError as error:
            losses.append(Loss(file, "all recordings", f"is not made: {error}"))
    return Gathered(rows, tuple(losses))


def losses_of(outcomes: Sequence[Outcome]) -> tuple[Loss, ...]:
    """What was lost in all recordings; of one that failed all of it, of one with many losses a part and their number.

    The table of runs has them all: in the metadata of a file, a million are more than libraries of Parquet read.
    """
    found = []
    for each in outcomes:
        told, more = each.losses[:MOST_LOSSES], each.losses[MOST_LOSSES:]
        found += [Loss(f"{each.name}: {loss.source}", loss.place, loss.what, loss.count) for loss in told]
        if more:
            counts = [loss.count for loss in more]
            what = f"{len(more)} more losses; {RUNS_TABLE} lists them"
            found.append(Loss(each.name, "other places", what, sum(counts) if all(counts) else 0))
        if each.state == FAILED:
            found.append(Loss(each.name, WHOLE, f"{each.stage} failed: {each.message}"))
    return tuple(found)


def _provenance(outcomes: Sequence[Outcome], tables: Sequence[str], config: Config) -> Provenance:
    seed = config.values.get("seed")
    recordings = tuple((each.shown, each.sha256) for each in outcomes)
    made = Provenance(
        "batch",
        {"config": config.values, "tables": list(tables)},
        seed if isinstance(seed, int) else None,
        (*hash_inputs([config.path]), *recordings),
        losses_of(outcomes),
        verdicts=(),
    )
    return made.with_checks(_checks(outcomes))


def _checks(outcomes: Sequence[Outcome]) -> tuple[Check, ...]:
    """The verdicts of all recordings as one check, with those that are doubted."""
    judged = [each for each in outcomes if each.plausible is not None]
    doubted = (
        finding(
            VERDICTS, "warning", "recording-doubtful", f"{each.name}: {each.warnings[0]}; {RUNS_TABLE} has them all"
        )
        for each in judged
        if not each.plausible
    )
    return outcome(VERDICTS, doubted, unless="" if judged else "no recording was judged", recordings=len(judged))


def _row(each: Outcome) -> dict[str, object]:
    return {
        "recording": each.name,
        "source": each.shown,
        "sha256": each.sha256,
        "state": each.state,
        "exit_code": each.code,
        "stage": each.stage,
        "message": each.message,
        "plausible": each.plausible,
        "warnings": list(each.warnings),
        "losses": [loss.as_dict() for loss in each.losses],
    }


def _figures(runs: Path, outcomes: Sequence[Outcome]) -> Iterator[dict[str, object]]:
    """A row for each number that the evaluations give."""
    for each in outcomes:
        for file in METRICS_FILES:
            if file not in each.outputs:
                continue
            for name, value in sorted(read_json(runs / each.name / file).items()):
                if value is None or (isinstance(value, int | float) and not isinstance(value, bool)):
                    number = None if value is None else float(value)
                    yield {"recording": each.name, "file": file, "name": name, "value": number}
