"""MOTChallenge text and folders: boxes written for other programs (`reader` reads the text).

A file has the boxes of one camera.  A line is frame (from 1), id, left, top, width, height [px], and then

    tracks      confidence, -1, -1, -1             confidence -1 if missing
    detections  the same, with id -1
    truth       1, 1, 1                            counts, class pedestrian, visible as a whole

Numbers are written in full, so that reading them again gives the same boxes.  The folder that
TrackEval evaluates has truth, and tracks of one or several programs:

    gt/MOT17-train/SEQUENCE/gt/gt.txt, seqinfo.ini
    gt/seqmaps/MOT17-train.txt
    trackers/MOT17-train/TRACKER/data/SEQUENCE.txt

TrackEval reads MOT17-train when nothing else is stated, so that it needs the two folders only.

Classes of MOTChallenge truth: which true boxes are pedestrians that count, and which are of something else.

The truth of MOT16, MOT17 and MOT20 has two columns after the box and the mark: class and visible share.  That of MOT15
has none, but three of a position in the world.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from occlog.array_types import Bools, Ints
from occlog.errors import InputError, OutputError, OutputExistsError, abridged, option
from occlog.io.files.atomic import folder_beside, translate_write_errors, write_bytes
from occlog.io.files.texts.csv_rows import CsvRows, read_plain
from occlog.records.tables import UNLABELLED, Boxes, TruthBoxes

SEQUENCE_INFO = "seqinfo.ini"
Kind = Literal["tracks", "detections", "truth"]


class WrittenSequence(NamedTuple):
    """Content of MOTChallenge's `seqinfo.ini` of a sequence.

    Attributes:
        name: name of the sequence, which is that of its folder and of files of tracks.
        frames: number of frames, including those without a box.
        rate_hz: frames per second.
        width: of the images [px].
        height: of the images [px].
    """

    name: str
    frames: int
    rate_hz: float
    width: int
    height: int

    def text(self) -> str:
        """Text of the file `seqinfo.ini`."""
        values = {
            "name": self.name,
            "imDir": "img1",
            "frameRate": f"{self.rate_hz:g}",
            "seqLength": self.frames,
            "imWidth": self.width,
            "imHeight": self.height,
            "imExt": ".jpg",
        }
        return "[Sequence]\n" + "".join(f"{key}={value}\n" for key, value in values.items())


def write_mot(path: Path, boxes: Boxes, kind: Kind, *, overwrite: bool = False) -> None:
    """Write the boxes of one camera as MOTChallenge text (frames from 1); frames without a box have no line.

    Args:
        path: the file.
        boxes: frames from 0; rows in any order.
        kind: `tracks`, `detections` (identities are not written) or `truth`.
        overwrite: replace an existing file.

    Raises:
        InputError: boxes are of several cameras, without an identity, or one identity is twice in a frame.
        OutputExistsError: the file exists and `overwrite` is false.
        OutputError: the file cannot be written.
    """
    write_bytes(path, mot_text(path, boxes, kind).encode(), overwrite)


def mot_text(path: Path, boxes: Boxes, kind: Kind) -> str:
    """Boxes of one camera as MOTChallenge text (frames from 1), sorted by frame and identity.

    Args:
        path: file named in messages.
        boxes: frames from 0; rows in any order.
        kind: `tracks`, `detections` (identities are not written) or `truth`.

    Raises:
        InputError: boxes are of several cameras, without an identity, or one identity is twice in a frame.
    """
    _check_camera(path, boxes)
    there = boxes.take(np.flatnonzero(boxes.box >= 0))
    order = np.lexsort((there.box, there.target_id, there.frame))
    there = there.take(order)
    if kind != "detections":
        _check_identities(path, there)
    return "".join(_lines(there, kind))


def write_sequence(folder: Path, truth: TruthBoxes, info: WrittenSequence, *, overwrite: bool = False) -> None:
    """Write the true boxes of one camera as a MOTChallenge sequence: `gt/gt.txt` and `seqinfo.ini`.

    Args:
        folder: folder of the sequence, made if missing; its name should be `info.name`.
        truth: true boxes; frames from 0.
        info: content of `seqinfo.ini`.
        overwrite: replace existing files.

    Raises:
        InputError: boxes are of several cameras, without an identity, repeated, or after the last frame.
        OutputError: a file exists and `overwrite` is false, or cannot be written.
    """
    last = int(truth.frame.max()) if len(truth) else -1
    if last >= info.frames:
        raise InputError(
            f"{folder}: not written: the truth has a box in frame {last}, but the last frame of the sequence is "
            f"{info.frames - 1}; remove it from the truth"
        )
    with translate_write_errors(folder):
        (folder / "gt").mkdir(parents=True, exist_ok=True)
    write_mot(folder / "gt" / "gt.txt", truth, "truth", overwrite=overwrite)
    write_bytes(folder / SEQUENCE_INFO, info.text().encode(), overwrite)


def write_sequence_list(path: Path, names: Sequence[str], *, overwrite: bool = False) -> None:
    """Write the list of sequences, by their names, that TrackEval is to evaluate (its SEQMAP_FILE)."""
    write_bytes(path, "".join(f"{name}\n" for name in ("name", *names)).encode(), overwrite)


def _lines(boxes: Boxes, kind: Kind) -> list[str]:
    columns = (boxes.left_px, boxes.top_px, boxes.width_px, boxes.height_px)
    cells = [[repr(value) for value in column.tolist()] for column in columns]
    labels = [UNLABELLED] * len(boxes) if kind == "detections" else boxes.target_id.tolist()
    sure = ["-1" if np.isnan(value) else repr(value) for value in boxes.confidence.tolist()]
    tails = ["1,1,1"] * len(boxes) if kind == "truth" else [f"{value},-1,-1,-1" for value in sure]
    rows = zip((boxes.frame + 1).tolist(), labels, *cells, tails, strict=True)
    return [",".join(map(str, row)) + "\n" for row in rows]


def _check_camera(path: Path, boxes: Boxes) -> None:
    cameras = np.unique(boxes.sensor).tolist()
    if len(cameras) > 1:
        raise InputError(
            f"{path}: not written: boxes of {len(cameras)} cameras ({abridged(cameras)}); MOTChallenge text "
            "holds one camera, write a file for each",
            id="ambiguous-input",
        )
    if len(boxes) and boxes.frame.min() < 0:
        raise InputError(
            f"{path}: not written: a box has frame number {int(boxes.frame.min())}, and frames are numbered from 0; "
            "correct the boxes that are exported"
        )


def _check_identities(path: Path, boxes: Boxes) -> None:
    """InputError if a box has no identity, or a frame has two boxes of one.

    `boxes` are sorted by frame and identity.
    """
    bad = np.flatnonzero(boxes.target_id < 0)
    if len(bad):
        raise InputError(
            f"{path}: not written: a box in frame {boxes.frame[bad[0]]} has no identity, which truth and tracks need; "
            "give it one, or leave it out of the boxes that are exported",
            id="missing-labels",
        )
    twice = np.flatnonzero((np.diff(boxes.frame) == 0) & (np.diff(boxes.target_id) == 0))
    if len(twice):
        row = int(twice[0])
        raise InputError(
            f"{path}: not written: identity {boxes.target_id[row]} has two boxes in frame {boxes.frame[row]}; keep one "
            "in the boxes that are exported",
            id="duplicate-row",
        )


BENCHMARK = "MOT17-train"
_NAME = re.compile(r"^[^\s/\\,:]{1,64}$")


class MotSequence(NamedTuple):
    """True boxes and tracks of one camera as a MOTChallenge sequence, with the content of its `seqinfo.ini`."""

    info: WrittenSequence
    truth: TruthBoxes
    tracks: Boxes


def write_layout(folder: Path, tracker: str, sequences: Sequence[MotSequence], *, overwrite: bool = False) -> None:
    """Write truth and tracks of several sequences as the folders that TrackEval reads (benchmark MOT17-train).

    Existing truth with the same content is kept, so that tracks of several programs can share a folder. All files are
    written next to the folder first, and moved when complete.

    Args:
        folder: made if missing.
        tracker: name of the program that made the tracks.
        sequences: one for each camera.
        overwrite: replace files that exist with another content.

    Raises:
        InputError: a name cannot be that of a file, or boxes are invalid.
        OutputExistsError: a file exists with another content and `overwrite` is false.
        OutputError: the folder is a file or cannot be written.
    """
    for name in (tracker, *(s.info.name for s in sequences)):
        if not _NAME.match(name) or name.startswith("."):
            raise InputError(f"{folder}: {name!r} cannot be the name of a sequence or a tracker; rename the file")
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{folder}: is a file; name a folder")
    if not folder.parent.is_dir():
        raise OutputError(f"{folder}: the folder {folder.parent} does not exist; make it first")
    with folder_beside(folder) as temporary:
        _fill(temporary, tracker, sequences)
        _move(temporary, folder, overwrite)


def _fill(folder: Path, tracker: str, sequences: Sequence[MotSequence]) -> None:
    data = folder / "trackers" / BENCHMARK / tracker / "data"
    with translate_write_errors(folder):
        data.mkdir(parents=True)
        (folder / "gt" / "seqmaps").mkdir(parents=True)
    for info, truth, tracks in sequences:
        write_sequence(folder / "gt" / BENCHMARK / info.name, truth, info)
        write_mot(data / f"{info.name}.txt", tracks, "tracks")
    write_sequence_list(folder / "gt" / "seqmaps" / f"{BENCHMARK}.txt", [s.info.name for s in sequences])


def _move(temporary: Path, folder: Path, overwrite: bool) -> None:
    """Move the files of a temporary folder that are new or changed to the same places in `folder`.

    OutputExistsError, and nothing is moved, if a file exists with another content and `overwrite` is false.
    """
    files = sorted(path for path in temporary.rglob("*") if path.is_file())
    new = []
    with translate_write_errors(folder):
        for path in files:
            target = folder / path.relative_to(temporary)
            same = target.is_file() and target.read_bytes() == path.read_bytes()
            if target.exists() and not same and not overwrite:
                raise OutputExistsError(f"{target}: exists with another content")
            if not same:
                new.append((path, target))
        for path, target in new:
            target.parent.mkdir(parents=True, exist_ok=True)
            path.replace(target)


PEDESTRIAN = 1
CLASSES = 13
"""Classes are numbered from 1 to this many."""
DISTRACTORS = {"mot17": (2, 7, 8, 12), "mot20": (2, 6, 7, 8, 12)}
"""Person on a vehicle, static person, distractor, reflection, and in MOT20 vehicles without a motor: whoever tracks one
of these is neither right nor wrong.  MOT16 has the rule of MOT17."""
WITH_CLASSES = (8, 9)
"""Columns of a truth with classes, with and without the visible share."""
WHAT = "MOTChallenge truth"


class Marks(NamedTuple):
    """Columns of the n rows of a MOTChallenge truth file without the box: frame, identity, mark and class."""

    frame: Ints  # (n,) from 0
    target_id: Ints  # (n,)
    counts: Bools  # (n,) its mark is not 0
    kind: Ints  # (n,) class, 1 to `CLASSES`


def has_classes(path: Path) -> bool:
    """Whether a MOTChallenge truth file has a class column (8 or 9 columns); InputError for a file without data."""
    return len(next(read_plain(path, WHAT)).cells) in WITH_CLASSES


def read_marks(path: Path) -> Marks:
    """Frame, identity, evaluation mark and class of each row of a MOTChallenge truth file that has classes.

    InputError, with the line, for an invalid class.
    """
    parts = [_marks(rows) for rows in read_plain(path, WHAT)]
    return Marks._make(np.concatenate(column) for column in zip(*parts, strict=True))


def _marks(rows: CsvRows) -> Marks:
    kind = rows.ints("7")
    bad = (kind < 1) | (kind > CLASSES)
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise rows.fail(
            row,
            f"class {kind[row]} outside 1 to {CLASSES}; correct it, or give {option('benchmark')} mot15 for truth "
            "without classes",
        )
    return Marks(rows.ints("0") - 1, rows.ints("1"), rows.floats("6") != 0, kind)
