"""`occlog ingest`: open sources, and write their frames and rows sorted by time."""

from __future__ import annotations

import heapq
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.console.notes import note_findings
from occlog.console.text import counted
from occlog.errors import InputError, UsageError, option
from occlog.io.files.inputs import hash_inputs
from occlog.io.files.limits import check_input
from occlog.io.files.provenance import Provenance, hash_file
from occlog.io.files.timing.frame_times import FrameTimes
from occlog.io.formats.boxes.reader import BoxSurvey, read_boxes
from occlog.io.formats.positions import PositionLog, PositionOptions, parse_grid, read_positions
from occlog.io.formats.sound.csv_log import DoaOptions
from occlog.io.formats.sound.directions import read_doa
from occlog.io.formats.sound.formats import parse_hop
from occlog.io.formats.tags import ReadLog, read_reads
from occlog.io.formats.truth import TruthOptions, read_truth
from occlog.io.frames.camera_source import CameraSource
from occlog.io.frames.decoders.process import Delivered
from occlog.io.messages.bag import Bag, BagSurvey, open_bag
from occlog.io.open import external_positions
from occlog.io.recording.chunks import is_of_occlog
from occlog.io.recording.writer import RecordingWriter
from occlog.records.columns import ColumnTable
from occlog.records.losses import Loss
from occlog.records.messages import listed
from occlog.records.scene import Scene
from occlog.records.tables import Boxes, Positions, Reads, Truth, TruthBoxes
from occlog.records.verdicts import Check, Verdict, summary_of, texts_of
from occlog.runner import Job

from .bag import BagCameraPoses, Taking, check_plan, check_truth_frames, look_into, place_cameras
from .boxes import are_people, box_files, box_options, inside, known_cameras, note_frames, truth_options
from .boxes import survey as survey_of
from .plan import IngestPlan, with_offsets
from .request import IngestRequest
from .scene import Sized, Turn, add_bag_cameras, base_scene, fit_sizes, match_cameras, sized, with_stated_sizes
from .sources import (
    Copies,
    IngestFailures,
    clock_of,
    duplicates,
    open_sources,
    read_sidecars,
    start_of,
    sync_times,
    times_of,
)
from .stated import source_checks
from .times import TimedWriter, Times, TimeSpanNs
from .truth import check_truth_consistency, note_first_frames, within_frames


@dataclass
class Ingested(IngestFailures):
    """What an ingest has written so far: frames, rows and tags by name, times, losses, failures and checks."""

    frames: dict[str, int] = field(default_factory=dict)
    rows: dict[str, int] = field(default_factory=dict)
    times: dict[str, str] = field(default_factory=dict)
    tags: dict[str, int] = field(default_factory=dict)
    seen: Times = field(default_factory=Times)
    checks: list[Check] = field(default_factory=list)


def run_ingest(request: IngestRequest, job: Job) -> tuple[dict[str, object], list[Loss]]:
    """Write the files of a request as one recording; return the summary for JSON, and the losses.

    If an InputError occurs, the findings made so far are printed before it is raised again.
    """
    plan, done = request.plan, Ingested()
    try:
        return _ingest(plan, job, done)
    except InputError:
        # What may be wrong with a calibration may be why a later file is refused
        note_findings(texts_of([Verdict.of("ingest", done.checks)], "ingest"), job.quiet)
        raise


