"""Rows of filters that wait for what comes after them, to be smoothed."""

from __future__ import annotations

from bisect import bisect_left
from typing import Any, Generic, NamedTuple, Protocol, Self, TypeVar

from numpy.random import Generator

from occlog.core.numerics.seeds import RandomStream, generator

from .interface import Config, SmoothedState, Smoothing, State
from .smoothing_and_lag import MAX_SMOOTHING_STEPS

WINDOW_LAGS = 3
"""Lags that a target's rows span when they are smoothed: each row is smoothed SPAN / (SPAN - 1) times on average."""


class SmoothableRow(Protocol):
    """Protocol of a filtered estimate that can be replaced by a smoothed one."""

    @property
    def target(self) -> int:
        """Identity of the target."""

    @property
    def t_ns(self) -> int:
        """Time of the estimate [ns]."""

    def smoothed(self, past: SmoothedState) -> Self:
        """Return this row with the smoothed state `past` in place of the filtered one."""


Row = TypeVar("Row", bound=SmoothableRow)


class PendingRows(NamedTuple, Generic[Row]):
    """Filtered rows of one target that wait for smoothing, in the order of time.

    `traces` has what the backward pass needs of the filter step of each row, `rng` the target's random numbers.
    """

    rows: list[Row]
    traces: list[Any]
    rng: Generator


class BackwardSmoother(Generic[State, Config, Row]):
    """Buffer of the filtered rows of all targets, which are smoothed once later scans are available."""

    def __init__(self, smoothing: Smoothing[State, Config], config: Config, seed: int) -> None:
        """Start without rows.

        Args:
            smoothing: the method's functions: trace of a filter step, and backward pass over traces.
            config: settings of the method.
            seed: seed of all random numbers; each target has its own stream.
        """
        self._smoothing, self._config, self._seed = smoothing, config, seed
        self._lag_ns = smoothing.wanted(config).lag_ns
        self._waiting: dict[int, PendingRows[Row]] = {}
        self._ready: list[Row] = []

    def add(self, row: Row, state: State) -> None:
        """Append a target's filtered row; `state` is the filter's state after it, of which the trace is kept."""
        if row.target not in self._waiting:
            rng = generator(self._seed, RandomStream.SMOOTH, row.target)
            self._waiting[row.target] = PendingRows([], [], rng)
        own = self._waiting[row.target]
        own.rows.append(row)
        own.traces.append(self._smoothing.trace(state))

    def settled(self, now_ns: int) -> list[Row]:
        """Return the smoothed rows of all targets that are final, sorted by time and target.

        `now_ns` is the time of the last scan. Rows of one target are smoothed once they span `WINDOW_LAGS` lags; those
        older than one lag are released. All rows of a target are released when it had no scan for `WINDOW_LAGS` lags.
        With `MAX_SMOOTHING_STEPS` rows the first half is released in any case. Rows later than a buffered row of
        another target wait.
        """
        for target, own in list(self._waiting.items()):
            first, last = own.rows[0].t_ns, own.rows[-1].t_ns
            if self._lag_ns is not None and now_ns - last > WINDOW_LAGS * self._lag_ns:
                self._release(target, len(own.rows))
            elif self._lag_ns is not None and last - first >= WINDOW_LAGS * self._lag_ns:
                self._release(target, sum(row.t_ns <= last - self._lag_ns for row in own.rows))
            elif len(own.rows) >= MAX_SMOOTHING_STEPS:
                self._release(target, MAX_SMOOTHING_STEPS // 2)
        horizon = min((own.rows[0].t_ns for own in self._waiting.values()), default=now_ns + 1)
        return self._until(horizon)

    @property
    def held(self) -> int:
        """Number of buffered rows, including smoothed rows that wait for an earlier row of another target."""
        return len(self._ready) + sum(len(own.rows) for own in self._waiting.values())

    def rest(self) -> list[Row]:
        """Return all remaining rows, smoothed, sorted by time and target; the buffer is empty then."""
        for target, own in list(self._waiting.items()):
            self._release(target, len(own.rows))
        return self._until(None)

    def _release(self, target: int, count: int) -> None:
        """Smooth all buffered rows of a target, and move the first `count` of them to the released ones."""
        own = self._waiting[target]
        found = self._smoothing.back(own.traces, self._config, own.rng)
        for row, past in zip(own.rows[:count], found[:count], strict=True):
            self._ready.append(row.smoothed(past))
        self._ready.sort(key=lambda row: (row.t_ns, row.target))
        if count == len(own.rows):
            del self._waiting[target]
        else:
            del own.rows[:count], own.traces[:count]

    def _until(self, horizon_ns: int | None) -> list[Row]:
        """Remove and return the released rows before time `horizon_ns` (None: all), sorted by time and target."""
        count = (
            len(self._ready) if horizon_ns is None else bisect_left(self._ready, horizon_ns, key=lambda row: row.t_ns)
        )
        early = self._ready[:count]
        del self._ready[:count]
        return early


def backward_smoother(
    smoothing: Smoothing[State, Config] | None, config: Config, seed: int
) -> BackwardSmoother[State, Config, Row] | None:
    """Return the buffer for smoothing; None if the method has no smoother or the settings do not request smoothing.

    Args:
        smoothing: functions of the method; None: it has no smoother.
        config: settings of the method.
        seed: seed of all random numbers.
    """
    if smoothing is None or not smoothing.wanted(config).smoothed:
        return None
    return BackwardSmoother(smoothing, config, seed)
