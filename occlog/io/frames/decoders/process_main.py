"""Main module of the decoding process: `python -m occlog.io.frames.decoders.process_main`.

Decoders are C code that parses possibly damaged files: a crash must not end the whole run, and the messages of FFmpeg,
libjpeg and libpng are the only evidence of some damage. They run in a separate process, and its standard error is
captured. The job is JSON on standard input; messages go to standard output.
"""

from __future__ import annotations

import json
import math
import os
import re
import signal
import struct
import sys
import tempfile
from contextlib import suppress
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, cast

from occlog.errors import InputError
from occlog.records.losses import Loss

from ..limits import CpuTimeLimit, allow_pixels, lower_limits
from .memory import Slots

if TYPE_CHECKING:
    from io import BufferedReader

    from occlog.records.frames import Image

    from ..codec import Facts
    from .process import DecoderMessage, DecodingJob

_ADDRESS = re.compile(r"\[([^\]@]+) @ 0x[0-9a-f]+\] ?")
MAX_TEXT = 90
SILENCERS = ("OPENCV_FFMPEG_LOGLEVEL", "OPENCV_FFMPEG_DEBUG")
"""Variables that change what FFmpeg writes, which alone shows damage and pictures that were not converted."""


class Log:
    """Temporary file in place of standard output and error, to capture messages of the decoding libraries."""

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile()  # noqa: SIM115
        for stream in (1, 2):
            os.dup2(self._file.fileno(), stream)
        self._read = 0

    def news(self) -> str:
        """First line that was written since the last call, without addresses and cut to `MAX_TEXT`.

        "" if there is none.
        """
        size = os.fstat(self._file.fileno()).st_size
        if size <= self._read:
            return ""
        text = os.pread(self._file.fileno(), 4096, self._read).decode("utf-8", "replace")
        self._read = size
        lines = [line.strip() for line in _ADDRESS.sub("", text).splitlines() if line.strip()]
        return lines[0][:MAX_TEXT] if lines else ""


def send(out: BinaryIO, header: DecoderMessage, payload: bytes | memoryview = b"") -> None:
    """Write a message to `out`: two lengths (4 bytes each, big-endian), the header as JSON, and the payload."""
    text = json.dumps(header).encode()
    out.write(struct.pack(">II", len(text), len(payload)))
    out.write(text)
    out.write(payload)
    out.flush()


def load() -> None:
    """Import the modules that every job needs, so that forked processes have them."""
    from occlog.io.frames import decode  # noqa: F401
    from occlog.io.video import avi, mkv, mp4  # noqa: F401


def main(memory: int | None = None) -> None:
    """Run the job on standard input, send messages to standard output, and exit.

    `memory` is the descriptor of memory shared with the client; None: there is none.
    """
    out = os.fdopen(os.dup(1), "wb")
    log = Log()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides what an interruption means
    job = json.loads(sys.stdin.buffer.readline())
    if "cwd" in job:
        os.chdir(job["cwd"])
    losses: list[Loss] = []
    try:
        facts = _run(job, out, log, losses, memory)
        send(out, {"end": [asdict(loss) for loss in losses], "facts": facts})
    except InputError as error:
        send(out, {"error": str(error)})
    except MemoryError:
        send(out, {"error": f"{job['path']}: its frames need more memory than there is"})
    except BrokenPipeError:
        pass
    with suppress(OSError):
        out.close()
    os._exit(0)  # nothing is left to do, and decoders may hang in their clean-up


def _run(job: DecodingJob, out: BinaryIO, log: Log, losses: list[Loss], memory: int | None) -> Facts:
    """Run a job; return what is found of all images together, as ids of findings with their values."""
    lower_limits()
    import cv2

    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    if job["kind"] == "video":
        return _video(job, out, log, losses, memory)
    if job["kind"] == "messages":
        _messages(job, out, log, memory)
        return []
    return _images(job, out, log, losses)


def _video(job: DecodingJob, out: BinaryIO, log: Log, losses: list[Loss], memory: int | None) -> Facts:
    from ..codec import Contents, size_changes
    from ..decode import CAPTURE_OPTIONS, decode, examine

    keys = frozenset(job["keys"]) if "keys" in job else None
    # Without delay what FFmpeg writes of damage is of the picture that comes next
    os.environ["OPENCV_FFMPEG_CAPTURE_OPTIONS"] = CAPTURE_OPTIONS + ("" if keys is None else "|flags;low_delay")
    for name in SILENCERS:
        os.environ.pop(name, None)
    clock = CpuTimeLimit(Path(job["path"]))

    def news() -> str:
        clock.go_on()
        return log.news()

    video = examine(Path(job["path"]), allow_pixels, news)
    start_s = video.start_s if math.isfinite(video.start_s) else None
    header: DecoderMessage = {"size": video.size, "frames": video.frames, "rate": video.rate_hz, "bars": video.bars}
    send(out, {**header, "facts": video.facts, "start": start_s})
    if job.get("waits"):
        line = sys.stdin.buffer.readline()
        if not line:
            return []
        start, size = map(int, line.split())
        sizes = None  # frames of another size were reported, and skipped, when it was ingested
        slots = _slots(memory, size)
    else:
        start, sizes, slots = job["start"], size_changes(video.path), None
        news()  # messages about packets will be written again
    width, height = video.size
    target = None if slots is None else partial(slots.target, (height, width, 3))
    contents = Contents()
    for picture in decode(video, start, job["stop"], losses.append, sizes, target, keys):
        contents.add(picture.image, picture.index)
        _deliver(job, out, picture.index, picture.pos_ns, picture.image, slots)
    return contents.facts()


