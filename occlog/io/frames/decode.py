"""Decoding of a video's frames by OpenCV (FFmpeg), forwards only, with frame numbers.

A decoder that skips a damaged frame does not report it. Each picture is therefore matched by its time stamp with the
container's list of frames. `FrameLedger` records which frames were delivered and why others were not.
"""

from __future__ import annotations

import math
import shlex
import struct
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, field, replace
from fractions import Fraction
from itertools import chain, pairwise
from pathlib import Path

import cv2
import numpy as np

from occlog.array_types import NS, Ints
from occlog.errors import InputError
from occlog.io.files.limits import check_input
from occlog.io.files.names import utf8_name
from occlog.io.files.programs import refuse_unread
from occlog.io.video.container import MIRRORS, SHEARED, SLACK, SPHERE, STEREO, Container
from occlog.io.video.reader import read_container
from occlog.records.frames import Image
from occlog.records.losses import Loss

from .codec import DARK, DARK_16, FULL, Changes, Facts, dark_bars, dim_values, is_dark, size_at
from .limits import MAX_PIXELS

MAX_SEGMENTS = 20
"""Lost sections listed one by one; the rest is added up in one line."""
NO_DECODER = ("hardware accelerated AV1", "No decoder", "no decoder")
"""What the decoder states of a video that is whole, for a codec that OpenCV was built without."""
ESTIMATE_SLACK = 0.02
"""Relative error allowed to a frame count that is only the container's estimate."""


