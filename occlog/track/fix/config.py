"""Settings of method `fix`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import Settings, setting

ESTIMATORS = ("mle", "huber", "andrews", "rmr", "jrmr")


@dataclass(frozen=True)
class FixConfig(Settings):
    """Settings of method `fix`; the same for every scene, since no setting is a length."""

    OWNER: ClassVar[str] = "fix"

    estimator: str = setting(
        "mle", "Maximum likelihood, an M-estimate, or a repeated median; see docs/fix.md.", choices=ESTIMATORS
    )
    bend: float = setting(1.5, "Where huber and andrews bend, in standard deviations.", above=0)
    spread: str = setting(
        "residuals",
        "Covariance from the residuals, as published, or from the stated standard deviations.",
        choices=("residuals", "stated"),
    )
    candidates: str = setting(
        "consensus",
        "Unlabelled candidates: those on which most sensors agree, or none.",
        choices=("consensus", "ignore"),
    )
    gate: float = setting(3.0, "Standard deviations within which a candidate agrees.", above=0)
