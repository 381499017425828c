"""Frame times of a recorded video or image folder.

The time of a frame comes from a sidecar file if there is one, else from the container's
time stamps, else from the frame rate.  Which one was used is written into the recording.

Images of one camera as files in a folder: their order, their numbers and when they were taken.

The time of an image comes from a sidecar file if there is one (one time an image, in
natural order of the names), else from its name: a number of 18 or more digits is a time
in ns since the Unix epoch, any other last number in the name counts frames, which are
then taken at the frame rate.  A gap in the numbers is a frame that the camera did not
deliver; the cameras of one recording count from the same first number.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from occlog.array_types import Ints
from occlog.errors import InputError, UsageError, option
from occlog.io.files.names import is_hidden, last_number, natural_sorted
from occlog.io.files.timing.frame_times import FrameTimes, as_rate, frames_to_ns
from occlog.io.video.avi import NO_RATE
from occlog.io.video.container import Container
from occlog.io.video.reader import read_container
from occlog.records.losses import Loss

from .codec import decode_image
from .decode import Picture

STAMPS = "container time stamps"
STREAM_MARKS = (b"\0\0\0\1", b"\xff\xd8\xff")
"""First bytes of pictures without a container, which have no times: H.264 and H.265 (Annex B), motion JPEG."""


def sidecar_times(table_ns: Ints, name: str, start_ns: int = 0) -> FrameTimes:
    """Frame times from a time stamp file called `name`.

    `table_ns` (n,) has the times of frames 0..n-1 [ns], counted from `start_ns`.
    """
    return FrameTimes(f"sidecar {name}", start_ns, table_ns)


def rate_times(rate: Fraction, origin: str, start_ns: int = 0, steps: Ints | None = None) -> FrameTimes:
    """Frame times from a frame rate.

    Args:
        rate: frames per second.
        origin: where the rate comes from, for messages.
        start_ns: time of frame 0 [ns].
        steps: (n,) number of frame intervals from the start to each frame; None: frame k is k intervals after it.
    """
    source = f"frame rate {float(rate):.10g} fps ({origin})"
    if steps is None:
        return FrameTimes(source, start_ns, None, rate)
    return FrameTimes(f"{source}, with the intervals of dropped frames", start_ns, frames_to_ns(steps, rate))


def video_times(
    path: Path, stated_hz: float | None = None, *, fps: Fraction | None = None, start_ns: int = 0
) -> FrameTimes:
    """Times of the frames of a video without a time stamp file: its time stamps, or its frame rate.

    Args:
        path: the video file.
        stated_hz: frame rate that the decoder found, for containers that only it can read.
        fps: frame rate given by the user, which replaces the container's time stamps.
        start_ns: time of the first frame.

    Returns:
        Times with `table_ns` and `rate` both None if only the decoder knows the time stamps: containers other than MP4,
            MKV and AVI, and damaged ones.

    Raises:
        InputError: the file cannot be read, is a stream without a container and thus without times, or its time stamps
            repeat and it states no frame rate.
    """
    container = read_container(path)
    if fps is not None:
        return rate_times(fps, "given", start_ns, None if container is None else container.steps)
    if container is None:
        with path.open("rb") as file:
            if file.read(len(STREAM_MARKS[0])).startswith(STREAM_MARKS):
                raise InputError(
                    f"{path}: a raw stream without a container, so that frames have no times; give {option('fps')}",
                    id="missing-times",
                )
        return FrameTimes(STAMPS, start_ns)
    if (unrated := next((place for place, what in container.problems if NO_RATE in what), None)) is not None:
        raise InputError(
            f"{path}: {unrated}: {NO_RATE}, and AVI has no time stamps; give {option('fps')} or {option('timestamps')}",
            id="missing-times",
        )
    if container.stamped and _plausible(container):
        return FrameTimes(STAMPS, start_ns, container.pts_ns)
    rate = container.rate or (as_rate(stated_hz) if stated_hz else None)
    repeats = container.stamped and container.pts_ns is not None
    if rate is None:
        if repeats:
            raise InputError(
                f"{path}: times of its frames repeat, and it states no frame rate; give {option('fps')} or "
                f"{option('timestamps')}",
                id="unsorted-times",
            )
        return FrameTimes(STAMPS, start_ns)
    origin = "time stamps of the file repeat" if repeats else "stated by the file"
    return rate_times(rate, origin, start_ns, container.steps)


def _plausible(container: Container) -> bool:
    """Whether the container states strictly increasing times of its frames."""
    return container.pts_ns is not None and bool((np.diff(container.pts_ns) > 0).all())


SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm", ".webp")
MAX_DIGITS = 40
"""Digits of a number that is read."""
NS_DIGITS = 18
"""A name that is a number of this many digits is a time in ns since the Unix epoch."""


def list_images(folder: Path) -> list[Path]:
    """Image files of a folder in natural order (img2 before img10); InputError if the folder or images are missing."""
    if not folder.exists():
        raise InputError(f"{folder}: no such folder; a folder of images was expected", id="file-not-found")
    if not folder.is_dir():
        raise InputError(
            f"{folder}: is a file; a folder of images was expected (a video has an option of its own)", id="not-a-file"
        )
    names = natural_sorted(
        p.name for p in folder.iterdir() if p.suffix.lower() in SUFFIXES and not is_hidden(p) and p.is_file()
    )
    if not names:
        raise InputError(f"{folder}: holds no image ({', '.join(SUFFIXES)})", id="empty-input")
    return [folder / name for name in names]


def numbers_of(files: list[Path]) -> list[int]:
    """Last number in the name of each file, as its frame number.

    InputError if a name has none, or numbers do not strictly increase or reach `MAX_FRAMES`.
    """
    from occlog.records.declared.sensors import MAX_FRAMES  # which the process that decodes does not need

    numbers: list[int] = []
    for file in files:
        found = last_number(file.stem)
        if found is None:
            raise InputError(
                f"{file}: has no number in its name; number the images, or give {option('timestamps')}",
                id="missing-times",
            )
        number = int(found) if len(found) < MAX_DIGITS else MAX_FRAMES
        if number >= MAX_FRAMES:
            raise InputError(
                f"{file}: frame {found:.24}; it must be below {MAX_FRAMES}; if it is a time in ms or us, write ns, or "
                f"give {option('timestamps')}"
            )
        numbers.append(number)
    for n in range(1, len(files)):
        if numbers[n] <= numbers[n - 1]:
            raise InputError(
                f"{files[n]}: number {numbers[n]} does not come after {numbers[n - 1]} of {files[n - 1].name}; "
                f"rename the images, or give {option('timestamps')}",
                id="unsorted-times",
            )
    return numbers


def are_times(files: list[Path]) -> bool:
    """Whether the names of all files are times [ns since the Unix epoch] (18 or more digits)."""
    return all(file.stem.isdigit() and len(file.stem) >= NS_DIGITS for file in files)


def load(
    files: list[tuple[int, Path]],
    size: tuple[int, int],
    lost: Callable[[Loss], None],
    complaint: Callable[[], str] = lambda: "",
) -> Iterator[tuple[Picture, bytes]]:
    """Yield each usable image of a folder, with the bytes of its file; others are reported to `lost` and skipped.

    Args:
        files: (frame number, file) in order.
        size: width and height that every image must have [px].
        lost: called with a loss for every image that is skipped.
        complaint: returns what the decoder has written about damage since the last call, "" if nothing.
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
        text = complaint()
        found = (image.shape[1], image.shape[0])
        if text or found != size:
            odd = f"{found[0]} x {found[1]} px where {size[0]} x {size[1]} was expected"
            lost(Loss(file.parent.name, file.name, f"the decoder met damage ({text})" if text else odd, 1))
            continue
        picture = Picture(index, float("nan"), image)
        del image  # only whoever takes it holds it: the next may need as much memory
        yield picture, data
        del picture