class FrameLedger:
    """Record of which frames start <= number < stop of a video were delivered, and why others were not."""

    def __init__(
        self,
        path: Path,
        container: Container | None,
        frames: int | None,
        size: tuple[int, int],
        start: int,
        stop: int | None,
    ) -> None:
        self.met = 0
        self._misplaced = False
        self._path, self._container, self._frames, self._size = path, container, frames, size
        self._start, self._stop = start, stop
        listed = container.frames if container else None
        self._seen = None if listed is None else np.zeros(listed, dtype=np.bool_)
        self._last = start - 1
        self._unplaced = 0
        self._complaints: list[tuple[int, str]] = []
        self._odd: list[tuple[int, tuple[int, int]]] = []
        self._refused: dict[str, list[int]] = {}

    def accept(self, index: int) -> bool:
        """Whether picture `index` is used.

        It is if it has a number, is in the range, later than the last one, and its bytes are complete in the file.
        Pictures without a number (-1), or in the range and not later than the last one, are counted.
        """
        if index < 0 or (self._start <= index <= self._last):
            self._unplaced += 1
            return False
        if index < self._start or (self._stop is not None and index >= self._stop):
            return False
        self._last = index
        broken = self._container.broken if self._container is not None else ()
        return index >= len(broken) or not broken[index]

    def note(self, index: int, complaint: str) -> None:
        """Record the decoder's message about damage of picture `index`, which is delivered nevertheless.

        Empty: no message.
        """
        if complaint:
            self._complaints.append((index, complaint))

    def refuse(self, index: int, why: str) -> None:
        """Record that picture `index` is not used, and why."""
        self._refused.setdefault(why, []).append(index)
        self._see(index)

    def _see(self, index: int) -> None:
        if self._seen is not None and index < len(self._seen):
            self._seen[index] = True

    def fits(self, index: int, size: tuple[int, int]) -> bool:
        """Record that picture `index` was decoded; return whether it has the expected size (width, height)."""
        self.met += 1
        self._see(index)
        if size == self._size:
            return True
        self._odd.append((index, size))
        return False

    def misplaced(self) -> None:
        """Record that pictures are stored in another order than shown, and some dropped: numbers are uncertain."""
        self._misplaced = True

    def faults(self) -> Iterator[Loss]:
        """Yield a loss for each fault of the container itself."""
        for location, what in self._container.problems if self._container else ():
            yield Loss(self._path.name, location, what)

    def check_any(self) -> None:
        """Raise InputError unless a frame of the range was delivered."""
        if self.met:
            return
        if self._refused:
            raise InputError(f"{self._path}: {next(iter(self._refused))}")
        if self._frames is not None and self._start >= self._frames:
            raise InputError(
                f"{self._path}: frames from {self._start} on are requested, but it has only {self._frames}; request "
                "earlier ones",
                id="time-out-of-range",
            )
        faults = "".join(
            f"; {location}: {what}" for location, what in (self._container.problems if self._container else ())
        )
        raise InputError(
            f"{self._path}: not one of the requested frames can be used{faults}; copy or repair the file",
            id="damaged-file",
        )

    def report(self, lost: Callable[[Loss], None]) -> None:
        """Call `lost` with a loss for each run of frames that are missing, refused, of another size or damaged.

        Faults of the container are reported, too, if there are any such frames or the video was read to its end.
        """
        losses = [*self._missing(), *self._odd_sizes(), *self._reported()]
        for why, frames in self._refused.items():
            losses += _segments(self._path.name, np.array(frames, dtype=np.int64), why)
        if self._misplaced:
            what = "pictures are stored in another order than shown, and some were dropped: times near these may be off"
            losses.append(Loss(self._path.name, "dropped frames", what))
        if self._unplaced:
            what = "pictures without a position in the container's list of frames were skipped"
            losses.append(Loss(self._path.name, "behind the damage", what, self._unplaced))
        if losses or self._stop is None:
            for loss in (*self.faults(), *losses):
                lost(loss)

    def _missing(self) -> Iterator[Loss]:
        if self._seen is None or self._container is None:
            yield from self._estimated()
            return
        gone = np.flatnonzero(~self._seen[self._start : self._stop]) + self._start
        broken = self._container.broken[gone]
        absent = "not in the file, or not completely"
        yield from _segments(self._path.name, gone[broken], absent)
        yield from _segments(self._path.name, gone[~broken], "could not be decoded")

    def _estimated(self) -> Iterator[Loss]:
        """Yield a loss if fewer frames were decoded than the decoder estimates; for containers occlog cannot parse."""
        if self._frames is None:
            return
        wanted = (self._frames if self._stop is None else min(self._frames, self._stop)) - self._start
        met = self.met + sum(map(len, self._refused.values()))
        if met < wanted * (1 - ESTIMATE_SLACK) - 1:
            what = f"{met} frames decoded where the file announces about {wanted}"
            yield Loss(self._path.name, f"after frame {self._last}", what, wanted - met)

    def _odd_sizes(self) -> Iterator[Loss]:
        for size in dict.fromkeys(s for _, s in self._odd):
            frames = np.array([i for i, s in self._odd if s == size], dtype=np.int64)
            want = f"{self._size[0]} x {self._size[1]}"
            yield from _segments(self._path.name, frames, f"{size[0]} x {size[1]} px where {want} was expected")

    def _reported(self) -> Iterator[Loss]:
        """Yield a loss for each run of pictures that were delivered with messages of the decoder about damage."""
        texts = dict(self._complaints)
        for loss in _segments(self._path.name, np.array(sorted(texts), dtype=np.int64), ""):
            first = texts[int(loss.place.split()[1].split("-")[0])] if loss.place.startswith("frame") else "errors"
            what = f"the decoder reported damage ({first}); the image and those built on it may be wrong"
            yield Loss(loss.source, loss.place, what)


def _segments(source: str, frames: Ints, what: str) -> Iterable[Loss]:
    """Yield a loss for each run of consecutive numbers in the sorted frame numbers (n,).

    After `MAX_SEGMENTS` runs the rest is one loss.

    Args:
        source: name of the file.
        frames: (n,) increasing frame numbers.
        what: what is wrong with them.
    """
    runs = np.split(frames, np.flatnonzero(np.diff(frames) > 1) + 1) if len(frames) else []
    for run in runs[:MAX_SEGMENTS]:
        location = f"frame {run[0]}" if len(run) == 1 else f"frames {run[0]}-{run[-1]}"
        yield Loss(source, location, what, len(run))
    rest = runs[MAX_SEGMENTS:]
    if rest:
        location = f"{len(rest)} more sections in frames {rest[0][0]}-{rest[-1][-1]}"
        yield Loss(source, location, what, sum(map(len, rest)))


