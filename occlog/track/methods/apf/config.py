"""Settings of the auxiliary particle filter, with the defaults that were measured to work.

Settings of the selection of cameras, [Ercan] Sec. 5.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from occlog.errors import InputError
from occlog.settings import Settings, declared, option_setting, setting
from occlog.track.smoothing_and_lag import SmoothingConfig

FORMS = ("printed", "improved", "quadrature")
CALIBRATE = ("none", "joint", "initial")
"""How errors of the cameras' poses are treated."""
BEGINNING, UNIFORM = "beginning", "uniform"
"""When in a step a target changes its destination."""
PROBABILITIES = ("recursion", "independent", "exact")


@dataclass(frozen=True)
class ApfConfig(SmoothingConfig):
    """Settings of method `apf`; lengths in the scene's unit, times in seconds."""

    OWNER: ClassVar[str] = "apf"

    particles: int = option_setting(
        1000,
        "Particles per target. More reduce the Monte Carlo error and take time in proportion; raise it when "
        "`depleted` is flagged. Typical 500 to 5000.",
        at_least=1,
    )
    start: tuple[float, ...] | None = setting(
        None,
        "Initial position X, Y and standard deviation SIGMA.",
        unit="length",
        counts=(3,),
        nothing="uniform over the room or the visible region",
    )
    initial_particle_factor: int = setting(
        10, "Particles at track initiation, as a multiple of `particles`. Raise it in large rooms.", at_least=1
    )

    # Motion, [Ercan] Sec. 4.1; probabilities are those of one reference step.
    reference_step_s: float = setting(
        1.0,
        "Reference step of the waypoint motion model: `beta1`, `lambda1`, `beta2` and `lambda2` are probabilities for "
        "this time.",
        unit="s",
        at_least=1e-3,
    )
    # People stop, turn and hurry: their velocity changes at random, while the reference scene's objects jump aside.
    initial_speed: float = setting(1.0, "Speed of new particles.", unit="length/s", at_least=0, people=1.0)
    sigma_initial_speed: float = setting(
        0.2, "Standard deviation of the speed of new particles.", unit="length/s", at_least=0, people=0.5
    )
    process_noise_position: float = setting(
        0.33,
        "Process noise of the position per axis, accumulated over 1 s ([Ercan] sigma_v). Larger values recover "
        "from model errors and widen covariances; raise it when tracks are lost in turns.",
        unit="length",
        at_least=0,
        people=0.1,
    )
    process_noise_velocity: float = setting(
        0.0,
        "Process noise of the velocity per axis, accumulated over 1 s. 0: as in the paper.",
        unit="length/s",
        at_least=0,
        people=0.5,
    )
    process_noise_waiting: float = setting(
        0.0,
        "Process noise of the position of a waiting target per axis, accumulated over 1 s; keeps its particles "
        "distinct. 0: as in the paper.",
        unit="length",
        at_least=0,
        people=0.01,
    )
    mean_wait_s: float = setting(
        0.0,
        "Mean waiting time at a stop. 0: as in the paper, one decision per reference step.",
        unit="s",
        at_least=0,
        people=10.0,
    )
    process_noise_creep: float = setting(
        0.0,
        "Process noise of the slow drift of a waiting target (velocity per axis, accumulated over 1 s); used with "
        "`mean_wait_s`.",
        unit="length/s",
        at_least=0,
        people=0.05,
    )
    velocity_memory: float = setting(
        0.03,
        "Weight of the last displacement in the speed of a particle ([Ercan] phi); 0: constant speed.",
        at_least=0,
        at_most=1,
        people=0.0,
    )
    beta1: float = setting(
        0.88,
        "Probability per reference step that a moving target keeps its destination ([Ercan] beta_1). Lower values "
        "model erratic motion.",
        at_least=0,
        at_most=1,
        people=0.7,
    )
    change_time: str = setting(
        BEGINNING,
        "When within a step a target changes its destination: at its `beginning`, as in the paper, or at any time "
        "(`uniform`), as people do. With `beginning` fast targets that turn are up to half a step's way off, and "
        "covariances too small.",
        choices=(BEGINNING, UNIFORM),
    )
    lambda1: float = setting(
        0.1,
        "Probability per reference step that a moving target takes a new destination ([Ercan] lambda_1); it waits with "
        "1 - beta1 - lambda1.",
        at_least=0,
        at_most=1,
        people=0.28,
    )
    beta2: float = setting(
        0.05,
        "Probability per reference step that a target at its destination keeps it ([Ercan] beta_2).",
        at_least=0,
        at_most=1,
    )
    lambda2: float = setting(
        0.9,
        "Probability per reference step that a target at its destination takes a new one ([Ercan] lambda_2); it waits "
        "with 1 - beta2 - lambda2.",
        at_least=0,
        at_most=1,
    )

    # Sampling, [Ercan] Alg. 1
    proposal: str = setting(
        "adapted",
        "Importance density: `adapted` draws particles with the measurements of the scan, `bootstrap` by the motion "
        "model alone, as in the paper (bootstrap filter).",
        choices=("adapted", "bootstrap"),
    )
    defensive_fraction: float = setting(
        0.05,
        "Share of particles selected without the measurements (defensive mixture); protects against overconfident "
        "proposals.",
        at_least=0,
        at_most=1,
    )
    resampling_threshold: float = setting(
        1.0,
        "Resampling threshold: resample when the effective sample size, relative to the number of particles, is "
        "below this; only with proposal=bootstrap. 1: every scan.",
        at_least=0,
    )

    # Measurements, [Ercan] Secs. 4.2 and 4.3
    detection_probability: float | None = setting(
        None,
        "Detection probability P_D of an unoccluded target; needed to use missed detections as information.",
        above=0,
        at_most=1,
        nothing="1 with occluder priors; without them missed detections are no information",
    )
    false_alarm_probability: float = setting(
        1e-4,
        "False alarm probability P_F of a sensor that did not detect the target. Raise it when false bearings pull "
        "the track away.",
        at_least=0,
        at_most=1,
    )
    out_of_view_likelihood: float = setting(
        1e-2,
        "Likelihood factor for a detection of a target that the camera cannot see (out of view, behind a wall). "
        "Guards against pose errors.",
        at_least=0,
        at_most=1,
    )
    candidate_detection_probability: float = setting(
        0.9, "P_D among unlabelled candidates, where `detection_probability` is not given.", above=0, at_most=1
    )
    clutter_rate: float = setting(
        1.0,
        "Clutter rate: candidates of other objects expected in a frame. Larger values trust single candidates "
        "less. Typical 1 per visible person.",
        above=0,
    )
    use_score: bool = setting(True, "Weight candidates by their detector score.")

    # Moving occluders, [Ercan] Sec. 4.2; only with priors of their positions
    likelihood: str = setting(
        "independent",
        "Likelihood that occluders hide a target at u from a set of cameras, p(eta|u): cameras taken as `independent` "
        "(fastest), `recursion` ([Ercan] Eqs. 8-9), or `exact`.",
        choices=PROBABILITIES,
    )
    occlusion_form: str = setting(
        "improved",
        "Probability that one occluder hides the target: `improved`, `quadrature`, or `printed` ([Ercan] Eq. 7).",
        choices=FORMS,
    )
    min_occlusion_probability: float = setting(
        1e-4,
        "Lower limit of p(eta|u) (`independent`: of the factor of each camera); keeps one contradicting camera "
        "from removing all particles.",
        at_least=0,
        at_most=1,
    )
    occlusion_tempering: float = setting(
        0.3,
        "Exponent of occlusion probabilities from uncertain priors, which have time-correlated errors. 1: as if "
        "independent (the paper). Only with likelihood=independent.",
        at_least=0,
        at_most=1,
    )
    occluder_diameter: float = setting(3.33, "Diameter of a moving occluder.", unit="length", above=0, people=0.5)
    prior_max_age_s: float = setting(5.0, "Ignore occluder priors older than this.", unit="s", at_most=1e9, above=0)
    own_prior_gate: float = setting(
        0.0,
        "Ignore occluder priors within this many standard deviations of the target: they are the target itself. 0: "
        "use all.",
        at_least=0,
    )

    # Errors of the cameras' poses that stay the same; see `occlog.track.methods.apf.calibration`
    calibrate: str = setting(
        "none",
        "Pose errors of the cameras: white noise (`none`), estimated with the track (`joint`), or estimated at the "
        "start only (`initial`).",
        choices=CALIBRATE,
    )
    calibration_s: float = setting(100.0, "Duration of the `initial` calibration.", unit="s", at_most=1e9, above=0)

    # When to give up
    max_gap_s: float = setting(
        60.0,
        "Reinitialise after more than this time without measurements. Smaller values give up sooner.",
        unit="s",
        above=0,
    )
    track_loss_count: int = setting(
        6,
        "Reinitialise when the reports that contradict the best particle outnumber those that agree by this count "
        "(at most 2 per scan). Lower values recover faster and restart more often; 0: never.",
        at_least=0,
    )

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """Generate (setting, whether it fits, limit as text) for limits that involve several values.

        Probabilities of one choice (beta and lambda) sum to at most 1, and the standard deviation in `start` is at
        least 0.
        """
        yield "lambda1", self.beta1 + self.lambda1 <= 1.0 + 1e-12, "at most 1 - beta1"
        yield "lambda2", self.beta2 + self.lambda2 <= 1.0 + 1e-12, "at most 1 - beta2"
        yield "start", self.start is None or self.start[2] >= 0, "X,Y,SIGMA, SIGMA >= 0"


