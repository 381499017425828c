"""Shared memory for images of a decoding process, without copying.

It is divided into slots of one image each. A slot belongs to the decoder until an image in it is delivered, then to the
image, and to the decoder again when the image is released.
"""

from __future__ import annotations

import mmap
import os
import sys
import weakref
from collections import deque
from collections.abc import Callable
from contextlib import suppress

import numpy as np

from occlog.errors import InputError
from occlog.records.frames import Image

SHARED = sys.platform == "linux"
"""True if the system has memory without a name that can be given to another process."""
SMALLEST, LARGEST = 2**18, 2**25
"""Sizes of images that pass through it [bytes]: a pipe is as quick for smaller ones; 3840 x 2160 px take 25 million."""
MIN_SLOTS, MAX_SLOTS = 3, 8
"""Slots: at least one that is decoded into, one that waits, and one that is in use."""
AHEAD = 2**23
"""Size of all slots, where they are more than the fewest [bytes]."""


def slot_size(width: int, height: int) -> int:
    """Size [bytes] of a slot of shared memory for images of width x height; 0 if a pipe serves better.

    0 also if memory cannot be shared on this system.
    """
    size = 3 * width * height
    return size if SHARED and SMALLEST <= size <= LARGEST else 0


class SharedImages:
    """Client side of the memory through which a decoding process returns images.

    Attributes:
        file: descriptor of the memory, for the decoding process.
        size: of a slot [bytes], 0 as long as no slots exist.
    """

    def __init__(self) -> None:
        """Create an empty memory file without space for images."""
        self.file = os.memfd_create("images", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        self.size = self._slots = 0
        self._held: set[int] = set()
        self._freed: deque[int] = deque()

    def cut(self, size: int) -> None:
        """Allocate slots of `size` bytes, once; the size of the memory is fixed from then on."""
        import fcntl

        self.size, self._slots = size, min(max(AHEAD // size, MIN_SLOTS), MAX_SLOTS)
        os.ftruncate(self.file, self._slots * size)
        fcntl.fcntl(self.file, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL)
        self._memory = mmap.mmap(self.file, self._slots * size)

    def image(self, slot: int, shape: tuple[int, ...]) -> Image:
        """Image of a shape in a slot: a view, or a copy if the decoder would have no free slot left.

        The slot is free again when the view is released.

        Raises:
            InputError: there is no such slot, it is in use, or the image does not fit into it.
        """
        count = int(np.prod(shape))
        if not (0 <= slot < self._slots and 0 < count <= self.size) or slot in self._held:
            raise InputError(
                "the decoder returned an image larger than its frames; the video is damaged, copy or repair it",
                id="damaged-file",
            )
        image = np.frombuffer(self._memory, np.uint8, count, slot * self.size).reshape(shape)
        self._held.add(slot)
        if len(self._held) - len(self._freed) >= self._slots:
            self._freed.append(slot)
            return image.copy()
        # A finalizer may run in the midst of anything, so it only takes a note
        weakref.finalize(image, self._freed.append, slot).atexit = False
        return image

    def freed(self) -> bytes:
        """Numbers of released slots to return to the decoder, a byte each.

        Empty while it has more than half of all slots.
        """
        if 2 * len(self._held) < self._slots:
            return b""
        slots = bytes(self._freed.popleft() for _ in range(len(self._freed)))
        self._held.difference_update(slots)
        return slots

    def close(self) -> None:
        """Close the memory; existing images stay valid."""
        if self.file >= 0:
            with suppress(OSError):
                os.close(self.file)
            self.file = -1


class Slots:
    """Decoder side of the memory through which images are returned: hands out free slots."""

    def __init__(self, file: int, size: int, wait: Callable[[], bytes]) -> None:
        """Map a shared memory; all slots are free.

        Args:
            file: descriptor of the memory.
            size: of a slot [bytes].
            wait: waits for, and returns, the numbers of released slots, a byte each; empty: the receiver has closed.
        """
        count = os.fstat(file).st_size // size
        self._memory, self._size, self._wait = mmap.mmap(file, count * size), size, wait
        self._free = list(range(count))

    def free(self, slots: bytes) -> None:
        """Add released slots, a byte for the number of each."""
        self._free.extend(slots)

    def target(self, shape: tuple[int, ...]) -> Image | None:
        """Array of a shape in the next free slot, to decode into.

        Waits for one. None if the image does not fit into a slot.

        Raises:
            BrokenPipeError: the receiver has closed.
        """
        count = int(np.prod(shape))
        if count > self._size:
            return None
        while not self._free:
            slots = self._wait()
            if not slots:
                raise BrokenPipeError
            self.free(slots)
        return np.frombuffer(self._memory, np.uint8, count, self._free[0] * self._size).reshape(shape)

    def deliver(self, image: Image) -> int | None:
        """Number of the slot that holds an image, which is copied into a free one if necessary.

        None if it does not fit. The slot is in use until `free` returns it.
        """
        target = self.target(image.shape)
        if target is None:
            return None
        if image.ctypes.data != target.ctypes.data:
            np.copyto(target, image)
        return self._free.pop(0)
