"""Settings of simulated recordings: the world, what sensors measure in it, and video of it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from occlog.core.geometry.radio_defaults import EXPONENT, NOISE_DB, POWER_DBM, SHADOW_DB, SHADOW_S
from occlog.core.navigation.config import FieldSettings
from occlog.settings import Settings, option_setting, setting

START_NS = 1_577_836_800_000_000_000
"""Time of the first step unless the settings say otherwise: 2020-01-01T00:00:00Z."""
SHARE: dict[str, float] = {"at_least": 0, "at_most": 1}


@dataclass(frozen=True)
class WorldConfig(Settings):
    """Settings of moving objects; lengths in the scene's unit.

    Speed, noise and change of destination are per second, so that they keep their
    meaning when the step changes.  The defaults in a scene-specific unit are the reference scene
    of [Ercan] Sec. 6: speed 1 and noise 0.33 per step of one second.  Those in metres, feet and inches are
    people 0.5 m wide who walk at 1.2 m/s and change their destination every 10 s on average.
    """

    OWNER: ClassVar[str] = "world"

    steps: int = option_setting(
        4000, "Number of time steps, including the start.", people=600, at_least=1, at_most=10_000_000
    )
    step_s: float = setting(1.0, "Time between two steps.", unit="s", at_most=1e9, people=0.1, at_least=1e-6)
    targets: int = option_setting(1, "Number of targets.", at_least=0)
    occluders: int = option_setting(0, "Number of other moving objects.", at_least=0)
    diameter: float = option_setting(
        3.33, "Diameter of every object; centres keep this distance.", unit="length", people=0.5, above=0
    )
    speed: float = option_setting(
        1.0, "Speed of an object, without noise.", unit="length/s", people=1.2, above=0, metavar="LENGTH"
    )
    process_noise_position: float = setting(
        0.33,
        "Process noise of the position per axis, accumulated over 1 s; a step has sigma sqrt(step_s).",
        unit="length",
        people=0.05,
        at_least=0,
        option="--process-noise",
    )
    redirect_probability: float = option_setting(
        0.095, "Probability per second of a new destination before arrival; 0: on arrival only.", **SHARE
    )
    wall_clearance: float = option_setting(
        0.0,
        "Minimum distance of centres to walls and static occluders; in video at least half a diameter.",
        unit="length",
        people=0.25,
        at_least=0,
    )
    object_height: float | None = option_setting(
        None,
        "Height of the reference point of the objects.",
        unit="length",
        people=0.9,
        at_least=0,
        nothing="unknown",
        shown="0.9 m; unknown in a scene-specific unit, or for scripted targets",
    )
    start_ns: int = setting(START_NS, "Time of the first step.", unit="ns")
    motion: str = option_setting(
        "waypoints",
        "Motion: `waypoints`, straight on and evading at close range, or `field`, by potential fields ([Lee] Sec. "
        "5.2.2).",
        choices=("waypoints", "field"),
    )


@dataclass(frozen=True)
class FieldConfig(FieldSettings):
    """Settings of avoidance between objects, walls and people for motion `field`."""

    OWNER: ClassVar[str] = "field"

    attraction_power: int = setting(1, "Exponent m of the potential of the destination of an object.", at_least=1)
    patience_s: float = setting(
        20.0,
        "Time without progress towards its destination after which an object takes another one.",
        unit="s",
        people=5.0,
        above=0,
        at_most=1e6,
        option="--patience",
    )


@dataclass(frozen=True)
class ObserveConfig(Settings):
    """Settings of measurements by cameras and microphone arrays."""

    OWNER: ClassVar[str] = "observe"

    diameter: float = setting(
        3.33, "Diameter of moving objects as occluders; 0: no occlusion.", unit="length", people=0.5, at_least=0
    )
    pose_noise: str = option_setting(
        "white",
        "Pose errors (extrinsics) of cameras: `white`, new in every frame ([Ercan] Eq. 2), or `calibration`, "
        "constant per camera; then only the read noise is white.",
        choices=("white", "calibration"),
    )
    miss_probability: float = option_setting(
        0.0,
        "Miss probability of a visible or audible target (1 - P_D); `detection` and `false_alarm_probability` "
        "of a camera in "
        "the scene take precedence.",
        **SHARE,
    )
    false_alarm_probability: float = option_setting(
        0.0,
        "False alarm probability of a frame in which a target is not detected, at a position uniform in the image.",
        **SHARE,
    )


@dataclass(frozen=True)
class SoundConfig(Settings):
    """Settings of sound sources, and of false directions at arrays."""

    OWNER: ClassVar[str] = "sound"

    sound_and_silence_s: tuple[float, float] | None = setting(
        None,
        "Random silences of targets: mean seconds of sound and of silence, both exponential, in turn.",
        unit="s",
        counts=(2,),
        option="--silence",
        metavar="SOUND_S,SILENT_S",
        nothing="never",
    )
    false_alarm_rate: float = option_setting(
        0.0, "False alarm rate: directions without a source per second and array.", at_least=0, metavar="RATE"
    )
    label_doa: bool = option_setting(False, "Write the target ID of each direction, for tests.", shown="unlabelled")
    step_s: float = setting(
        1.0, "Time between the frames of an array without its own rate.", unit="s", at_most=1e9, above=0
    )
    known_heights: bool = setting(
        True, "The heights of targets are known, so that directions have elevations. Without, no direction has one."
    )

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """Check that the mean durations of sound and silence are above 0."""
        yield (
            "sound_and_silence_s",
            self.sound_and_silence_s is None or min(self.sound_and_silence_s) > 0,
            "two mean times above 0 s",
        )


@dataclass(frozen=True)
class ReadConfig(Settings):
    """Settings of tag readers; every target carries a tag.

    A read at a distance of d metres has the strength power - 10 exponent log10(d) [dBm], plus the shadowing of the
    reader and tag, which changes slowly, plus white noise.
    """

    OWNER: ClassVar[str] = "reads"

    power: float = setting(
        POWER_DBM,
        "Received power at 1 m of readers for which the scene states none.",
        unit="dBm",
        option="--read-power",
    )
    path_loss_exponent: float = option_setting(EXPONENT, "Exponent of the path loss.", above=0)
    noise_db: float = setting(
        NOISE_DB,
        "Measurement noise of a read: standard deviation of its white part.",
        unit="dB",
        at_least=0,
        option="--read-noise",
    )
    shadow_db: float = setting(
        SHADOW_DB, "Standard deviation of the shadowing.", unit="dB", at_least=0, option="--shadowing"
    )
    shadow_s: float = setting(
        SHADOW_S, "Correlation time of the shadowing.", unit="s", above=0, option="--shadowing-time"
    )
    min_rssi_dbm: float | None = setting(
        None, "Sensitivity: weaker signals are not read.", unit="dBm", option="--min-rssi", nothing="all are"
    )
    read_detection_probability: float = option_setting(
        0.95,
        "Probability that a polling reader reads a tag in its range, or any tag where the scene states no range.",
        **SHARE,
    )
    read_false_alarm_probability: float = option_setting(
        0.01, "Probability that a polling reader reads a tag out of its range.", **SHARE
    )


KINDS = ("range", "difference", "strength")
"""Quantities that stations can measure."""


@dataclass(frozen=True)
class MeasureConfig(Settings):
    """Settings of ranges, range differences and signal strengths measured by cameras and arrays.

    Every target transmits its identity. Strengths have the path loss, noise and shadowing of tag reads.
    """

    OWNER: ClassVar[str] = "measure"

    measure: str | None = option_setting(
        None,
        "Additional measurements of cameras and arrays: range, difference (of ranges, to the first of them), "
        "strength; separated by commas.",
        metavar="KINDS",
        nothing="directions alone",
    )
    measure_rate_hz: float | None = setting(
        None, "Rate of these measurements.", unit="Hz", above=0, option="--measure-rate", nothing="at every step"
    )
    range_noise: float = option_setting(
        0.1, "Measurement noise of ranges (standard deviation).", unit="length", people=0.1, above=0
    )
    range_difference_noise: float = option_setting(
        0.1, "Measurement noise of differences of ranges (standard deviation).", unit="length", people=0.1, above=0
    )
    measure_miss_probability: float = option_setting(0.0, "Probability of a missed measurement.", **SHARE)
    measure_outlier_probability: float = option_setting(
        0.0, "Probability of an outlier, uniform over the values that are possible in the scene.", **SHARE
    )
    nlos_probability: float = option_setting(
        0.0, "Probability of a non-line-of-sight (NLOS) signal, which makes its range too long.", **SHARE
    )
    nlos_bias: float = option_setting(
        1.0, "Mean NLOS bias, the excess of such ranges (exponential).", unit="length", people=1.0, above=0
    )

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """Check that the kinds are known."""
        known = self.measure is None or (bool(self.kinds) and set(self.kinds) <= set(KINDS))
        yield "measure", known, f"one or several of {', '.join(KINDS)}, separated by commas"

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of measurements that are simulated; empty: none."""
        return () if self.measure is None else tuple(part.strip() for part in self.measure.split(","))


