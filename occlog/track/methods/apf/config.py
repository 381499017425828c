"""Settings of the auxiliary particle filter, with the defaults that were measured to work.

Settings of the selection of cameras, [Ercan] Sec. 5.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from occlog.errors import InputError
from occlog.settings import Settings, declared, setting
from occlog.track.smoothing_and_lag import SmoothingConfig

FORMS = ("printed", "improved", "quadrature")
CALIBRATE = ("none", "joint", "initial")
"""How errors of the cameras' poses are treated."""
PROBABILITIES = ("recursion", "independent", "exact")


@dataclass(frozen=True)
class ApfConfig(SmoothingConfig):
    """Settings of method `apf`; lengths in the scene's unit, times in seconds."""

    OWNER: ClassVar[str] = "apf"

    particles: int = setting(1000, "Particles a target.", at_least=1, option="--particles")
    start: tuple[float, ...] | None = setting(
        None, "X, Y and SIGMA of the first position.", unit="length", counts=(3,), nothing="anywhere a target can be"
    )
    start_factor: int = setting(10, "A filter starts with this many times its particles.", at_least=1)

    # Motion, [Ercan] Sec. 4.1; probabilities are those of one reference step.
    reference_s: float = setting(1.0, "Length of the reference step.", unit="s", at_least=1e-3)
    # People stop, turn and hurry: their velocity changes at random, while the reference scene's objects jump aside.
    speed: float = setting(1.0, "Speed of new particles.", unit="length/s", at_least=0, people=1.0)
    speed_spread: float = setting(
        0.2, "Standard deviation of the speed of new particles.", unit="length/s", at_least=0, people=0.5
    )
    sigma_v: float = setting(
        0.33, "Motion noise per axis, gathered in a second.", unit="length", at_least=0, people=0.1
    )
    sigma_a: float = setting(
        0.0,
        "Noise of the velocity per axis, gathered in a second; 0 is the paper's.",
        unit="length/s",
        at_least=0,
        people=0.5,
    )
    sigma_w: float = setting(
        0.0,
        "Motion noise per axis of a target that waits, gathered in a second; 0 is the paper's.",
        unit="length",
        at_least=0,
        people=0.01,
    )
    wait_s: float = setting(
        0.0,
        "How long a target stands on average before it goes elsewhere; 0 is the paper's, which decides once a "
        "reference step.",
        unit="s",
        at_least=0,
        people=10.0,
    )
    sigma_c: float = setting(
        0.0,
        "Noise of the velocity per axis with which a target that stands creeps, gathered in a second; with `wait_s`.",
        unit="length/s",
        at_least=0,
        people=0.05,
    )
    phi: float = setting(0.03, "Share of the last step in the speed of a particle.", at_least=0, at_most=1, people=0.0)
    beta1: float = setting(
        0.88, "beta_1: probability that a target on its way goes on.", at_least=0, at_most=1, people=0.7
    )
    lambda1: float = setting(
        0.1,
        "lambda_1: probability that it changes its destination; else it waits.",
        at_least=0,
        at_most=1,
        people=0.28,
    )
    beta2: float = setting(0.05, "beta_2: the same as beta_1 once the destination is reached.", at_least=0, at_most=1)
    lambda2: float = setting(
        0.9, "lambda_2: the same as lambda_1 once the destination is reached.", at_least=0, at_most=1
    )

    # Sampling, [Ercan] Alg. 1
    proposal: str = setting(
        "scan",
        "Importance density: one that looks at the scan, or the paper's, by the motion alone.",
        choices=("scan", "motion"),
    )
    defensive: float = setting(0.05, "Share of stage 1 that does not look at the measurements.", at_least=0, at_most=1)
    resample_below: float = setting(
        1.0, "Resample when the effective sample size is below this share; only with proposal=motion.", at_least=0
    )

    # Measurements, [Ercan] Secs. 4.2 and 4.3
    detection: float | None = setting(
        None,
        "P_D: probability that a camera detects a target in plain view.",
        above=0,
        at_most=1,
        nothing='1 with priors of the moving occluders; without, "not seen" says nothing',
    )
    false: float = setting(
        1e-4,
        "P_F: probability that a sensor that did not detect the target reports it all the same.",
        at_least=0,
        at_most=1,
    )
    soften: float = setting(1e-2, "Factor for a camera that sees what it cannot see.", at_least=0, at_most=1)
    candidate: float = setting(
        0.9, "P_D among unlabelled candidates, where `detection` is not given.", above=0, at_most=1
    )
    clutter: float = setting(1.0, "Candidates of other objects expected in a frame.", above=0)
    use_score: bool = setting(True, "Weigh candidates by their score.")

    # Moving occluders, [Ercan] Sec. 4.2; only with priors of their positions
    likelihood: str = setting(
        "independent", "Form of p(eta|u); `recursion` is [Ercan] Eqs. 8-9.", choices=PROBABILITIES
    )
    q: str = setting("improved", "Probability that one occluder hides the target; `printed` is Eq. 7.", choices=FORMS)
    p_floor: float = setting(
        1e-4, "p(eta|u) is not below this (`independent`: each camera's factor of it).", at_least=0, at_most=1
    )
    temper: float = setting(
        0.3,
        "Exponent of the probabilities of being hidden or not, where priors are uncertain: their errors last, so that "
        "each scan tells less than if they were new; 1 is the paper's. Of likelihood=independent.",
        at_least=0,
        at_most=1,
    )
    occluder_diameter: float = setting(3.33, "Diameter of a moving occluder.", unit="length", above=0, people=0.5)
    prior_max_age_s: float = setting(5.0, "Older priors are not used.", unit="s", at_most=1e9, above=0)
    own_gate: float = setting(
        0.0, "Priors this many standard deviations near the target are its own; 0: none is.", at_least=0
    )

    # Errors of the cameras' poses that stay the same; see `occlog.track.methods.apf.calibration`
    calibrate: str = setting(
        "none",
        "Errors of the cameras' poses: white noise (`none`), estimated along with the track (`joint`), "
        "or at first only (`initial`).",
        choices=CALIBRATE,
    )
    calibrate_s: float = setting(100.0, "How long `initial` gathers.", unit="s", at_most=1e9, above=0)

    # When to give up
    max_gap_s: float = setting(60.0, "After a longer time without a scan particles are drawn anew.", unit="s", above=0)
    lost_after: int = setting(
        6, "Reports more against than for the best particle after which all are drawn anew; 0: never.", at_least=0
    )

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """Probabilities of one choice sum to at most 1; a spread is at least 0."""
        yield "lambda1", self.beta1 + self.lambda1 <= 1.0 + 1e-12, "at most 1 - beta1"
        yield "lambda2", self.beta2 + self.lambda2 <= 1.0 + 1e-12, "at most 1 - beta2"
        yield "start", self.start is None or self.start[2] >= 0, "X,Y,SIGMA, SIGMA >= 0"


