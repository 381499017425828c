"""True boxes of annotation tools that count frames and know no times: XML (PETS, CAVIAR), VATIC's and KITTI's text.

`occlog ingest --truth` reads the same files by the same readers.  Frames are those of the tracks by their numbers, so
that the times are needed in tables only.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from occlog.array_types import NS
from occlog.errors import InputError, UsageError, option
from occlog.io.boxes.reader import BoxOptions, table_times
from occlog.io.files.texts.registry import Probe, recognise
from occlog.io.files.times.frame_times import FrameTimes, as_rate
from occlog.io.frames.video_stream import rate_times
from occlog.io.open import open_if_ours
from occlog.io.truth.reader import FORMATS, TruthOptions, read_truth
from occlog.records.tables import Boxes, TruthBoxes

from .config import ManyConfig

COUNTING = ("xml", "vatic", "kitti")
"""Formats of one camera's boxes by the number of the frame."""
RATE = 25.0
"""Frames a second of files that have no times."""
MAX_FRAMES = 2_000_000
"""Most frames of text; the truth has a row for each of them."""
SAME_RATE = 0.01
"""Largest relative difference of two frame rates that are the same."""


def annotation_format(path: Path) -> str | None:
    """Name of the format of an annotation tool in which a file is; None: it is anything else."""
    if not path.is_file() or not path.stat().st_size or open_if_ours(path) is not None:
        return None
    try:
        return recognise({name: FORMATS[name] for name in COUNTING}, Probe(path, "true boxes"))
    except InputError:  # whoever reads it as another kind of file says what is wrong
        return None


def read_annotation(path: Path, name: str, camera: str, config: ManyConfig) -> TruthBoxes:
    """All true boxes of a file, those of frames that are not compared included.

    Args:
        path: the file.
        name: of its format.
        camera: whose boxes they are.
        config: frame rate and number of frame 0.

    Raises:
        InputError: the file is damaged, or its numbers of frames are too large.
    """
    how = TruthOptions(
        format=name,
        camera=camera,
        cameras=(camera,),
        times={camera: frame_times(config)},
        boxes=BoxOptions(first_number=config.first_number or 0, frames=config.frames),
    )
    tables = [table for table in read_truth(path, how) if isinstance(table, TruthBoxes)]
    truth = TruthBoxes.concat(tables)
    if not len(truth):
        chosen = "" if config.frames is None else f" in frames {config.frames[0]}:{config.frames[1]}"
        raise InputError(f"{path}: has no true box{chosen}; nothing to compare with")
    return truth


def frame_times(config: ManyConfig) -> FrameTimes:
    """Times of frames by the given rate; where none is given, 25 a second are assumed."""
    rate = RATE if config.fps is None else config.fps
    return rate_times(as_rate(rate), "assumed" if config.fps is None else "given")


def timed_like(truth: TruthBoxes, tracks: Boxes, camera: str, config: ManyConfig, path: Path) -> TruthBoxes:
    """The truth with the times that its frames have in the tracks; frames between and beyond these lie evenly.

    Args:
        truth: true boxes of a file without times.
        tracks: a table, which has times.
        camera: whose they are.
        config: the frame rate, if it is given.
        path: of the truth, for messages.

    Raises:
        UsageError: the given frame rate is not that of the tracks.
        InputError: a number of a frame is too large.
    """
    own = tracks.take(tracks.sensor == camera)
    frame, row = np.unique(own.frame, return_index=True)
    if len(frame) < 2 or not len(truth):
        return truth
    t_ns = own.t_ns[row]
    stop = int(truth.frame.max()) + 1
    if stop > MAX_FRAMES:
        raise InputError(f"{path}: frame {stop - 1}; there may be {MAX_FRAMES} frames; correct the number")
    rate = float(NS / np.median(np.diff(t_ns) / np.diff(frame)))
    if config.fps is not None and abs(config.fps - rate) > SAME_RATE * rate:
        raise UsageError(f"{option('fps')} {config.fps:g}: the tracks have {rate:.4g} frames a second; leave it out")
    known = dict(zip(frame.tolist(), t_ns.tolist(), strict=True))
    return replace(truth, t_ns=table_times(known, 0, stop, f"tracks of {camera}").at(truth.frame))


def check_counted(path: Path, name: str | None, text: bool, config: ManyConfig) -> None:
    """UsageError for a frame rate or a first number that the file with the truth has no use for.

    Args:
        path: the file.
        name: as `annotation_format` says.
        text: it is MOTChallenge text.
        config: with what was given.
    """
    if config.fps is not None and name is None and not text:
        raise UsageError(f"{option('fps')} is for a truth that counts frames; {path} has times, leave it out")
    if config.first_number is not None and name != "xml":
        raise UsageError(f"{option('first_number')} is for true boxes in XML; the frames of {path} have their numbers")
