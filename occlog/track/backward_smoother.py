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
    """A row that a filter made, and that can be smoothed."""

    @property
    def target(self) -> int:
        """Identity of the target."""

    @property
    def t_ns(self) -> int:
        """Time of the estimate."""

    def smoothed(self, past: SmoothedState) -> Self:
        """The row with a state that was estimated with later measurements."""


Row = TypeVar("Row", bound=SmoothableRow)


class PendingRows(NamedTuple, Generic[Row]):
    """The rows of one target that wait, each with what its step left for the way back."""

    rows: list[Row]
    traces: list[Any]
    rng: Generator


class BackwardSmoother(Generic[State, Config, Row]):
    """Holds the rows of all targets until enough was seen after them, and smooths them then."""

    def __init__(self, smoothing: Smoothing[State, Config], config: Config, seed: int) -> None:
        """Start without buffered rows.

        Args:
            smoothing: the method's.
            config: settings of the method.
            seed: of all random numbers.
        """
        self._smoothing, self._config, self._seed = smoothing, config, seed
        self._lag_ns = smoothing.wanted(config).lag_ns
        self._waiting: dict[int, PendingRows[Row]] = {}
        self._ready: list[Row] = []

    def add(self, row: Row, state: State) -> None:
        """Add a row of a target, and its filter's state after it."""
        if row.target not in self._waiting:
            rng = generator(self._seed, RandomStream.SMOOTH, row.target)
            self._waiting[row.target] = PendingRows([], [], rng)
        own = self._waiting[row.target]
        own.rows.append(row)
        own.traces.append(self._smoothing.trace(state))

    def settled(self, now_ns: int) -> list[Row]:
        """Rows that need not wait any longer, of all targets, in the order of time.

        With a lag a target's rows are smoothed whenever they span `WINDOW_LAGS` lags, and those older than one are
        given out; all of them when the target was not met for longer than that.
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
        """How many rows wait, or are ready and wait for an earlier one of another target."""
        return len(self._ready) + sum(len(own.rows) for own in self._waiting.values())

    def rest(self) -> list[Row]:
        """All rows that still wait, in the order of time."""
        for target, own in list(self._waiting.items()):
            self._release(target, len(own.rows))
        return self._until(None)

    def _release(self, target: int, count: int) -> None:
        """Smooth all rows of a target, and give the first ones out."""
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
        """Ready rows before a time; None: all.  They are in the order of time and target."""
        count = (
            len(self._ready) if horizon_ns is None else bisect_left(self._ready, horizon_ns, key=lambda row: row.t_ns)
        )
        early = self._ready[:count]
        del self._ready[:count]
        return early


def backward_smoother(
    smoothing: Smoothing[State, Config] | None, config: Config, seed: int
) -> BackwardSmoother[State, Config, Row] | None:
    """What holds the rows back; None where the method cannot smooth or the settings want none."""
    if smoothing is None or not smoothing.wanted(config).smoothed:
        return None
    return BackwardSmoother(smoothing, config, seed)