PATIENCE = 64
"""Failed reads in a row, beyond the frames still expected, after which the file is taken to be at its end."""
NO_PTS = 2.0**62
"""Least time stamp of FFmpeg's for a frame without one (AV_NOPTS_VALUE); OpenCV divides none of it away."""
MAX_HELD = 16
"""Pictures that a decoder holds to bring them into their order, at most (H.264)."""
TRIAL = 4
"""Pictures that must fit the container's list of frames before it is trusted."""
WHAT = "a video file"
CAPTURE_OPTIONS = (
    "protocol_whitelist;file|format_whitelist;mov,mp4,matroska,webm,avi,mpegts,mpeg,mpegvideo,flv,asf,ogg,mxf,h264,"
    "hevc,mjpeg,jpeg_pipe,png_pipe,m4v,ivf,y4m,yuv4mpegpipe,dv,gif,apng,nut,rawvideo"
)
"""Protocols that FFmpeg may open: files, and no play lists."""


DEEP_CODES = ("RGB0", "BGR0", "RBA@", "BRA@")
"""Codes of pixel formats of 16 bits that do not end with the number of bits."""


@dataclass(frozen=True, slots=True)
class Picture:
    """A decoded frame: number, time since the start of the file [ns] (NaN: unknown), and image."""

    index: int
    pos_ns: float
    image: Image


@dataclass(frozen=True)
class VideoFile:
    """An open video with its first frame decoded: its properties, and the decoder.

    The frames of the decoder can be read once.
    """

    path: Path
    size: tuple[int, int]  # width, height
    frames: int | None
    rate_hz: float | None
    container: Container | None
    bars: tuple[int, int, int, int]  # black, at the left, top, right and lower edge [px]
    deep: bool  # values of 16 bits, of which the decoder gives the upper 8
    facts: Facts  # what the file states of its pictures
    start_s: float  # time stamp of the first frame in the file, which counts as 0; NaN: not known
    capture: cv2.VideoCapture = field(repr=False)
    raw: Iterator[_Raw] = field(repr=False)


def examine(
    path: Path, allow_pixels: Callable[[int], None] = lambda _: None, complaint: Callable[[], str] = lambda: ""
) -> VideoFile:
    """Open a video and decode its first frame; return its size, frame count, rate and other properties.

    Args:
        path: the video file.
        allow_pixels: called with the number of pixels of a frame, which is within the limit, before one is decoded.
        complaint: returns what the decoder has written about damage since the last call, "" if nothing.

    Raises:
        InputError: the file is no video, frames are too large, or not one frame can be decoded.
    """
    check_input(path, WHAT)
    container = read_container(path)
    capture = _open(path, container)
    try:
        return _describe(path, capture, container, allow_pixels, complaint)
    except BaseException:
        capture.release()
        raise


def _open(path: Path, container: Container | None) -> cv2.VideoCapture:
    # One thread: the frames from a damaged file must not depend on the machine.
    with utf8_name(path.resolve()) as name:
        capture = cv2.VideoCapture(name, cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1])
    if capture.isOpened():
        if container is not None and container.mirror:
            # OpenCV would take the matrix of a mirror for that of a rotation
            capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
        return capture
    if container is None:
        refuse_unread(path)
        raise InputError(
            f"{path}: not a video file that FFmpeg can read; convert it to MP4, MKV or AVI",
            id="unknown-format",
        )
    faults = _faults(container) or "; its header is damaged"
    raise InputError(f"{path}: the video cannot be opened{faults}; copy or repair it", id="damaged-file")


