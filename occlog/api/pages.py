"""`report` in Python: a run as one page, or tracks drawn over the images."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from occlog.errors import UsageError
from occlog.report.request import OverlayRequest, PageRequest, Report
from occlog.request import Form, Request

from .call import call
from .results import OverlayResult, ReportResult, TrackResult
from .sources import SceneSource, Source

BESIDE = {"png": ".png", "markdown": ".md"}
"""How files end that are made beside a page."""


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
    if isinstance(tracks, TrackResult):
        diagnostics = tracks.tables.get("diagnostics") if diagnostics is None else diagnostics
        events = tracks.tables.get("events") if events is None else events
        scene = tracks.scene if scene is None else scene
        tracks = tracks.tracks
    arguments: dict[str, Any] = dict(locals())
    if output is not None:
        arguments |= {name: Path(output).with_suffix(end) for name, end in BESIDE.items() if arguments[name]}
    return call(Form(PageRequest), arguments, ReportResult, html=_page, png=_picture, markdown=_words)


def _page(request: Request) -> str:
    assert isinstance(request, PageRequest)
    assert request.output is not None
    return request.output.read_text(encoding="utf-8")


def _words(request: Request) -> str | None:
    assert isinstance(request, PageRequest)
    return None if request.markdown is None else request.markdown.read_text(encoding="utf-8")


def _picture(request: Request) -> bytes | None:
    assert isinstance(request, Report)
    return None if request.png is None else request.png.read_bytes()


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
        SettingError: a number out of its range.
        InputError: an input is missing, damaged, or of another recording.
        OutputExistsError: the video is there, and may not be replaced.

    Warns:
        OcclogWarning: the tracks are of another recording's video.
    """
    if isinstance(tracks, TrackResult):
        tracks = tracks.tracks
    if video is None and frame is None:
        raise UsageError("no output: give video (a file to make), frame (a number), or both")
    return call(Form(OverlayRequest), dict(locals()), OverlayResult, png=_picture)
