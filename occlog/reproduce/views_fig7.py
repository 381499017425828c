"""[Qu] Fig. 7: what happens to the trackers of MIPF, IDMOT and BMCT on the synthetic video."""

from __future__ import annotations

import math

from . import verdicts as v
from .model import Execute, Experiment, Row, Size, Table, Verdict
from .views_common import PARTS, ordered, spec_of
from .views_shots import SHOWN, fig7_shots
from .views_trial import run_views_trial


def fig7(size: Size, execute: Execute) -> Table:
    """Share of the trackers that are not on their target [%], in twentieths of the video and at its end."""
    results = execute([spec_of(size, run) for run in range(size.runs)])
    rows = []
    for m in SHOWN:
        for k in range(PARTS):
            values = tuple(100.0 * r[f"{m}.off_{k}"] for r in results)
            if not math.isnan(values[0]):  # a short video has fewer parts
                rows.append(Row(m.upper(), (k + 0.5) * size.steps / PARTS, values))
        rows.append(Row(f"{m.upper()}, last frame", math.nan, tuple(100.0 * r[f"{m}.off_end"] for r in results), {},
                        plotted=False))  # fmt: skip
    return rows


def judge7(table: Table) -> list[Verdict]:
    """What is said about the three methods."""
    end = {m: next(r for r in table if r.series == f"{m.upper()}, last frame") for m in SHOWN}
    hijacked, n = end["mipf"], end["mipf"].runs
    word = v.REPRODUCED if hijacked.mean - hijacked.error > 100 / 3 else v.IN_PART if hijacked.mean > 10 else v.NOT
    failed = sum(x > 0 for x in end["idmot"].values)
    whole = sum(x == 0 for x in end["bmct"].values)
    said = (
        "IDMOT has improved the performance: share of trackers off their target at the end lower than MIPF's, by [%]."
    )
    better = "BMCT rectifies these problems: share of trackers off their target at the end lower than IDMOT's, by [%]."
    return [
        Verdict("fig7-hijacked", "MIPF: many trackers are hijacked and lose their target: share at the end [%].", None,
                hijacked.mean, hijacked.error, n, word, "above a third by a standard error; in part above 10 %"),
        ordered("fig7-idmot", said, end["idmot"], end["mipf"]),
        Verdict("fig7-idmot-fails", "IDMOT still has failures: videos at whose end a tracker is off its target.", None,
                float(failed), None, n, v.share([x > 0 for x in end["idmot"].values]),
                "all of the videos; in part at least half"),
        ordered("fig7-bmct", better, end["bmct"], end["idmot"]),
        Verdict("fig7-all", "BMCT tracks all targets: videos at whose end all trackers are on their targets.", float(n),
                float(whole), None, n, v.share([x == 0 for x in end["bmct"].values]),
                "all of the videos; in part at least half"),
    ]  # fmt: skip


FIG7 = Experiment(
    "fig7", "What happens to the trackers", "frame", "trackers off their target [%]",
    12, 400, (2, 50), fig7, judge7, trial=run_views_trial, plans={"frames": fig7_shots},
    note="The same videos; balls that nobody can see count, too.",
)  # fmt: skip
