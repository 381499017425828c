"""Settings of methods that can smooth: whether estimates use what was recorded after them.

Filters smooth in `occlog.track.backward_smoother`, `map` in `occlog.track.methods.map.method`, `jipda` in
`occlog.track.methods.jipda.batch`.
"""

from __future__ import annotations

from dataclasses import dataclass

from occlog.settings import Settings, option_setting, setting

MAX_SMOOTHING_STEPS = 4096
"""Steps of a target that wait at most: a state is smoothed with at least half as many steps after it."""


@dataclass(frozen=True)
class LagConfig(Settings):
    """Smoothing settings of a filter: whether to smooth, and with how much later data (`lag_s`; None: all)."""

    smooth: bool = option_setting(
        False,
        f"Smooth: estimate each state from earlier and later measurements, {MAX_SMOOTHING_STEPS} scans of a target "
        f"at a time. More accurate, but available only later.",
    )
    lag_s: float | None = setting(
        None,
        "Fixed-lag smoothing: use at least this much later data, in bounded memory. Longer lags resolve longer "
        "occlusions and delay the output. Typical 2 to 10 s.",
        unit="s",
        at_least=1e-9,
        at_most=1e9,
        option="--lag",
        nothing="no smoothing, or with --smooth all of it",
    )

    @property
    def smoothed(self) -> bool:
        """Whether estimates use later measurements: smoothing or a lag is requested."""
        return self.smooth or self.lag_s is not None

    @property
    def lag_ns(self) -> int | None:
        """The lag [ns]; None: the whole recording."""
        from occlog.array_types import NS  # numpy comes with it, and settings are read for help, too

        return None if self.lag_s is None else round(self.lag_s * NS)


@dataclass(frozen=True)
class SmoothingConfig(LagConfig):
    """Smoothing settings of particle filters, which smooth by backward simulation of trajectories."""

    smoothing_trajectories: int = setting(
        200,
        "Trajectories drawn by the backward simulation. More give smoother covariances and take longer.",
        at_least=2,
    )
