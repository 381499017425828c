"""Settings of the filter of several motion models for several targets, and of its cooperation with cameras."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import listed, option_setting, setting
from occlog.track.smoothing_and_lag import SmoothingConfig

POLICIES = ("none", "periodic", "printed", "count", "spread")
TRIGGERS = ("count", "bearing", "ellipse")
"""Triggers of policy `printed`: [Lee] Eqs. 3.14, 3.15 and 3.16."""
START_NUMBERS = 6
"""X, Y, SIGMA, VX, VY, SIGMA_V of one target."""


@dataclass(frozen=True)
class ImmConfig(SmoothingConfig):
    """Settings of method `imm`; lengths in the scene's unit, times in seconds, angles in radians."""

    OWNER: ClassVar[str] = "imm"

    particles: int = option_setting(
        2000,
        "Particles per target; each is moved under all three motion models. More reduce the Monte Carlo error and "
        "take time in proportion.",
        at_least=1,
    )
    start: tuple[float, ...] | None = setting(
        None, "Known initial states: X, Y, SIGMA, VX, VY, SIGMA_V per target.", unit="length", nothing="none"
    )

    # Motion, [Lee] Sec. 3.3.1
    turn_acceleration: float = setting(
        1.0, "Lateral acceleration of the two turn models ([Lee] alpha).", unit="length/s^2", at_least=0
    )
    process_noise_velocity: float = setting(
        1.3,
        "Process noise of the velocity per axis, accumulated over 1 s. Larger values follow manoeuvres and widen "
        "the gate.",
        unit="length/s",
        at_least=0,
    )
    model_sojourn_s: float | None = setting(
        None,
        "Mean sojourn time of a motion model. Shorter values switch faster between straight motion and turns.",
        unit="s",
        at_most=1e9,
        above=0,
        nothing="models independent at every step",
    )
    sigma_initial_velocity: float = setting(
        1.0, "Standard deviation of the velocity of a new track, per axis.", unit="length/s", at_least=0
    )

    # Data association
    association: str = setting(
        "joint",
        "Data association: `joint` over all targets (JPDA), or `any`: the filter of every target takes any bearing "
        "([Lee] Eq. 3.6).",
        choices=("joint", "any"),
    )
    detection_probability: float = setting(
        0.95, "Detection probability of a sounding target in range of an array.", above=0, at_most=1
    )
    clutter_rate: float = setting(
        0.1,
        "Clutter rate: false bearings expected per array and scan, uniform in azimuth. Raise it in reverberant rooms.",
        above=0,
    )
    source_height: float | None = setting(
        None,
        "Height of sources above the ground, for the range of arrays.",
        unit="length",
        nothing="an array's range is taken on the ground",
    )
    mean_sound_s: float = setting(30.0, "Mean time that a target sounds before a silence.", unit="s", above=0)
    mean_silence_s: float = setting(
        3.0, "Mean duration of a silence. Longer values keep silent tracks for longer.", unit="s", above=0
    )

    # Births and deaths
    birth_probability: float = setting(
        0.02,
        "Probability that an unassigned bearing initiates a track. Higher values find new targets sooner and make "
        "more false tracks. With 0, or association=any, targets are only those given, labelled or found by "
        "cameras.",
        at_least=0,
        below=1,
    )
    initial_particle_factor: int = setting(
        3, "Particles of a tentative track, as a multiple of `particles`, until it is confirmed.", at_least=1
    )
    confirmation_threshold: float = setting(
        0.95,
        "Existence probability above which a track is confirmed and reported. Higher values suppress false tracks "
        "and delay true ones.",
        at_least=0,
        below=1,
    )
    confirmation_hits: int = setting(3, "Minimum number of detections before confirmation.", at_least=1)
    termination_threshold: float = setting(
        0.02, "Existence probability below which a track is terminated.", at_least=0, below=1
    )
    max_coasting_s: float = setting(
        15.0,
        "Maximum coasting time: a track that was not detected for longer is terminated.",
        unit="s",
        at_most=1e9,
        above=0,
    )
    walls: bool = setting(True, "Keep targets inside the room of the scene, if it has one.")

    # Cooperation with cameras, [Lee] Sec. 3.3
    cooperate: str = option_setting(
        "none",
        f"Policies that request camera frames of targets: {', '.join(POLICIES)}; several separated by commas.",
        choices=POLICIES,
        several=True,
        metavar="POLICY",
    )
    period_s: float = setting(10.0, "Period of `periodic` requests.", unit="s", at_most=1e9, above=0)
    triggers: str = setting(
        "count,bearing,ellipse", "Triggers of `printed`, separated by commas.", choices=TRIGGERS, several=True
    )
    request_sigma: float = setting(
        1.0,
        "Position standard deviation (root of the trace of the covariance) above which `spread` requests frames. "
        "Smaller values ask more often.",
        unit="length",
        at_least=0,
    )
    camera_fix: str = setting(
        "update",
        "Use of a position fix from cameras: `update` as a measurement, or `replace` the particles by it, as in [Lee].",
        choices=("update", "replace"),
    )
    update_other_targets: bool = setting(True, "Also update other targets seen in the requested frames.")
    max_frame_age_s: float = setting(
        0.5,
        "Maximum age of a frame to be used, not counting the latency of the answer.",
        unit="s",
        at_most=1e9,
        above=0,
    )
    answer_delay_s: float = setting(
        0.0,
        "Latency of camera answers: of each camera the last frame at least this old is used (see `occlog traffic`).",
        unit="s",
        at_least=0,
        at_most=1e6,
    )
    min_request_interval_s: float = setting(
        0.5, "Minimum time before an unanswered request is repeated.", unit="s", at_least=0
    )
    gate: float = setting(
        4.0, "Gate in standard deviations for assigning unlabelled camera candidates to a target.", above=0
    )

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """Generate (setting, whether it fits, limit as text) for the values of `start`, six for each target."""
        limit = "X,Y,SIGMA,VX,VY,SIGMA_V of each target, SIGMA and SIGMA_V >= 0"
        yield "start", _good_start(self.start), limit

    @property
    def policies(self) -> frozenset[str]:
        """Return the names in setting `cooperate`."""
        return frozenset(listed(self.cooperate))

    @property
    def printed(self) -> frozenset[str]:
        """Return the names in setting `triggers`."""
        return frozenset(listed(self.triggers))


def _good_start(start: tuple[float, ...] | None) -> bool:
    """Return whether `start` is None, or has six values for each target with no standard deviation below 0."""
    if start is None:
        return True
    return len(start) > 0 and len(start) % START_NUMBERS == 0 and all(s >= 0 for s in (*start[2::6], *start[5::6]))
