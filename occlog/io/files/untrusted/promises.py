"""How much a file of binary columns or of packed chunks may promise before anything of it is read."""

from __future__ import annotations

from pathlib import Path

from occlog.errors import InputError

FREE_ROWS, MAX_ROWS_PER_BYTE = 1_000_000, 20
"""Rows that any file may promise, and above that for each of its bytes: a row of measured numbers takes 2 bytes or
more, however well it is packed."""
FREE_BYTES, MAX_GROWTH = 128 * 1024 * 1024, 1000
"""Unpacked bytes of a group of rows, or of all chunks, that any file may promise, and more for each of its bytes."""


def most_unpacked(size: int) -> int:
    """How many bytes a group of rows, or all chunks, of a file of `size` bytes may unpack to."""
    return max(FREE_BYTES, MAX_GROWTH * size)


def too_much(size: int, rows: int, unpacked: int) -> str:
    """What no file of `size` bytes can hold: its rows, or what a group of them unpacks to [bytes]; empty: neither."""
    if rows > max(FREE_ROWS, MAX_ROWS_PER_BYTE * size):
        return f"{rows} rows"
    return f"{unpacked} bytes at once" if unpacked > most_unpacked(size) else ""


def check_promise(path: Path, size: int, rows: int, unpacked: int) -> None:
    """InputError for a file of `size` bytes that promises more than such a file can hold."""
    if fault := too_much(size, rows, unpacked):
        raise InputError(f"{path}: promises {fault} in a file of {size} bytes, which no measurements fit into")
