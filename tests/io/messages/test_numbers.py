"""Numbers in messages that are beyond all range: they are refused, and nothing warns on the way."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.errors import InputError
from occlog.io.messages.camera_info import intrinsics
from occlog.io.messages.kinds import DirectionMessage, Header, InfoMessage, Source, TransformMessage
from occlog.io.messages.rows import direction_rows
from occlog.io.messages.transforms import rotation_of
from occlog.records.scene import MicrophoneArray

pytestmark = pytest.mark.filterwarnings("error")
HEADER = Header(1, "cam")
LARGE = 1e200


@pytest.mark.parametrize("value", [LARGE, np.inf, np.nan])
def test_a_direction_beyond_all_range(value: float) -> None:
    heard = DirectionMessage(HEADER, (Source(1, (value, 0.1, 0.1), 1.0),))
    with pytest.raises(InputError, match="want a unit vector"):
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
