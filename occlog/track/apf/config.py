"""Settings of the auxiliary particle filter, with the defaults that were measured to work."""

from __future__ import annotations

from dataclasses import dataclass, replace

from occlog.core.filter.likelihood_occluded import EXACT, INDEPENDENT, RECURSION, Occlusion
from occlog.settings import check_settings
from occlog.track.apf.kernels.waypoint import Motion

METRES = {"m": 1.0, "ft": 0.3048, "in": 0.0254}
FORMS = ("printed", "improved", "quadrature")
PROBABILITIES = ("recursion", "independent", "exact")
MODES = ("none", "joint", "initial")
"""How `calibrate` treats errors of the cameras' poses."""


@dataclass(frozen=True)
class ApfConfig:
    """Settings of method `apf`; lengths in the scene's unit, times in seconds."""

    particles: int = 2000
    start: tuple[float, ...] | None = None  # x, y and sigma of the first position; None: anywhere in the room
    start_factor: int = 10  # a filter starts with this many times its particles

    # Motion, [Ercan] Sec. 4.1; probabilities are those of one reference step.
    reference_s: float = 1.0
    speed: float = 1.0  # of new particles, per second
    speed_spread: float = 0.2
    sigma_v: float = 0.33  # noise per axis gathered in a second
    phi: float = 0.03
    beta1: float = 0.88
    lambda1: float = 0.1
    beta2: float = 0.05
    lambda2: float = 0.9

    # Sampling, [Ercan] Alg. 1
    defensive: float = 0.05  # share of stage 1 that does not look at the measurements
    resample_below: float = 1.0  # resample when the effective sample size is below this share of the particles

    # Measurements, [Ercan] Sec. 4.2-4.3
    detection: float | None = None
    """P_D of a camera.  None: 1 with priors of the moving occluders; without, "not seen" says nothing."""
    false: float = 1e-4  # P_F: a sensor that did not detect the target reports it all the same
    soften: float = 1e-2  # factor for a camera that sees what it cannot see
    candidate: float = 0.9  # P_D among unlabelled candidates, if `detection` is None
    clutter: float = 1.0  # candidates of other objects expected in a frame
    use_score: bool = True  # weigh candidates by their score

    # Moving occluders, [Ercan] Sec. 4.2; only with priors of their positions
    likelihood: str = "independent"  # p(eta|u): `independent`, `recursion` (Eqs. 8-9) or `exact`
    q: str = "improved"  # probability that one occluder hides the target: `printed` (Eq. 7), `improved`, `quadrature`
    p_floor: float = 1e-4  # p(eta|u) is not below this (`independent`: each camera's factor of it)
    occluder_diameter: float = 3.33
    prior_max_age_s: float = 5.0  # older priors are not used
    own_gate: float = 0.0  # priors this many standard deviations near the target are its own; 0: none is

    # Errors of the cameras' poses that stay the same; see `occlog.track.apf.calibration`
    calibrate: str = "none"  # `none`: white noise, as [Ercan] has it; `joint`: estimate them; `initial`: at first only
    calibrate_s: float = 100.0  # how long `initial` gathers

    # When to give up
    max_gap_s: float = 60.0  # after a longer time without a scan particles are drawn anew
    lost_after: int = 6  # reports more against than for the best particle; then all are drawn anew; 0: never

    def __post_init__(self) -> None:
        chance = {
            name: 0.0 <= getattr(self, name) <= 1.0
            for name in (
                "phi",
                "beta1",
                "lambda1",
                "beta2",
                "lambda2",
                "defensive",
                "false",
                "soften",
                "candidate",
                "p_floor",
            )
        }
        limits = [(name, good, "in [0, 1]") for name, good in chance.items()]
        for name in ("reference_s", "clutter", "max_gap_s", "occluder_diameter", "prior_max_age_s", "calibrate_s"):
            limits.append((name, getattr(self, name) > 0, "above 0"))
        for name in ("speed", "speed_spread", "sigma_v", "resample_below", "lost_after", "own_gate"):
            limits.append((name, getattr(self, name) >= 0, "at least 0"))
        for name in ("particles", "start_factor"):
            limits.append((name, getattr(self, name) >= 1, "at least 1"))
        for name, choices in (("likelihood", PROBABILITIES), ("q", FORMS), ("calibrate", MODES)):
            limits.append((name, getattr(self, name) in choices, "one of " + ", ".join(choices)))
        limits += [
            ("lambda1", self.beta1 + self.lambda1 <= 1.0 + 1e-12, "at most 1 - beta1"),
            ("lambda2", self.beta2 + self.lambda2 <= 1.0 + 1e-12, "at most 1 - beta2"),
            ("detection", self.detection is None or 0.0 < self.detection <= 1.0, "above 0 and at most 1"),
            ("candidate", self.candidate > 0.0, "above 0"),
            ("start", self.start is None or (len(self.start) == 3 and self.start[2] >= 0), "X,Y,SIGMA, SIGMA >= 0"),
        ]
        check_settings(self, "apf", limits)

    @property
    def motion(self) -> Motion:
        """The motion model's part."""
        return Motion(self.reference_s, self.sigma_v, self.phi, self.beta1, self.lambda1, self.beta2, self.lambda2)

    @property
    def occlusion(self) -> Occlusion:
        """How priors of moving occluders count."""
        kind = {"independent": INDEPENDENT, "recursion": RECURSION, "exact": EXACT}[self.likelihood]
        return Occlusion(kind, FORMS.index(self.q), self.p_floor, 0.0)


def apf_defaults(length_unit: str) -> ApfConfig:
    """Settings that suit a scene: the reference scene of [Ercan] for `unit`, people for metres, feet and inches."""
    config = ApfConfig()
    if length_unit not in METRES:
        return config
    metre = 1.0 / METRES[length_unit]
    # People stop, turn and hurry: their speed is learned faster than that of the reference scene's objects.
    return replace(
        config,
        speed=1.0 * metre,
        speed_spread=0.5 * metre,
        sigma_v=0.4 * metre,
        phi=0.2,
        occluder_diameter=0.5 * metre,
    )