@dataclass(frozen=True, eq=False)
class ImageFolder:
    """Images of one camera in a folder: (frame number, file) in order, and the times of frame numbers."""

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
    """Find the images of several cameras, with their frame numbers and times, in folders.

    Args:
        folders: folder of each camera.
        sidecars: (times [ns], file name) of cameras that have a time stamp file.
        fps: frame rate of cameras with numbered images.
        starts_ns: time of frame 0 of each camera [ns]; 0 if not given.
        first_number: number in the name that is frame 0; None: the smallest one of all folders.

    Raises:
        InputError: images are missing, or their names have no increasing numbers or times.
        UsageError: numbered images have no frame rate, or images named by times have a start time.
    """
    from occlog.records.columns import MAX_NS

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
        elif start:
            raise UsageError(
                f"{folder}: names of images are times since 1970; omit {option('start_time')}", id="not-applicable"
            )
        else:
            far = next((file for file in files if len(file.stem) > MAX_DIGITS or int(file.stem) > MAX_NS), None)
            if far is not None:
                raise InputError(
                    f"{far}: the time in ns in its name is out of range, 1970 to 2115; rename it",
                    id="time-out-of-range",
                )
            table = np.array([int(file.stem) for file in files], dtype=np.int64)
            out[name] = ImageFolder(
                folder, tuple(enumerate(files)), FrameTimes("file names (ns)", 0, _rising(files, table))
            )
    return out


def _with_sidecar(folder: Path, files: list[Path], table: Ints, source: str, start_ns: int) -> ImageFolder:
    if len(table) != len(files):
        raise InputError(
            f"{folder}: {len(files)} images, but {source} has {len(table)} times; give one time for each image",
            id="incompatible-inputs",
        )
    return ImageFolder(folder, tuple(enumerate(files)), sidecar_times(table, source, start_ns))


def _numbered(
    name: str, folder: Path, files: list[Path], numbers: list[int], base: int, fps: Mapping[str, Fraction], start: int
) -> ImageFolder:
    if name not in fps:
        raise UsageError(
            f"{folder}: nothing states when its images were taken; give the frame rate ({option('fps')}), or time "
            f"stamps ({option('timestamps')} {name}=FILE), or name them by their time in ns",
            id="missing-times",
        )
    if numbers[0] < base:
        raise InputError(
            f"{files[0]}: number {numbers[0]} is before {option('first_number')} {base}; give a smaller first number"
        )
    frames = tuple((number - base, file) for number, file in zip(numbers, files, strict=True))
    return ImageFolder(folder, frames, rate_times(fps[name], f"given; {base} is frame 0", start))


def _rising(files: list[Path], table: Ints) -> Ints:
    back = np.flatnonzero(np.diff(table) <= 0)
    if len(back):
        raise InputError(
            f"{files[int(back[0]) + 1]}: the time in its name repeats or goes back; rename it", id="unsorted-times"
        )
    return table
