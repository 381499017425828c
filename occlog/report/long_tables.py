"""Tables of a report that are too long to be drawn whole: read once, drawn in part, their figures of all rows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeGuard, TypeVar

import numpy as np

from occlog.evaluate.verdict import AgainstTruth, Made, with_truth
from occlog.io.files.parquet import describe
from occlog.io.open import open_input
from occlog.records.columns import Table
from occlog.records.scene import Scene
from occlog.records.tables import Errors, Tracks, Truth
from occlog.report.content.thinned import MOST_ROWS, ErrorsSoFar, Thinned, thinned
from occlog.track.plausibility.verdict import Evidence

T = TypeVar("T", bound=Table)


@dataclass(frozen=True)
class LongTables:
    """Tracks, and truth and errors where they are given."""

    tracks: Path
    truth: Path | None
    errors: Path | None

    @cached_property
    def are_long(self) -> bool:
        """Whether one of them is a Parquet file of occlog with too many rows, and tracks do not say who is there."""
        described = [describe(path) for path in (self.tracks, self.truth, self.errors) if _is_ours(path)]
        people = any(c["name"] == "existence" for found in described for c in found["columns"])
        return not people and any(found["rows"] > MOST_ROWS for found in described)

    def read(self, made: Made, scene: Scene | None, metrics: Mapping[str, object]) -> dict[str, Any]:
        """What `ReportInput` takes of them.

        Args:
            made: how the tracks were made.
            scene: of the run.
            metrics: figures of the evaluation.
        """
        unknown = False

        def watched(chunks: Iterator[Tracks]) -> Iterator[Tracks]:
            nonlocal unknown
            for chunk in chunks:
                unknown = unknown or bool(np.isnan(chunk.cov_xx).any())
                yield chunk

        tracks = _thinned(self.tracks, watched(open_input(self.tracks).rows(Tracks)), Tracks)
        out: dict[str, Any] = {"tracks": tracks.table, "whole": {"tracks": tracks.whole}}
        if self.truth is not None and (opened := open_input(self.truth)).has(Truth):
            truth = _thinned(self.truth, opened.rows(Truth), Truth)
            out["truth"] = truth.table
            out["whole"]["truth"] = truth.whole
        if self.errors is not None:
            errors = _thinned(self.errors, open_input(self.errors).rows(Errors), Errors)
            of_all, against, so_far, count = ErrorsSoFar(), AgainstTruth(made, scene), [np.zeros(0)], 0
            # One pass more: the RMSE up to a row is of all rows before it
            for part in open_input(self.errors).rows(Errors):
                against.add(part)
                drawn = errors.rows[(errors.rows >= count) & (errors.rows < count + len(part))] - count
                so_far.append(of_all.add(part)[drawn])
                count += len(part)
            out |= {"errors": errors.table, "of_all": of_all, "so_far": np.concatenate(so_far)}
            out["whole"]["errors"] = errors.whole
            if errors.whole.rows:
                evidence = Evidence(rows=tracks.whole.rows)
                out["judged"] = with_truth(evidence, made, against, unknown=unknown, metrics=metrics)
        return out


def _is_ours(path: Path | None) -> TypeGuard[Path]:
    """Whether a file is given that is a Parquet file of occlog."""
    if path is None:
        return False
    opened = open_input(path)
    return opened.recording is None and opened.foreign is None


def _thinned(path: Path, chunks: Iterable[T], kind: type[T]) -> Thinned[T]:
    """Rows by the rule for long tables; all of a recording or of a table of another program."""
    return thinned(chunks, kind, describe(path)["rows"] if _is_ours(path) else 0, MOST_ROWS)
