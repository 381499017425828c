"""The recorded videos of ../shared/data: whole ones lose nothing, cut and damaged copies are noticed."""

from __future__ import annotations

from pathlib import Path

import pytest

from occlog.io.frames.codec import size_changes
from occlog.io.frames.decoders.process import start_decoder
from occlog.io.frames.streams import video_times
from occlog.io.video.reader import read_container

FILES = {
    "pose2sim_demo/single/videos/cam01.mp4": (100, (1080, 1920), 60),
    "pose2sim_demo/single/videos/cam04.mp4": (100, (1088, 1920), 60),
    "intel_sample_videos/one-by-one-person-detection.mp4": (1394, (768, 432), 10),
    "pets2009_s2l1_view1/vtest.avi": (795, (768, 576), 10),
    "caliscope_4cam/session_a/calibration/extrinsic/cam_2.mp4": (57, (1280, 720), 6),
}


def decode(path: Path) -> tuple[list[int], list[str]]:
    job = {"kind": "video", "path": str(path), "start": 0, "stop": None, "store": "none", "quality": 95}
    with start_decoder(job) as running:
        return [f.index for f in running.delivered()], [str(loss) for loss in running.losses]


@pytest.mark.parametrize("name", FILES)
def test_the_container_tells_frames_rate_and_times(shared_data: Path, name: str) -> None:
    count, _, rate = FILES[name]
    found = read_container(shared_data / name)
    assert found is not None
    assert found.problems == ()
    assert (found.frames, found.rate) == (count, rate)
    times = video_times(shared_data / name)
    assert times.source.startswith("frame rate" if name.endswith(".avi") else "container")


@pytest.mark.statistics
@pytest.mark.parametrize("name", FILES)
def test_whole_files_lose_nothing(shared_data: Path, name: str) -> None:
    indexes, losses = decode(shared_data / name)
    assert indexes == list(range(FILES[name][0]))
    assert losses == []


@pytest.mark.parametrize("name", ["pose2sim_demo/single/videos/cam01.mp4", "pose2sim_demo/single/videos/cam04.mp4"])
def test_the_size_in_the_parameters_of_h264(shared_data: Path, name: str) -> None:
    assert size_changes(shared_data / name) == [(0.0, FILES[name][1])]


def test_changed_bytes_in_h264_are_reported_by_the_decoder(shared_data: Path, tmp_path: Path) -> None:
    data = bytearray((shared_data / "pose2sim_demo/single/videos/cam01.mp4").read_bytes())
    for k in range(20):
        data[len(data) // 2 + 7 * k] ^= 0xFF
    path = tmp_path / "cam01.mp4"
    path.write_bytes(bytes(data))
    indexes, losses = decode(path)
    assert len(indexes) > 90
    assert any("decoder reported damage" in loss for loss in losses)


def test_a_cut_h264_file_with_its_index_ahead(shared_data: Path, tmp_path: Path) -> None:
    data = (shared_data / "intel_sample_videos/one-by-one-person-detection.mp4").read_bytes()
    path = tmp_path / "v.mp4"
    path.write_bytes(data[: len(data) // 10])
    indexes, losses = decode(path)
    assert indexes == list(range(len(indexes)))
    assert any(f"({1394 - len(indexes)} lost)" in loss for loss in losses)


def test_a_wiped_stretch_of_an_avi_keeps_the_numbers_behind_it(shared_data: Path, tmp_path: Path) -> None:
    data = bytearray((shared_data / "pets2009_s2l1_view1/vtest.avi").read_bytes())
    data[400_000:500_000] = bytes(100_000)
    path = tmp_path / "v.avi"
    path.write_bytes(bytes(data))
    indexes, losses = decode(path)
    assert indexes[-1] == 794
    assert sum(int(loss.rsplit("(", 1)[1].split()[0]) for loss in losses if loss.endswith("lost)")) == 795 - len(
        indexes
    )
