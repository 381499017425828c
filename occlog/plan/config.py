"""Settings of `occlog plan`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import Settings, like, option_setting, setting
from occlog.simulate.config import WorldConfig
from occlog.track.methods.apf.config import ApfConfig

MAX_PEOPLE = 1000


@dataclass(frozen=True)
class PlanConfig(Settings):
    """Settings of the walking people, the filter, and the map of expected errors; lengths in the scene's unit."""

    OWNER: ClassVar[str] = "plan"

    people: int | None = option_setting(
        None,
        "Number of people other than the target, who occlude it.",
        at_least=0,
        at_most=MAX_PEOPLE,
        nothing="from --density",
    )
    density: float = option_setting(
        0.0,
        "People other than the target per square metre (or squared scene unit) of the floor, "
        "where their number is not given.",
        at_least=0,
        metavar="NUMBER",
    )
    person_diameter: float = like(WorldConfig, "diameter", "Diameter of a person.")
    height: float | None = option_setting(
        None,
        "Height, in the scene's unit, of people who occlude the target from cameras of known height.",
        unit="length",
        above=0,
        nothing="no camera sees over them, as in `occlog simulate`",
    )
    target_height: float = option_setting(
        0.0,
        "Height above the ground of the point of the target that sensors measure.",
        unit="length",
        at_least=0,
        people=0.9,
    )
    speed: float = like(WorldConfig, "speed", "Speed of target and people.")
    process_noise_position: float = like(
        WorldConfig,
        "process_noise_position",
        "Process noise of the target: standard deviation of its position per axis after 1 s. With larger values errors "
        "grow faster between detections.",
    )
    redirect_probability: float = like(
        WorldConfig,
        "redirect_probability",
        "Probability per second of a new destination before arrival.",
        at_most=None,
        below=1,
    )
    filter_process_noise_position: float = like(
        ApfConfig,
        "process_noise_position",
        "Process noise of the position per axis that the filter assumes, accumulated over 1 s; at least `sigma`.",
    )
    filter_process_noise_velocity: float = like(
        ApfConfig,
        "process_noise_velocity",
        "Process noise of the velocity per axis that the filter assumes, accumulated over 1 s.",
    )
    rate_hz: float = setting(
        1.0,
        "Frame rate of sensors for which the scene states none.",
        unit="Hz",
        people=10.0,
        above=0,
        at_most=1000,
        option="--rate",
    )
    settling_s: float = setting(
        60.0,
        "Duration for which the target has been tracked when it reaches a position. Longer durations approach "
        "the steady state.",
        unit="s",
        people=8.0,
        above=0,
        at_most=3600,
    )
    cells: int = option_setting(
        400,
        "Number of positions of the map, approximately. More show finer detail and take longer.",
        at_least=4,
        at_most=100_000,
    )
    samples_per_cell: int = option_setting(
        16,
        "Random walks through each position, each with a crowd. More reduce the Monte Carlo error and take longer.",
        at_least=4,
        at_most=10_000,
    )
    max_expected_error: float | None = option_setting(
        None,
        "Report the share of the floor with an expected RMS error below this, in the scene's unit.",
        unit="length",
        above=0,
        nothing="not reported",
    )

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """Constraints, each as setting, whether it holds, and allowed values: the time window has 2 to 20000 steps."""
        steps = self.settling_s * self.rate_hz
        yield "settling_s", 2 <= steps <= 20_000, "2 to 20000 steps long"
