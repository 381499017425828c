"""Frames of a video file that a recording links to instead of holding its images."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from ..errors import InputError
from ..frames import Image
from .inputs import check_input
from .provenance import hash_file
from .video_decode import Picture, VideoFile, decode, examine, quiet


@dataclass
class LinkedVideo:
    """A video that is decoded forwards only; frames keep the numbers that `occlog ingest` gave them."""

    path: Path
    where: str
    video: VideoFile
    _pictures: Iterator[Picture] | None = field(default=None)

    def read(self, index: int) -> Image:
        """The frame of that number; frames before it are skipped, InputError where it cannot be decoded."""
        if self._pictures is None:
            # Losses were told when the video was ingested.
            self._pictures = decode(self.video, index, None, lambda _: None)
        for picture in self._pictures:
            if picture.index == index:
                return picture.image
            if picture.index > index:
                break
        raise InputError(f"{self.where}: frame {index}: cannot be decoded from {self.path}; ingest it again")

    def close(self) -> None:
        """Let go of the file."""
        self._pictures = None


def open_linked(recording: Path, sensor: str, link: dict[str, str] | None) -> LinkedVideo:
    """The video of a camera; InputError unless it lies where the recording says and has not changed."""
    where = f"{recording}: camera {sensor}"
    if not link or "path" not in link or "sha256" not in link:
        raise InputError(f"{where}: has frame times but no link to its video; ingest it again")
    path = recording.parent / link["path"]
    check_input(path, f"the video of camera {sensor} that {recording} links to")
    if hash_file(path) != link["sha256"]:
        raise InputError(f"{where}: {path} is not the video that was ingested (its content changed); ingest it again")
    quiet()
    return LinkedVideo(path, where, examine(path))
