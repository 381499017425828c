"""`report` in Python: a run as one page."""

from __future__ import annotations

import os
from pathlib import Path

from occlog.cli import options
from occlog.track.plausibility.verdict import figures

from .folders import Folder
from .results import ReportResult, TrackResult, sentences, warn
from .sources import Inputs, SceneSource, Source

SOURCES = ("tracks", "truth", "bearings", "errors", "bound", "diagnostics", "events", "occluders")


def report(
    tracks: Source | TrackResult | None = None,
    *,
    scene: SceneSource | None = None,
    truth: Source | None = None,
    bearings: Source | None = None,
    errors: Source | None = None,
    bound: Source | None = None,
    diagnostics: Source | None = None,
    events: Source | None = None,
    occluders: Source | None = None,
    metrics: str | os.PathLike[str] | None = None,
    title: str = "Tracking report",
    png: bool = False,
    output: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
) -> ReportResult:
    """Show tracks and what else is given as one page, as `occlog report` does.

    Args:
        tracks: tracks; a result of `track` brings diagnostics and events along. None: the scene alone is drawn.
        scene: room and sensors; None: that of the recording with the truth or the bearings.
        truth: true positions.
        bearings: what each sensor saw.
        errors: of `evaluate`.
        bound: of `evaluate`.
        diagnostics: of `track`.
        events: births, deaths and doubtful identities of everybody, of `track`.
        occluders: moving occluders as the tracker was told.
        metrics: figures written by `occlog evaluate` (JSON).
        title: heading of the page.
        png: also make the picture of the main figures.
        output: where the page is written (HTML), with the picture beside it; None: nowhere, see `html` of the result.
        overwrite: files that are there may be replaced.

    Raises:
        UsageError: there is nothing to show.
        InputError: an input is missing, damaged, or of another scene.

    Warns:
        OcclogWarning: the tracks are not plausible, or input was lost.
    """
    from occlog.report.command import Paths, run_report

    if isinstance(tracks, TrackResult):
        diagnostics = tracks.tables.get("diagnostics") if diagnostics is None else diagnostics
        events = tracks.tables.get("events") if events is None else events
        scene = tracks.scene if scene is None else scene
        tracks = tracks.tracks
    given = (tracks, truth, bearings, errors, bound, diagnostics, events, occluders)
    home = Folder()
    page = home.file("report.html") if output is None else Path(output)
    with Inputs() as inputs, options.notes_kept():
        paths = Paths(
            output=page,
            scene=inputs.scene(scene),
            metrics=None if metrics is None else Path(metrics),
            png=page.with_suffix(".png") if png else None,
            overwrite=overwrite,
            **{name: inputs.optional(value, name) for name, value in zip(SOURCES, given, strict=True)},
        )
        data = run_report(paths, title)
        findings = data.findings or ()
        told, rest = sentences(inputs.in_words_of_python(f"{f.severity}: {f.sentence}") for f in findings)
    warn(told, data.losses, stacklevel=2)
    shown = {} if data.findings is None else figures(data.findings)
    return ReportResult(
        summary={"targets": len(data.targets), **shown},
        losses=data.losses,
        warnings=told,
        notes=rest,
        html=page.read_text(encoding="utf-8"),
        png=paths.png.read_bytes() if paths.png is not None else None,
    )
