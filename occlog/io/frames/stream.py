"""Recorded images of one camera in a folder: their numbers and when they were taken.

The time of an image comes from a sidecar file if there is one (one time an image, in
natural order of the names), else from its name: a number of 18 or more digits is a time
in ns since the Unix epoch, any other last number in the name counts frames, which are
then taken at the frame rate.  A gap in the numbers is a frame that the camera did not
deliver; the cameras of one recording count from the same first number.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from occlog.array_types import Ints
from occlog.errors import InputError, UsageError
from occlog.io.files.frame_times import FrameTimes

from .folder import are_times, list_images, numbers_of
from .video_stream import rate_times, sidecar_times


@dataclass(frozen=True, eq=False)
class ImageFolder:
    """Images of one camera: (frame number, file) in order, and the times of frame numbers."""

    path: Path
    files: tuple[tuple[int, Path], ...]
    times: FrameTimes


def read_folders(
    folders: Mapping[str, Path],
    sidecars: Mapping[str, tuple[Ints, str]],
    fps: Mapping[str, Fraction],
    starts_ns: Mapping[str, int],
    first_number: int | None = None,
) -> dict[str, ImageFolder]:
    """Image folders of several cameras.

    Args:
        folders: folder of each camera.
        sidecars: (times, file name) of cameras that have a sidecar file.
        fps: frame rate of cameras whose images are numbered.
        starts_ns: time of frame 0 of each camera; 0 where not given.
        first_number: number in the name that is frame 0; None: the smallest one of all folders.
    """
    listed = {name: list_images(folder) for name, folder in folders.items()}
    numbered = [name for name in folders if name not in sidecars and not are_times(listed[name])]
    numbers = {name: numbers_of(listed[name]) for name in numbered}
    base = first_number if first_number is not None else min((n[0] for n in numbers.values()), default=0)
    out: dict[str, ImageFolder] = {}
    for name, folder in folders.items():
        files, start = listed[name], starts_ns.get(name, 0)
        if name in sidecars:
            out[name] = _with_sidecar(folder, files, *sidecars[name], start)
        elif name in numbers:
            out[name] = _numbered(name, folder, files, numbers[name], base, fps, start)
        else:
            table = np.array([int(file.stem) for file in files], dtype=np.int64)
            out[name] = ImageFolder(
                folder, tuple(enumerate(files)), FrameTimes("file names (ns)", 0, _rising(files, table))
            )
    return out


def _with_sidecar(folder: Path, files: list[Path], table: Ints, source: str, start_ns: int) -> ImageFolder:
    if len(table) != len(files):
        raise InputError(
            f"{folder}: {len(files)} images, but {source} gives {len(table)} times; give one time an image"
        )
    return ImageFolder(folder, tuple(enumerate(files)), sidecar_times(table, source, start_ns))


def _numbered(
    name: str, folder: Path, files: list[Path], numbers: list[int], base: int, fps: Mapping[str, Fraction], start: int
) -> ImageFolder:
    if name not in fps:
        raise UsageError(
            f"{folder}: nothing says when its images were taken; give the frame rate, or time stamps as {name}=FILE, "
            "or name them by their time in ns"
        )
    if numbers[0] < base:
        raise InputError(f"{files[0]}: number {numbers[0]} lies before the first number, {base}; give a smaller one")
    frames = tuple((number - base, file) for number, file in zip(numbers, files, strict=True))
    return ImageFolder(folder, frames, rate_times(fps[name], f"given; {base} is frame 0", start))


def _rising(files: list[Path], table: Ints) -> Ints:
    back = np.flatnonzero(np.diff(table) <= 0)
    if len(back):
        raise InputError(f"{files[int(back[0]) + 1]}: its time repeats or goes back; rename it")
    return table
