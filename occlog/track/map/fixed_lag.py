"""Fixed lag (`--lag`): which states of a trajectory have seen enough of what comes after them to be given out.

With a lag, the driver hands a target's scans over in blocks (`occlog.track.drivers.batch`).  After each block the
whole record that is held is solved anew; states that lie at least the lag before its end are settled: they are given
out and forgotten, but for what they say of the states after them.  Memory does not grow with the recording.
"""

from __future__ import annotations

import numpy as np

from occlog.array_types import NS, Ints


def lag_ns(lag_s: float | None) -> int | None:
    """The lag [ns] of a setting [s]; None: estimates wait for everything that was recorded."""
    return None if lag_s is None else round(lag_s * NS)


def settled(t_ns: Ints, lag_ns: int | None) -> int:
    """How many of the first states are settled; the last one never is.

    Args:
        t_ns: (T,) times of the states, rising, T >= 1.
        lag_ns: a state is settled when it lies at least so long before the last one; None: no state is.
    """
    if lag_ns is None:
        return 0
    return min(int(np.searchsorted(t_ns, t_ns[-1] - lag_ns, side="right")), len(t_ns) - 1)
