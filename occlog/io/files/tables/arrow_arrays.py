"""Arrow arrays to NumPy arrays without pandas, which pyarrow imports (a third of a second) for its own `to_numpy`."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from occlog.array_types import Strings
from occlog.errors import InputError
from occlog.io.files.untrusted.guard import check_texts


def to_numpy(values: pa.Array) -> NDArray[np.generic]:
    """(n,) numbers or truth values of an array without nulls; not to be written to."""
    if not pa.types.is_boolean(values.type):
        return np.from_dlpack(values)
    if not len(values):
        return np.empty(0, dtype=np.bool_)
    # Truth values are bits, the first one the lowest of its byte
    bits = np.unpackbits(np.frombuffer(values.buffers()[1], dtype=np.uint8), bitorder="little")
    return bits[values.offset : values.offset + len(values)].astype(np.bool_)


def to_texts(values: pa.Array, where: str, longest: int | None = None) -> Strings:
    """(n,) texts of an array of texts or numbers, "" for those that are null.

    Each text is made once, however many rows refer to it: a small file may have a large one in a million rows.

    Args:
        values: texts, numbers, or a dictionary of such.
        where: the words that an error begins with.
        longest: characters that a text may have; None: as many as fit into an array of these rows.

    Raises:
        InputError: a text is too long for so many rows, or a row refers to one that is not there.
    """
    coded = values if pa.types.is_dictionary(values.type) else values.dictionary_encode()
    texts = ["" if text is None else str(text) for text in coded.dictionary.to_pylist()]
    most = max(map(len, texts), default=0)
    if longest is not None and most > longest:
        raise InputError(f"{where}: a text of {most} characters; shorten it to {longest}")
    check_texts(texts, max(len(values), len(texts)), where)
    which = to_numpy(coded.indices.fill_null(0))
    if len(which) and coded.null_count < len(which) and not 0 <= int(which.min()) <= int(which.max()) < len(texts):
        raise InputError(f"{where}: the file is damaged: it refers to a text that is not there")
    out = np.asarray(texts or [""], dtype=np.str_)[which]
    if coded.null_count:
        out[to_numpy(coded.is_null())] = ""
    return np.asarray(out)
