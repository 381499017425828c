"""Settings of the identification of a motion model, with their defaults."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import MAX_SETTING, Settings, option_setting, setting

ESTIMATED, COVARIANCE = "estimated", "covariance"
"""Sources of the measurement noise if it is not given: estimated, or the covariances of tracks."""


@dataclass(frozen=True)
class FitConfig(Settings):
    """Model structure and method of the fit ([Rahimi] Sec. 7); lengths in the unit of the positions."""

    OWNER: ClassVar[str] = "fit-motion"

    form: str = option_setting(
        "cv",
        "Form of the transition matrix A: constant velocity (cv), decaying velocity (damped), or free (full).",
        choices=("cv", "damped", "full"),
    )
    process_noise_form: str = option_setting(
        "white",
        "Form of the process noise covariance Sigma: white acceleration and jitter of the position (white), diagonal, "
        "or free (full).",
        choices=("white", "diagonal", "full"),
    )
    process_noise_axes: str = option_setting(
        "same",
        "Process noise of x and y: the same, or one for each.",
        choices=("same", "each"),
    )
    method: str = option_setting(
        "em",
        "Estimator: maximum likelihood with noisy positions (em), or regression on differences of exact positions "
        "(differences).",
        choices=("em", "differences"),
    )
    measurement_noise: str = option_setting(
        ESTIMATED,
        "Measurement noise: standard deviation of the positions per axis, in their unit; or `covariance`: the "
        "covariances of the tracks.",
        metavar="LENGTH|estimated|covariance",
    )
    step_s: float | None = setting(
        None, "Time step of the model.", unit="s", above=0, option="--step", nothing="the median time between positions"
    )
    max_gap_s: float | None = setting(
        None,
        "Split trajectories at gaps in time longer than this.",
        unit="s",
        above=0,
        option="--max-gap",
        nothing="5 steps",
    )

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """Generate checks between settings as (setting, is fulfilled, requirement as text).

        The measurement noise must be a length, `estimated` or `covariance`, and `estimated` with method `differences`,
        which takes positions as exact.
        """
        good = self.measurement_noise in (ESTIMATED, COVARIANCE) or self.noise_length is not None
        yield "measurement_noise", good, f"a length of 0 to {MAX_SETTING:g}, {ESTIMATED} or {COVARIANCE}"
        yield (
            "measurement_noise",
            self.method == "em" or self.measurement_noise == ESTIMATED,
            f"{ESTIMATED} unless the method is em",
        )

    @property
    def noise_length(self) -> float | None:
        """Stated standard deviation of the positions per axis, >= 0.

        None: it is estimated, or follows from the covariances of tracks.
        """
        try:
            value = float(self.measurement_noise)
        except ValueError:
            return None
        return value if 0.0 <= value <= MAX_SETTING else None
