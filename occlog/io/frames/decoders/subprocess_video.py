"""Compressed images and frames of linked videos, decoded in separate processes.

Processes for images are reused; there are as many as threads that decode at the same time.
"""

from __future__ import annotations

import atexit
import os
import weakref
from pathlib import Path

from occlog.errors import InputError
from occlog.records.frames import Image

from ..codec import check_image, image_size
from .memory import slot_size
from .process import Decoder, DecodingJob, start_decoder

_idle: list[Decoder] = []


def decode_apart(data: bytes, where: str) -> Image:
    """Decode an image file, given as bytes, in another process.

    Args:
        data: content of the file.
        where: name of the image, with which errors begin.

    Returns:
        (h, w, 3) BGR or (h, w) grey, writable.

    Raises:
        InputError: it is damaged, too large, no image, or the decoder crashed or met a limit.
    """
    check_image(data, where)
    decoder = _take(slot_size(*image_size(data) or (0, 0)))
    try:
        image = decoder.image_of(data, where)
    except InputError:
        if decoder.process.poll() is None:
            _idle.append(decoder)
        else:
            decoder.close()
        raise
    except BaseException:  # an interrupt in the middle of a message
        decoder.close()
        raise
    _idle.append(decoder)
    return image


def _take(size: int) -> Decoder:
    """Idle decoding process with slots of at least `size` bytes in its shared memory, or a new one.

    Idle processes with smaller slots are ended.
    """
    while _idle:
        try:
            decoder = _idle.pop()
        except IndexError:  # another thread was faster
            break
        slots = 0 if decoder.shared is None else decoder.shared.size
        if decoder.process.poll() is None and slots >= size:
            return decoder
        decoder.close()
    return start_decoder(DecodingJob(kind="messages", path="images", store="raw", quality=0, slot=size))


def end_idle() -> None:
    """End all idle processes that decode images."""
    while _idle:
        _idle.pop().close()


atexit.register(end_idle)
if hasattr(os, "register_at_fork"):  # a process that was forked must not write to those of its parent
    os.register_at_fork(after_in_child=_idle.clear)


class SubprocessVideo:
    """Frames of a video, decoded forwards in another process, which works ahead."""

    def __init__(self, path: Path) -> None:
        """Open the video; InputError unless at least one frame can be decoded."""
        self.path = path
        self._decoder: Decoder | None = None
        self._open()

    def _open(self) -> Decoder:
        job = DecodingJob(kind="video", path=str(self.path), waits=True, stop=None, store="raw", quality=0)
        self._decoder = start_decoder(job).__enter__()
        # Frames may be decoded, in other threads, after whoever listed them is done; the process ends with the last one
        weakref.finalize(self, self._decoder.close)
        self._frames = self._decoder.delivered()
        self._begun = False
        return self._decoder

    def read(self, index: int) -> Image | None:
        """Frame with the number `index`; None if it cannot be decoded.

        Frames before it are skipped, so that calls must be in increasing order.
        """
        decoder = self._decoder or self._open()
        if not self._begun:
            decoder.begin(index)
            self._begun = True
        for frame in self._frames:
            if frame.index == index:
                return frame.image
            if frame.index > index:
                break
        return None

    @property
    def death(self) -> str:
        """How the process ended before its time; "" if it did not."""
        return "" if self._decoder is None else self._decoder.death

    def close(self) -> None:
        """End the process; it is started again when a frame is requested."""
        if self._decoder is not None:
            self._decoder.close()
            self._decoder = None
