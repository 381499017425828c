"""MOTChallenge text: boxes of one camera, written for other programs (`reader` reads it).

A line is frame (from 1), id, left, top, width, height [px], and then

    tracks      confidence, -1, -1, -1             confidence -1 where there is none
    detections  the same, with id -1
    truth       1, 1, 1                            counts, class pedestrian, visible as a whole

Numbers are written in full, so that reading them again gives the same boxes.  A sequence is a
folder with `gt/gt.txt` and `seqinfo.ini`, as TrackEval wants it.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from occlog.errors import InputError
from occlog.io.files.atomic import translate_write_errors, write_bytes
from occlog.records.tables import UNLABELLED, Boxes, TruthBoxes

Kind = Literal["tracks", "detections", "truth"]


class SequenceInfo(NamedTuple):
    """What `seqinfo.ini` says of a recording.

    Attributes:
        name: name of the sequence, which is that of its folder and of files of tracks.
        frames: number of frames, those without a box included.
        rate_hz: frames a second.
        width: of the images [px].
        height: of the images [px].
    """

    name: str
    frames: int
    rate_hz: float
    width: int
    height: int


def write_mot(path: Path, boxes: Boxes, kind: Kind, *, overwrite: bool = False) -> None:
    """Write the boxes of one camera as MOTChallenge text; frames without a box have no line.

    Args:
        path: the file.
        boxes: frames from 0; rows in any order.
        kind: what the boxes are.
        overwrite: replace a file that exists.

    Raises:
        InputError: boxes of several cameras, without an identity, or twice the same one in a frame.
        OutputExistsError: the file exists and `overwrite` is false.
        OutputError: the file cannot be written.
    """
    _check_camera(path, boxes)
    there = boxes.take(np.flatnonzero(boxes.box >= 0))
    order = np.lexsort((there.box, there.target_id, there.frame))
    there = there.take(order)
    if kind != "detections":
        _check_identities(path, there)
    write_bytes(path, "".join(_lines(there, kind)).encode(), overwrite)


def write_sequence(folder: Path, truth: TruthBoxes, info: SequenceInfo, *, overwrite: bool = False) -> None:
    """Write the true boxes of one camera as a MOTChallenge sequence: `gt/gt.txt` and `seqinfo.ini`.

    Args:
        folder: folder of the sequence, made where it is missing; its name should be `info.name`.
        truth: true boxes; frames from 0.
        info: the recording.
        overwrite: replace files that exist.

    Raises:
        InputError: as for `write_mot`, or a box lies after the last frame.
    """
    last = int(truth.frame.max()) if len(truth) else -1
    if last >= info.frames:
        raise InputError(f"{folder}: frame {last} after the last one, {info.frames - 1}; give the length of the video")
    with translate_write_errors(folder):
        (folder / "gt").mkdir(parents=True, exist_ok=True)
    write_mot(folder / "gt" / "gt.txt", truth, "truth", overwrite=overwrite)
    values = {
        "name": info.name,
        "imDir": "img1",
        "frameRate": f"{info.rate_hz:g}",
        "seqLength": info.frames,
        "imWidth": info.width,
        "imHeight": info.height,
        "imExt": ".jpg",
    }
    text = "[Sequence]\n" + "".join(f"{key}={value}\n" for key, value in values.items())
    write_bytes(folder / "seqinfo.ini", text.encode(), overwrite)


def write_sequence_list(path: Path, names: Sequence[str], *, overwrite: bool = False) -> None:
    """Write the list of sequences that TrackEval is to look at (its SEQMAP_FILE)."""
    write_bytes(path, "".join(f"{name}\n" for name in ("name", *names)).encode(), overwrite)


def _lines(boxes: Boxes, kind: Kind) -> list[str]:
    columns = (boxes.left_px, boxes.top_px, boxes.width_px, boxes.height_px)
    places = [[repr(value) for value in column.tolist()] for column in columns]
    labels = [UNLABELLED] * len(boxes) if kind == "detections" else boxes.target_id.tolist()
    sure = ["-1" if np.isnan(value) else repr(value) for value in boxes.confidence.tolist()]
    tails = ["1,1,1"] * len(boxes) if kind == "truth" else [f"{value},-1,-1,-1" for value in sure]
    rows = zip((boxes.frame + 1).tolist(), labels, *places, tails, strict=True)
    return [",".join(map(str, row)) + "\n" for row in rows]


def _check_camera(path: Path, boxes: Boxes) -> None:
    cameras = np.unique(boxes.sensor).tolist()
    if len(cameras) > 1:
        raise InputError(
            f"{path}: boxes of {len(cameras)} cameras ({', '.join(cameras)}); MOTChallenge text holds one camera, "
            "write a file for each"
        )
    if len(boxes) and boxes.frame.min() < 0:
        raise InputError(f"{path}: frame {int(boxes.frame.min())}; frames are numbered from 0")


def _check_identities(path: Path, boxes: Boxes) -> None:
    """InputError where a row of `boxes`, sorted by frame and identity, has none or that of the row before."""
    bad = np.flatnonzero(boxes.target_id < 0)
    if len(bad):
        raise InputError(
            f"{path}: the box in frame {boxes.frame[bad[0]]} has no identity; "
            "leave it out, or write the boxes as detections"
        )
    twice = np.flatnonzero((np.diff(boxes.frame) == 0) & (np.diff(boxes.target_id) == 0))
    if len(twice):
        row = int(twice[0])
        raise InputError(f"{path}: identity {boxes.target_id[row]} has two boxes in frame {boxes.frame[row]}; keep one")
