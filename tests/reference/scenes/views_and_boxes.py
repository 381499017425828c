"""Views of people who hide one another, and their true boxes."""

from __future__ import annotations

import numpy as np

from occlog.records.tables import APPEARANCE_BINS, TruthBoxes, Views


def seen(seed: int, moments: int = 40) -> tuple[Views, TruthBoxes]:
    """Boxes of people in two cameras who hide one another, views of most of them and of nothing, and empty frames."""
    random = np.random.default_rng(seed)
    true, views = [TruthBoxes.empty()], [Views.empty()]
    for t in range(moments):
        for sensor in ("left", "right"):
            n = int(random.integers(0, 5))
            box = np.column_stack([random.uniform(0, 100, (n, 2)), random.uniform(20, 40, (n, 2))])
            place = dict(zip(("left_px", "top_px", "width_px", "height_px"), box.T, strict=True))
            empty = {name: np.full(max(n, 1), np.nan) for name in place}
            at = {"t_ns": np.full(max(n, 1), t * 10**8), "sensor": np.full(max(n, 1), sensor)}
            at |= {"frame": np.full(max(n, 1), t)}
            true.append(
                TruthBoxes.of(
                    **at,
                    box=np.arange(n, dtype=np.int32) if n else np.array([-1], np.int32),
                    target_id=np.arange(max(n, 1), dtype=np.int32),
                    confidence=np.full(max(n, 1), np.nan),
                    **(place if n else empty),
                )
            )
            found = box[random.random(n) < 0.8] + random.normal(0, 2, (1, 4))
            found = np.vstack([found, random.uniform(20, 60, (int(random.integers(0, 2)), 4))])
            m = len(found)
            nan = {c.name: np.full(m, np.nan) for c in Views.columns() if c.kind == "f8" and not c.optional}
            views.append(
                Views.of(
                    **nan
                    | {name: found[:, k] for k, name in enumerate(place)}
                    | {"x_px": found[:, 0] + found[:, 2] / 2, "y_px": found[:, 1], "area_px": found[:, 2] * found[:, 3]}
                    | {"cov_xx_px": np.ones(m), "cov_xy_px": np.zeros(m), "cov_yy_px": np.ones(m)},
                    t_ns=np.full(m, t * 10**8),
                    sensor=np.full(m, sensor),
                    frame=np.full(m, t),
                    cluster=np.arange(m, dtype=np.int32),
                    target_id=np.full(m, -1, dtype=np.int32),
                    appearance=np.full((m, APPEARANCE_BINS), np.nan, dtype=np.float32),
                )
            )
    return Views.concat(views), TruthBoxes.concat(true)