def _ingest(plan: IngestPlan, job: Job, done: Ingested) -> tuple[dict[str, object], list[Loss]]:
    """Write the recording of a plan; return the summary for JSON, and the losses.

    Args:
        plan: inputs and options.
        job: has notes, progress and verdicts.
        done: counts, losses and findings are added to it, so that they are known after an error.
    """
    note = job.note
    for path, what in plan.files():
        if not (path.is_dir() and path in plan.folders()):
            check_input(path, what)
    scene, turn, checks = base_scene(plan, note)
    done.checks.extend(checks)
    survey = survey_of(plan, scene, note)
    with ExitStack() as stack:
        bag = _open_bag(plan, scene, stack, note)
        if bag is not None and not plan.calibration:
            placed, _, world, found = bag.placement
            scene, turn, checks = add_bag_cameras(scene, placed, world, found, plan, note)
            done.checks = [*checks]
        in_bag = bag.found.map.cameras if bag else ()
        wanted = list(dict.fromkeys([*plan.video, *plan.images, *in_bag, *(survey.cameras if survey else ())]))
        plan.check_names(wanted)
        scene = match_cameras(scene, wanted, plan, bag.placement.reasons if bag else {}, note)
        scene = with_offsets(scene, plan.clock_offset)
        sources = open_sources(plan, scene, wanted, stack, done)
        if done.failures and not sources:
            raise done.failures[0]
        sizes = {s.name: sized(s) for s in sources}
        sizes |= {name: Sized(size) for name, size in (bag.found.sizes.items() if bag else ())}
        scene = fit_sizes(scene, with_stated_sizes(sizes, survey, scene, plan.image_size), note)
        if survey is not None:
            recorded = {s.name: s.decoder.frames for s in sources if s.name in plan.video and s.decoder.frames}
            survey = replace(survey, recorded=recorded)
        times = _all_times(plan, scene, sources, survey)
        settings = plan.parameters() | ({} if turn is None else turn.parameters())
        provenance = Provenance("ingest", settings, None, hash_inputs(plan.paths()))
        writer = stack.enter_context(TimedWriter(plan.output, scene, provenance, overwrite=job.overwrite))
        writer.times = done.seen
        # Tables first: a fault in one is then reported before hours of video have been read.
        _write_reads(plan, scene, writer, done, note)
        _write_positions(plan, scene, writer, done, note)
        _write_tables(plan, scene, turn, survey, times, writer, done, note)
        if sources:
            _write_frames(plan, sources, writer, done, job)
        if bag is not None:
            _write_bag(bag, plan, scene, turn, writer, done, job)
        done.times.update({name: t.source for name, t in times.items() if name not in done.times})
        cameras: dict[str, list[str]] = {}  # by what is the same of them
        for name, source in sorted(done.times.items()):
            count = f"{counted(done.frames[name], 'frame')}, " if name in done.frames else ""
            cameras.setdefault(f"{count}times from {source}", []).append(name)
        for text, names in cameras.items():
            note(f"{'camera' if len(names) == 1 else 'cameras'} {listed(names)}: {text}")
        parameters = {**settings, "time_sources": dict(sorted(done.times.items()))}
        made = replace(provenance, parameters=parameters, losses=tuple(done.losses))
        judged = job.judged(made, (*done.checks, *done.seen.checks(), *source_checks(plan, sources, survey, times)))
        writer.annotate(judged)
    return {**_summary(plan, done), **summary_of(judged.judged)}, done.losses


class _OpenBag(NamedTuple):
    """An open bag in an ingest: its files, the survey of its topics, and the cameras with poses."""

    bag: Bag
    found: BagSurvey
    placement: BagCameraPoses


def _open_bag(plan: IngestPlan, scene: Scene, stack: ExitStack, note: Callable[[str], None]) -> _OpenBag | None:
    """Open the bags of the plan as one, select topics, and find poses of cameras; None if the plan has no bag.

    Args:
        plan: inputs and options.
        scene: from the scene file and calibration.
        stack: closes the bag.
        note: called with remarks for the user.

    Raises:
        InputError: a bag is a recording of occlog, or has nothing that can be used.
    """
    if not plan.bags:
        return None
    for path in plan.bags:
        if path.is_file() and is_of_occlog(path):
            raise InputError(
                f"{path}: is an occlog recording; ingest would drop its tables and losses; use it directly, or ingest "
                "its sources",
                id="wrong-content",
            )
    bag = stack.enter_context(open_bag(plan.bags))
    found = look_into(bag, plan, note)
    check_plan(plan, found, scene, note)
    others = found.map.cameras if plan.calibration else [c.name for c in scene.cameras]
    placement = place_cameras(found, plan, others, note)
    check_truth_frames(found, placement, note)
    return _OpenBag(bag, found, placement)


def _write_bag(
    bag: _OpenBag,
    plan: IngestPlan,
    scene: Scene,
    turn: Turn | None,
    writer: RecordingWriter,
    done: Ingested,
    job: Job,
) -> None:
    """Write images and rows of a bag to the recording, in one pass.

    Args:
        bag: open bag, its topics and the poses of its cameras.
        plan: inputs and options.
        scene: has sensors and clocks.
        turn: transform to the levelled world; None: the world is upright.
        writer: of the recording.
        done: counts, losses and findings are added to it.
        job: shows progress and notes.
    """
    clocks = {s.name: clock for s in scene.sensors if (clock := clock_of(scene, s.name)) is not None}
    with Taking(bag.bag, bag.found, plan, scene, clocks, bag.placement, turn) as taking:
        for message in job.progress(taking.messages(), "ingest", taking.count):
            taking.take(message, writer)
        taking.write_videos(writer)
    done.losses.extend(taking.finish(job.note))
    done.checks.extend(taking.checks())
    done.frames.update(taking.frames)
    done.times.update(taking.times)
    for name, count in taking.rows.items():
        done.rows[name] = done.rows.get(name, 0) + count


