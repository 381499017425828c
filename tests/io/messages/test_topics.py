"""Names of cameras by their topics, and which of several topics is taken."""

from __future__ import annotations

import pytest

from occlog.errors import InputError, UsageError
from occlog.io.messages.mcap_file import BagTopic
from occlog.io.messages.topics import is_rectified, map_topics, name_cameras

COMPRESSED, RAW, INFO = "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"


def bag(kinds: dict[str, str]) -> dict[str, BagTopic]:
    return {name: BagTopic(name, kind, "cdr", b"", "", 10) for name, kind in kinds.items()}


@pytest.mark.parametrize(
    ("topics", "names"),
    [
        (["/cam_front/image_raw/compressed", "/cam_back/image_raw/compressed"], ["cam_back", "cam_front"]),
        (["/camera/left/image", "/camera/right/image"], ["left", "right"]),
        (["/a/color/image_raw", "/b/color/image_raw"], ["a_color", "b_color"]),
        (["/image_raw"], ["image_raw"]),
        (["/camera/cam01/image"], ["cam01"]),
    ],
)
def test_cameras_are_called_by_the_part_that_tells_them_apart(topics: list[str], names: list[str]) -> None:
    assert sorted(name_cameras(topics)) == names


def test_of_several_topics_of_a_camera_the_raw_image_is_taken_as_it_was_compressed() -> None:
    raw, rectified = "/cam/image_raw", "/cam/image_rect"
    topics = bag({raw: RAW, f"{raw}/compressed": COMPRESSED, rectified: RAW, "/cam/camera_info": INFO})
    found = map_topics(topics, (), topics)
    assert found.images == {"cam": "/cam/image_raw/compressed"}
    assert found.infos == {"cam": "/cam/camera_info"}
    assert set(found.others) == {raw, rectified}
    # ... unless another has more messages.
    topics[rectified] = topics[rectified]._replace(messages=11)
    assert map_topics(topics, (), topics).images == {"cam": rectified}


def test_what_the_user_names_is_taken_alone() -> None:
    topics = bag({"/a/image": RAW, "/b/image": RAW, "/b/camera_info": INFO, "/cal": INFO})
    found = map_topics(topics, [("west", "/b/image"), ("west", "/cal")], topics)
    assert (found.images, found.infos) == ({"west": "/b/image"}, {"west": "/cal"})


def test_rectified_topics_say_so() -> None:
    assert is_rectified("/cam/image_rect_color/compressed")
    assert not is_rectified("/rectory/image_raw")


def test_two_topics_of_one_array_must_be_chosen_from() -> None:
    kind = "odas_ros_msgs/msg/OdasSstArrayStamped"
    with pytest.raises(InputError, match="both hold directions of mic"):
        map_topics(bag({"/mic/odas/sst": kind, "/mic/sst": kind}), (), ())


def test_a_topic_of_blanks_is_an_array_without_a_name() -> None:
    topics = bag({"/ /sst": "odas_ros_msgs/msg/OdasSstArrayStamped"})
    assert map_topics(topics, (), ()).directions == {"odas": "/ /sst"}


def test_two_topics_that_would_be_one_camera_are_named_by_the_user() -> None:
    with pytest.raises(
        UsageError, match=r"topics /a b/image and /a=b/image would both be camera 'a_b'; name them: --topic a_b_1=/a b/"
    ):
        name_cameras(["/a b/image", "/a=b/image"])
