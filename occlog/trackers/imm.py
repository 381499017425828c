"""Method `imm` as stages see it: what is heard in, estimates out."""

from __future__ import annotations

import math

import numpy as np

from ..scene import Scene
from .imm_filter import Belief, Report
from .method import Estimate


def estimates(report: Report, scene: Scene) -> list[tuple[int, Estimate]]:
    """The confirmed targets' estimates by number."""
    return [(belief.number, _estimate(belief, report, len(scene.cameras))) for belief in report.beliefs]


def _estimate(belief: Belief, report: Report, cameras: int) -> Estimate:
    e, m = belief.estimate, belief.moved
    evidence = report.log_evidence
    return Estimate(
        xy=e.mean[::2],
        velocity=e.mean[1::2],
        covariance=np.ascontiguousarray(e.covariance[::2, ::2]),
        ess=belief.ess,
        log_likelihood=evidence if math.isfinite(evidence) else math.nan,
        n_looked=len(report.looks),
        n_seen=int(m.heard),
        fallback="",
        used=tuple(cameras + a for a in m.arrays),
    )
