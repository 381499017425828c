"""How records lie in an MCAP file, beside what its library says (`mcap.opcode`), and what is said of damaged ones."""

from __future__ import annotations

import struct
from pathlib import Path

from occlog.errors import InputError
from occlog.io.files.untrusted.content import RECORDING_MAGIC

HEAD = struct.Struct("<BQ")
"""Code and length of a record, before its data."""
MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Channel, number, and times of recording and of publishing [ns] of a message, before its data."""
INDEX_HEAD, INDEX_ENTRY = struct.Struct("<HI"), 16
"""Of an index of messages: channel and length of its entries, and the length of each."""
SALVAGE = "`occlog recover {path} -o OUT.mcap`"
"""What to do with a damaged recording that cannot be copied again."""

PROGRAM = "occlog "
"""What the head of our recordings says of who wrote them begins with."""
_TEXT = struct.Struct("<I")
_LONGEST = 256
"""Bytes of the head that are looked at."""


def is_of_occlog(path: Path) -> bool:
    """Whether an MCAP file was written by occlog, as its head says, which stays where it is cut or damaged later."""
    with path.open("rb") as file:
        data = file.read(_LONGEST)
    at = len(RECORDING_MAGIC) + HEAD.size
    for _ in ("profile", "library"):
        if len(data) < at + _TEXT.size:
            return False
        length = _TEXT.unpack_from(data, at)[0]
        text, at = data[at + _TEXT.size : at + _TEXT.size + length], at + _TEXT.size + length
    return data.startswith(RECORDING_MAGIC) and text.startswith(PROGRAM.encode())


def damaged_mcap(path: Path, what: str) -> InputError:
    """What to tell of a damaged file: what is wrong with it, and what to do."""
    return InputError(f"{path}: damaged MCAP file: {what}; copy it again, or salvage it: {SALVAGE.format(path=path)}")
