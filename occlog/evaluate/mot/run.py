"""`occlog evaluate` for many targets: in images (view tracks, boxes, MOTChallenge text) and on the ground."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from occlog.console.notes import begin_work
from occlog.errors import InputError, UsageError, abridged, option
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.request import EvaluateRequest
from occlog.evaluate.results import Evaluation
from occlog.evaluate.sources import opened_rows, rows_of
from occlog.io.files.inputs import previous_losses
from occlog.io.files.texts.csv_rows import first_line, is_header
from occlog.io.files.texts.documents import write_json
from occlog.io.files.timing.frame_times import FrameTimes
from occlog.io.formats.boxes.datasets import is_kitti
from occlog.io.formats.boxes.mot_challenge import (
    DISTRACTORS,
    PEDESTRIAN,
    Marks,
    MotSequence,
    WrittenSequence,
    has_classes,
    read_marks,
    write_layout,
)
from occlog.io.formats.boxes.reader import BoxFile, BoxOptions, read_boxes, survey_boxes
from occlog.io.formats.boxes.rows import fill_frames
from occlog.io.open import Opened, is_external, open_if_ours, open_input
from occlog.records.declared.views import ViewTracks, boxes_of_ellipses
from occlog.records.scene import Scene
from occlog.records.tables import Boxes, TruthBoxes, windows
from occlog.runner import Job
from occlog.settings import configure
from occlog.track.methods.images.run.inputs import independent_id_note, initiated_from_detections, other_video

from .config import MultiTargetConfig
from .stage import ComparedBoxes, Sides
from .truth_and_tracks import (
    MAX_FRAMES,
    TruthAndTracks,
    annotation_format,
    check_counted,
    frame_rate,
    frame_times,
    image_size,
    joined,
    pedestrians,
    read_annotation,
    timed_like,
    view_boxes,
)

B = TypeVar("B", bound=Boxes)
TEXT = (".txt", ".csv")


def in_images(path: Path | None) -> bool:
    """Return whether a file holds tracks in images: MOTChallenge text, or a table of view tracks or boxes.

    False for None.
    """
    if path is None:
        return False
    if _is_text(path):
        return True
    opened = open_input(path, fps=Fraction(1))  # any rate: the columns alone state what it holds
    return opened.recording is None and any(opened.has(table) for table in (ViewTracks, Boxes, TruthBoxes))


def evaluate_in_images(request: EvaluateRequest, job: Job) -> Evaluation:
    """Evaluate tracks in images against true boxes, write the requested files, and return figures, notes and checks."""
    compared, config, scene, uncounted = compared_boxes(request)
    begin_work()
    provenance = job.provenance(asdict(config), previous_losses(request.inputs))
    with job.tables(provenance, "m") as tables:
        result = compared.evaluate(None if request.failures is None else lambda rows: tables.write(failures=rows))
        provenance = provenance if result.checks is None else provenance.with_checks(result.checks)
        tables.annotate(provenance)
    note = independent_id_note(request.tracks, config.assigned_target, _asked(request.multi_target))
    notes = (*uncounted, *result.notes, *note, *other_video(request.tracks, [request.truth]))
    result = replace(result, notes=notes, verdicts=provenance.judged)
    if request.mot is not None and request.tracks is not None:
        whole = joined([part for _, part in compared.parts()])
        write_layout(request.mot, request.tracks.stem, _sequences(whole, scene), overwrite=job.overwrite)
    if request.output is not None:
        values = {**result.figures, "_provenance": provenance.as_dict()}
        write_json(request.output, values, overwrite=job.overwrite)
    return result


def _configured(request: EvaluateRequest, ours: Opened | None) -> MultiTargetConfig:
    """Return the settings of the request; UsageError for a GOSPA cutoff above 1, the largest 1 - IoU of boxes.

    `ours`: the tracks; None: they are MOTChallenge text.
    """
    named = ours is not None and ours.has(ViewTracks)
    own = "id" if named and not initiated_from_detections(request.tracks) else "start"
    overlap = configure(EvaluateConfig(), request.settings).iou_threshold
    frames = {} if request.frames is None else {"frames": request.frames}
    config = configure(
        MultiTargetConfig(), {"assigned_target": own, "match_iou": overlap, **request.multi_target, **frames}
    )
    if config.gospa_cutoff is not None and config.gospa_cutoff > 1:
        raise UsageError(
            f"{option('gospa_cutoff')} {config.gospa_cutoff:g}: the distance of boxes is 1 - IoU, at most 1; for a "
            f"cutoff in pixels give {option('gospa_px')}",
            id="not-applicable",
        )
    return config


def compared_boxes(
    request: EvaluateRequest,
) -> tuple[ComparedBoxes, MultiTargetConfig, Scene | None, tuple[str, ...]]:
    """Open tracks and truth of the request for comparison.

    Also returned are the settings, the scene of the truth (None: it has none), and notes for the user.
    """
    if request.tracks is None or request.truth is None:
        raise UsageError(
            f"tracks in images need {option('truth')}: a recording or a table with true boxes, or MOTChallenge text",
            id="missing-option",
        )
    text, counted = _is_text(request.tracks), annotation_format(request.truth)
    ours = None if text else open_input(request.tracks)
    config = _configured(request, ours)
    in_text = counted is None and _is_text(request.truth)
    check_counted(request.truth, counted, in_text, config)
    rule = _benchmark(request.truth, config, in_text)
    cameras = _strings(ours.provenance.parameters.get("cameras")) if ours is not None and ours.has(ViewTracks) else ()
    with _named({"tracks": request.tracks, "truth": request.truth}):
        if ours is not None and counted is None and not in_text:
            theirs = open_input(request.truth)
            theirs.require(TruthBoxes)
            return ComparedBoxes(_timed(ours, theirs), config, cameras=cameras), config, theirs.scene, ()
        if counted is None:
            tracks, truth, scene = _read_both(request.tracks, request.truth, config, rule)
        else:
            (tracks, truth), scene = _read_annotated(request.tracks, request.truth, config, counted), None
        adjust: Callable[[TruthAndTracks], TruthAndTracks] | None = None
        notes: tuple[str, ...] = ()
        if rule in DISTRACTORS:
            marks = read_marks(request.truth)
            adjust = partial(pedestrians, marks=marks, distractors=DISTRACTORS[rule])
            notes = _uncounted(request.truth, marks, rule)
        sides: Sides = lambda: iter([(tracks, truth)])  # noqa: E731
        compared = ComparedBoxes(sides, config, cameras=cameras, by_number=True, adjust=adjust)
    return compared, config, scene, notes


def _uncounted(path: Path, marks: Marks, rule: str) -> tuple[str, ...]:
    """Return a note on the true boxes that a benchmark's rules exclude; empty if none are.

    Args:
        path: file of the true boxes.
        marks: class and mark (counts or not) of each of its rows.
        rule: name of the benchmark.

    Raises:
        InputError: no true box is left.
    """
    skipped = ~(marks.counts & (marks.kind == PEDESTRIAN))
    if not skipped.any():
        return ()
    kinds = Counter(marks.kind[skipped].tolist())
    why = {PEDESTRIAN: f"class {PEDESTRIAN}, with 0 in column 7"}
    classes = ", ".join(f"{why.get(kind, f'class {kind}')}: {count}" for kind, count in sorted(kinds.items()))
    how = f"{option('benchmark')} mot15"
    statement = f"{int(skipped.sum())} of {len(skipped)} true boxes do not count by the rules of {rule} ({classes})"
    if skipped.all():
        other = min((kind for kind in kinds if kind != PEDESTRIAN), default=None)
        remedy = "write 1 there to count them"
        if other is not None:
            remedy = f"if class {other} means people, count them with {how}"
        raise InputError(
            f"{path}: all {len(skipped)} true boxes are skipped by the rules of {rule} ({classes}); {remedy}"
        )
    return (f"{path}: {statement}; {how} counts all boxes",)


def _timed(ours: Opened, theirs: Opened) -> Sides:
    """Return a function that generates tracks and true boxes, both of the same times, chunk by chunk.

    `ours`, `theirs`: opened tables of the tracks and of the truth.
    """
    kind: type[Boxes] = TruthBoxes if ours.has(TruthBoxes) else Boxes
    ellipses = opened_rows(ours, ViewTracks)
    boxes = opened_rows(ours, kind)
    truth = opened_rows(theirs, TruthBoxes)

    def sides() -> Iterator[tuple[Boxes, TruthBoxes]]:
        rows = rows_of(boxes) if ellipses is None else map(boxes_of_ellipses, ellipses())
        for part in windows(rows, rows_of(truth), (kind, TruthBoxes), 0):
            yield part.a, part.b

    return sides


def _benchmark(truth: Path, config: MultiTargetConfig, text: bool) -> str:
    """Return the benchmark with the rules for classes (`mot15`, `mot17`, `mot20`): as requested, else by the columns.

    UsageError if the requested one needs a column of classes that the file lacks. `text`: the truth is MOTChallenge
    text.
    """
    classes = text and not has_no_rows(truth) and has_classes(truth)
    if config.benchmark == "auto":
        return "mot17" if classes else "mot15"
    if config.benchmark in DISTRACTORS and not classes:
        raise UsageError(
            f"{option('benchmark')} {config.benchmark}: needs classes, but {truth} has no column of them (the "
            "eighth); add it, or give mot15",
            id="missing-column",
        )
    return config.benchmark


def has_no_rows(path: Path) -> bool:
    """Return whether a text file has no data line: nothing was tracked, or no target is present."""
    return path.stat().st_size == 0 or not first_line(path, "MOTChallenge text")


def _asked(given: Mapping[str, object]) -> str | None:
    """Return the setting `assigned_target` of the user; None if it is not given."""
    return None if given.get("assigned_target") is None else str(given["assigned_target"])


def _strings(value: object) -> tuple[str, ...]:
    return tuple(text for text in value if isinstance(text, str)) if isinstance(value, list) else ()


@contextmanager
def _named(files: Mapping[str, Path]) -> Iterator[None]:
    """Context manager that replaces the first word of an InputError's message by the file with that name in `files`.

    For example `truth: has no boxes` becomes `gt.txt: has no boxes`.
    """
    try:
        yield
    except InputError as error:
        word, mark, rest = str(error).partition(": ")
        raise (InputError(f"{files[word]}{mark}{rest}") if word in files else error) from error


def _is_text(path: Path) -> bool:
    """Return whether a file is MOTChallenge text by its name, and neither a recording nor a table."""
    if path.suffix.lower() not in TEXT or open_if_ours(path, "MOTChallenge text") is not None:
        return False
    return not path.stat().st_size or not is_external(path)


def _read_both(
    tracks: Path, truth: Path, config: MultiTargetConfig, rule: str
) -> tuple[Boxes, TruthBoxes, Scene | None]:
    """Return tracks, truth, and the scene of the truth's recording (None: no recording).

    MOTChallenge text is taken to be of the camera in the other file. `rule`: name of the benchmark; if it has classes,
    also rows that are marked as not counting are read.
    """
    if not _is_text(truth):
        boxes, scene = _read_truth(truth)
        ours = _read_text(tracks, _sole_camera(truth, boxes, config), Boxes, config) if _is_text(tracks) else None
        return _read_tracks(tracks) if ours is None else ours, boxes, scene
    found, name = _tracks_of_one(tracks, config)
    last = int(found.frame[found.sensor == name].max(initial=-1))
    boxes = _read_text(truth, name, TruthBoxes, config, last, marked=rule not in DISTRACTORS)
    return found, boxes if _is_text(tracks) else timed_like(boxes, found, name, config, truth), None


def _read_annotated(tracks: Path, truth: Path, config: MultiTargetConfig, counted: str) -> tuple[Boxes, TruthBoxes]:
    """Return tracks, and true boxes of an annotation tool, of one camera of the tracks.

    Args:
        tracks: table or MOTChallenge text.
        truth: file of the tool, with frame numbers and no times.
        config: camera, frame rate.
        counted: name of the tool's format.
    """
    found, name = _tracks_of_one(tracks, config)
    boxes = read_annotation(truth, counted, name, config)
    return found, boxes if _is_text(tracks) else timed_like(boxes, found, name, config, truth)


def _tracks_of_one(path: Path, config: MultiTargetConfig) -> tuple[Boxes, str]:
    """Return the tracks, and the name of the camera that a truth without camera names is taken to be of.

    `config`: the selected camera; UsageError if the tracks are of several and none is selected.
    """
    if not _is_text(path):
        found = _read_tracks(path)
        return found, _sole_camera(path, found, config)
    name = config.cameras[0] if config.cameras else "view"
    return _read_text(path, name, Boxes, config), name


def _read_tracks(path: Path) -> Boxes:
    opened = open_input(path)
    if opened.has(ViewTracks):
        return boxes_of_ellipses(opened.read(ViewTracks))
    return opened.read(TruthBoxes) if opened.has(TruthBoxes) else opened.read(Boxes)


def _read_truth(path: Path) -> tuple[TruthBoxes, Scene | None]:
    opened = open_input(path)
    return opened.read(TruthBoxes), opened.scene


def _sole_camera(path: Path, boxes: Boxes, config: MultiTargetConfig) -> str:
    names = list(config.cameras) or np.unique(boxes.sensor).tolist()
    if len(names) != 1:
        raise UsageError(
            f"{path}: has cameras {abridged(names)}; state with {option('camera')} NAME which one the text is of",
            id="ambiguous-input",
        )
    return str(names[0])


def _read_text(
    path: Path, camera: str, table: type[B], config: MultiTargetConfig, last: int | None = None, *, marked: bool = False
) -> B:
    """Read MOTChallenge text as boxes or true boxes of a camera.

    Args:
        path: the file.
        camera: name for the rows.
        table: type of the result.
        config: frame rate.
        last: last frame that the truth covers, with rows or not; None: that of its last row.
        marked: skip the rows that are marked as not counting (confidence 0).
    """
    times: dict[str, FrameTimes] = {camera: frame_times(config)}
    if has_no_rows(path):
        empty = fill_frames(iter(()), table, [camera], [range(0 if last is None else last + 1)], times)
        return table.concat(empty) if last is not None else table.empty()
    head = first_line(path, "MOTChallenge text")
    if is_kitti(head):
        raise InputError(
            f"{path}: is KITTI text, not MOTChallenge text; ingest it (occlog ingest --boxes CAMERA={path.name})",
            id="wrong-content",
        )
    if is_header(head):
        raise InputError(
            f"{path}: begins with a header, which MOTChallenge text has not; ingest other tables of boxes (occlog "
            "ingest --boxes)",
            id="unknown-format",
        )
    file, how = [BoxFile(path, camera)], BoxOptions(drop_zero=marked, use_confidence=marked)
    survey = survey_boxes(file, (), how)
    if survey.stop > MAX_FRAMES:
        raise InputError(
            f"{path}: frame number {survey.stop} is beyond the limit of {MAX_FRAMES}; correct it", id="input-too-large"
        )
    if last is not None:
        survey = replace(survey, ranges={camera: range(max(survey.stop, last + 1))})
    rows = read_boxes(file, survey, times, (), how, table)
    return table.concat(rows if last is not None else (part.take(part.box >= 0) for part in rows))


def _sequences(compared: TruthAndTracks, scene: Scene | None) -> list[MotSequence]:
    sizes = {camera.name: camera.image_size for camera in (scene.cameras if scene is not None else ())}
    out = []
    for view, name in enumerate(compared.views):
        width, height = sizes.get(name) or image_size(compared, view)
        frames = int(compared.number[view].max()) + 1
        info = WrittenSequence(name, frames, frame_rate(compared, view), width, height)
        out.append(MotSequence(info, *view_boxes(compared, view)))
    return out
