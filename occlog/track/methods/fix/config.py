"""Settings of method `fix`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import Settings, setting

ESTIMATORS = ("mle", "huber", "andrews", "rmr", "jrmr")
"""Estimators of [Lenth]."""
MIXTURE = "mixture"
BENDS = {"huber": 1.5, "andrews": 1.5, MIXTURE: 3.7}
"""Default `bend` of each estimator [standard deviations]."""


@dataclass(frozen=True)
class FixConfig(Settings):
    """Settings of method `fix`; defaults are equal in all scenes, since no setting is a length."""

    OWNER: ClassVar[str] = "fix"

    estimator: str = setting(
        MIXTURE,
        "Estimator of each position: mixture of true and false bearings, maximum likelihood, M-estimate, or "
        "repeated median (see fix.md).",
        choices=(MIXTURE, *ESTIMATORS),
    )
    loss_threshold: float | None = setting(
        None,
        "Threshold of the robust loss, in standard deviations; with mixture where a bearing is as likely false as "
        "true. Smaller values reject more bearings.",
        above=0,
        nothing="1.5 (huber, andrews), 3.7 (mixture)",
    )
    covariance: str = setting(
        "pooled",
        "Covariance of the position: stated noise `pooled` with the residuals, `residuals` alone (as published), "
        "or `stated` noise alone.",
        choices=("pooled", "residuals", "stated"),
    )
    false_bearing_probability: float = setting(
        0.01,
        "With mixture: initial probability that a bearing is false, where two alone agree; it is learned from time "
        "steps with more. 0: two that agree are true.",
        at_least=0,
        at_most=0.5,
    )
    candidates: str = setting(
        "consensus",
        "Unlabelled candidates: use those on which most sensors agree (`consensus`), or `ignore` them.",
        choices=("consensus", "ignore"),
    )
    gate: float = setting(3.0, "Gate in standard deviations for a candidate to agree.", above=0)

    @property
    def bent(self) -> float:
        """Return the tuning constant of the robust estimator [standard deviations], stated or default."""
        return BENDS.get(self.estimator, BENDS["huber"]) if self.loss_threshold is None else self.loss_threshold

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """Generate (setting, whether it fits, limit as text): a mixture needs stated standard deviations."""
        yield (
            "covariance",
            self.estimator != MIXTURE or self.covariance != "residuals",
            "pooled or stated with estimator mixture",
        )