POLICIES = ("greedy", "brute-force", "fixed", "random", "closest", "all")
BY_ERROR = ("greedy", "brute-force")
"""Policies that select by the expected error."""


@dataclass(frozen=True)
class SelectConfig(Settings):
    """How cameras are selected."""

    OWNER: ClassVar[str] = "select"

    policy: str = setting(
        "greedy",
        "Use only some cameras, selected anew every few steps.",
        choices=POLICIES,
        option="--select",
        shown="use all",
    )
    count: int = setting(4, "Cameras selected.", at_least=1, option="--count")
    every: float = setting(
        5.0, "Reference steps (--set reference_s, 1 s) between selections.", above=0, option="--every", metavar="STEPS"
    )
    model: str = setting(
        "perspective",
        "Camera model of the expected error: [Ercan] Secs. 5.1 and 5.2.",
        choices=("perspective", "weak"),
        option="--select-model",
    )
    order: tuple[str, ...] = setting(
        (),
        "Order of the cameras for --select fixed.",
        option="--select-order",
        metavar="A,B,...",
        shown="that of the scene",
    )
    patience: int = setting(
        1,
        "Scans in a row in which fewer than two of the selected cameras see the target, after which they are selected "
        "anew; 0: only after the whole interval. Only greedy and brute-force, without priors of the moving occluders.",
        at_least=0,
        option="--patience",
        metavar="SCANS",
    )


def read_selection(values: Mapping[str, Any]) -> SelectConfig:
    """How cameras are selected, from the fields of a file; InputError for an unknown one or one that does not fit."""
    known = [f.name for f in declared(SelectConfig)]
    for name in values:
        if name not in known:
            raise InputError(f"select: unknown key {name!r}; it has: {', '.join(known)}")
    lists = {name: tuple(value) for name, value in values.items() if isinstance(value, list)}
    return SelectConfig(**{**values, **lists})
