"""Images of one camera as files in a folder: which they are, in which order, and their numbers."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path

from occlog.errors import InputError
from occlog.io.files.sensor_names import natural_sorted
from occlog.records.losses import Loss

from .codec import decode_image
from .decode import Picture

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm", ".webp")
_LAST_NUMBER = re.compile(r"(\d+)\D*$")
NS_DIGITS = 18
"""A name that is a number of so many digits is a time in ns since the Unix epoch."""


def list_images(folder: Path) -> list[Path]:
    """Image files of a folder in natural order (img2 before img10); InputError where there are none."""
    if not folder.exists():
        raise InputError(f"{folder}: no such folder; a folder of images was expected")
    if not folder.is_dir():
        raise InputError(f"{folder}: is not a folder; a folder of images was expected (videos are given one by one)")
    names = natural_sorted(p.name for p in folder.iterdir() if p.suffix.lower() in SUFFIXES and p.is_file())
    if not names:
        raise InputError(f"{folder}: holds no image ({', '.join(SUFFIXES)})")
    return [folder / name for name in names]


def numbers_of(files: list[Path]) -> list[int]:
    """The last number in each name, strictly rising; InputError where a name has none or two are equal."""
    numbers: list[int] = []
    for file in files:
        found = _LAST_NUMBER.search(file.stem)
        if found is None:
            raise InputError(f"{file}: has no number in its name; number the images, or give time stamps")
        numbers.append(int(found.group(1)))
    for n in range(1, len(files)):
        if numbers[n] <= numbers[n - 1]:
            raise InputError(
                f"{files[n]}: number {numbers[n]} does not come after {numbers[n - 1]} of {files[n - 1].name}; "
                "rename the images, or give time stamps"
            )
    return numbers


def are_times(files: list[Path]) -> bool:
    """Whether the names are times in ns since the Unix epoch (numbers of 18 or more digits)."""
    return all(file.stem.isdigit() and len(file.stem) >= NS_DIGITS for file in files)


def load(
    files: list[tuple[int, Path]],
    size: tuple[int, int],
    lost: Callable[[Loss], None],
    complaint: Callable[[], str] = lambda: "",
) -> Iterator[tuple[Picture, bytes]]:
    """Picture and file content of each image; one that cannot be used is told to `lost` and left out.

    Args:
        files: (frame number, file) in order.
        size: width and height that every image must have [px].
        lost: is called for every image that is left out.
        complaint: what the decoder has written about damage since the last call, "" if nothing.
    """
    for index, file in files:
        try:
            data = file.read_bytes()
            image = decode_image(data, file.name)
        except OSError as error:
            lost(Loss(file.parent.name, file.name, f"cannot be read: {error.strerror or error}", 1))
            continue
        except InputError as error:
            lost(Loss(file.parent.name, file.name, str(error).removeprefix(f"{file.name}: "), 1))
            continue
        said = complaint()
        found = (image.shape[1], image.shape[0])
        if said or found != size:
            odd = f"{found[0]} x {found[1]} px where {size[0]} x {size[1]} was expected"
            lost(Loss(file.parent.name, file.name, f"the decoder met damage ({said})" if said else odd, 1))
            continue
        yield Picture(index, float("nan"), image), data
