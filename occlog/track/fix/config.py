"""Settings of method `fix`."""

from __future__ import annotations

from dataclasses import dataclass

from occlog.settings import check_settings

from .estimators import BEND, ESTIMATORS

SPREADS = ("residuals", "stated")
CANDIDATES = ("consensus", "ignore")


@dataclass(frozen=True)
class FixConfig:
    """Settings of method `fix`; lengths in the scene's unit."""

    estimator: str = "mle"  # `mle`, `huber`, `andrews`, `rmr` or `jrmr`, see `occlog.track.fix.estimators`
    bend: float = BEND  # of huber and andrews, in standard deviations
    spread: str = "residuals"  # covariance from the `residuals`, as published, or from the `stated` standard deviations
    candidates: str = "consensus"  # unlabelled ones: those on which most sensors agree, or `ignore` them
    gate: float = 3.0  # standard deviations within which a candidate agrees
    start: tuple[float, ...] | None = None  # not used: a fix starts from nothing

    def __post_init__(self) -> None:
        check_settings(
            self,
            "fix",
            [
                ("estimator", self.estimator in ESTIMATORS, "one of " + ", ".join(ESTIMATORS)),
                ("spread", self.spread in SPREADS, "one of " + ", ".join(SPREADS)),
                ("candidates", self.candidates in CANDIDATES, "one of " + ", ".join(CANDIDATES)),
                ("bend", self.bend > 0.0, "above 0"),
                ("gate", self.gate > 0.0, "above 0"),
                ("start", self.start is None, "left out: a fix starts from nothing"),
            ],
        )


def fix_defaults(length_unit: str) -> FixConfig:  # noqa: ARG001
    """The same for every scene: no setting is a length."""
    return FixConfig()
