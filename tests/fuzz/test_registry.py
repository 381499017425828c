"""Good files are read, and reading them calls every function of occlog that takes a file apart."""

from __future__ import annotations

import ast
import re
import sys
from types import FrameType

from places import ROOT

from .readers import READERS
from .watch import watching

FILES = re.compile(r"Path|bytes|mmap")
ELSEWHERE = {
    "frames/streams.py read_folders": "lists the images of folders, of which there are one reader each",
    "frames/streams.py load": "gives these their places",
    "open.py open_in_unit": "opens by `open_input`, and converts units",
    "open.py load_scene": "chooses between readers of scenes and of recordings",
    "recording/reader.py open_linked": "opens videos, which FFmpeg takes apart",
    "recording/salvage/records.py recover_block_tail": "completes a cut block of LZ4 for the salvage",
}
"""Functions that no reader calls, and why."""


def border() -> set[str]:
    """Public functions of the formats whose name says that they read, and whose first argument is files or bytes."""
    found = set()
    for path in (ROOT / "occlog/io").rglob("*.py"):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.FunctionDef) and re.match(r"(read|open|parse|load|recover)_?", node.name):
                first = node.args.args[0].annotation if node.args.args else None
                if first is not None and FILES.search(ast.unparse(first)):
                    found.add(f"{path.relative_to(ROOT / 'occlog/io').as_posix()} {node.name}")
    return found


def test_good_files_are_read_by_every_function_that_reads() -> None:
    called: set[str] = set()

    def note(frame: FrameType, event: str, _: object) -> None:
        if event == "call" and (at := frame.f_code.co_filename.find("/occlog/io/")) >= 0:
            called.add(f"{frame.f_code.co_filename[at + len('/occlog/io/') :]} {frame.f_code.co_name}")

    with watching() as watch:
        for reader in READERS.values():
            sys.setprofile(note)
            try:
                outcomes = [watch.outcome(reader, data) for data in reader.seeds]
            finally:
                sys.setprofile(None)
            assert {outcome.kind for outcome in outcomes} == {"read"}, (reader.name, outcomes)
    assert border() - called == set(ELSEWHERE)
