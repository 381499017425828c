"""Fused bearings as measurements: what trackers make of rows that the fusion recovered."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from ..records import Bearings

MODES = ("ignore", "use")
MEASURED = ("bearing", "sigma", "u_px", "sigma_px", "score", "elevation", "sigma_elevation")


def only_measured(chunks: Iterable[Bearings]) -> Iterator[Bearings]:
    """The chunks with recovered rows as what the cameras said: looked, not seen.

    A recovered row repeats what other cameras measured at the same time, so that it is no measurement of its own.
    """
    for chunk in chunks:
        recovered = chunk.cause == "recovered"
        if not recovered.any():
            yield chunk
            continue
        columns = {name: np.where(recovered, np.nan, getattr(chunk, name)) for name in MEASURED}
        yield replace(chunk, seen=chunk.seen & ~recovered, **columns)
