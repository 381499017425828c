"""Settings of simulated recordings: the world, what sensors measure in it, and video of it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from occlog.core.geometry.radio_defaults import EXPONENT, NOISE_DB, POWER_DBM, SHADOW_DB, SHADOW_S
from occlog.core.navigation.config import FieldSettings
from occlog.settings import Settings, setting

START_NS = 1_577_836_800_000_000_000
"""Time of the first step unless the settings say otherwise: 2020-01-01T00:00:00Z."""
SHARE: dict[str, float] = {"at_least": 0, "at_most": 1}


@dataclass(frozen=True)
class WorldConfig(Settings):
    """Settings of moving objects; lengths in the scene's unit.

    Speed, noise and change of destination are per second, so that they keep their
    meaning when the step changes.  The defaults in its own unit are the reference scene
    of [Ercan] Sec. 6: speed 1 and noise 0.33 per step of one second.  Those in metres, feet and inches are
    people 0.5 m wide who walk at 1.2 m/s and change their destination every 10 s on average.
    """

    OWNER: ClassVar[str] = "world"

    steps: int = setting(
        4000, "Time steps, the start included.", people=600, at_least=1, at_most=10_000_000, option="--steps"
    )
    step_s: float = setting(1.0, "Time between two steps.", unit="s", at_most=1e9, people=0.1, at_least=1e-6)
    targets: int = setting(1, "Targets.", at_least=0, option="--targets")
    occluders: int = setting(0, "Other moving objects.", at_least=0, option="--occluders")
    diameter: float = setting(
        3.33,
        "Of every object; their centres keep this distance.",
        unit="length",
        people=0.5,
        above=0,
        option="--diameter",
        metavar="LENGTH",
    )
    speed: float = setting(
        1.0,
        "Way of an object in a second, without noise.",
        unit="length/s",
        people=1.2,
        above=0,
        option="--speed",
        metavar="LENGTH",
    )
    sigma: float = setting(
        0.33,
        "Noise of the motion per axis, gathered in a second; a step has sigma sqrt(step_s).",
        unit="length",
        people=0.05,
        at_least=0,
        option="--sigma",
        metavar="LENGTH",
    )
    redirect: float = setting(
        0.095,
        "Probability of a new destination within a second; 0: only on arrival.",
        option="--redirect",
        **SHARE,
    )
    clearance: float = setting(
        0.0,
        "Centres keep this distance from walls and static occluders; in video at least half a diameter.",
        unit="length",
        people=0.25,
        at_least=0,
        option="--clearance",
        metavar="LENGTH",
    )
    z: float | None = setting(
        None,
        "Height of the objects' reference point.",
        unit="length",
        people=0.9,
        at_least=0,
        option="--z",
        metavar="LENGTH",
        nothing="not known",
        shown="0.9 m; not known in a unit of its own, or of scripted targets",
    )
    start_ns: int = setting(START_NS, "Time of the first step.", unit="ns")
    motion: str = setting(
        "waypoints",
        "How objects come to their places: `waypoints`, straight on and around each other at the last moment, or "
        "`field`, by potential fields, out of each other's way ([Lee] Sec. 5.2.2).",
        choices=("waypoints", "field"),
        option="--motion",
    )


@dataclass(frozen=True)
class FieldConfig(FieldSettings):
    """Settings of avoidance between objects, walls and people for motion `field`."""

    OWNER: ClassVar[str] = "field"

    attraction_power: int = setting(1, "Exponent m of the potential of an object's destination.", at_least=1)
    patience_s: float = setting(
        20.0,
        "An object that does not get nearer to its destination for so long takes another one.",
        unit="s",
        people=5.0,
        above=0,
        at_most=1e6,
        option="--patience",
        metavar="SECONDS",
    )


@dataclass(frozen=True)
class ObserveConfig(Settings):
    """Settings of measurements by cameras and microphone arrays."""

    OWNER: ClassVar[str] = "observe"

    diameter: float = setting(
        3.33,
        "Of moving objects, as they hide targets; 0: they hide nothing.",
        unit="length",
        people=0.5,
        at_least=0,
    )
    noise: str = setting(
        "white",
        "Errors of a camera's pose: `white`, drawn anew for every frame ([Ercan] Eq. 2), or `calibration`, drawn "
        "once for each camera and fixed in time; only the read noise is white then.",
        choices=("white", "calibration"),
        option="--noise",
    )
    miss: float = setting(
        0.0,
        "Probability that a camera or array misses a target that it could measure; a camera's own `detection` in "
        "the scene comes first, as its `false_alarm` does.",
        option="--miss",
        **SHARE,
    )
    false_alarm: float = setting(
        0.0,
        "Probability that a frame in which a target was not detected reports it all the same, at a place drawn "
        "uniformly from the image.",
        option="--false-alarm",
        **SHARE,
    )


@dataclass(frozen=True)
class SoundConfig(Settings):
    """Settings of sound sources, and of false directions at arrays."""

    OWNER: ClassVar[str] = "sound"

    silence: tuple[float, float] | None = setting(
        None,
        "Targets fall silent at random: mean seconds of sound and of silence, both exponential, in turn; the start "
        "of the recording is a moment like any other.",
        unit="s",
        counts=(2,),
        option="--silence",
        metavar="SOUND_S,SILENT_S",
        nothing="never",
    )
    false_rate: float = setting(
        0.0,
        "Directions without a source, a second and array.",
        at_least=0,
        option="--false-doa",
        metavar="RATE",
    )
    label: bool = setting(
        False,
        "Write which target each direction is of, to test with.",
        option="--label-doa",
        shown="unlabelled",
    )
    step_s: float = setting(
        1.0, "Time between the looks of an array without a rate of its own.", unit="s", at_most=1e9, above=0
    )
    heights: bool = setting(True, "Targets have known heights; without, false directions have no elevation either.")

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """Sound and silence last for some time."""
        yield "silence", self.silence is None or min(self.silence) > 0, "two mean times above 0 s"


@dataclass(frozen=True)
class ReadConfig(Settings):
    """Settings of tag readers; every target carries a tag.

    A read at a distance of d metres has the strength power - 10 exponent log10(d), plus the shadowing of the reader and
    tag, which changes slowly, plus white noise.
    """

    OWNER: ClassVar[str] = "reads"

    power: float = setting(
        POWER_DBM,
        "Strength at 1 m of readers of which the scene does not say it.",
        unit="dBm",
        option="--read-power",
        metavar="DBM",
    )
    exponent: float = setting(EXPONENT, "Exponent of the path loss.", above=0, option="--path-loss-exponent")
    noise_db: float = setting(
        NOISE_DB,
        "Standard deviation of a read's white noise.",
        unit="dB",
        at_least=0,
        option="--read-noise",
        metavar="DB",
    )
    shadow_db: float = setting(
        SHADOW_DB, "Standard deviation of the shadowing.", unit="dB", at_least=0, option="--shadowing", metavar="DB"
    )
    shadow_s: float = setting(
        SHADOW_S,
        "Time in which the shadowing is forgotten.",
        unit="s",
        above=0,
        option="--shadowing-time",
        metavar="SECONDS",
    )
    weakest: float | None = setting(
        None, "Weaker signals are not read.", unit="dBm", option="--weakest-read", metavar="DBM", nothing="all are"
    )
    detection: float = setting(
        0.95,
        "Probability that a reader that looks reads a tag in its range, or any tag where the scene says no range.",
        option="--read-detection",
        **SHARE,
    )
    stray: float = setting(
        0.01, "Probability that a reader that looks reads a tag out of its range.", option="--stray-reads", **SHARE
    )


KINDS = ("range", "difference", "strength")
"""Quantities that stations can measure."""


@dataclass(frozen=True)
class MeasureConfig(Settings):
    """Settings of distance measurements of cameras and arrays; every target transmits its identity.

    Strengths have the path loss, noise and shadowing of reads of tags; readers make these and nothing else.
    """

    OWNER: ClassVar[str] = "measure"

    measure: str | None = setting(
        None,
        "What cameras and arrays measure beside directions: range, difference (of ranges, to the first of them), "
        "strength, or several, separated by commas.",
        option="--measure",
        metavar="KINDS",
        nothing="directions alone",
    )
    measure_rate_hz: float | None = setting(
        None, "How often they do.", unit="Hz", above=0, option="--measure-rate", metavar="HZ", nothing="at every step"
    )
    range_noise: float = setting(
        0.1,
        "Standard deviation of ranges.",
        unit="length",
        people=0.1,
        above=0,
        option="--range-noise",
        metavar="LENGTH",
    )
    difference_noise: float = setting(
        0.1,
        "Standard deviation of differences of ranges.",
        unit="length",
        people=0.1,
        above=0,
        option="--difference-noise",
        metavar="LENGTH",
    )
    measure_miss: float = setting(0.0, "Probability that a value is not measured.", option="--measure-miss", **SHARE)
    measure_false: float = setting(
        0.0,
        "Probability that a value is false: drawn uniformly from those that are possible in the scene.",
        option="--measure-false",
        **SHARE,
    )
    measure_late: float = setting(
        0.0,
        "Probability that a signal comes by a detour (no line of sight), so that its range is too long.",
        option="--measure-late",
        **SHARE,
    )
    detour: float = setting(
        1.0,
        "Mean length of a detour, which is exponential.",
        unit="length",
        people=1.0,
        above=0,
        option="--detour",
        metavar="LENGTH",
    )

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """Kinds are known."""
        known = self.measure is None or (bool(self.kinds) and set(self.kinds) <= set(KINDS))
        yield "measure", known, f"one or several of {', '.join(KINDS)}, separated by commas"

    @property
    def kinds(self) -> tuple[str, ...]:
        """Settings of the measurements."""
        return () if self.measure is None else tuple(part.strip() for part in self.measure.split(","))


@dataclass(frozen=True)
class RenderConfig(Settings):
    """Appearance of the video."""

    OWNER: ClassVar[str] = "render"

    noise: float = setting(
        1.5,
        "Noise of every pixel, common to its colours: standard deviation in grey levels of 255.",
        at_least=0,
        option="--image-noise",
        metavar="LEVELS",
    )
    colour_noise: float = setting(
        1.0, "Noise of every colour alone.", at_least=0, option="--colour-noise", metavar="LEVELS"
    )
    light_drift: float = setting(
        0.03, "Share by which the light rises and falls.", at_least=0, below=1, option="--light-drift"
    )
    light_period_s: float = setting(
        60.0, "Time in which it does so.", unit="s", above=0, option="--light-period", metavar="SECONDS"
    )
    shadows: bool = setting(True, "Shadows of people on the floor.", option="--shadows/--no-shadows")
    texture: float = setting(
        1.0,
        "Contrast of tiles, bricks and grain; 0, plain paint, makes small files.",
        at_least=0,
        option="--texture",
    )
    lookalike: bool = setting(
        False, "The others wear the same clothes as the targets.", option="--lookalike", shown="clothes of their own"
    )
    two_sided: bool = setting(
        False,
        "Shirts have another colour behind than in front: the back of each target is as the front of the next one.",
        option="--two-sided",
        shown="the same all around",
    )
    alike: bool = setting(False, "All targets have the clothes and the stature of the first one.")
    min_visible: float = setting(
        0.1, "Bodies of which less than this share is visible have no box; 0: hidden ones have it too.", **SHARE
    )
    diameter: float = setting(
        3.33,
        "Of an object in a scene whose unit is no known length: it is taken as 0.5 m.",
        unit="length",
        people=0.5,
        above=0,
    )
    workers: int = setting(1, "Cameras drawn at the same time; the result does not depend on it.", at_least=1)


@dataclass(frozen=True)
class StoreConfig(Settings):
    """Settings of the video's format."""

    OWNER: ClassVar[str] = "video"

    store: str = setting(
        "png",
        "Video as PNG images in the recording, or lossless FFV1 files beside it, which are smaller.",
        choices=("png", "ffv1"),
        option="--store",
    )
    grey: bool = setting(False, "Video without colours.", option="--grey", shown="colours")


@dataclass(frozen=True)
class PeopleConfig(Settings):
    """Numbers of people of identical appearance in a room, and of the cameras that see them."""

    OWNER: ClassVar[str] = "people"

    people: int = setting(4, "How many, all targets in the same clothes.", at_least=1, option="--people")
    frames: int = setting(400, "Of each camera.", at_least=1, at_most=10_000_000, option="--frames")
    views: int = setting(3, "Cameras.", at_least=1, at_most=6, option="--views")
    width: int = setting(640, "Of the images.", unit="px", at_least=64, at_most=8192)
    height: int = setting(480, "Of the images.", unit="px", at_least=64, at_most=8192)
    start_apart: bool = setting(True, "No target hides another in the first frame.", option="--apart/--overlap")
