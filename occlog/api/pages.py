"""`report` in Python: a run as one page, or tracks drawn over the images."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from occlog import console
from occlog.errors import UsageError
from occlog.records.verdicts import summary_of, texts_of

from .folders import Folder
from .keywords import names_of
from .results import OverlayResult, ReportResult, TrackResult, sentences, warn
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
    images: Source | None = None,
    images_limit: float = 5.0,
    title: str = "Tracking report",
    png: bool = False,
    markdown: bool = False,
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
        images: a recording whose images are shown small beside the plan, with the tracks drawn over them.
        images_limit: how much of the page they may take [MB]; more of them are left out.
        title: heading of the page.
        png: also make the picture of the main figures.
        markdown: also make words and figures as Markdown.
        output: where the page is written (HTML), with picture and Markdown beside it; None: nowhere, see `html`.
        overwrite: files that are there may be replaced.

    Raises:
        UsageError: there is nothing to show.
        InputError: an input is missing, damaged, or of another scene.

    Warns:
        OcclogWarning: the tracks are not plausible, or input was lost.
    """
    from occlog.report.inputs import Paths
    from occlog.report.run import run_report

    if isinstance(tracks, TrackResult):
        diagnostics = tracks.tables.get("diagnostics") if diagnostics is None else diagnostics
        events = tracks.tables.get("events") if events is None else events
        scene = tracks.scene if scene is None else scene
        tracks = tracks.tracks
    given = (tracks, truth, bearings, errors, bound, diagnostics, events, occluders)
    home = Folder()
    page = home.file("report.html") if output is None else Path(output)
    with Inputs() as inputs, console.notes_kept():
        tables: dict[str, Any] = {n: inputs.optional(value, n) for n, value in zip(SOURCES, given, strict=True)}
        paths = Paths(
            output=page,
            scene=inputs.scene(scene),
            metrics=None if metrics is None else Path(metrics),
            images=inputs.optional(images, "images"),
            images_limit=images_limit,
            png=page.with_suffix(".png") if png else None,
            markdown=page.with_suffix(".md") if markdown else None,
            overwrite=overwrite,
            **tables,
        )
        data, _ = run_report(paths, title)
        told, rest = sentences(inputs.named(text) for text in texts_of(data.verdicts, "report"))
    warn(told, data.losses)
    shown = summary_of(data.verdicts)
    return ReportResult(
        summary={"targets": len(data.targets), **shown},
        losses=data.losses,
        warnings=told,
        notes=rest,
        html=page.read_text(encoding="utf-8"),
        png=paths.png.read_bytes() if paths.png is not None else None,
        markdown=paths.markdown.read_text(encoding="utf-8") if paths.markdown is not None else None,
    )


def overlay(
    tracks: Source | TrackResult | None = None,
    *,
    recording: Source,
    truth: Source | None = None,
    failures: Source | None = None,
    fundamental: Source | None = None,
    scene: SceneSource | None = None,
    video: str | os.PathLike[str] | None = None,
    frame: int | None = None,
    frames: tuple[int, int] | None = None,
    cameras: str | Sequence[str] = (),
    scale: float | None = None,
    fps: float | None = None,
    world: Source | None = None,
    diagnostics: Source | None = None,
    plan: bool = True,
    trail: float = 2.0,
    overwrite: bool = False,
    progress: bool = False,
) -> OverlayResult:
    """Draw tracks and true boxes over the frames of a recording, as `occlog report --recording` does.

    Args:
        tracks: in images, or of the world; None: the truth alone is drawn.
        recording: with video.
        truth: true boxes.
        failures: of `evaluate`, drawn in red.
        fundamental: geometry of the views as the tracker had it; None: that of the recording.
        scene: where the cameras are; None: the recording holds it.
        video: file of the video to make (.webm, .mp4, .avi).
        frame: number, in the first camera, of the frame whose picture is made.
        frames: video of frames first <= number < stop of the first camera only.
        cameras: only these, the first of which counts the frames; empty: all.
        scale: images are enlarged by this, 0.05 to 16; None: to a height of about 360 px, and at
            most 3840 x 2160 px in all.
        fps: frames a second of the video, 0.1 to 1000; None: those of the recording.
        world: tracks of the world, for the plan; None: `tracks`, if they are of the world.
        diagnostics: of `track`: which cameras see a target of the world, where its tracks do not say.
        plan: whether tracks of the world get the plan beside the images.
        trail: seconds of the way behind each target, 0 to 3600.
        overwrite: a video that is there may be replaced.
        progress: show a bar on standard error, if it is a terminal.

    Returns:
        The picture of `frame`, which a notebook shows, and what was drawn.

    Raises:
        UsageError: there is nothing to draw, or neither `video` nor `frame` is given.
        InputError: an input is missing, damaged, or of another recording.
        OutputExistsError: the video is there, and may not be replaced.

    Warns:
        OcclogWarning: the tracks are of another recording's video.
    """
    from occlog.report.overlay.command import run_overlay
    from occlog.report.overlay.pictures import Asked

    for name, value, low, high in (
        ("scale", scale, 0.05, 16),
        ("fps", fps, 0.1, 1000),
        ("frame", frame, 0, 2**31),
        ("trail", trail, 0, 3600),
    ):
        if value is not None and not low <= value <= high:
            raise UsageError(f"{name}: {value}: must be from {low} to {high}")
    if frames is not None and not 0 <= frames[0] < frames[1]:
        raise UsageError(f"frames: {frames}: must be first < stop, from 0")
    if video is None and frame is None:
        raise UsageError("no output: give video (a file to make), frame (a number), or both")
    home = Folder()
    picture = None if frame is None else home.file("frame.png")
    with Inputs() as inputs, console.notes_kept() as notes:
        asked = Asked(
            recording=inputs.rows(recording, "recording"),
            tracks=inputs.optional(tracks.tracks if isinstance(tracks, TrackResult) else tracks, "tracks"),
            truth=inputs.optional(truth, "truth"),
            failures=inputs.optional(failures, "failures"),
            fundamental=inputs.optional(fundamental, "fundamental"),
            scene=inputs.scene(scene),
            video=None if video is None else Path(video),
            png=picture,
            frame=frame,
            frames=frames,
            cameras=names_of(cameras),
            scale=scale,
            fps=fps,
            world=inputs.optional(world, "world"),
            diagnostics=inputs.optional(diagnostics, "diagnostics"),
            plan=plan,
            trail=trail,
            overwrite=overwrite,
        )
        summary, losses = run_overlay(asked, quiet=not progress)
        told, rest = sentences(inputs.named(text) for text in notes)
    warn(told, losses)
    return OverlayResult(
        summary=home.without_paths(summary),
        losses=losses,
        warnings=told,
        notes=rest,
        png=None if picture is None else picture.read_bytes(),
    )
