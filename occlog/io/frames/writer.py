"""Writing of video files: lossless (FFV1 in AVI), half as large as PNG images, or small ones for viewing."""

from __future__ import annotations

import os
import shutil
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Self

import cv2
import numpy as np

from occlog.errors import OutputError
from occlog.io.files.atomic import OutputGroup, check_writable, folder_beside, open_output
from occlog.io.files.names import utf8_name
from occlog.io.files.provenance import hash_file
from occlog.io.video.mkv import number_tracks
from occlog.io.video.reader import read_container
from occlog.records.frames import Image

SHOWN = {".avi": "MJPG", ".mp4": "mp4v", ".webm": "VP80"}
"""Kinds of files for viewing, and how their frames are coded; browsers play WebM.

VP8 rather than VP9, which OpenCV codes five times slower for files a quarter smaller.
"""


class VideoWriter:
    """Base class of video writers, context managers; the file appears when the block ends without an error.

    `frames`, `bytes` and `sha256` of the file are known then. Since OpenCV reports no write errors, the frames in the
    file are counted at the end, and compared for lossless video.
    """

    code = ""
    suffix = ".avi"
    otherwise = ""

    def __init__(
        self,
        path: Path,
        size: tuple[int, int],
        rate_hz: float,
        *,
        overwrite: bool = False,
        together: OutputGroup | None = None,
    ) -> None:
        """Prepare to write; nothing is opened before the block begins.

        Args:
            path: the file.
            size: width and height of the frames [px].
            rate_hz: frames per second.
            overwrite: replace an existing file.
            together: group at the end of which the file appears; None: at the end of the block.
        """
        self.path, self.size, self.rate_hz, self.overwrite = path, size, rate_hz, overwrite
        self.together = together
        self.frames = self.bytes = 0
        self.sha256 = ""

    def __enter__(self) -> Self:
        """Open a temporary file, and return self; OutputError if the file exists or cannot be written."""
        check_writable(self.path, self.overwrite)
        self._folder = folder_beside(Path(os.path.realpath(self.path)))
        self._draft = self._folder.__enter__() / f"video{self.suffix}"
        code = cv2.VideoWriter.fourcc(*self.code)
        with _without_words(), utf8_name(self._draft) as name:
            self._video = cv2.VideoWriter(name, cv2.CAP_FFMPEG, code, self.rate_hz, self.size)
        if not self._video.isOpened():
            self._folder.__exit__(None, None, None)
            raise OutputError(f"{self.path}: the installed OpenCV cannot write {self.code} video{self.otherwise}")
        return self

    def write(self, image: Image) -> None:
        """Append a frame (h, w, 3) BGR; ValueError for one of another size, which OpenCV would drop silently."""
        if image.shape != (self.size[1], self.size[0], 3):
            raise ValueError(
                f"a frame of shape {image.shape} in a video of {self.size[0]} x {self.size[1]} px; (height, width, "
                "3) was expected"
            )
        self._video.write(image)
        self.frames += 1
        self._wrote(image)

    def _wrote(self, image: Image) -> None:
        """Record a frame that was written, for the comparison in `_damaged`; does nothing unless overridden."""

    def _damaged(self) -> int | None:
        """Number of the first frame that, read back, differs from the written image.

        None if none does or it is not checked.
        """
        return None

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Check and complete the file, or delete it after an error; OutputError if frames are missing or damaged."""
        try:
            self._video.release()
            if kind is None:
                self._finish()
        finally:
            self._folder.__exit__(None, None, None)

    def _finish(self) -> None:
        if self.suffix == ".webm":
            number_tracks(self._draft)
        container = read_container(self._draft)
        written = 0 if container is None else (container.frames or 0) - int(container.broken.sum())
        if written != self.frames:
            raise OutputError(
                f"{self.path}: only {written} of {self.frames} frames could be written; is the disk full?"
            )
        problems = [] if container is None else [what for _, what in container.problems]
        if container is not None and container.largest is not None and len(set(container.largest)) > 1:
            problems.append("the header states {} bytes for the largest frame, which has {}".format(*container.largest))
        if problems:
            raise OutputError(f"{self.path}: was not written whole: {problems[-1]}; is the disk full or damaged?")
        if (bad := self._damaged()) is not None:
            raise OutputError(f"{self.path}: frame {bad} was written and cannot be read back; is the disk damaged?")
        with self._draft.open("rb") as draft, open_output(self.path, self.overwrite, self.together) as file:
            shutil.copyfileobj(draft, file, 1 << 20)
        self.bytes, self.sha256 = self._draft.stat().st_size, hash_file(self._draft)


@contextmanager
def _without_words() -> Iterator[None]:
    """Context manager in which standard error is discarded (OpenCV writes a harmless warning about WebM)."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


class LosslessVideo(VideoWriter):
    """Writer of lossless video, FFV1 in AVI, which is read back and compared at the end.

    Equal images give equal bytes, since the file has neither times nor random numbers.
    """

    code = "FFV1"
    otherwise = "; keep PNG images instead"

    def __enter__(self) -> Self:
        """Open a temporary file, and return self."""
        self._sums: list[int] = []
        return super().__enter__()

    def _wrote(self, image: Image) -> None:
        self._sums.append(zlib.crc32(np.ascontiguousarray(image).data))

    def _damaged(self) -> int | None:
        with utf8_name(self._draft) as name:
            video = cv2.VideoCapture(name, cv2.CAP_FFMPEG)
        try:
            for number, want in enumerate(self._sums):
                good, image = video.read()
                if not good or zlib.crc32(np.ascontiguousarray(image).data) != want:
                    return number
            return None
        finally:
            video.release()


class ShownVideo(VideoWriter):
    """Writer of small lossy video for viewing; the suffix, one of `SHOWN`, determines the format.

    Equal images give equal bytes.
    """

    def __init__(self, path: Path, size: tuple[int, int], rate_hz: float, *, overwrite: bool = False) -> None:
        """Prepare to write `path` with frames of `size` (width, height), both even, at `rate_hz` frames per second.

        OutputExistsError at the beginning of the block if it exists and `overwrite` is false.
        """
        super().__init__(path, size, rate_hz, overwrite=overwrite)
        self.suffix = path.suffix.lower()
        self.code = SHOWN[self.suffix]
        self.otherwise = f" of {size[0]} x {size[1]} px; make it smaller"