def _summary(plan: IngestPlan, done: Ingested) -> dict[str, object]:
    return {
        "recording": str(plan.output),
        "frames": dict(sorted(done.frames.items())),
        "rows": done.rows,
        "times": dict(sorted(done.times.items())),
        **({"tags": done.tags} if done.tags else {}),
    }


def _all_times(
    plan: IngestPlan, scene: Scene, sources: list[CameraSource], survey: BoxSurvey | None
) -> dict[str, FrameTimes]:
    """Times of the frames of each camera, by its name; a camera of which they are unknown is omitted.

    They come from the camera's video or images, or else, for a camera with boxes alone, from a time stamp file, a
    stated frame rate or the box file itself.

    Args:
        plan: inputs and options.
        scene: has the cameras and their clocks.
        sources: cameras with a video or images.
        survey: of the box files; None: there are none.
    """
    found: dict[str, FrameTimes] = {}
    cameras = [c.name for c in scene.cameras]
    sidecars = read_sidecars(plan, cameras)
    own: Mapping[str, FrameTimes] = survey.times if survey else {}
    opened = {s.name: s.times for s in sources}
    for name in cameras:
        times = opened.get(name)
        if times is None and survey is not None and name in survey.cameras:
            times = times_of(plan, name, sidecars)
            if times is None and name in own:
                times = replace(own[name], start_ns=start_of(plan, name))
            times = times.by(clock_of(scene, name)) if times is not None else None
        if times is not None:
            found[name] = times
    return found


def _write_frames(
    plan: IngestPlan, sources: list[CameraSource], writer: RecordingWriter, done: Ingested, job: Job
) -> None:
    """Write the frames of all cameras to the recording, sorted by time; links to videos if the plan stores only times.

    Counts and failures are added to `done`. A camera that fails is a loss.

    Raises:
        InputError: all cameras fail.
    """
    streams = [_guarded(source, done) for source in sources]
    total = sum(s.decoder.frames or 0 for s in sources) or None
    merged = heapq.merge(*streams, key=lambda item: (item[0], item[1]))
    for t_ns, name, frame in job.progress(merged, "ingest", total):
        if plan.store == "link":
            writer.video_frame(name, t_ns, frame.index)
        else:
            writer.image(name, t_ns, frame.index, bytes(frame.data), frame.kind)
        done.frames[name] = done.frames.get(name, 0) + 1
    if done.failures and not done.frames:
        raise done.failures[0]
    for source in sources:
        done.times[source.name] = source.times.source
        if plan.store == "link" and source.name in done.frames:
            link = os.path.relpath(source.path.resolve(), plan.output.resolve().parent)
            writer.video(source.name, Path(link).as_posix(), hash_file(source.path))


def _guarded(source: CameraSource, done: Ingested) -> Iterator[tuple[int, str, Delivered]]:
    try:
        for t_ns, frame in source.frames():
            yield t_ns, source.name, frame
    except InputError as error:
        done.failures.append(error)
        done.losses.append(Loss(source.path.name, "whole camera", str(error)))
    done.losses.extend(source.losses)


def _write_tables(
    plan: IngestPlan,
    scene: Scene,
    turn: Turn | None,
    survey: BoxSurvey | None,
    times: dict[str, FrameTimes],
    writer: RecordingWriter,
    done: Ingested,
    note: Callable[[str], None],
) -> None:
    """Write rows of boxes, directions and truth to the recording; losses, counts and findings are added to `done`.

    Args:
        plan: options of the user.
        scene: scene of the recording.
        turn: transform of the truth to the levelled world; None: it is upright.
        survey: of the box files; None: there are none.
        times: frame times by camera.
        writer: of the recording.
        done: what was written so far.
        note: called with remarks for the user.
    """
    tables: list[Iterator[ColumnTable]] = []
    if survey is not None:
        known = known_cameras(plan, scene)
        note_frames(survey, times, note)
        read = read_boxes(box_files(plan), survey, times, known, box_options(plan, scene), Boxes, done.losses)
        sized = {*survey.sizes, *plan.video, *plan.images}
        given, people = plan.image_size is not None, are_people(survey)
        tables.append(inside(read, scene, done.losses, note, done.checks, sized, given=given, of_people=people))
    copies = Copies(several=len(plan.doa) > 1)
    for sensor, path in plan.doa:
        clocks = {a.name: c for a in scene.arrays if (c := clock_of(scene, a.name)) is not None}
        heard = read_doa(path, scene.arrays, _doa_options(plan, sensor), clocks, done.losses)
        tables.append(copies.once(heard, path, done.checks, "direction"))
    note_first_frames(plan, survey, note)
    sync = sync_times(plan) if plan.truth else None
    seen: dict[int | str, list[tuple[Path, TimeSpanNs]]] = {}
    for camera, path in plan.truth:
        how = TruthOptions(
            format=plan.truth_format,
            camera=camera,
            cameras=known_cameras(plan, scene),
            times=times,
            sync_ns=sync,
            length_unit=scene.length_unit,
            boxes=truth_options(plan, scene),
        )
        true = _split_tables(_truth(path, how, plan, turn, scene.length_unit), path, seen)
        true = within_frames(true, plan, survey, times, note)
        tables.append(check_truth_consistency(true, scene, path, note))
    empty = 0
    for chunks in tables:
        for table in chunks:
            writer.table(table)
            done.rows[table.NAME] = done.rows.get(table.NAME, 0) + len(table)
            empty += int((table.box < 0).sum()) if isinstance(table, Boxes) and table.NAME == Boxes.NAME else 0
    if empty:
        rows = "row is" if empty == 1 else "rows are"
        note(f"boxes: {done.rows[Boxes.NAME] - empty}; {empty} more {rows} of frames in which a camera saw no person")


