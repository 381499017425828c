"""True paths as places on a grid of times."""

from __future__ import annotations

import numpy as np

from occlog.core.numerics.time_grid import Grid, to_grid
from occlog.records.tables import Truth


def truth_grid(truth: Truth | Grid) -> Grid:
    """The (C, n, 3) places x, y, z in a table of truth; NaN where an object has no row.  A grid stays as it is."""
    if isinstance(truth, Grid):
        return truth
    places = np.column_stack([truth.x, truth.y, truth.z])
    return to_grid(truth.t_ns, truth.target_id, truth.role == "target", places)
