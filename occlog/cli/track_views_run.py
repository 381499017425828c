"""What `occlog track` does with methods that track in images: read, track, write."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError, UsageError
from ..io.atomic import Together
from ..io.parquet import TableWriter
from ..io.provenance import Provenance, hash_inputs
from ..records import Boxes, Tracks
from ..stages.track_views import Setup, ViewsPart, track_views
from ..stages.view_config import ViewsConfig
from ..stages.view_frames import in_step
from ..trackers.settings import configure
from ..trackers.view_doubt import doubted
from ..trackers.views import VISUAL
from ..view_records import ViewTracks
from . import options
from .track_views_input import ViewsInput
from .track_views_summary import ALONE, ViewsTally

if TYPE_CHECKING:
    from ..losses import Loss
    from ..stages.view_regions import Feed


@dataclass(frozen=True)
class ViewsRequest:
    """What to track in images, and how."""

    recording: Path
    scene: Path | None
    method: str
    settings: dict[str, str]
    initial: Path | None
    detections: Path | None
    fundamental: Path | None
    only: tuple[str, ...]  # cameras; empty: all
    without: tuple[str, ...]
    window_ns: int | None
    seed: int

    @property
    def paths(self) -> list[Path]:
        """All inputs, each once."""
        given = (self.recording, self.scene, self.initial, self.detections, self.fundamental)
        return list(dict.fromkeys(p for p in given if p is not None))

    @property
    def births(self) -> str:
        """Where trackers come from."""
        if self.initial is None:
            return "detections"
        return "initial" if self.detections is None else "both"


@dataclass(frozen=True)
class ViewsOutputs:
    """What to write."""

    tracks: Path
    world: Path | None = None


def run_track_views(
    request: ViewsRequest, wanted: ViewsOutputs, overwrite: bool, quiet: bool
) -> tuple[dict[str, Any], list[Loss]]:
    """Track and write; the summary, and what was lost."""
    config, stage = view_settings(request)
    inputs = ViewsInput(request, stage)
    if wanted.world is not None:
        inputs.check_world()
    starts, next_id = inputs.starts()
    helped, periods = request.method in ALONE, tuple(s.period_ns for s in inputs.surveyed)
    setup = Setup(
        inputs.views, inputs.geometry, VISUAL[request.method], config, stage, starts, next_id, helped, periods,
        doubted if helped else None,
    )  # fmt: skip
    feed = inputs.feed()
    if request.initial is None and request.detections is None:
        source = "the boxes in the recording" if inputs.recording.has(Boxes) else "what moves in the images"
        options.note(f"no --initial and no --detections: trackers begin from {source}", quiet)
    window = request.window_ns if request.window_ns is not None else inputs.window_ns
    frames = options.progress(inputs.recording.frames(inputs.names), "track", inputs.frames, quiet=quiet)
    moments = in_step(frames, inputs.views, window, os.cpu_count() or 1, stage.bits, inputs.background(quiet))
    parts = track_views(moments, setup, request.seed, feed)
    parameters = {
        "method": request.method, "births": request.births, "cameras": list(inputs.names), "window_ns": window,
        "geometry": inputs.known.sources, **asdict(stage), **asdict(config),
    }  # fmt: skip
    earlier = tuple(inputs.losses)
    made = Provenance("track", parameters, request.seed, hash_inputs(request.paths), earlier)
    tally = ViewsTally(request.method, inputs)
    with ExitStack() as stack:
        rows, places = _writers(stack, wanted, made, {"overwrite": overwrite, "length_unit": inputs.length_unit})
        passed = _passed(parts, rows, tally)
        if places is not None:
            for part in inputs.on_ground(passed, window):
                places.write(part.tracks)
                tally.places += part.counts
        for _ in passed:
            pass
        _check_met(feed, request, inputs)
        losses = [*earlier, *tally.losses()]
        for writer in (rows, places):
            if writer is not None:
                writer.annotate(replace(made, losses=tuple(losses)))
    for line in inputs.known.notes:
        options.note(line, quiet)
    for line in tally.warnings():
        options.note(f"warning: {line}", quiet)
    world = {} if wanted.world is None else {"world": str(wanted.world)}
    return {"tracks": str(wanted.tracks), **world, "method": request.method, **tally.summary()}, losses


def _writers(
    stack: ExitStack, wanted: ViewsOutputs, made: Provenance, how: dict[str, Any]
) -> tuple[TableWriter, TableWriter | None]:
    """Of the tracks in the images and, if that is wanted, of those in the world, which then appear together."""
    if wanted.world is None:
        return stack.enter_context(TableWriter(wanted.tracks, ViewTracks, made, **how)), None
    how = {**how, "together": stack.enter_context(Together())}
    rows = stack.enter_context(TableWriter(wanted.tracks, ViewTracks, made, **how))
    return rows, stack.enter_context(TableWriter(wanted.world, Tracks, made, **how))


def _check_met(feed: Feed | None, request: ViewsRequest, inputs: ViewsInput) -> None:
    """InputError for detections of other times than the frames."""
    if feed is not None and feed.read and not feed.met:
        raise InputError(
            f"{request.detections or request.recording}: none of its {feed.read} regions is of the time of a frame "
            f"of {', '.join(inputs.names)}; give detections that were made from this recording"
        )


def _passed(parts: Iterator[ViewsPart], rows: TableWriter, tally: ViewsTally) -> Iterator[ViewTracks]:
    """The tables, written and counted on their way."""
    for part in parts:
        rows.write(part.tracks)
        tally.add(part)
        yield part.tracks


def view_settings(request: ViewsRequest) -> tuple[Any, ViewsConfig]:
    """Settings of the method and of what is around it; UsageError for what neither has."""
    around = {f.name for f in fields(ViewsConfig)}
    own = {name: value for name, value in request.settings.items() if name not in around}
    others = {name: value for name, value in request.settings.items() if name in around}
    try:
        method = VISUAL[request.method].config
        config, stage = configure(method(), own, request.method), configure(ViewsConfig(), others, request.method)
    except InputError as error:  # here the values are options
        raise UsageError(str(error)) from error
    if stage.birth_frames == 0 and request.initial is None:
        raise UsageError("birth_frames is 0, so that no tracker begins from detections; give --initial, or 1 or more")
    return config, stage
