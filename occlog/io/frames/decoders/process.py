"""Frames of a video file or an image folder, decoded in a separate process."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import IO, TYPE_CHECKING, Any, Literal, Required, Self, TypedDict

import numpy as np

from occlog.errors import InputError
from occlog.io.files.children import enlarge_pipe, environment_for_children, exit_description
from occlog.records.frames import Image
from occlog.records.losses import Loss

from ..limits import MAX_PIXELS, SECONDS
from .fork_server import FORK_SERVER, FORKS, ForkedProcess
from .memory import SHARED, SharedImages, slot_size

if TYPE_CHECKING:
    from ..codec import Facts


class DecodingJob(TypedDict, total=False):
    """What a decoding process is to decode, and in which form it returns frames; sent to it as JSON."""

    kind: Required[Literal["video", "images", "messages"]]  # messages: images that come on standard input
    path: Required[str]  # video file, or folder of the images
    files: list[tuple[int, str]]  # of images: frame number and file
    start: int  # of a video: first frame
    waits: bool  # of a video: its first frame, and the size of slots in shared memory, come later, on standard input
    slot: int  # of messages: size of slots in shared memory, 0: missing
    keys: list[int]  # of a video: frames that need no other one; those between damage and the next of them are lost
    stop: int | None  # of a video: frame before which it ends; None: its end
    store: Required[str]  # png, jpeg, raw or none; of images also keep
    quality: Required[int]  # of JPEG
    cwd: str  # folder that relative paths start from


class DecoderMessage(TypedDict, total=False):
    """Header (JSON) of a message of the decoding process: properties of the input, a frame, the end, or an error."""

    size: tuple[int, int]
    frames: int | None
    rate: float | None
    bars: tuple[int, int, int, int]
    facts: Facts
    start: float | None  # time stamp of the first frame [s]; None: not known
    i: int  # number of the frame
    p: float | None  # its time in the file [ns]
    k: str  # how its data are stored
    s: tuple[int, ...]  # shape of raw data
    m: int  # slot of shared memory that they are in; without it the bytes come next
    end: list[dict[str, Any]]  # losses
    error: str


@dataclass(frozen=True, slots=True)
class Delivered:
    """A frame from a decoding process: number, time since the start of the file [ns] (None: unknown), and its data."""

    index: int
    pos_ns: int | None
    kind: str  # png, jpeg, raw or none
    data: bytes | bytearray | Image  # a bytearray, or an image in shared memory, if raw
    shape: tuple[int, ...] = ()

    @property
    def image(self) -> Image:
        """Image (h, w, 3) BGR or (h, w) grey of a `raw` frame."""
        if isinstance(self.data, np.ndarray):
            return self.data
        return np.frombuffer(self.data, np.uint8).reshape(self.shape)


@dataclass
class Decoder:
    """A running decoding process; a context manager that ends it.

    Attributes:
        path: the video file or image folder.
        process: the process.
        size: width and height of the frames [px].
        frames: number of frames announced, None if unknown.
        rate_hz: frame rate as stated, None if not.
        bars: width of black bars at the left, top, right and lower edge [px].
        facts: what the file states of its pictures, as ids of findings with their values; and at the end what is found
            of all pictures together.
        start_s: time stamp of the first frame in the file [s], which counts as 0; None: not known.
        losses: the losses; complete when all frames have been read.
        death: how the process ended before its time; empty: it did not.
        shared: memory through which images are returned; None: a pipe.
    """

    path: Path
    process: subprocess.Popen[bytes] | ForkedProcess
    size: tuple[int, int] = (0, 0)
    frames: int | None = None
    rate_hz: float | None = None
    bars: tuple[int, int, int, int] = (0, 0, 0, 0)
    facts: Facts = field(default_factory=list)
    start_s: float | None = None
    losses: list[Loss] = field(default_factory=list)
    death: str = ""
    shared: SharedImages | None = field(default=None, repr=False)

    def begin(self, start: int) -> None:
        """Start a waiting video decoder: send its first frame number and, if images are large, share memory with it."""
        size = slot_size(*self.size) if self.shared is not None else 0
        if self.shared is not None and size:
            self.shared.cut(size)
        self._write(b"%d %d\n" % (start, size))

    def image_of(self, data: bytes, where: str) -> Image:
        """Decode an image file given as bytes (with a decoder of `messages`); `where` names it in messages.

        Raises:
            InputError: it cannot be decoded, or the process has ended, which this image may have caused.
        """
        freed = self._freed()
        self._write(struct.pack(">IB", len(data), len(freed)), freed, data)
        try:
            message = self._receive()
        except InputError as error:
            raise InputError(f"{where}: {error}") from error
        if message is None:
            raise InputError(f"{where}: the decoder {self._death()}", id="damaged-file")
        header, payload = message
        return payload if isinstance(payload, np.ndarray) else np.frombuffer(payload, np.uint8).reshape(header["s"])

    def _freed(self) -> bytes:
        """Numbers of released slots of shared memory to return to the process, a byte each; empty if there are none."""
        return self.shared.freed() if self.shared is not None and self.shared.size else b""

    def _write(self, *parts: bytes) -> None:
        pipe: IO[bytes] = self.process.stdin  # type: ignore[assignment]
        with suppress(BrokenPipeError):  # that it died shows when it is read from
            for part in parts:
                pipe.write(part)
            pipe.flush()

    def __enter__(self) -> Self:
        """Wait for the properties of the input, and set the attributes; InputError if the process cannot open it."""
        try:
            message = self._receive()
            if message is None:
                raise InputError(
                    f"{self.path}: the decoder {self._death()} on opening it; copy or repair the file",
                    id="damaged-file",
                )
        except BaseException:
            self.close()
            raise
        header, _ = message
        width, height = header["size"]
        left, top, right, bottom = header["bars"]
        self.size, self.bars = (width, height), (left, top, right, bottom)
        self.frames, self.rate_hz = header["frames"], header["rate"]
        self.facts, self.start_s = [(id, values) for id, values in header["facts"]], header.get("start")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the process of the decoder."""
        self.close()

    def close(self) -> None:
        """End the process if it still runs, and close its pipes."""
        if self.process.poll() is None:
            self.process.kill()
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        self.process.wait()
        if self.shared is not None:
            self.shared.close()

    def delivered(self) -> Iterator[Delivered]:
        """Yield the frames in order.

        If the process dies early, that is a loss; `losses` is complete at the end.

        Raises:
            InputError: no frame can be used.
        """
        last = None
        while True:
            freed = self._freed()
            if freed:
                self._write(freed)
            message = self._receive()
            if message is None:
                if last is None:
                    raise InputError(
                        f"{self.path}: the decoder {self._death()} before the first frame; copy or repair the file",
                        id="damaged-file",
                    )
                self.death = self._death()
                self.losses.append(Loss(self.path.name, f"after frame {last}", f"the decoder {self.death}"))
                return
            header, payload = message
            if "end" in header:
                self.losses.extend(Loss(**loss) for loss in header["end"])
                self.facts += [(id, values) for id, values in header["facts"]]
                return
            last = int(header["i"])
            pos = header["p"]
            kind = header.get("k", "raw" if "s" in header else "none")
            yield Delivered(last, None if pos is None else round(pos), kind, payload, tuple(header.get("s", ())))

    def _receive(self) -> tuple[DecoderMessage, bytes | bytearray | Image] | None:
        """Next message of the process: header, and bytes or image; None if the process has ended.

        InputError if the message is an error.
        """
        pipe: IO[bytes] = self.process.stdout  # type: ignore[assignment]
        head = pipe.read(8)
        if len(head) < 8:
            return None
        text, size = struct.unpack(">II", head)
        header: DecoderMessage = json.loads(pipe.read(text))
        payload: bytes | bytearray
        if "m" in header and self.shared is not None:
            return header, self.shared.image(header["m"], tuple(header["s"]))
        if "s" in header:  # an image, which may be drawn upon
            payload = bytearray(size)
            received = pipe.readinto(payload)  # type: ignore[attr-defined]
        else:
            payload = pipe.read(size)
            received = len(payload)
        if received < size:
            return None
        if "error" in header:
            raise InputError(header["error"], id="damaged-file")
        return header, payload

    def _death(self) -> str:
        return exit_description(self.process.wait(), f"{SECONDS} s for one frame")


