"""The fuzzing of whole commands: its list has every command, its judge notices each kind of fault."""

from __future__ import annotations

import hashlib
import shlex
import zipfile
from pathlib import Path
from random import Random

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from command_lines import refusal

from occlog.cli.main import COMMANDS
from occlog.pipeline.pack.archive import LOCK, MANIFEST, Manifest, PackedFile, lock_text, manifest_bytes, unpack

from . import seeds
from .commands import Attempt, Ended, draw_attempt, fault, inputs_of, sections, stamps, tried
from .mutations import ZIP
from .structure import restructured

OTHERS = {"reproduce", "plugin"}
"""Commands that read no files of users."""
WORDS = ["track", "walk.mcap", "-o", "out.parquet"]
LINE = "occlog: error: walk.mcap: is empty; record it again\n"


def ended(code: int = 4, err: str = LINE, out: str = "", seconds: float = 1.0, megabytes: float = 300.0) -> Ended:
    return Ended(code, out, err, seconds, megabytes)


def test_every_command_is_tried_by_lines_that_it_takes() -> None:
    assert set(sections()) - {"inputs"} == set(COMMANDS) - OTHERS
    lines = [(name, line.partition(" | ")[0]) for name, lines in sections().items() for line in lines]
    assert [(line, why) for _, line in lines if (why := refusal(shlex.split(line)))] == []
    assert [line for name, line in lines if name not in ("inputs", shlex.split(line)[1])] == []


@pytest.mark.parametrize(
    ("end", "kind"),
    [
        (ended(1, "occlog: error: a bug of occlog 1: KeyError: 'x' (track/run.py:7); report it\n"), "KeyError"),
        (ended(-11, ""), "exit code -11"),
        (ended(-24, ""), "hang"),
        (ended(4, f"warning\n{LINE}"), "a line without occlog"),
        (ended(4, f"{LINE}{LINE}"), "2 error lines"),
        (ended(4, ""), "0 error lines"),
        (ended(4, "occlog: error: no rows\n"), "no file in the message"),
        (ended(4, f"occlog: error: walk.mcap: {'x' * 500}\n"), "a long line"),
        (ended(megabytes=3000.0), "memory"),
    ],
)
def test_each_kind_of_fault_is_noticed(end: Ended, kind: str, tmp_path: Path) -> None:
    (tmp_path / "walk.mcap").touch()
    before = stamps(tmp_path)
    found = fault(WORDS, end, tmp_path, before)
    assert found is not None
    assert kind in found.kind
    assert fault(WORDS, ended(), tmp_path, before) is None
    (tmp_path / "out.parquet").write_bytes(b"PAR1")
    assert "left behind" in str(fault(WORDS, ended(), tmp_path, before))
    assert "incomplete" in str(fault(WORDS, ended(0, ""), tmp_path, before))
    assert "JSON" in str(fault([*WORDS[:2], "--json"], ended(0, "", "NaN"), tmp_path, stamps(tmp_path)))


def test_a_changed_command_runs_in_a_folder_of_its_own(tmp_path: Path) -> None:
    made = tmp_path / "made"
    made.mkdir()
    (made / "mine.csv").write_text(seeds.TRACKS)
    line = "occlog info mine.csv --rows 3"
    assert inputs_of(line, made) == (["info", "mine.csv", "--rows", "3"], ["mine.csv"])
    good = Attempt(["info", "mine.csv"], "mine.csv", seeds.TRACKS.encode())
    end, found = tried(made, tmp_path / "work", good)
    assert (end.code, found) == (0, None), end.err
    random = Random(1)
    attempts = [draw_attempt(line, made, random) for _ in range(20)]
    assert len({(*each.words, each.data) for each in attempts}) > 10
    for attempt in attempts[:3]:
        assert tried(made, tmp_path / "work", attempt)[1] is None
    assert (made / "mine.csv").read_text() == seeds.TRACKS


def test_tables_and_descriptions_get_another_structure() -> None:
    random, target = Random(2), pa.BufferOutputStream()
    pq.write_table(pa.table({"t_ns": [1, 2, 3], "x": [0.5, 1.0, 2.0], "sensor": ["a", "b", "a"]}), target)
    parquet = target.getvalue().to_pybytes()
    for data in (parquet, seeds.TRACKS.encode(), seeds.MOTION.encode()):
        assert len({restructured(data, random) for _ in range(30)}) > 10
    with pytest.raises(ValueError, match="no"):
        restructured(b"words", random)


def test_a_changed_member_of_a_packed_run_is_as_its_manifest_states(tmp_path: Path) -> None:
    def packed(name: str, data: bytes) -> PackedFile:
        return PackedFile(name, hashlib.sha256(data).hexdigest(), len(data))

    manifest = Manifest(1, "1", {}, "r.yaml", "out", [packed("r.yaml", b"a: 1")], [packed("t.csv", b"x\n")], {})
    members = {MANIFEST: manifest_bytes(manifest), LOCK: lock_text(manifest)}
    members |= {"inputs/r.yaml": b"a: 1", "run/t.csv": b"x\n"}
    with zipfile.ZipFile(tmp_path / "run.zip", "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    for number in (2, 3):
        changed = ZIP.pack((tmp_path / "run.zip").read_bytes(), number, b"changed")
        (tmp_path / "changed.zip").write_bytes(changed)
        (tmp_path / str(number)).mkdir()
        unpack(tmp_path / "changed.zip", tmp_path / str(number))
        assert (tmp_path / str(number) / list(members)[number]).read_bytes() == b"changed"
