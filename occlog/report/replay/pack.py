"""Columns of numbers as text that is short and that a script turns back into arrays."""

from __future__ import annotations

import base64
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from occlog.array_types import Bools, Floats, Ints

KINDS = {"f8": "<f8", "u4": "<u4", "u2": "<u2", "i2": "<i2", "u1": "u1", "i1": "i1"}
"""Kinds of numbers by their names in the script."""
MOST_INT16, MOST_UINT16 = 32767, 65535
NONE = MOST_UINT16
"""Stands for what is not known, or not named."""
SMALL = {"u4": "u2", "u2": "u1", "i2": "i1"}
"""Kinds of half the size."""
Packed = list[Any]
"""Kind and the values as little-endian bytes in base64; or `=`, how many they are and the value of all of them."""


def packed(kind: str, values: ArrayLike) -> Packed:
    """Numbers as the smallest kind like `kind` that holds them, which `kind` must do."""
    array = np.asarray(values)
    fitted = array.astype(KINDS[kind])
    if kind != "f8" and not np.array_equal(fitted, array):
        raise ValueError(f"values do not fit {kind}")
    if len(array) > 1 and (fitted == fitted[0]).all():
        return ["=", len(fitted), fitted[0].item()]
    while kind in SMALL and np.array_equal(array.astype(KINDS[SMALL[kind]]), array):
        kind = SMALL[kind]
    return [kind, base64.b64encode(array.astype(KINDS[kind]).tobytes()).decode("ascii")]


def placed(values: Floats, middle: float, step: float) -> Ints:
    """(N,) places as whole steps from the middle of the plan, cut off where 16 bits end."""
    steps = np.round((values - middle) / step)
    return np.asarray(np.clip(steps, -MOST_INT16, MOST_INT16).astype(np.int64))


def starts(moment: Ints, moments: int) -> Packed:
    """First row of each moment and the end, of rows in the order of their moments."""
    return packed("u4", np.searchsorted(moment, np.arange(moments + 1)))


class Words:
    """Texts that repeat, each once."""

    def __init__(self) -> None:
        """None yet."""
        self._numbers: dict[str | None, int] = {}

    def numbers(self, texts: Iterable[Any], known: Bools | None = None) -> Ints:
        """(N,) number of each text; of those that are not known that of None."""
        out = [
            self._numbers.setdefault(None if known is not None and not known[k] else str(text), len(self._numbers))
            for k, text in enumerate(texts)
        ]
        return np.array(out, dtype=np.int64)

    @property
    def all(self) -> list[str | None]:
        """The texts, by their numbers; one at least."""
        return list(self._numbers) or [""]
