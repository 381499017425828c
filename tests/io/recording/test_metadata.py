"""Damage of what a recording says of itself: how it was made, what was lost, which video belongs to a camera."""

from __future__ import annotations

from pathlib import Path

import pytest

from occlog.errors import InputError
from occlog.io.files.provenance import Provenance
from occlog.io.recording.metadata import DIGESTS
from occlog.io.recording.reader import open_recording
from occlog.io.recording.salvage.recover import recover_recording
from occlog.io.recording.writer import RecordingWriter
from occlog.records.losses import Loss

MADE = Provenance("ingest", {"fps": 25}, None, (), (Loss("cam1", "frame 3", "a frame is damaged", 1),))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    with RecordingWriter(tmp_path / "r.mcap", None, MADE) as writer:
        writer.video_frame("cam1", 40_000_000, 0)
        writer.video("cam1", "cam1.avi", "ab" * 32)
    return tmp_path / "r.mcap"


def change(path: Path, old: bytes, new: bytes) -> None:
    data = path.read_bytes()
    assert data.count(old) == 1
    path.write_bytes(data.replace(old, new))


@pytest.mark.parametrize(
    ("old", "new", "name"),
    [
        (b"frame 3", b"frame 7", "'occlog'"),
        (b"cam1.avi", b"cam2.avi", "'occlog.video/cam1'"),
        (b"provenance", b"provenancf", "'occlog'"),
    ],
)
def test_changed_metadata_are_refused(path: Path, old: bytes, new: bytes, name: str) -> None:
    assert open_recording(path).losses == MADE.losses
    change(path, old, new)
    with pytest.raises(InputError, match=f"the metadata {name} at byte .*salvage it: `occlog recover"):
        open_recording(path)


def test_the_digests_cannot_go_without_a_word(path: Path) -> None:
    data = path.read_bytes()
    first = data.index(DIGESTS.encode())  # the record; the index has the name again
    path.write_bytes(data[:first] + b"another.digest" + data[first + len(DIGESTS) :])
    with pytest.raises(InputError, match=DIGESTS):
        open_recording(path)


def test_what_was_damaged_is_lost_in_words_when_it_is_salvaged(path: Path, tmp_path: Path) -> None:
    change(path, b"frame 3", b"frame 7")
    found = recover_recording(path, tmp_path / "whole.mcap")
    lost = [loss.what for loss in open_recording(tmp_path / "whole.mcap").losses]
    assert found.messages == {"/camera/cam1/video": 1}
    assert any("wrong digest" in reason for reason in lost)
    assert any("the losses then, is not known any more" in reason for reason in lost)
    assert not any("frame 7" in loss.place for loss in found.losses)
