"""Array types that the whole program uses, and the number of nanoseconds in a second; each is defined here only."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Ints = NDArray[np.int64]
Ints32 = NDArray[np.int32]
Uints = NDArray[np.uint64]
Bytes = NDArray[np.uint8]
Bools = NDArray[np.bool_]
Strings = NDArray[np.str_]

NS = 1_000_000_000
"""Nanoseconds in a second."""
