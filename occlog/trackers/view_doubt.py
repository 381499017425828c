"""What is left of a tracking state when matrices between its views turn out to be wrong."""

from __future__ import annotations

import numpy as np

from ..columns import Bools
from .view_method import Geometry
from .views_state import State, completed


def doubted(state: State, geometry: Geometry) -> State:
    """The state with another geometry; counterparts in views whose matrix is gone are neither good nor checked.

    Args:
        state: of any method that has trackers of its own.
        geometry: the same views, with fewer matrices.
    """
    known: Bools = np.asarray(np.isfinite(geometry.fundamental).all(axis=(2, 3)))
    t = state.trackers
    kept = (known | known.T)[t.view]
    trackers = t._replace(good=t.good & kept, run=np.where(kept, t.run, 0), checked=t.checked & kept)
    return state._replace(geometry=completed(geometry), trackers=trackers)
