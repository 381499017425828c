"""Work of `occlog report`: read, draw, write the page, the picture and the text."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from occlog.console.details import begin_work
from occlog.errors import UsageError
from occlog.io.files.atomic import check_outputs

from .inputs import Paths, read_input

if TYPE_CHECKING:
    from occlog.records.losses import Loss
    from occlog.report.content.model import ReportInput

    from .replay.thumbnails import Thumbnails


def run_report(paths: Paths, title: str) -> tuple[ReportInput, tuple[Loss, ...]]:
    """Read everything, draw, write the page and the picture; what was shown, and which images were lost now."""
    from occlog.console.text import as_bytes
    from occlog.io.files.atomic import Together, open_output
    from occlog.io.files.untrusted.content import Content, content_of

    from .markdown import build_markdown
    from .page import build_page
    from .picture import build_picture

    if paths.tracks is None and paths.scene is None:
        raise UsageError("nothing to show: give TRACKS, a run folder, or --scene")
    if paths.tracks is not None and paths.scene is None and content_of(paths.tracks) is Content.RECORDING:
        raise UsageError(f"{paths.tracks}: is a recording, not tracks; show it by --scene, beside tracks or alone")
    check_outputs(paths.inputs, paths.outputs, paths.overwrite)
    data = read_input(paths, title)
    begin_work()
    images = _images(paths, data)
    unseen = () if images is None else images.losses
    data = replace(data, losses=tuple(dict.fromkeys((*data.losses, *unseen))))
    made = {paths.output: as_bytes(build_page(data, images))}
    if paths.png is not None:
        made[paths.png] = build_picture(data)
    if paths.markdown is not None:
        made[paths.markdown] = as_bytes(build_markdown(data))
    with Together() as together:
        for path, content in made.items():
            with open_output(path, paths.overwrite, together) as file:
                file.write(content)
    return data, unseen


def _images(paths: Paths, data: ReportInput) -> Thumbnails | None:
    """Small images of the recording that is named, with the tracks drawn over them."""
    if paths.images is None:
        return None
    from .overlay.world import Sources
    from .replay.thumbnails import thumbnails

    drawn = None
    if data.tracks is not None and paths.tracks is not None:
        drawn = Sources(paths.tracks, paths.diagnostics)
    return thumbnails(paths.images, drawn, data.targets, round(paths.images_limit * 1e6))
