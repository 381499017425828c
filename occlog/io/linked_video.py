"""Frames of a video file that a recording links to instead of holding its images."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2

from ..errors import InputError
from ..frames import Image
from .inputs import check_input
from .provenance import hash_file


@dataclass
class LinkedVideo:
    """A video that is decoded forwards only."""

    path: Path
    where: str
    capture: Any
    next_index: int = field(default=0)

    def read(self, index: int) -> Image:
        """The frame of that number; frames before it are skipped, InputError where it cannot be decoded."""
        while self.next_index < index:
            self.next_index += 1
            if not self.capture.grab():
                raise InputError(f"{self.where}: frame {index}: {self.path} ends before it")
        self.next_index += 1
        ok, image = self.capture.read()
        if not ok or image is None:
            raise InputError(f"{self.where}: frame {index}: cannot be decoded from {self.path}")
        return image  # type: ignore[no-any-return]

    def close(self) -> None:
        """Let go of the file."""
        self.capture.release()


def open_linked(recording: Path, sensor: str, link: dict[str, str] | None) -> LinkedVideo:
    """The video of a camera; InputError unless it lies where the recording says and has not changed."""
    where = f"{recording}: camera {sensor}"
    if not link or "path" not in link or "sha256" not in link:
        raise InputError(f"{where}: has frame times but no link to its video; ingest it again")
    path = recording.parent / link["path"]
    check_input(path, f"the video of camera {sensor} that {recording} links to")
    if hash_file(path) != link["sha256"]:
        raise InputError(f"{where}: {path} is not the video that was ingested (its content changed); ingest it again")
    capture = cv2.VideoCapture(str(path))
    if not capture.isOpened():
        raise InputError(f"{where}: {path} cannot be opened as a video")
    return LinkedVideo(path, where, capture)
