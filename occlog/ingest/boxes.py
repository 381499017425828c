"""Boxes in an ingest: their files, cameras, description, and boxes outside the image."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from occlog.array_types import Bools
from occlog.console.text import counted
from occlog.io.files.texts.formats import Probe
from occlog.io.files.timing.frame_times import FrameTimes
from occlog.io.formats.boxes.datasets import camera_folders, is_annotations, label_files
from occlog.io.formats.boxes.reader import BoxFile, BoxOptions, BoxSurvey, survey_boxes
from occlog.io.formats.boxes.rows import in_words
from occlog.io.frames.streams import are_times, list_images, numbers_of
from occlog.records.lens import MAX_FISHEYE_DEG
from occlog.records.losses import OUTSIDE_IMAGE, Loss
from occlog.records.messages import listed
from occlog.records.scene import Scene
from occlog.records.tables import Boxes
from occlog.records.verdicts import Check

from .box_extent import BoxExtents
from .plan import IngestPlan

B = TypeVar("B", bound=Boxes)
MIN_UPRIGHT = 0.7
"""Least vertical component of the upward direction of an image in which people are upright: a camera that is tilted or
rolled by less than 45 degrees."""
PEOPLE = frozenset({"0", "1", "person", "people", "pedestrian", "human", "head_body"})
"""Classes that may be people: numbers of COCO's and MOTChallenge's, and usual names."""
Note = Callable[[str], None]


def survey(plan: IngestPlan, scene: Scene, note: Note) -> BoxSurvey | None:
    """Read the box files of the plan to find their cameras, frames and classes, and note in one line what they hold.

    Args:
        plan: has the files and how they are read.
        scene: scene with the cameras.
        note: called with the text of the note.

    Returns:
        None if the plan has no box files.
    """
    if not plan.boxes:
        return None
    found = survey_boxes(box_files(plan), known_cameras(plan, scene), box_options(plan))
    reported = [
        " and ".join(found.kinds),
        f"{counted(found.rows, 'box', 'boxes')} of {counted(len(found.cameras), 'camera')}",
    ]
    if not found.rows and not found.beyond and found.cameras:
        reported.append(f"every frame of {', '.join(found.cameras)} is a frame without a person")
    if found.beyond:
        reported.append(f"skipped: {counted(found.beyond, 'box', 'boxes')} of other frames")
    if found.classes and any(found.classes):
        reported.append(f"class {in_words(found.classes)}")
    if found.left_out:
        reported.append(f"skipped: class {in_words(found.left_out)}")
    if found.unused:
        reported.append(f"not used: keys {listed(found.unused)}")
    frames = f"frames {found.first} to {found.stop - 1}"
    steps = {name: each.step for name, each in found.ranges.items()}
    if max(steps.values(), default=1) > 1:
        similar = len(set(steps.values())) == 1
        text = str(max(steps.values())) if similar else ", ".join(f"{step} ({name})" for name, step in steps.items())
        frames += f" in steps of {text} (the frame rate is that of all frame numbers, also of those between)"
    note(f"boxes: {', '.join(reported)}; {frames}; a frame without a box is one without a detection")
    return found


def note_frames(found: BoxSurvey, times: Mapping[str, FrameTimes], note: Note) -> None:
    """Note the frame ranges of the cameras if they differ, as with unequal frame rates; `times` are by camera."""
    frames = found.frames(times)
    if len({(each.start, each.stop) for each in frames.values()}) > 1:
        text = ", ".join(f"{name} {each[0]} to {each[-1]}" for name, each in frames.items() if each)
        note(f"boxes: frames by camera: {text}")


def box_files(plan: IngestPlan) -> list[BoxFile]:
    """Files and folders of boxes in the plan, each with its camera (or None) and the number of frame 0 (or None)."""
    return [BoxFile(path, name, _first_number(plan, name, path)) for name, path in plan.boxes]


def _first_number(plan: IngestPlan, camera: str | None, path: Path) -> int | None:
    """Number that frame 0 has in the file names of a folder of boxes: the lowest of the images, or 1 for a video's.

    The latter holds for files named after the video (`walk_1.txt`), which Ultralytics counts from 1. None if the plan
    states the number, `path` is a file, or the folder alone decides. `camera` is the one that the user names for the
    folder.
    """
    if plan.first_number is not None or not path.is_dir() or is_annotations(Probe(path, "a folder of boxes")):
        return None
    folders = [list_images(folder) for folder in plan.images.values()]
    numbered = [numbers_of(files)[0] for files in folders if not are_times(files)]
    if numbered:
        return min(numbered)
    # Ultralytics names the boxes of frame k of `walk.mp4` `walk_k.txt`, and counts from 1.
    for label, folder in camera_folders(path).items():
        video = plan.video.get(camera or label or "")
        if video is not None and all(f.stem.startswith(f"{video.stem}_") for f in label_files(folder)):
            return 1
    return None


def known_cameras(plan: IngestPlan, scene: Scene) -> list[str]:
    """Names of the cameras to which names in box files can refer.

    They are the cameras with videos, images or named box files; if there are none, all cameras of the scene.
    """
    given = _named_cameras(plan)
    return list(dict.fromkeys([*given, *([] if given else [c.name for c in scene.cameras])]))


def _named_cameras(plan: IngestPlan) -> list[str]:
    """Names of the cameras that the plan names for videos, images or boxes; they can repeat."""
    return [*plan.video, *plan.images, *(name for name, _ in plan.boxes if name is not None)]


def box_options(plan: IngestPlan, scene: Scene | None = None) -> BoxOptions:
    """Options for reading the box files of the plan.

    Cameras of `scene` give the image sizes, None: sizes are unknown.
    """
    sizes = None if scene is None else {c.name: c.image_size for c in scene.cameras if c.image_size is not None}
    return BoxOptions(
        frames=plan.frames,
        first_number=plan.first_number or 0,
        confidence_scale=plan.confidence_scale,
        scores=plan.score_type,
        ignore_extra=plan.ignore_extra_columns,
        classes=plan.classes,
        sizes=sizes,
        others=plan.allow_uncalibrated and not _named_cameras(plan),
        lenient=True,
    )


def truth_options(plan: IngestPlan, scene: Scene) -> BoxOptions:
    """Options for reading true boxes: those of detector boxes, with the frame number that is stated for the truth.

    All classes are kept unless the plan names some. A box of an unknown camera, without a size, or that is in the file
    twice, is an error.
    """
    options = replace(box_options(plan, scene), others=False, lenient=False)
    if plan.truth_first_number is not None:
        options = replace(options, first_number=plan.truth_first_number)
    return options if plan.classes else replace(options, classes=None)


def are_people(survey: BoxSurvey) -> bool:
    """Whether each class of the boxes that are read may be people; True if the files state no classes."""
    return all(PEOPLE & set(label) for label in survey.classes if label)


def inside(
    tables: Iterator[B],
    scene: Scene,
    losses: list[Loss],
    note: Note,
    found: list[Check],
    known: Collection[str] = (),
    *,
    given: bool = False,
    of_people: bool = True,
) -> Iterator[B]:
    """Generate the tables without boxes entirely outside the image or outside the valid field of a fisheye lens.

    A frame that loses all its boxes keeps a row without a box. Boxes that extend beyond the border are kept, since
    detectors complete truncated people; their number is noted.

    Args:
        tables: boxes, of cameras of the scene.
        scene: has the cameras and image sizes.
        losses: a loss for each camera with removed boxes is added at the end.
        note: called with remarks for the user.
        found: the check of the image size by box edges is added at the end.
        known: cameras with an image size that is known from images or box files, not only from the calibration.
        given: the user gives the size.
        of_people: no class of the boxes is that of other objects.
    """
    sizes = {c.name: c.image_size for c in scene.cameras if c.image_size is not None}
    upright = [c.name for c in scene.cameras if of_people and (not c.placed or -c.rotation[2, 1] > MIN_UPRIGHT)]
    extents, total = BoxExtents(sizes, upright), 0
    outside: Counter[str] = Counter()
    askew: Counter[str] = Counter()
    over: Counter[str] = Counter()
    farthest = 0.0
    for table in tables:
        width = np.array([sizes.get(name, (np.inf, np.inf))[0] for name in table.sensor.tolist()], dtype=np.float64)
        height = np.array([sizes.get(name, (np.inf, np.inf))[1] for name in table.sensor.tolist()], dtype=np.float64)
        edges = np.column_stack([table.left_px, table.top_px])
        far = edges + np.column_stack([table.width_px, table.height_px])
        size = np.column_stack([width, height])
        beyond = np.maximum(-edges, far - size)
        gone: Bools = np.asarray(((far <= 0) | (edges >= size)).any(axis=1))
        extents.add(table)
        total += int(np.count_nonzero(table.box >= 0))
        unseen = beyond_lens(table, scene) & ~gone
        askew.update(table.sensor[unseen].tolist())
        out = (beyond > 1.0).any(axis=1) & ~gone & ~unseen & np.isfinite(width)
        outside.update(table.sensor[gone].tolist())
        over.update(table.sensor[out].tolist())
        farthest = max(farthest, float(beyond[out].max(initial=0.0)))
        lost = gone | unseen
        yield without(table, lost) if lost.any() else table
    for name, count in sorted(outside.items()):
        extent = f" of {sizes[name][0]} x {sizes[name][1]} px" if name in sizes else " (below 0 px)"
        losses.append(Loss(name, "boxes", OUTSIDE_IMAGE + extent, count, total))
    losses.extend(lens_losses(askew, total))
    found.extend(extents.checks(known, given=given))
    if over:
        text = ", ".join(f"{name} {count}" for name, count in sorted(over.items()))
        note(f"boxes over the border of the image, by up to {farthest:.0f} px: {text}; kept as they are")


def beyond_lens(table: Boxes, scene: Scene) -> Bools:
    """(N,) mask of boxes that have the middle of an edge outside the valid field of a fisheye lens (80 degrees)."""
    gone = np.zeros(len(table), dtype=np.bool_)
    right, bottom = table.left_px + table.width_px, table.top_px + table.height_px
    across, down = 0.5 * (table.left_px + right), 0.5 * (table.top_px + bottom)
    for camera in (c for c in scene.cameras if c.distortion_model == "equidistant"):
        own = np.flatnonzero((table.sensor == camera.name) & (table.box >= 0))
        for u, v in ((table.left_px, down), (right, down), (across, table.top_px), (across, bottom)):
            gone[own] |= ~camera.usable(np.column_stack([u[own], v[own]]))
    return gone


def lens_losses(counts: Mapping[str, int], total: int) -> list[Loss]:
    """Losses of boxes outside the valid field of a fisheye lens, one for each camera.

    `counts` has the number of such boxes by camera, `total` is the number of all boxes.
    """
    what = f"more than {MAX_FISHEYE_DEG:.0f} degrees off the axis of a fisheye lens"
    return [Loss(name, "boxes", what, count, total) for name, count in sorted(counts.items())]


def without(table: B, gone: Bools) -> B:
    """Copy of a table without the boxes of the mask `gone` (N,), sorted by its key.

    A frame that loses all its boxes keeps one row with `box` -1.
    """
    kept = table.take(~gone)
    pairs = set(zip(kept.sensor.tolist(), kept.frame.tolist(), strict=True))
    alone: list[int] = []
    for row in np.flatnonzero(gone).tolist():
        key = (str(table.sensor[row]), int(table.frame[row]))
        if key not in pairs:
            pairs.add(key)
            alone.append(row)
    empty = table.take(np.array(alone, dtype=np.int64))
    nothing = np.full(len(empty), np.nan)
    columns = {c.name: getattr(empty, c.name) for c in table.columns()}
    columns |= dict.fromkeys(("left_px", "top_px", "width_px", "height_px", "confidence"), nothing)
    columns |= dict.fromkeys(("box", "target_id"), np.full(len(empty), -1, dtype=np.int64))
    return type(table).merge([kept, type(table).of(**columns)])
