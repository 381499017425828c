"""What `occlog report` does for a page: read, draw, write the page, the picture and the text."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from occlog.console.details import begin_work
from occlog.console.text import as_bytes
from occlog.errors import UsageError, option
from occlog.io.files.atomic import Together, open_output
from occlog.io.files.untrusted.content import Content, content_of
from occlog.records.verdicts import summary_of, texts_of
from occlog.report.content.model import ReportInput
from occlog.runner import Done, Job

from .gather import TABLES
from .inputs import read_input
from .markdown import build_markdown
from .overlay.world import Sources
from .page import build_page
from .picture import build_picture
from .replay.thumbnails import Thumbnails, thumbnails
from .request import PageRequest


def run_report(request: PageRequest, job: Job) -> Done:
    """Read everything, draw, write the page, the picture and the text."""
    paths = request.found
    if paths.output is None:
        raise UsageError(
            f"no output: give -o (the page), or {option('recording')} with {option('video')} or {option('frame')}"
        )
    if paths.tracks is None and paths.scene is None:
        raise UsageError(f"nothing to show: give TRACKS, a run folder, or {option('scene')}")
    if paths.tracks is not None and paths.scene is None and content_of(paths.tracks) is Content.RECORDING:
        raise UsageError(
            f"{paths.tracks}: is a recording, not tracks; show it by {option('scene')}, beside tracks or alone"
        )
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
    summary |= {name: data.rows(name) for name in TABLES if getattr(data, name) is not None}
    summary |= {"not_in_scene": list(data.strangers)} if data.strangers else {}
    return Done(summary | summary_of(data.verdicts), unseen, [loss for loss in earlier if loss not in unseen])


def write(made: Mapping[Path, bytes], *, overwrite: bool) -> None:
    """Write files that appear together."""
    with Together() as together:
        for path, content in made.items():
            with open_output(path, overwrite, together) as file:
                file.write(content)


def _images(paths: PageRequest, data: ReportInput) -> Thumbnails | None:
    """Small images of the recording that is named, with the tracks drawn over them."""
    if paths.images is None:
        return None
    drawn = None
    if data.tracks is not None and paths.tracks is not None:
        drawn = Sources(paths.tracks, paths.diagnostics)
    return thumbnails(paths.images, drawn, data.targets, round(paths.images_limit * 1e6))
