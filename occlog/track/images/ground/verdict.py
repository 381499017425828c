"""Verdict on tracks in the world: what doubts their rows have, and which targets one view alone supports."""

from __future__ import annotations

from collections import Counter

from .stage import CONTRADICTION, EXCHANGE, ONE_VIEW, GroundPart

ALONE = 0.9
"""One view alone supports a target if it alone made this share of its rows."""
MANY = 0.1
"""A line warns of doubts that so large a share of the rows has."""
TOO_FAR = 1.5
"""A line warns where squared standardised residuals are so many times as large as stated."""
WORDS = {
    ONE_VIEW: "one view alone made the place, at the height of a person's middle",
    CONTRADICTION: "a view is on something else; covariances are widened by where the others would have it",
    EXCHANGE: "the target may have taken another one's identity; its covariance reaches to the other targets",
}
"""What each doubt means."""


class Verdict:
    """Counts doubts while parts stream by."""

    def __init__(self) -> None:
        """Nothing was seen yet."""
        self._doubts: Counter[str] = Counter()
        self._rows: Counter[int] = Counter()
        self._alone: Counter[int] = Counter()
        self._nis, self._freedom = 0.0, 0

    def add(self, part: GroundPart) -> None:
        """Count some more rows."""
        self._nis += part.nis
        self._freedom += part.freedom
        for target, doubt in zip(part.tracks.target_id.tolist(), part.tracks.doubt.tolist(), strict=True):
            words = doubt.split(",") if doubt else []
            self._doubts.update(words)
            self._rows[target] += 1
            self._alone[target] += ONE_VIEW in words

    def figures(self) -> dict[str, object]:
        """Rows by doubt, targets that one view supports, and the mean of the squared standardised residuals."""
        return {
            "doubts": {word: self._doubts[word] for word in WORDS if self._doubts[word]},
            "one_view_targets": self._one_view(),
            **({"nis_per_freedom": self._nis / self._freedom} if self._freedom else {}),
        }

    def warnings(self) -> list[str]:
        """Lines on what makes the places doubtful."""
        total = sum(self._rows.values())
        lines = [
            f"{self._doubts[word]} of {total} places: {word}: {text}"
            for word, text in WORDS.items()
            if self._doubts[word] > MANY * total
        ]
        if alone := self._one_view():
            names = ", ".join(str(target) for target in alone)
            lines.append(f"targets that one view alone supports, which may be nobody: {names}")
        if self._freedom and self._nis > TOO_FAR * self._freedom:
            lines.append(
                f"views are {(self._nis / self._freedom) ** 0.5:.1f} times as far from agreeing as their covariances "
                "say; check the calibration and the clocks, or give a larger model_share to `occlog ground`"
            )
        return lines

    def _one_view(self) -> list[int]:
        """Targets that one view alone supports."""
        return [target for target, rows in sorted(self._rows.items()) if self._alone[target] > ALONE * rows]