def start_decoder(job: DecodingJob) -> Decoder:
    """Start a decoding process and send it its job.

    Use the decoder in a `with` statement, which waits until it is ready.

    Args:
        job: what is decoded, and in which form it is returned.
    """
    with suppress(FileNotFoundError):  # the folder was taken away: absolute paths still work
        job = {**job, "cwd": str(Path.cwd())}
    shared = SharedImages() if FORKS and SHARED and (job.get("waits") or job.get("slot")) else None
    if shared is not None and job.get("slot"):
        shared.cut(job["slot"])
    try:
        process = _start(shared)
    except BaseException:
        if shared is not None:
            shared.close()
        raise
    pipe: IO[bytes] = process.stdin  # type: ignore[assignment]
    for end in (pipe, process.stdout):
        enlarge_pipe(end)
    with suppress(BrokenPipeError):
        pipe.write(json.dumps(job).encode() + b"\n")
        pipe.flush()
    return Decoder(Path(job["path"]), process, shared=shared)


def _start(shared: SharedImages | None) -> subprocess.Popen[bytes] | ForkedProcess:
    """Start a process that waits for its job on standard input: forked if the system allows, else a new interpreter.

    `shared` is the memory through which it returns images; None: a pipe.
    """
    environment = {**environment_for_children(), "OPENCV_IO_MAX_IMAGE_PIXELS": str(MAX_PIXELS)}
    if FORKS:
        return FORK_SERVER.fork(environment, None if shared is None else shared.file)
    return subprocess.Popen(
        [sys.executable, "-P", "-m", "occlog.io.frames.decoders.process_main"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=environment,
    )
