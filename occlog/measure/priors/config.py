"""Settings of `occlog priors`: of positions, of views and of sound.

Default lengths are those of the objects in the reference scene of [Ercan] Sec. 6, or of people
in a room where the scene's unit is metres, feet or inches.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import METRES, Settings, option_setting, setting

CHANGE = (
    "Process noise of the velocity per axis, accumulated over 1 s. Larger values widen the priors, the predicted "
    "distributions of positions."
)


@dataclass(frozen=True)
class PositionPriorConfig(Settings):
    """Settings of priors from measured positions; with the defaults of the reference scene the RMS error is 6.67."""

    OWNER: ClassVar[str] = "priors"

    measurement_noise: float = option_setting(
        8.0,
        "Standard deviation, per axis, of the noise added to true positions, or that --measured positions have; 0: "
        "positions are known.",
        unit="length",
        at_least=0,
        people=0.3,
        shown="0.3 m, or 8 in a scene-specific unit; 0 for --measured tracks, added to their own covariance",
    )
    process_noise_velocity: float = setting(1.2, CHANGE, unit="length/s", above=0, people=0.6, option="--process-noise")
    max_coasting_s: float = setting(
        2.0, "Omit objects that are not measured for this long.", unit="s", above=0, option="--max-coasting"
    )


@dataclass(frozen=True)
class HullConfig(Settings):
    """Settings of hull polygons from views."""

    OWNER: ClassVar[str] = "hull"

    max_missed_views: int = option_setting(
        1,
        "Number of cameras that may miss an object. Larger values keep hulls that fewer silhouettes support.",
        at_least=0,
    )
    min_views: int = option_setting(2, "Minimum number of cameras that detect an object.", at_least=1)
    dilation: float = option_setting(
        0.01,
        "Margin added to both sides of every run (foreground interval of a camera), in addition to twice its "
        "sigma_yaw.",
        unit="rad",
        at_least=0,
        metavar="RADIANS",
    )
    min_area: float = option_setting(
        1.0, "Minimum area of a polygon.", unit="length^2", at_least=0, people=0.02, metavar="AREA"
    )
    confirmation_time_s: float = setting(
        0.2,
        "Confirmation time: minimum age of a polygon that is reported.",
        unit="s",
        at_most=1e9,
        at_least=0,
        option="--confirmation-time",
    )
    evidence_memory_s: float = setting(
        2.0,
        "Time for which a polygon counts as confirmed after it alone explained a run (foreground interval of a "
        "camera). Larger values keep more polygons, phantoms included.",
        unit="s",
        at_most=1e9,
        at_least=0,
        option="--evidence-memory",
    )
    deletion_time_s: float = setting(
        0.5,
        "Maximum time for which an occluder keeps its identity while no polygon is found.",
        unit="s",
        at_most=1e9,
        at_least=0,
    )
    coasting_s: float = setting(
        0.3,
        "Time for which a polygon is kept while it is missing, if it has evidence (--evidence-memory).",
        unit="s",
        at_most=1e9,
        at_least=0,
        option="--coasting",
    )
    max_speed: float = setting(3.0, "Maximum speed of objects.", unit="length/s", at_least=0, people=2.5)
    max_jump: float = setting(3.33, "Maximum jump of the centre of a polygon.", unit="length", at_least=0, people=0.5)
    window_s: float = setting(
        0.0,
        "Frames of cameras that are closer together in time are one time step.",
        unit="s",
        at_least=0,
        option="--window",
    )
    exclude_targets: bool = setting(
        True,
        "Omit clusters that are labelled as a target, or keep them as occluders.",
        option="--exclude-targets/--include-targets",
    )

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """Constraints, each as setting, whether it holds, and allowed values: a polygon may move between time steps."""
        yield "max_jump", self.max_speed + self.max_jump > 0, "above 0 where speed is 0"


@dataclass(frozen=True)
class AcousticConfig(Settings):
    """Settings of priors from directions of arrival."""

    OWNER: ClassVar[str] = "acoustic"

    gate: float = option_setting(
        3.0, "Gate in standard deviations for a direction or a position to be of a source.", above=0
    )
    process_noise_velocity: float = setting(
        1.2,
        CHANGE,
        unit="length/s",
        above=0,
        people={unit: 0.6 / metres for unit, metres in METRES.items()},
        option="--process-noise",
    )
    confirmation_time_s: float = setting(
        0.3,
        "Minimum time for which a source has been detected before it gives priors of an occluder.",
        unit="s",
        at_most=1e9,
        at_least=0,
        option="--confirmation-time",
    )
    max_coasting_s: float = setting(
        2.0, "Omit sources that are not detected for this long.", unit="s", at_least=0, option="--max-coasting"
    )
    window_s: float = setting(
        0.0, "Directions closer together in time are one time step.", unit="s", at_least=0, option="--window"
    )
    min_triangulation_angle: float = setting(
        0.1, "Minimum triangulation angle: directions at smaller angles give no position.", unit="rad", at_least=0
    )
