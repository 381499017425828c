"""Numbers in messages that are beyond all range: they are refused, and nothing warns on the way."""

from __future__ import annotations

from types import SimpleNamespace as Value

import numpy as np
import pytest

from occlog.errors import InputError
from occlog.io.messages.contents import MessageBoxRows, direction_rows, intrinsics, rotation_of
from occlog.io.messages.kinds import (
    BoxDetection,
    BoxMessage,
    DirectionMessage,
    InfoMessage,
    MessageStamp,
    SoundSource,
    TransformMessage,
    read_message,
)
from occlog.records.scene import MicrophoneArray

pytestmark = pytest.mark.filterwarnings("error")
HEADER = MessageStamp(1, "cam")
LARGE = 1e200


@pytest.mark.parametrize("value", [LARGE, np.inf, np.nan])
def test_a_direction_beyond_all_range(value: float) -> None:
    heard = DirectionMessage(HEADER, (SoundSource(1, (value, 0.1, 0.1), 1.0),))
    with pytest.raises(InputError, match="expected a unit vector"):
        direction_rows(heard, 1, MicrophoneArray("mic", np.zeros(3)))


@pytest.mark.parametrize("value", [LARGE, np.inf, np.nan])
def test_a_quaternion_beyond_all_range(value: float) -> None:
    with pytest.raises(InputError, match="it must be 1 to within"):
        rotation_of(TransformMessage("a", "b", np.zeros(3), np.array([value, 0.0, 0.0, 1.0])))


@pytest.mark.parametrize("value", [LARGE, np.inf, np.nan])
def test_a_rotation_beyond_all_range_is_none(value: float) -> None:
    """NaN is neither above a limit nor below: such a camera was taken before."""
    k, turn = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]), np.eye(3)
    turn[0, 1] = value
    info = InfoMessage(
        HEADER, (640, 480), "plumb_bob", np.zeros(5), k, turn, np.hstack([k, np.zeros((3, 1))]), (0, 0), (0, 0, 0, 0)
    )
    with pytest.raises(InputError, match="its matrix R is not a rotation"):
        intrinsics(info, rectified=True, where="cam")


def boxes_of(*names: str) -> BoxMessage:
    where = {"left": 1.0, "top": 1.0, "width": 5.0, "height": 9.0, "score": 0.5, "label": "person"}
    return BoxMessage(HEADER, tuple(BoxDetection(**where, id=name) for name in names))


def test_a_track_that_is_named_otherwise_takes_no_number_of_another() -> None:
    """The first name became 0, and so did the track that is called 0."""
    rows = MessageBoxRows("cam", (), 1.0)
    assert rows.rows(boxes_of("ann", "bob", ""), 1).target_id.tolist() == [0, 1, -1]
    assert rows.rows(boxes_of("bob"), 2).target_id.tolist() == [1]
    with pytest.raises(InputError, match="tracks 'ann' and '0' would both be number 0"):
        rows.rows(boxes_of("0"), 3)


def test_turned_boxes_are_refused() -> None:
    centre = Value(position=Value(x=10.0, y=10.0), theta=0.5)
    detection = Value(bbox=Value(center=centre, size_x=4.0, size_y=8.0), results=[], id="")
    message = Value(header=Value(stamp=Value(sec=1, nanosec=0), frame_id="cam"), detections=[detection])
    with pytest.raises(InputError, match=r"rotated by 0\.5 rad"):
        read_message("vision_msgs/msg/Detection2DArray", message)
    centre.theta = 0.0
    assert read_message("vision_msgs/msg/Detection2DArray", message).boxes[0].left == 8.0