def _write_positions(
    plan: IngestPlan, scene: Scene, writer: RecordingWriter, done: Ingested, note: Callable[[str], None]
) -> None:
    """Write the positions of all position files, and add their numbers of rows and findings to `done`.

    Args:
        plan: has the files and how they are read.
        scene: has the sensors.
        writer: of the recording.
        done: what was written so far.
        note: called with a line of text for each file.

    Raises:
        UsageError: the name of a source is in two files, or is that of a sensor.
    """
    grid = None if plan.grid is None else parse_grid(plan.grid)
    taken = dict.fromkeys((sensor.name for sensor in scene.sensors), "a sensor of the scene")
    for name, path in plan.positions:
        sources = dict.fromkeys(["", *(source for source, _ in plan.positions if source is not None)])
        times = {source: found for source in sources if (found := times_of(plan, source, {})) is not None}
        log = read_positions(
            path,
            PositionOptions(
                sensor=name,
                times=times,
                start_ns=start_of(plan, name or ""),
                first_number=plan.first_number or 0,
                frames=plan.frames.of(name),
                grid=grid,
                scale=plan.confidence_scale,
                scores=plan.score_type,
                ignore_extra=plan.ignore_extra_columns,
            ),
        )
        for source in log.sources:
            if source in taken:
                raise UsageError(
                    f"{path}: positions of source {source!r} are also in {taken[source]}; give them another name: "
                    f"{option('positions')} NAME={path.name}",
                    id="duplicate-name",
                )
            taken[source] = f"that of {path.name}"
        writer.table(log.table)
        done.rows[Positions.NAME] = done.rows.get(Positions.NAME, 0) + len(log.table)
        note(_positions_in_words(path, log))
        if log.duplicates:
            done.checks.append(duplicates(path, log.duplicates, "position"))


def _positions_in_words(path: Path, log: PositionLog) -> str:
    """Describe in one line the rows of a position file: counts, sources, extent, frame step and stated errors."""
    table = log.table
    there = table.detection >= 0
    x, y = table.x[there], table.y[there]
    stated = int(np.isfinite(table.cov_xx[there]).sum())
    text = [
        f"{counted(int(there.sum()), 'position')} of {', '.join(log.sources)}",
        f"x {x.min():.4g} to {x.max():.4g}, y {y.min():.4g} to {y.max():.4g}",
        f"{counted(int((~there).sum()), 'frame')} without any",
    ]
    if log.step > 1:
        text.append(f"frames in steps of {log.step} (the frame rate is that of all frame numbers)")
    text.append("no errors stated, jipda learns them" if not stated else f"errors stated of {stated}")
    if log.other_frames:
        text.append(f"skipped: {log.other_frames} of other frames")
    return f"positions: {path.name}: {'; '.join(text)}"