def _describe(
    path: Path,
    capture: cv2.VideoCapture,
    container: Container | None,
    allow_pixels: Callable[[int], None],
    complaint: Callable[[], str],
) -> VideoFile:
    size = (int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)))
    if size[0] * size[1] > MAX_PIXELS:
        raise InputError(
            f"{path}: frames of {size[0]} x {size[1]} px; the limit is {MAX_PIXELS} pixels; scale them down",
            id="input-too-large",
        )
    allow_pixels(size[0] * size[1])
    fps = capture.get(cv2.CAP_PROP_FPS)
    rate = float(container.rate) if container and container.rate else fps
    count = capture.get(cv2.CAP_PROP_FRAME_COUNT)
    frames = container.frames if container else (int(count) if 0 < count < 2**31 else None)
    # Those with bytes that are not in the file need not be waited for
    there = frames if container is None or frames is None else frames - int(container.broken.sum())
    heard: list[str] = []

    def output() -> str:
        text = complaint()
        if text and not heard:
            heard.append(text)
        return text

    output()  # opening decodes the first pictures, of which FFmpeg writes again when they are decoded in turn
    pictures = _raw_pictures(there, capture, output, MIRRORED.get(container.mirror) if container else None)
    first = next(pictures, None)
    image, unconverted = first.fetch(None) if first is not None else (None, "")
    if unconverted:
        raise InputError(f"{path}: {_remedied(path, unconverted)}", id="damaged-file")
    if first is None or image is None:
        decoder = f"; the decoder states: {heard[0]}" if heard else ""
        lacking = any(words in text for text in heard for words in NO_DECODER)
        remedy = f"convert it: {_conversion(path)}" if lacking else "copy or repair the file"
        raise InputError(
            f"{path}: not one frame can be decoded{_faults(container)}{decoder}; {remedy}",
            id="unsupported-format" if lacking else "damaged-file",
        )
    size = (image.shape[1], image.shape[0])
    rate_hz = rate if 1e-6 < rate <= 1e6 else None
    start_s = _start_s(capture, first)
    if frames is not None and start_s > 0.0 and _begins_with(path, b"FLV"):
        frames -= round(start_s * fps)  # estimated from its duration, which counts from 0
    code = struct.pack("<I", int(capture.get(cv2.CAP_PROP_CODEC_PIXEL_FORMAT)) & 0xFFFFFFFF)
    deep = code.decode("latin-1") in DEEP_CODES or code[::-1].decode("latin-1") in DEEP_CODES or 16 in code[::3]
    return VideoFile(
        path=path,
        size=size,
        frames=frames,
        rate_hz=rate_hz,
        container=container,
        bars=dark_bars(image),
        deep=deep,
        facts=[
            *_tracks(container),
            *_orientation(capture, container),
            *_aspect(capture, container),
            *(dim_values(int(image.max()), FULL) if deep else ()),
        ],
        start_s=start_s,
        capture=capture,
        raw=chain([first], pictures),
    )


def _begins_with(path: Path, mark: bytes) -> bool:
    with path.open("rb") as file:
        return file.read(len(mark)) == mark


def _remedied(path: Path, what: str) -> str:
    """Why the decoder cannot convert the pictures of a video, and a command that converts the file.

    `what` is FFmpeg's message.
    """
    if "interlaced" in what.lower():
        command = _conversion(path, "-vf bwdif=send_frame ")
        return f"it is interlaced, of which OpenCV makes no pictures; deinterlace it: {command}"
    return f"OpenCV makes no pictures of it ({what}); convert it: {_conversion(path)}"


def _conversion(path: Path, filters: str = "") -> str:
    """FFmpeg command, for the user, that converts the video `path` to H.264; `filters` are further options."""
    made = shlex.quote(str(path.with_name(f"{path.stem}-converted.mp4")))
    return f"ffmpeg -i {shlex.quote(str(path))} {filters}-an -c:v libx264 -crf 12 {made}"


def _orientation(capture: cv2.VideoCapture, container: Container | None) -> Facts:
    """Fact (id of a finding with values) that a video file asks for rotated or mirrored pictures; empty if it does not.

    `pictures-turned` if the decoder applies this, `pictures-not-turned` if not; of rotations, multiples of 90 degrees
    are applied, and nothing but rotations and mirrors.
    """
    mirror, undone = ("", "") if container is None else (container.mirror, container.undone)
    facts: Facts = [("pictures-not-turned", {"how": undone})] if undone else []
    if mirror:
        return [("pictures-turned" if mirror in MIRRORED else "pictures-not-turned", {"how": f"mirrored {mirror}"})]
    angle = float(capture.get(cv2.CAP_PROP_ORIENTATION_META))
    if undone not in ("", SPHERE, STEREO) or not 0.0 < abs(angle) < 360.0:  # a matrix of zeros has no angle
        return facts
    turned = "pictures-turned" if angle in (90.0, 180.0, 270.0) else "pictures-not-turned"
    return [*facts, (turned, {"how": f"rotated by {angle:g} deg"})]


def _tracks(container: Container | None) -> Facts:
    """Fact (id of a finding with values) that a video file has several video tracks; empty if it has one."""
    return [("video-tracks", {"count": container.tracks})] if container is not None and container.tracks > 1 else []


