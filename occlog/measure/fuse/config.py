"""Settings of the fusion of detections."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from occlog.measure.detections import PERSON_HEIGHT
from occlog.settings import Settings, option_setting, setting


@dataclass(frozen=True)
class FuseConfig(Settings):
    """Settings of the fusion; lengths in the scene's unit.

    Default lengths are for objects of width 3.33; `FuseConfig.in_unit` returns those for people.
    """

    OWNER: ClassVar[str] = "fuse"

    sigma_prediction: float = option_setting(
        3.33,
        "Standard deviation of a position about its prediction ([Lee] Eq. 4.20), about the width of a person.",
        unit="length",
        above=0,
        people={"m": 0.5, "ft": 1.6, "in": 20.0},
    )
    miss_probability: float = option_setting(
        0.2, "Probability of a missed detection, unless the scene states it ([Lee] P_M).", above=0, below=1
    )
    false_alarm_probability: float = option_setting(
        0.2, "Probability of a false alarm, unless the scene states it ([Lee] P_F).", above=0, below=1
    )
    detection_gate: float = option_setting(
        4.0, "Gate in standard deviations: a detection farther from the prediction counts as missed.", above=0
    )
    gate: float = option_setting(
        3.0, "Gate in standard deviations: a detection farther from the fused position is removed.", above=0
    )
    max_coasting_steps: int = option_setting(
        5,
        "Maximum coasting: consecutive steps without a declaration after which a prediction is dropped.",
        at_least=1,
        metavar="TIMES",
    )
    window_s: float = setting(
        0.0,
        "Frames closer together in time are fused as one time step.",
        unit="s",
        at_least=0,
        option="--window",
        shown="equal times",
    )
    min_triangulation_angle_deg: float = setting(
        5.0,
        "Minimum triangulation angle: lines of sight at smaller angles give no position.",
        unit="deg",
        above=0,
        below=90,
    )
    process_noise_density: float = setting(
        1.0,
        "Process noise: spectral density of white acceleration with which objects are predicted.",
        unit="length^2/s^3",
        above=0,
        people={"m": 1.0, "ft": 10.0, "in": 1500.0},
    )
    sigma_initial_velocity: float = setting(
        1.5,
        "Standard deviation of the velocity of a new object, per axis.",
        unit="length/s",
        above=0,
        people={"m": 1.5, "ft": 5.0, "in": 60.0},
    )
    person_height: float | None = option_setting(
        None,
        "Height of a person, to find the feet in boxes.",
        unit="length",
        above=0,
        people=PERSON_HEIGHT,
        shown="1.7 m",
    )
