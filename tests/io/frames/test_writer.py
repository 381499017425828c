import numpy as np
import pytest

from occlog.errors import OutputError, OutputExistsError
from occlog.io.frames.decode import decode, examine
from occlog.io.frames.writer import SHOWN, LosslessVideo, ShownVideo
from occlog.io.video.reader import read_container


def images(n, height=48, width=64):
    rng = np.random.default_rng(0)
    return rng.integers(0, 256, (n, height, width, 3), dtype=np.uint8)


def test_what_is_written_is_read_again_bit_by_bit(tmp_path):
    path, frames = tmp_path / "v.avi", images(7)
    with LosslessVideo(path, (64, 48), 12.5) as video:
        for image in frames:
            video.write(image)
    got = [picture.image for picture in decode(examine(path), 0, None, lambda _: None)]
    assert len(got) == 7
    assert all((a == b).all() for a, b in zip(got, frames, strict=True))


def test_nothing_is_left_after_an_error_and_nothing_is_overwritten(tmp_path):
    path = tmp_path / "v.avi"
    with pytest.raises(ValueError, match="of shape"), LosslessVideo(path, (64, 48), 5.0) as video:
        video.write(images(1, 40)[0])
    assert list(tmp_path.iterdir()) == []
    path.write_bytes(b"mine")
    with pytest.raises(OutputExistsError), LosslessVideo(path, (64, 48), 5.0):
        pass
    assert path.read_bytes() == b"mine"


def test_frames_that_did_not_reach_the_disk_are_noticed(tmp_path, monkeypatch):
    path = tmp_path / "v.avi"
    with pytest.raises(OutputError, match="only 3 of 4 frames"), LosslessVideo(path, (64, 48), 5.0) as video:
        for image in images(3):
            video.write(image)
        video.frames += 1  # as when OpenCV drops one without a word
    assert not path.exists()


def test_an_end_that_did_not_reach_the_disk_is_noticed(tmp_path):
    path = tmp_path / "v.avi"
    with (
        pytest.raises(OutputError, match=r"v\.avi: was not written whole"),
        LosslessVideo(path, (64, 48), 5.0) as video,
    ):
        for image in images(4):
            video.write(image)
        video._video.release()
        video._draft.write_bytes(video._draft.read_bytes()[:-50])  # of the index: all frames are there
    assert not path.exists()


def test_a_header_that_was_not_completed_is_noticed(tmp_path):
    path = tmp_path / "v.avi"
    cannot = pytest.raises(
        OutputError, match=r"was not written whole: the header states 1048576 bytes .* which has \d+;"
    )
    with cannot, LosslessVideo(path, (64, 48), 5.0) as video:
        for image in images(4):
            video.write(image)
        video._video.release()
        data = bytearray(video._draft.read_bytes())
        at = data.find(b"strh") + 44
        data[at : at + 4] = (1 << 20).to_bytes(4, "little")  # as FFmpeg begins it, before it knows
        video._draft.write_bytes(data)
    assert not path.exists()


def test_the_header_of_a_video_to_look_at_states_the_largest_frame(tmp_path):
    path = tmp_path / "v.avi"
    with ShownVideo(path, (64, 48), 5.0) as video:
        for image in images(4):
            video.write(image)
    container = read_container(path)
    assert container.largest[0] == container.largest[1] > 1000


@pytest.mark.parametrize("suffix", SHOWN)
def test_equal_images_give_equal_bytes(tmp_path, suffix):
    made = [tmp_path / f"{name}{suffix}" for name in "ab"]
    for path in made:
        with ShownVideo(path, (64, 48), 5.0) as video:
            for image in images(9):
                video.write(image)
    one, two = (path.read_bytes() for path in made)
    assert one == two
    assert len([*decode(examine(made[0]), 0, None, lambda _: None)]) == 9


def test_bytes_that_did_not_reach_the_disk_are_noticed(tmp_path):
    path = tmp_path / "v.avi"
    cannot = pytest.raises(OutputError, match=r"v\.avi: frame [0-3] was written and cannot be read back")
    with cannot, LosslessVideo(path, (64, 48), 5.0) as video:
        for image in images(4):
            video.write(image)
        video._video.release()
        data = bytearray(video._draft.read_bytes())
        hole = data.find(b"movi") + 3000
        data[hole : hole + 4096] = bytes(4096)  # as of a write that failed, behind which there were others
        video._draft.write_bytes(data)
    assert not path.exists()