def _aspect(capture: cv2.VideoCapture, container: Container | None) -> Facts:
    """Fact (id of a finding with values) that pixels of a video are not square; empty if they are.

    Stated are the pixels of the pictures as they are turned.
    """
    across, down = capture.get(cv2.CAP_PROP_SAR_NUM), capture.get(cv2.CAP_PROP_SAR_DEN)
    pixel = across / down if min(across, down) > 0 else 1.0
    # Of a matrix that turns and stretches FFmpeg takes the scales of the other axes
    if container is not None and min(abs(container.pixel - 1.0), abs(container.pixel / pixel - 1.0)) > SLACK:
        pixel = container.pixel
    if pixel == 1.0 or (container is not None and container.undone == SHEARED):
        return []
    mirror = "" if container is None else container.mirror
    sideways = "diagonal" in mirror or (not mirror and capture.get(cv2.CAP_PROP_ORIENTATION_META) in (90, 270))
    shape = Fraction(1 / pixel if sideways else pixel).limit_denominator(1000)
    return [("pixels-not-square", {"across": shape.numerator, "down": shape.denominator})]


def _start_s(capture: cv2.VideoCapture, first: _Raw) -> float:
    """Offset of the file's time stamps from the decoder's times [s], by the first frame; NaN if unknown."""
    return _stamp_s(capture) - first.pos_ns / NS


def _stamp_s(capture: cv2.VideoCapture) -> float:
    """Time stamp of the picture that was decoded last [s], rounded to the frame rate; NaN if unknown."""
    stamp, rate = getattr(cv2, "CAP_PROP_PTS", None), capture.get(cv2.CAP_PROP_FPS)
    if stamp is None or not rate > 0 or abs(pts := capture.get(stamp)) >= NO_PTS:
        return math.nan
    return float(pts) / float(rate)


def _faults(container: Container | None) -> str:
    return "".join(f"; {location}: {what}" for location, what in container.problems) if container else ""


def decode(
    video: VideoFile,
    start: int,
    stop: int | None,
    lost: Callable[[Loss], None],
    sizes: Changes | None = None,
    target: Callable[[], Image | None] | None = None,
    keys: Collection[int] | None = None,
) -> Iterator[Picture]:
    """Yield the frames start <= number < stop of a video in order; missing ones are reported to `lost` at the end.

    Args:
        video: the file, as `examine` opened it; it is closed at the end.
        start: first frame number.
        stop: frame number after the last; None: to the end.
        lost: called with a loss for all that should be there and is not.
        sizes: times and frame sizes at which the size changes (`size_changes`); None: all frames have the first size.
        target: returns the array into which the next frame may be decoded, or None.
        keys: numbers of key frames: after a missing or damaged frame, those before the next key frame are lost; None:
            such frames are used, and reported.

    Raises:
        InputError: the range has no frame that can be used.
    """
    size = sizes[0][1] if sizes else video.size
    ledger = FrameLedger(video.path, video.container, video.frames, size, start, stop)
    expected, damaged = start, False
    try:
        for raw in _trusted(video.container, video.raw, ledger.misplaced):
            if stop is not None and raw.index >= stop:
                break
            if not ledger.accept(raw.index):
                continue
            if keys is not None:
                gap, expected = raw.index > expected, raw.index + 1
                damaged = bool(raw.complaint) or (raw.index not in keys and (gap or damaged))
                if damaged:
                    ledger.refuse(raw.index, f"damaged, or built on a frame that is ({raw.complaint or 'as before'})")
                    continue
            image, unconverted = raw.fetch(None if target is None else target())
            if unconverted:
                ledger.refuse(raw.index, _remedied(video.path, unconverted))
                continue
            ledger.note(raw.index, raw.complaint)
            if image is None:
                continue
            if video.deep and is_dark(max(int(image.max()), 1), FULL):  # a range of studio levels cuts them to 0
                ledger.refuse(raw.index, DARK.format(most=DARK_16))
            elif ledger.fits(raw.index, size_at(sizes or [], raw.pos_ns) or (image.shape[1], image.shape[0])):
                yield Picture(raw.index, raw.pos_ns, image)
    finally:
        video.capture.release()
    ledger.check_any()
    ledger.report(lost)


