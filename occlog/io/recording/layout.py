"""How records lie in an MCAP file, beside what its library says (`mcap.opcode`), and what is said of damaged ones."""

from __future__ import annotations

import struct
from pathlib import Path

from occlog.errors import InputError

HEAD = struct.Struct("<BQ")
"""Code and length of a record, before its data."""
MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Channel, number, and times of recording and of publishing [ns] of a message, before its data."""
SALVAGE = "`occlog recover {path} -o OUT.mcap`"
"""What to do with a damaged recording that cannot be copied again."""


def damaged_mcap(path: Path, what: str) -> InputError:
    """What to tell of a damaged file: what is wrong with it, and what to do."""
    return InputError(f"{path}: damaged MCAP file: {what}; copy it again, or salvage it: {SALVAGE.format(path=path)}")