POLICIES = ("greedy", "brute-force", "fixed", "random", "closest", "all")
BY_ERROR = ("greedy", "brute-force")
"""Policies that select by the expected error."""


@dataclass(frozen=True)
class SelectConfig(Settings):
    """Settings of the selection of cameras, [Ercan] Sec. 5: policy, number of cameras, interval and camera model."""

    OWNER: ClassVar[str] = "select"

    policy: str = setting(
        "greedy",
        "Sensor selection: use only --n-cameras cameras, reselected every --selection-interval steps by this policy. "
        "`greedy` and `brute-force` minimise the expected error.",
        choices=POLICIES,
        option="--select",
        shown="use all",
    )
    n_cameras: int = option_setting(4, "Number of selected cameras.", at_least=1)
    selection_interval: float = option_setting(
        5.0,
        "Interval between selections, in reference steps (--set reference_step_s, 1 s). Longer intervals save messages "
        "and lose targets that leave the views.",
        above=0,
        metavar="STEPS",
    )
    model: str = setting(
        "perspective",
        "Camera model of the expected error: `perspective` or `weak` perspective ([Ercan] Secs. 5.1, 5.2).",
        choices=("perspective", "weak"),
        option="--select-model",
    )
    camera_order: tuple[str, ...] = option_setting(
        (),
        "Camera order for --select fixed.",
        metavar="A,B,...",
        shown="that of the scene",
    )
    max_blind_scans: int = option_setting(
        1,
        "Reselect after this many consecutive scans in which fewer than two selected cameras detect the target; 0: "
        "only at the interval. For greedy and brute-force without occluder priors.",
        at_least=0,
        metavar="SCANS",
    )


def read_selection(values: Mapping[str, Any]) -> SelectConfig:
    """Return the settings of the camera selection from the fields of a file.

    InputError for an unknown key; errors of the values are those of `SelectConfig`.
    """
    known = [f.name for f in declared(SelectConfig)]
    for name in values:
        if name not in known:
            raise InputError(f"select: unknown key {name!r}; it has: {', '.join(known)}", id="unknown-key")
    lists = {name: tuple(value) for name, value in values.items() if isinstance(value, list)}
    return SelectConfig(**{**values, **lists})
