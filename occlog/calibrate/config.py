"""Settings of `occlog calibrate`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import Settings, option_setting, setting


@dataclass(frozen=True)
class CalibrateConfig(Settings):
    """Settings of the calibration by walking people; lengths in metres."""

    OWNER: ClassVar[str] = "calibrate"

    person_height: float = option_setting(
        1.7,
        "Mean height of people. It determines the scale where no pose is stated: 5 % too small makes every "
        "distance 5 % too small. Typical 1.7 m for adults.",
        unit="m",
        above=0.2,
        at_most=3,
        metavar="METRES",
    )
    sigma_mean_height: float = setting(
        0.05,
        "Standard deviation of the mean height of people. With larger values the stated poses determine the scale.",
        unit="m",
        above=0,
        at_most=1,
    )
    sigma_person_height: float = setting(
        0.1, "Standard deviation of the height among people.", unit="m", above=0, at_most=1
    )
    sigma_position: float = option_setting(
        0.5,
        "Standard deviation of the stated position of each camera, a prior of the estimate. Larger values allow larger "
        "corrections.",
        unit="m",
        above=0,
        metavar="METRES",
    )
    sigma_yaw: float = setting(
        3.0,
        "Standard deviation of the stated yaw angles of the cameras. Larger values allow larger corrections.",
        unit="deg",
        above=0,
        at_most=180,
        option="--sigma-angle",
        metavar="DEG",
    )
    sigma_tilt: float | None = setting(
        None,
        "Standard deviation of the stated pitch and roll angles of cameras that share no view.",
        unit="deg",
        above=0,
        at_most=90,
        nothing="estimated from people",
        shown="estimated from people",
    )
    sigma_height: float | None = setting(
        None,
        "Standard deviation of the stated heights of cameras that share no view, which then determine the scale.",
        unit="m",
        above=0,
        nothing="estimated from people",
        shown="estimated from people",
    )
    max_clock_offset: float = option_setting(
        2.0,
        "Largest offset between the clocks of two cameras that is searched. Larger values take longer; 0: clocks "
        "agree, and are not estimated.",
        unit="s",
        at_least=0,
        at_most=600,
    )
    max_gap: float = option_setting(
        10.0,
        "Longest time that a person is not seen between two views of cameras that share no view.",
        unit="s",
        above=0,
        at_most=60,
    )
    source_height: float = setting(
        1.5,
        "Mean height of people's mouths above the ground, as sources of sound. Heights of microphone arrays are "
        "relative to it.",
        unit="m",
        at_least=0,
        at_most=3,
    )
    sigma_source_height: float = setting(
        0.1, "Standard deviation of the mean height of mouths.", unit="m", at_least=0, at_most=1
    )
    rounds: int = setting(
        2,
        "Number of iterations: boxes of all cameras are associated by method `jipda`, then cameras are adjusted to "
        "them. 0: only tracks of single cameras are associated, once.",
        at_least=0,
        at_most=10,
    )
