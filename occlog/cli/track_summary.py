"""What `occlog track` says when it is done."""

from __future__ import annotations

import math
from collections import Counter
from typing import TYPE_CHECKING, Any

from ..stages.messages import Messages

if TYPE_CHECKING:
    from ..stages.tracked import Solve, Tracked


class Tally:
    """Figures of the summary, gathered while streaming."""

    def __init__(self) -> None:
        """Nothing yet."""
        self.rows = 0
        self.targets: set[int] = set()
        self.fallbacks: Counter[str] = Counter()
        self.ess = 0.0
        self.messages = Messages()
        self.solves: list[Solve] = []
        self.asked: Counter[str] = Counter()
        self.cooperated = False
        self.requests = self.answered = self.frames = self.offered = 0

    def add(self, part: Tracked) -> None:
        """Count some more rows."""
        self.rows += len(part.tracks)
        self.targets.update(part.tracks.target_id.tolist())
        self.fallbacks.update(f for f in part.diagnostics.fallback.tolist() if f)
        self.ess += float(part.diagnostics.ess.sum())
        self.messages.add(part.diagnostics)
        self.solves += part.solves
        self.offered += part.offered
        if (asked := part.cooperation) is not None:
            self.cooperated = True
            self.requests += int((asked.cause != "shared").sum())
            self.answered += int((asked.answered & (asked.cause != "shared")).sum())
            self.frames += int(asked.frames.sum())
            self.asked.update(cause for text in asked.cause.tolist() for cause in text.split(","))

    def summary(self) -> dict[str, Any]:
        """The figures."""
        return {
            "targets": len(self.targets),
            "rows": self.rows,
            **(self._searches() if self.solves else self._particles()),
            "fallbacks": dict(sorted(self.fallbacks.items())),
            **self.messages.summary(),
            **(self._cooperation() if self.cooperated else {}),
        }

    def _cooperation(self) -> dict[str, Any]:
        """What cameras were asked; a request with several causes counts for each."""
        return {
            "requests": self.requests,
            "answered": self.answered,
            "requests_by_cause": dict(sorted(self.asked.items())),
            "frames_asked": self.frames,
            "frames_offered": self.offered,
        }

    def warnings(self) -> list[str]:
        """What whoever uses a batch method's tracks should know."""
        said = {
            "unobservable": "what was seen does not tell the position (its covariance says how well it is known)",
            "contradiction": "no place holds all constraints; what was seen there was left out",
            "wall": "no way around a wall was found; more states may help (--set fill_s=0.2)",
            "unfinished": "the search did not converge; try --set iterations=1000",
        }
        if not self.rows:
            return [
                "nobody was heard often enough to be reported; see the settings of births (birth, confirm, clutter)"
            ]
        return [
            f"{self.fallbacks[k]} of {self.rows} rows: {k}: {text}" for k, text in said.items() if self.fallbacks[k]
        ]

    def _particles(self) -> dict[str, Any]:
        """Mean effective number of particles, of a method that has some."""
        return {} if math.isnan(self.ess) else {"mean_effective_particles": self.ess / max(self.rows, 1)}

    def _searches(self) -> dict[str, Any]:
        """Figures of a batch method: iterations of each target's searches, and how many did not converge."""
        iterations: Counter[int] = Counter()
        for solve in self.solves:
            iterations[solve.target] += solve.iterations
        return {
            "iterations": {str(k): n for k, n in sorted(iterations.items())},
            "searches": len(self.solves),
            "unfinished": sum(not s.converged for s in self.solves),
        }