@dataclass(frozen=True, slots=True)
class _Raw:
    index: int  # -1: cannot be placed
    pos_ns: float
    complaint: str
    fetch: Callable[[Image | None], tuple[Image | None, str]]  # the image, and why it is none; see `_retrieve`
    stamp_ns: float = math.nan  # time stamp in the file, to half a frame interval; NaN: unknown


MIRRORED: dict[str, Callable[[Image], Image]] = {
    MIRRORS[-1, 0, 0, 1]: lambda image: cv2.flip(image, 1),
    MIRRORS[1, 0, 0, -1]: lambda image: cv2.flip(image, 0),
    MIRRORS[0, 1, 1, 0]: lambda image: cv2.transpose(image),
    MIRRORS[0, -1, -1, 0]: lambda image: cv2.flip(cv2.transpose(image), -1),
}
"""Pictures as the metadata ask players to mirror them, by `Container.mirror`."""


def _raw_pictures(
    frames: int | None,
    capture: cv2.VideoCapture,
    complaint: Callable[[], str],
    mirror: Callable[[Image], Image] | None = None,
) -> Iterator[_Raw]:
    """Yield every picture that the decoder delivers, numbered in sequence; failed reads are skipped, and count.

    The picture is fetched, and mirrored if required, on request, before the next one is read.

    Args:
        frames: number of frames by the container; None: unknown.
        capture: the decoder.
        complaint: returns what FFmpeg has reported since the last call.
        mirror: applied to each picture; None: nothing is.
    """
    ordinal = misses = missed = 0
    while misses <= PATIENCE + max((frames or 0) - ordinal - missed, 0):
        good = capture.grab()
        text = complaint()
        if not good:
            misses += 1
            continue
        missed, misses = missed + misses, 0
        pos = capture.get(cv2.CAP_PROP_POS_MSEC)
        image: list[tuple[Image | None, str]] = []

        def fetch(target: Image | None, image: list[tuple[Image | None, str]] = image) -> tuple[Image | None, str]:
            if not image:
                found, why = _retrieve(capture, None if mirror else target, complaint)
                image.append((found if found is None or mirror is None else mirror(found), why))
            return image[0]

        pos_ns = pos * 1e6 if math.isfinite(pos) else math.nan
        yield _Raw(ordinal + missed, pos_ns, text, fetch, _stamp_s(capture) * NS)
        ordinal += 1


def _retrieve(
    capture: cv2.VideoCapture, target: Image | None, complaint: Callable[[], str]
) -> tuple[Image | None, str]:
    """Convert the picture that was decoded last.

    Return it (None on failure), and the message about a failed conversion. If FFmpeg refuses the conversion, OpenCV
    returns an unfilled buffer; the failure is detected by FFmpeg's message.

    Args:
        capture: the decoder.
        target: array that may be filled; None: a new one.
        complaint: returns what FFmpeg has reported since the last call.
    """
    try:
        ok, image = capture.retrieve(target)
    except cv2.error:
        return None, ""
    text = complaint()
    return (image, text) if ok and image is not None and image.size > 0 else (None, text)


def _trusted(container: Container | None, pictures: Iterator[_Raw], misplaced: Callable[[], None]) -> Iterator[_Raw]:
    """Yield pictures numbered by the container's list of frames, if the first few fit it; else numbered in sequence.

    Args:
        container: lists the frames; None: it cannot be parsed.
        pictures: in the order of the decoder.
        misplaced: called if numbers near dropped frames are uncertain.
    """
    head: list[_Raw] = []
    for raw in pictures:
        raw.fetch(None)  # the decoder keeps only the latest picture
        head.append(raw)
        if len(head) == TRIAL:
            break
    indices = [_place(container, raw) for raw in head]
    rising = all(b > a for a, b in pairwise(indices) if a >= 0 and b >= 0)
    listed = bool(head) and rising and _distinct(container) and sum(p >= 0 for p in indices) * 2 >= len(head)
    every = chain(head, pictures)
    if not listed or container is None:
        first = 0 if container is None or not head else _first_decoded(container, head[0])
        yield from (replace(raw, index=raw.index + first) for raw in every)
        return
    late = _lateness(container, head[0])
    if late and container.steps is not None:
        misplaced()
    yield from _placed(container, every, late)


