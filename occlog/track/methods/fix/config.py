"""Settings of method `fix`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import Settings, setting

ESTIMATORS = ("mle", "huber", "andrews", "rmr", "jrmr")
"""Those of [Lenth]."""
MIXTURE = "mixture"
BENDS = {"huber": 1.5, "andrews": 1.5, MIXTURE: 3.7}
"""Where estimators bend, unless it is set."""


@dataclass(frozen=True)
class FixConfig(Settings):
    """Settings of method `fix`; the same for every scene, since no setting is a length."""

    OWNER: ClassVar[str] = "fix"

    estimator: str = setting(
        MIXTURE,
        "Mixture of true and false bearings, maximum likelihood, M-estimate, or repeated median; see fix.md.",
        choices=(MIXTURE, *ESTIMATORS),
    )
    bend: float | None = setting(
        None,
        "Where estimators bend, in standard deviations; with mixture where a bearing is as likely false as true.",
        above=0,
        nothing="1.5 (huber, andrews), 3.7 (mixture)",
    )
    spread: str = setting(
        "pooled",
        "Covariance from the stated standard deviations pooled with the residuals, from the residuals alone as "
        "published, or as stated.",
        choices=("pooled", "residuals", "stated"),
    )
    candidates: str = setting(
        "consensus",
        "Unlabelled candidates: those on which most sensors agree, or none.",
        choices=("consensus", "ignore"),
    )
    gate: float = setting(3.0, "Standard deviations within which a candidate agrees.", above=0)

    @property
    def bent(self) -> float:
        """Where the estimator bends."""
        return BENDS.get(self.estimator, BENDS["huber"]) if self.bend is None else self.bend

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """A mixture is of bearings whose standard deviations are stated."""
        yield (
            "spread",
            self.estimator != MIXTURE or self.spread != "residuals",
            "pooled or stated with estimator mixture",
        )