def _write_reads(
    plan: IngestPlan, scene: Scene, writer: RecordingWriter, done: Ingested, note: Callable[[str], None]
) -> None:
    """Write the reads of all tag logs, and add their numbers of rows, tags and findings to `done`.

    Args:
        plan: has the files and how they are read.
        scene: has the readers.
        writer: of the recording.
        done: what was written so far.
        note: called with a line of text for a log that was not sorted by time.

    Raises:
        InputError: a tag has different targets in two logs, or a target different tags.
    """
    names = [r.name for r in scene.readers]
    clocks = {name: clock for name in names if (clock := clock_of(scene, name)) is not None}
    copies = Copies(several=len(plan.reads) > 1)
    for path in plan.reads:
        log = read_reads(
            path,
            names,
            start_ns=start_of(plan, ""),
            clocks=clocks,
            ignore_extra=plan.ignore_extra_columns,
        )
        _check_tags(path, log, done.tags)
        done.tags.update(log.tags)
        if log.late:
            note(f"{path.name}: {log.late} reads came after later ones, and were sorted by time")
        if log.double:
            done.checks.append(duplicates(path, log.double, "read"))
        for reads in copies.once([log.reads], path, done.checks, "read"):
            writer.table(reads)
            done.rows[Reads.NAME] = done.rows.get(Reads.NAME, 0) + len(reads)


def _check_tags(path: Path, log: ReadLog, known: Mapping[str, int]) -> None:
    """InputError if a tag had another target in an earlier log, or a target another tag.

    `known` has the target of each tag of the earlier logs.
    """
    owner = {target: tag for tag, target in known.items()}
    for tag, target in log.tags.items():
        if known.get(tag, target) != target or owner.get(target, tag) != tag:
            raise InputError(
                f"{path}: tag {tag} is target {target}, but an earlier log gives this tag or this number to "
                f"another; join the logs of {option('reads')} into one",
                id="duplicate-name",
            )


def _truth(
    path: Path, how: TruthOptions, plan: IngestPlan, turn: Turn | None, length_unit: str
) -> Iterator[Truth | TruthBoxes]:
    """Generate tables of true positions and boxes from a file, positions in the levelled world of the cameras.

    If no frame times are known, a frame rate given for all cameras converts frame numbers to times.

    Args:
        path: file of the truth.
        how: options of its reader.
        plan: options of the user.
        turn: transform to the levelled world; None: it is upright.
        length_unit: of the scene.
    """
    if not how.times:
        rate = times_of(plan, "", {})
        how = replace(how, times={"": rate} if rate else {})
    external = external_positions(path, length_unit) if plan.truth_format == "auto" else None
    if external is not None:
        # Positions on the earth are in the world of their origin, which is upright
        yield from external.rows if external.on_earth or turn is None else (turn.truth(t, path) for t in external.rows)
        return
    for table in read_truth(path, how):
        if isinstance(table, Truth) and not len(table):
            continue
        yield turn.truth(table, path) if turn is not None and isinstance(table, Truth) else table


def _split_tables(
    tables: Iterator[Truth | TruthBoxes], path: Path, known: dict[int | str, list[tuple[Path, TimeSpanNs]]]
) -> Iterator[Truth | TruthBoxes]:
    """Generate the tables of a truth file unchanged, and check that it does not overlap with earlier files.

    Args:
        tables: of the file.
        path: the file.
        known: files and time spans of each target (number) and each camera with true boxes (name); this file's are
            added.

    Raises:
        InputError: an earlier file has the same target, or boxes of the same camera, at the same times.
    """
    spans: dict[int | str, TimeSpanNs] = {}
    for table in tables:
        keys, rows = np.unique(table.target_id if isinstance(table, Truth) else table.sensor, return_inverse=True)
        first, last = np.full(len(keys), 2**63 - 1), np.full(len(keys), -(2**63))
        np.minimum.at(first, rows, table.t_ns)
        np.maximum.at(last, rows, table.t_ns)
        for key, low, high in zip(keys.tolist(), first.tolist(), last.tolist(), strict=True):
            here = spans.setdefault(key, TimeSpanNs())
            here.take(low, high)
            for other, span in known.get(key, ()):
                if span.first <= here.last and here.first <= span.last:
                    raise InputError(f"{path}: {_twice(key, other)}")
        yield table
    for key, here in spans.items():
        known.setdefault(key, []).append((path, here))


def _twice(key: int | str, other: Path) -> str:
    """Text for an error: the file `other` has the target `key` (int), or boxes of the camera `key` (str), too."""
    if isinstance(key, str):
        return f"camera {key}: has true boxes in {other}, too, at the same times; give one of the files, or join them"
    return (
        f"target {key} has positions in {other}, too, at the same times; give each target its own number in a column id"
    )


def _doa_options(plan: IngestPlan, sensor: str | None) -> DoaOptions:
    return DoaOptions(
        format=plan.doa_format,
        sensor=sensor,
        unit=plan.doa_unit,
        convention=plan.doa_convention,
        algorithm=plan.doa_algorithm,
        start_ns=start_of(plan, sensor or ""),
        ignore_extra=plan.ignore_extra_columns,
        hop=None if plan.odas_hop_s is None else parse_hop(plan.odas_hop_s),
    )