def _slots(memory: int | None, size: int) -> Slots | None:
    """Slots of a size [bytes] in the memory shared with the client; None without memory or slots.

    `memory` is its descriptor. Numbers of released slots are read from standard input.
    """
    if memory is None or not size:
        return None
    return Slots(memory, size, cast("BufferedReader", sys.stdin.buffer).read1)


def _messages(job: DecodingJob, out: BinaryIO, log: Log, memory: int | None) -> None:
    """Decode image files from standard input, and answer each with an image or an error, until the input ends.

    Each is preceded by its length (4 bytes), the number of released slots (1 byte), and their numbers.

    Args:
        job: has the size of slots.
        out: pipe for the answers.
        log: captures messages of the libraries.
        memory: descriptor of the shared memory; None: there is none.
    """
    from ..codec import decode_image, image_size

    clock = CpuTimeLimit()
    slots = _slots(memory, job.get("slot", 0))
    while head := sys.stdin.buffer.read(5):
        length, free = struct.unpack(">IB", head)
        freed = sys.stdin.buffer.read(free)
        if slots is not None:
            slots.free(freed)
        data = sys.stdin.buffer.read(length)
        clock.go_on()
        width, height = image_size(data) or (0, 0)
        allow_pixels(width * height)
        try:
            image = decode_image(data, "")
        except InputError as error:
            send(out, {"error": str(error).removeprefix(": ")})
            log.news()
            continue
        except MemoryError:
            send(out, {"error": "needs more memory than there is"})
            continue
        text = log.news()
        if text:
            send(out, {"error": f"the decoder met damage ({text.replace(': ', ' ')})"})
        else:
            _send_image(out, {}, image, slots)
        del image  # the next may need as much memory


def _send_image(out: BinaryIO, header: DecoderMessage, image: Image, slots: Slots | None) -> None:
    """Send an image to the client: through shared memory if it fits there, else after the header.

    Args:
        out: pipe to the client.
        header: message that precedes the image; shape and slot are added to a copy of it.
        image: pixels.
        slots: shared memory; None: there is none.
    """
    slot = None if slots is None else slots.deliver(image)
    if slot is None:
        send(out, {**header, "s": image.shape}, bytes_of(image))
    else:
        send(out, {**header, "s": image.shape, "m": slot})


def _images(job: DecodingJob, out: BinaryIO, log: Log, losses: list[Loss]) -> Facts:
    from ..codec import Contents, dark_bars, image_facts, image_kind
    from ..streams import load

    files = [(int(index), Path(path)) for index, path in job["files"]]
    clock = CpuTimeLimit()

    def news() -> str:
        clock.go_on()
        return log.news()

    first, data = _first_image(job, files)
    size = (first.shape[1], first.shape[0])
    facts = image_facts(data, first)
    send(out, {"size": size, "frames": len(files), "rate": None, "bars": dark_bars(first), "facts": facts})
    del first, data  # it will be decoded again, and may be as large as is allowed
    log.news()
    delivered, contents = 0, Contents()
    for picture, data in load(files, size, losses.append, news):
        kind = image_kind(data)
        delivered += 1
        contents.add(picture.image, picture.index)
        if kind is not None and job["store"] in (kind, "keep"):
            send(out, {"i": picture.index, "p": None, "k": kind}, data)
        else:
            _deliver(job, out, picture.index, picture.pos_ns, picture.image)
        del picture, data
    if not delivered:
        raise InputError(
            f"{job['path']}: none of its images can be used; first: {losses[0] if losses else 'none'}",
            id="damaged-file",
        )
    return contents.facts()


def bytes_of(image: Image) -> memoryview:
    """Pixels of an image in row-major order as a view of bytes; copied only if they are not contiguous."""
    import numpy as np

    return np.ascontiguousarray(image).reshape(-1).data


def _first_image(job: DecodingJob, files: list[tuple[int, Path]]) -> tuple[Image, bytes]:
    """First image that can be decoded among the files, and the bytes of its file; InputError if there is none.

    `files` has (frame number, path) of each.
    """
    from ..codec import decode_image

    reason = ""
    for _, file in files:
        try:
            data = file.read_bytes()
            return decode_image(data, file.name), data
        except (OSError, InputError) as error:
            reason = reason or str(error)
    raise InputError(
        f"{job['path']}: none of its images can be decoded ({reason}); copy or convert them", id="damaged-file"
    )


def _deliver(
    job: DecodingJob, out: BinaryIO, index: int, pos_ns: float, image: Image, slots: Slots | None = None
) -> None:
    from ..codec import encode_image

    header: DecoderMessage = {"i": index, "p": pos_ns if pos_ns == pos_ns else None}
    store = job["store"]
    if store == "none":
        send(out, header)
    elif store == "raw":
        _send_image(out, header, image, slots)
    else:
        kind = "jpeg" if store == "jpeg" else "png"
        send(out, {**header, "k": kind}, encode_image(image, kind, job["quality"]))


if __name__ == "__main__":
    main()