@dataclass(frozen=True)
class RenderConfig(Settings):
    """Settings of the rendered video: noise, light, shadows, clothes, and the diameter that gives the scale."""

    OWNER: ClassVar[str] = "render"

    noise: float = setting(
        1.5,
        "Image noise common to the colour channels: standard deviation in grey levels of 255.",
        at_least=0,
        option="--image-noise",
        metavar="LEVELS",
    )
    colour_noise: float = option_setting(1.0, "Image noise per colour channel.", at_least=0, metavar="LEVELS")
    light_drift: float = option_setting(0.03, "Relative amplitude of the light variation.", at_least=0, below=1)
    light_period_s: float = setting(60.0, "Period of the light variation.", unit="s", above=0, option="--light-period")
    shadows: bool = setting(True, "Shadows of people on the floor.", option="--shadows/--no-shadows")
    texture: float = option_setting(
        1.0, "Contrast of tiles, bricks and grain; 0: plain paint, which makes small files.", at_least=0
    )
    identical_clothes: bool = option_setting(
        False,
        "Dress all people like the targets, so that they cannot be distinguished by appearance.",
        shown="different clothes",
    )
    two_sided: bool = option_setting(
        False, "Shirts have another colour at the back: the front colour of the next target.", shown="one colour"
    )
    identical_targets: bool = setting(False, "All targets have the clothes and the stature of the first one.")
    min_visibility: float = setting(
        0.1, "Minimum visibility of a body to have a true box; 0: occluded ones too.", **SHARE
    )
    diameter: float = setting(
        3.33,
        "Diameter of an object, in the unit of the scene. Where the length of that unit is unknown, one diameter "
        "is taken as 0.5 m.",
        unit="length",
        people=0.5,
        above=0,
    )
    workers: int = setting(1, "Cameras drawn at the same time; the result does not depend on it.", at_least=1)


@dataclass(frozen=True)
class StoreConfig(Settings):
    """Settings of the video's format."""

    OWNER: ClassVar[str] = "video"

    store: str = option_setting(
        "png",
        "Video as PNG images in the recording, or as lossless FFV1 files next to it, which are smaller.",
        choices=("png", "ffv1"),
    )
    grey: bool = option_setting(False, "Video without colours.", shown="colours")


@dataclass(frozen=True)
class PeopleConfig(Settings):
    """Numbers of people of identical appearance in a room, and of the cameras that see them."""

    OWNER: ClassVar[str] = "people"

    people: int = option_setting(4, "Number of people, all targets in the same clothes.", at_least=1)
    frames: int = option_setting(400, "Number of frames of each camera.", at_least=1, at_most=10_000_000)
    views: int = option_setting(3, "Number of cameras.", at_least=1, at_most=6)
    width: int = setting(640, "Width of the images.", unit="px", at_least=64, at_most=8192)
    height: int = setting(480, "Height of the images.", unit="px", at_least=64, at_most=8192)
    start_separated: bool = setting(
        True, "Start without occlusions of targets in the first frame.", option="--separated/--overlapping"
    )
