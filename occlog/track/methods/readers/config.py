"""Settings of the methods `virtual` and `rssi`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from occlog.core.geometry.radio_defaults import EXPONENT, NOISE_DB, POWER_DBM, SHADOW_DB, SHADOW_S
from occlog.settings import Settings, option_setting, setting
from occlog.track.smoothing_and_lag import LagConfig

PARTICLES, SMOOTHED_PARTICLES = 1000, 5000
"""Default numbers of particles of a tag: of the filter, and where it is smoothed."""


@dataclass(frozen=True)
class RefineConfig(Settings):
    """Settings of the refinement of tag positions by cameras: which cameras, how, and which of their bearings."""

    refine: tuple[str, ...] | None = option_setting(
        None,
        "Cameras with detections that are combined with the tag positions, which makes them more accurate.",
        metavar="CAM,CAM",
        nothing="none",
    )
    refine_method: str = option_setting(
        "rays",
        "Refinement of a tag position: triangulation with the position as prior (rays), projection onto planes through "
        "the position (printed-1, [Lee] Eq. 5.39), or that with corrected depth (parallel, Eq. 5.40).",
        choices=("rays", "parallel", "printed-1"),
    )
    max_frame_age_s: float = setting(0.5, "Maximum time between frame and read.", unit="s", at_least=0, at_most=1e6)
    gate: float = setting(3.0, "Gate in standard deviations for assigning an unlabelled candidate to a tag.", above=0)
    tag_speed: float = setting(
        1.0,
        "Speed of tags: lines of sight count less the further their time is from that of a read.",
        unit="length/s",
        people=1.0,
        at_least=0,
    )


@dataclass(frozen=True)
class VirtualConfig(RefineConfig):
    """Settings of method `virtual`, which locates a tag by the set of readers that read it."""

    OWNER: ClassVar[str] = "virtual"

    reader_range: float | None = setting(
        None,
        "Range of readers for which the scene states none.",
        unit="length",
        above=0,
        nothing="the scene must state it",
    )
    min_rssi_dbm: float | None = setting(
        None,
        "Ignore reads weaker than this [dBm].",
        nothing="every read counts, or as stated in the file of path losses",
    )
    detection_probability: float = setting(
        1.0, "Probability that a reader reads a tag in its range in a window.", above=0, at_most=1
    )
    false_alarm_probability: float = setting(
        0.0, "Probability that a reader reads a tag out of its range in a window.", at_least=0, below=1
    )

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """Generate (setting, whether it fits, limit as text): reads in range are likelier than reads out of range."""
        yield (
            "false_alarm_probability",
            self.false_alarm_probability < self.detection_probability,
            "below detection_probability",
        )


@dataclass(frozen=True)
class RssiConfig(LagConfig, RefineConfig):
    """Settings of method `rssi`: a particle filter on the strength of the signals.

    A read at a distance of d metres has the strength power - 10 exponent log10(d), plus the reader's shadowing, which
    changes slowly, plus white noise.
    """

    OWNER: ClassVar[str] = "rssi"

    particles: int | None = setting(
        None,
        "Particles per tag. More reduce the Monte Carlo error, of which smoothed covariances hold nothing, and take "
        "time in proportion.",
        at_least=10,
        at_most=1_000_000,
        nothing=f"{PARTICLES}, or {SMOOTHED_PARTICLES} with --smooth or --lag",
    )
    power: float = setting(
        POWER_DBM,
        "Received power at 1 m [dBm] of readers for which the scene states none. Check it with `occlog fit-readers`.",
    )
    path_loss_exponent: float = setting(EXPONENT, "Path loss exponent: 2 in free space, 2.5 to 4 indoors.", above=0)
    noise_db: float = setting(
        NOISE_DB, "Measurement noise of a read: standard deviation of its white part [dB].", above=0
    )
    shadow_db: float = setting(SHADOW_DB, "Standard deviation of the shadowing [dB].", at_least=0)
    shadow_s: float = setting(SHADOW_S, "Correlation time of the shadowing.", unit="s", above=0)
    tag_height: float = setting(0.0, "Height of tags above the floor.", unit="length", people=1.2)
    sigma_velocity: float = setting(
        1.0,
        "Standard deviation of the velocity per axis: the usual speed over the root of two.",
        unit="length/s",
        people=0.85,
        above=0,
    )
    velocity_time_constant_s: float = setting(
        4.0, "Time constant of the velocity. Shorter values follow turns and predict less far.", unit="s", above=0
    )
    detection_probability: float = setting(
        0.95, "Probability that a reader of known range reads a tag in it in a window.", above=0, below=1
    )
    false_alarm_probability: float = setting(
        0.01, "Probability that a reader of known range reads a tag out of it in a window.", above=0, below=1
    )

    @property
    def n_particles(self) -> int:
        """Return the number of particles of a tag; if not stated, more where tracks are smoothed."""
        if self.particles is not None:
            return self.particles
        return SMOOTHED_PARTICLES if self.smoothed else PARTICLES

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """Generate (setting, whether it fits, limit as text): reads in range are likelier than reads out of range."""
        yield (
            "false_alarm_probability",
            self.false_alarm_probability < self.detection_probability,
            "below detection_probability",
        )
