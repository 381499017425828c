"""Where links of recordings to videos may lead."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from occlog.errors import InputError
from occlog.io.files.provenance import Provenance, hash_file
from occlog.io.formats.scenes.scene import scene_from_yaml
from occlog.io.recording.metadata import linked_path
from occlog.io.recording.reader import linked_videos, open_recording
from occlog.io.recording.writer import RecordingWriter

AVI = b"RIFF\x10\0\0\0AVI LIST"
SCENE = scene_from_yaml(
    "occlog_scene: 1\ncameras: [{name: a, position: [0, 0], yaw_deg: 45, focal_px: 70, fov_deg: 90}]", "scene"
)


def recording(folder: Path, place: str, content: bytes) -> Path:
    """A recording that links to a file of this content, with the right SHA-256."""
    path = folder / "inner" / "hall.mcap"
    path.parent.mkdir(parents=True)
    target = path.parent / place
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(content)
    with RecordingWriter(path, SCENE, Provenance("test")) as out:
        out.video_frame("a", 0, 0)
        out.video("a", place, hash_file(target))
    return path


@pytest.mark.parametrize("place", ["a.avi", "videos/a.avi", "../a.avi", "../other/a.avi", "videos/../../a.avi"])
def test_videos_are_followed_anywhere(tmp_path: Path, place: str) -> None:
    path = recording(tmp_path, place, AVI)
    assert linked_path(path, "a", place) == path.parent / place
    assert linked_videos(path) == (path.parent / place,)


@pytest.mark.parametrize("place", ["../secret", "../../x/secret", "videos/../../secret"])
def test_a_link_out_of_the_folder_to_what_is_no_video_is_refused(tmp_path: Path, place: str) -> None:
    path = recording(tmp_path / "deep", place, b"root:x:0:0:root:/root:/bin/bash\n")
    with pytest.raises(InputError, match=r"hall\.mcap: camera a: links to .*secret, outside of the recording's folder"):
        list(open_recording(path).frames())
    assert linked_videos(path) == ()


def test_a_symbolic_link_in_the_folder_leads_out_as_well(tmp_path: Path) -> None:
    path = recording(tmp_path, "a.avi", b"no video, but in the folder")
    assert linked_path(path, "a", "a.avi").name == "a.avi"
    (tmp_path / "secret").write_bytes(b"no video")
    (path.parent / "a.avi").unlink()
    (path.parent / "a.avi").symlink_to(tmp_path / "secret")
    with pytest.raises(InputError, match="outside of the recording's folder and no video"):
        linked_path(path, "a", "a.avi")
    (tmp_path / "secret").write_bytes(AVI)
    assert linked_path(path, "a", "a.avi").is_symlink()


def test_an_absolute_place_and_a_pipe_are_refused(tmp_path: Path) -> None:
    path = recording(tmp_path, "a.avi", AVI)
    with pytest.raises(InputError, match="must be a relative path"):
        linked_path(path, "a", str(path.parent / "a.avi"))
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="pipe"):
        linked_path(path, "a", "../pipe")