def _first_decoded(container: Container, raw: _Raw) -> int:
    """Number of the first decoded picture `raw`: that of the first key frame if its time stamp is not before it."""
    pts, key = container.pts_ns, container.first_key
    if pts is None or not 0 < key < len(pts):
        return 0
    return key if raw.stamp_ns - container.origin_ns >= (pts[key - 1] + pts[key]) / 2 else 0


def _placed(container: Container, pictures: Iterator[_Raw], late: int) -> Iterator[_Raw]:
    """Yield pictures numbered by the container's list of frames, minus the decoder's delay of `late` frames.

    The last `late` pictures come after all packets, without a time: they are numbered in sequence.
    """
    last, held = -1, late
    for raw in pictures:
        index = _place(container, raw)
        if index >= late:
            index -= late
        elif held and last >= 0 and not raw.pos_ns:  # comes when there are no packets any more, and has no time
            index, held = last + 1, held - 1
        last = max(last, index)
        yield replace(raw, index=index)


def _lateness(container: Container | None, first: _Raw) -> int:
    """Delay of the decoder in an AVI file, in packets between reading a picture and its delivery; 0 for other files.

    With B-frames the first picture is delivered with a later packet. Undecodable pictures have the same effect, but are
    reported by the decoder. `first` is the first picture that is delivered.
    """
    if container is None or container.packets is None or first.complaint:
        return 0
    index = _place(container, first)
    return index if 0 < index <= MAX_HELD and not container.broken[:index].any() and not container.problems else 0


def _distinct(container: Container | None) -> bool:
    """Whether the container lists frame times, and they strictly increase; False for None."""
    return container is not None and container.pts_ns is not None and bool((np.diff(container.pts_ns) > 0).all())


def _place(container: Container | None, raw: _Raw) -> int:
    """Number of a picture in the container's list of frames, by its time stamp; -1 if there is no such frame."""
    if container is None or container.pts_ns is None or not len(container.pts_ns) or not math.isfinite(raw.pos_ns):
        return -1
    if container.packets is not None:
        # AVI has no stamps: the decoder's time is the number of the packet.
        packet = round(raw.pos_ns / NS * float(container.rate or 0)) - container.first_packet
        return int(container.packets[packet]) if 0 <= packet < len(container.packets) else -1
    pts = container.pts_ns
    pos = raw.pos_ns + _decoder_start_ns(container, raw)
    return _nearest(pts, pos)


def _nearest(pts: Ints, pos: float) -> int:
    """Number of the frame at the time `pos` [ns] among the increasing times `pts` (n,) [ns]; -1 if there is none."""
    after = int(np.searchsorted(pts, pos))
    near = min((k for k in (after - 1, after) if 0 <= k < len(pts)), key=lambda k: abs(int(pts[k]) - pos))
    return near if abs(int(pts[near]) - pos) <= _tolerance(pts, near) else -1


def _decoder_start_ns(container: Container, raw: _Raw) -> float:
    """Time after frame 0 from which the decoder counts the time of a picture [ns].

    That is the first frame in the file. Where this is no key frame, FFmpeg counts from 0 until it can tell the order of
    the packets, and then from the packet at which it can; the time stamp shows which.
    """
    pts = container.pts_ns
    if pts is None or not container.first_key or not math.isfinite(raw.stamp_ns):
        return container.first_ns
    stated = raw.stamp_ns - container.origin_ns
    k = int(np.searchsorted(pts, stated - raw.pos_ns))
    starts: list[float] = [-container.origin_ns, container.first_ns, *pts[max(k - 2, 0) : k + 2].tolist()]
    return min(starts, key=lambda start: (_nearest(pts, start + raw.pos_ns) < 0, abs(start + raw.pos_ns - stated)))


def _tolerance(pts: Ints, k: int) -> float:
    """Tolerance [ns] for matching a time stamp with frame k: half the interval to the nearer neighbour, at most 5 ms.

    `pts` (n,) are the increasing times of all frames [ns].
    """
    gaps = np.diff(pts[max(k - 1, 0) : k + 2])
    return min(float(gaps.min()) / 2 if len(gaps) else 5e6, 5e6)
