"""`occlog report` for a page: read the inputs, draw, and write page, picture and Markdown."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from occlog.console.notes import begin_work
from occlog.console.text import as_bytes
from occlog.errors import InputError, UsageError, option
from occlog.evaluate.verdict import TrackProvenance
from occlog.io.files.atomic import OutputGroup, open_output
from occlog.io.files.inputs import hash_inputs
from occlog.io.files.limits import Content, content_of
from occlog.io.files.provenance import Provenance
from occlog.io.files.texts.documents import read_json
from occlog.io.open import check_unit, common_unit, input_losses, load_scene, open_if_ours, open_input
from occlog.io.recording.reader import open_recording
from occlog.records.declared.people import BOX, GROUND, PREDICTED
from occlog.records.declared.views import ViewTracks
from occlog.records.losses import Loss
from occlog.records.scene import Scene
from occlog.records.tables import Tracks, Truth
from occlog.records.verdicts import Verdict, summary_of, texts_of
from occlog.runner import Job, JobResult

from .content.model import ReportInput
from .gather import TABLES, gather, in_files, in_pixels
from .overlay.plan import OverlayTables
from .page import build_markdown, build_page
from .picture import build_picture
from .replay.thumbnails import ImageTables, Thumbnails, thumbnails
from .request import PageRequest

PIXELS = "px"
"""Unit of lengths of tracks in images."""


def from_folder(request: PageRequest) -> PageRequest:
    """Return the request with the files of the run folder for inputs that are not named, if TRACKS is a folder."""
    folder = request.tracks
    if folder is None or not folder.is_dir():
        return request
    names = {n: f"{n}.parquet" for n in ("tracks", "bearings", "errors", "bound", "diagnostics", "events")}
    figures = ("metrics.json", "metrics_in_images.json")  # the latter alone where the truth has boxes only
    names |= {"metrics": next((file for file in figures if (folder / file).is_file()), figures[0])}
    names["scene"] = "recording.mcap"
    names["occluders"] = "hulls.parquet" if (folder / "hulls.parquet").is_file() else "occluders.parquet"
    found = {n: folder / file for n, file in names.items() if (folder / file).is_file()}
    if "tracks" not in found:
        return _in_images(request, folder, found)
    if "scene" in found and _has_truth(found["scene"]):
        found["truth"] = found["scene"]
    unnamed: dict[str, Any] = {n: p for n, p in found.items() if n == "tracks" or getattr(request, n) is None}
    return replace(request, **unnamed)


def _in_images(request: PageRequest, folder: Path, found: Mapping[str, Path]) -> PageRequest:
    """Return the request with the files of a run folder for tracks in images.

    `found`: files of the run by field of the request. InputError if the folder has no tracks in images.
    """
    tracks = folder / "view_tracks.parquet"
    if not tracks.is_file():
        raise InputError(
            f"{folder}: holds no tracks.parquet and no view_tracks.parquet, so it is not the folder of a finished run",
            id="wrong-content",
        )
    files = {name: path for name, path in found.items() if name in ("events", "metrics")}
    if "scene" in found and request.recording is None and open_recording(found["scene"]).cameras:
        files["images"] = found["scene"]
    unnamed: dict[str, Any] = {name: path for name, path in files.items() if getattr(request, name) is None}
    return replace(request, tracks=tracks, **unnamed)


def _has_truth(recording: Path) -> bool:
    return open_recording(recording).has(Truth)


def has_tracks_in_images(tracks: Path | None) -> bool:
    """Return whether a file is a table of tracks in images (False for a recording or None)."""
    if tracks is None or content_of(tracks) is Content.RECORDING:
        return False
    opened = open_input(tracks)
    return opened.has(ViewTracks) and not opened.has(Tracks)


def read_input(request: PageRequest, whole: Collection[str] = ()) -> ReportInput:
    """Read all inputs; the scene is that of the recording with truth, bearings or images if none is named.

    Args:
        request: inputs.
        whole: names of tables that are drawn whole, however long they are.
    """
    paths, title = request.found, request.title
    in_images = paths.in_images
    scene = None if in_images else _scene(paths)
    unit = PIXELS if in_images else _unit(paths, scene)
    provenance, losses, verdicts = _made(paths, title)
    metrics = read_json(paths.metrics) if paths.metrics is not None else {}
    made = _made_tracks(paths.tracks)
    named = {name: path for name in TABLES if (path := getattr(paths, name)) is not None}
    given = in_files(named, None if in_images else unit, scene)
    tables, figures = gather(in_pixels(given) if in_images else given, made, scene, metrics, whole, in_images=in_images)
    return ReportInput(
        title=title,
        scene=scene,
        metrics=metrics,
        provenance=provenance,
        losses=losses,
        earlier=verdicts,
        made=made,
        length_unit=unit,
        in_images=in_images,
        boxes_stated=not in_images or paths.tracks is None or _states_boxes(paths.tracks),
        collected=figures,
        **tables,
    )


def _states_boxes(tracks: Path) -> bool:
    """Return whether a table of tracks in images states in which frames a target has a box."""
    modes = (BOX, GROUND, PREDICTED)
    return any(np.isin(rows.likelihood_mode, modes).any() for rows in open_input(tracks).rows(ViewTracks))


def _made_tracks(tracks: Path | None) -> TrackProvenance:
    """Return how the tracks were made, by their provenance.

    Defaults without a file, or if it is not an occlog table.
    """
    opened = None if tracks is None else open_if_ours(tracks)
    return TrackProvenance() if opened is None else TrackProvenance.of(opened.provenance)


def _scene(paths: PageRequest) -> Scene | None:
    if paths.scene is not None:
        return load_scene(paths.scene, None, paths.scene)
    named = (paths.truth, paths.bearings, paths.images, paths.recording)
    opened = (open_input(path) for path in named if path is not None)
    return next((each.scene for each in opened if each.recording is not None), None)


def _unit(paths: PageRequest, scene: Scene | None) -> str:
    """Return the length unit of the scene, else of the tables; InputError if a table has another one."""
    named = (paths.tracks, paths.truth, paths.errors, paths.bound, paths.diagnostics, paths.occluders)
    opened = [each for path in named if path is not None and (each := open_input(path)).recording is None]
    unit, source = common_unit(opened) if scene is None else (scene.length_unit, "the scene")
    for each in opened:
        check_unit(each, unit, source, InputError)
    return unit


def _made(paths: PageRequest, title: str) -> tuple[dict[str, object], tuple[Loss, ...], tuple[Verdict, ...]]:
    """Return the provenance of a report and of its inputs (JSON-ready), and losses and verdicts of the inputs.

    `paths`: request with the inputs; `title`: heading of the page.
    """
    opened = [each for path in paths.inputs if (each := open_if_ours(path)) is not None]
    losses = input_losses(opened)
    listed_separately = ("losses", "verdicts")
    made = {
        o.path.name: {k: v for k, v in o.provenance.as_dict().items() if k not in listed_separately} for o in opened
    }
    own = Provenance("report", {"title": title}, None, hash_inputs(paths.inputs), losses)
    values = {k: v for k, v in own.as_dict().items() if k not in listed_separately} | {"made": made}
    return values, losses, own.judged


def run_report(request: PageRequest, job: Job) -> JobResult:
    """Read the inputs, draw, and write page, picture and Markdown; return summary and losses.

    UsageError if there is no output, or nothing to show.
    """
    paths = request.found
    if paths.output is None:
        raise UsageError(
            f"no output: give -o (the page), or {option('recording')} with {option('video')} or {option('frame')}",
            id="missing-option",
        )
    if paths.tracks is None and paths.scene is None:
        raise UsageError(f"nothing to show: give TRACKS, a run folder, or {option('scene')}", id="missing-option")
    if paths.tracks is not None and paths.scene is None and content_of(paths.tracks) is Content.RECORDING:
        raise UsageError(
            f"{paths.tracks}: is a recording, not tracks; show it by {option('scene')}, with tracks or alone",
            id="wrong-content",
        )
    if paths.in_images:
        _check_in_images(paths)
    data = read_input(request)
    begin_work()
    images = _images(paths, data)
    unseen, earlier = () if images is None else images.losses, data.losses
    data = replace(data, losses=tuple(dict.fromkeys((*earlier, *unseen))))
    made = {paths.output: as_bytes(build_page(data, images))}
    if paths.png is not None:
        made[paths.png] = build_picture(data)
    if paths.markdown is not None:
        made[paths.markdown] = as_bytes(build_markdown(data))
    write(made, overwrite=job.overwrite)
    if data.strangers:
        job.note(
            f"warning: bearings of {', '.join(map(repr, data.strangers[:4]))}, not in the scene, are counted and not "
            "drawn; give the scene that they were made in"
        )
    for text in texts_of(data.verdicts, "report"):
        job.note(text)
    files: dict[str, object] = {"page": paths.output, "png": paths.png, "markdown": paths.markdown}
    summary = {name: path for name, path in files.items() if path is not None} | {"targets": len(data.targets)}
    summary["rows"] = {name: data.rows(name) for name in TABLES if getattr(data, name) is not None}
    summary |= {"unknown_sensors": list(data.strangers)} if data.strangers else {}
    return JobResult(summary | summary_of(data.verdicts), unseen, [loss for loss in earlier if loss not in unseen])


def _check_in_images(paths: PageRequest) -> None:
    """Raise UsageError for inputs that a page of tracks in images cannot show."""
    others = ("scene", "bearings", "errors", "bound", "diagnostics", "occluders")
    for name in others:
        if getattr(paths, name) is not None:
            raise UsageError(
                f"{option(name)}: {paths.tracks} has tracks in images, and their page does not show this; leave it out",
                id="not-applicable",
            )


def write(made: Mapping[Path, bytes], *, overwrite: bool) -> None:
    """Write several files, which appear together; `made`: content by path; `overwrite`: they may exist."""
    with OutputGroup() as together:
        for path, content in made.items():
            with open_output(path, overwrite, together) as file:
                file.write(content)


def _images(paths: PageRequest, data: ReportInput) -> Thumbnails | None:
    """Return small images of the recording with the tracks drawn over them; None without a recording."""
    images = paths.images or paths.recording
    if images is None:
        return None
    drawn: OverlayTables | ImageTables | None = None
    if data.in_images and paths.tracks is not None:
        drawn = ImageTables(paths.tracks, paths.truth)
    elif data.tracks is not None and paths.tracks is not None:
        drawn = OverlayTables(paths.tracks, paths.diagnostics)
    return thumbnails(images, drawn, data.targets, round(paths.images_limit * 1e6))
