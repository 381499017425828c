"""What asking cameras cost: figures of a tracker's requests, to stand beside its errors."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np

from occlog.records.tables import Cooperation, Tracks

NS = 1e9
SHARED = "shared"
CAUSES = ("periodic", "count", "bearing", "ellipse", "spread")


def cooperation_figures(asked: Cooperation, tracks: Tracks | None = None) -> dict[str, float]:
    """Requests, frames and their mean period.

    Args:
        asked: requests; rows of cause `shared` are none, but places that came along with others.
        tracks: what was tracked; the period is their length by the number of times at which
            cameras were asked.  None: the mean time between these.

    Returns:
        `cooperation_requests` (one for each target and time), `cooperation_answered`,
        `cooperation_shared`, `cooperation_frames`, `cooperation_period_s` (NaN if it cannot be
        told), and `cooperation_requests_CAUSE`; a request with several causes counts for each.
    """
    own = asked.take(asked.cause != SHARED)
    causes = Counter(cause for text in own.cause.tolist() for cause in text.split(","))
    times = np.unique(own.t_ns)
    span, count = (times[-1] - times[0] if len(times) else 0), len(times) - 1
    if tracks is not None and len(tracks):
        span, count = tracks.t_ns[-1] - tracks.t_ns[0], len(times)
    return {
        "cooperation_requests": float(len(own)),
        "cooperation_answered": float(np.count_nonzero(own.answered)),
        "cooperation_shared": float(len(asked) - len(own)),
        "cooperation_frames": float(asked.frames.sum()),
        "cooperation_period_s": float(span) / NS / count if count > 0 else math.nan,
        **{f"cooperation_requests_{c}": float(causes[c]) for c in (*CAUSES, *sorted(set(causes) - set(CAUSES)))},
    }
