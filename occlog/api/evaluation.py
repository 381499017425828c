"""`evaluate` in Python: tracks against truth, bound and bearings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from occlog.evaluate.request import EvaluateRequest
from occlog.request import Form

from .call import call, check_taken
from .keywords import Setting
from .results import EvaluateResult, TrackResult
from .sources import SceneSource, Source

JUDGED = ("plausible", "warnings")
"""Of a summary what is no figure."""


def evaluate(
    tracks: Source | TrackResult | None = None,
    truth: Source | None = None,
    *,
    bearings: Source | None = None,
    doa: Source | None = None,
    doa_labels: bool = False,
    truth_azimuths: Source | None = None,
    doa_gate_deg: float | None = None,
    measurements: Source | None = None,
    views: Source | None = None,
    cooperation: Source | None = None,
    diagnostics: Source | None = None,
    scene: SceneSource | None = None,
    frames: tuple[int, int] | None = None,
    also: tuple[str, ...] = (),
    metrics: Sequence[str] | Mapping[str, Mapping[str, Setting]] = (),
    **settings: Setting,
) -> EvaluateResult:
    """Compare tracks with the truth, with the Cramer-Rao bound, and with their bearings, as `occlog evaluate` does.

    What the given inputs allow is computed.

    Args:
        tracks: tracks in the world or in images; a result of `track` brings its diagnostics along.
        truth: true positions or boxes.
        bearings: for detections, bound and sight lines.
        doa: directions of arrival to use along with the bearings.
        doa_labels: identities in the log of directions are those of targets.
        truth_azimuths: true directions, to compare `doa` with and nothing else.
        doa_gate_deg: a direction further from the true one is false, and the true one missed; None: 10.
        measurements: ranges, signal strengths and time differences: for the bound.
        views: to compare with true boxes; with `held_out` views or boxes of all people.
        cooperation: what cameras were asked.
        diagnostics: how the filter fared.
        scene: where the sensors are; None: that of the recording with the truth or the bearings.
        frames: only frames first <= number < stop.
        also: more tables, of many targets: failures, counts (on the ground).
        metrics: names of metrics of plug-ins, or their settings by these names; for tracks on the ground with truth.
        **settings: by the names of the options: `match`, `held_out`, `sigma_v`, `match_distance` and the others.

    Returns:
        The figures, and the tables `errors` and `bound` where there are any.

    Raises:
        UsageError: an argument or a setting that there is not, or that these inputs do not have.
        InputError: an input is missing, damaged, or says something that cannot be.

    Warns:
        OcclogWarning: the tracks are not plausible.
    """
    if isinstance(tracks, TrackResult):
        diagnostics = tracks.tables.get("diagnostics") if diagnostics is None else diagnostics
        tracks = tracks.tracks
    arguments = dict(locals())
    form = Form(EvaluateRequest)
    check_taken(form, {}, also, "evaluate")
    result = call(form, arguments, EvaluateResult)
    figures = {name: value for name, value in result.summary.items() if name not in JUDGED}
    tables = {name: table for name, table in result.tables.items() if len(table)}
    return replace(result, tables=tables, metrics=figures)
