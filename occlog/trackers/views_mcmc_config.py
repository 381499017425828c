"""Settings of `mcmc`, the filters whose samples hold all targets of a view."""

from __future__ import annotations

from dataclasses import dataclass

from .views_config import MOST, MipfConfig

SAMPLERS = ("mcmc", "sir")


@dataclass(frozen=True)
class McmcConfig(MipfConfig):
    """Settings of method `mcmc`: a filter for each view, whose samples hold all of its targets."""

    particles: int = 500  # samples of a view, not of a tracker

    sampler: str = "mcmc"  # `mcmc`: a Markov chain that moves one target at a time; `sir`: weights of whole samples
    burn: float = 0.25  # moves of the chain before its first sample, as a share of `particles`
    thin: int = 1  # moves of the chain per sample that is kept
    overlap: float = 2.0  # strength of the prior: two targets at one place are exp(-overlap) times as likely

    def limits(self) -> list[tuple[str, bool, str]]:
        """See `MipfConfig`."""
        return [
            *super().limits(),
            ("sampler", self.sampler in SAMPLERS, f"one of {', '.join(SAMPLERS)}"),
            ("thin", 1 <= self.thin <= MOST, f"1 to {MOST}"),
            *((name, 0 <= getattr(self, name) <= MOST, f"0 to {MOST}") for name in ("burn", "overlap")),
        ]
