"""Arrow arrays to NumPy arrays without pandas, which pyarrow imports (a third of a second) for its own `to_numpy`."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray


def to_numpy(values: pa.Array) -> NDArray[np.generic]:
    """(n,) numbers or truth values of an array without nulls; not to be written to."""
    if not pa.types.is_boolean(values.type):
        return np.from_dlpack(values)
    if not len(values):
        return np.empty(0, dtype=np.bool_)
    # Truth values are bits, the first one the lowest of its byte
    bits = np.unpackbits(np.frombuffer(values.buffers()[1], dtype=np.uint8), bitorder="little")
    return bits[values.offset : values.offset + len(values)].astype(np.bool_)
