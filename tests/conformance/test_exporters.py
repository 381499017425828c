"""The kit of exporters finds each seeded fault by the name of its check, and nothing in one without fault."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import pytest
from seeded import check_kit, check_seeded, common_faults, example, hoard

from occlog.conformance.exporters import CHECKS
from occlog.plugins.interface import ExportContext

Good: Any = example("own_parts/own_tables").Gnuplot


class Trucks(Good):
    tables = ("trucks",)


class WritesNothing(Good):
    def write(self, rows: Any, world: ExportContext, file: Any) -> None:
        pass


class LeavesOutTheLast(Good):
    def write(self, rows: Any, world: ExportContext, file: Any) -> None:
        super().write(rows.take(slice(0, -1)), world, file)


class ChangesInputs(Good):
    def write(self, rows: Any, world: ExportContext, file: Any) -> None:
        rows.x[:] += 1.0
        super().write(rows, world, file)


class WantsRows(Good):
    def write(self, rows: Any, world: ExportContext, file: Any) -> None:
        rows.t_ns.max()
        super().write(rows, world, file)


class WantsTwoRows(Good):
    def write(self, rows: Any, world: ExportContext, file: Any) -> None:
        assert len(rows) != 1
        super().write(rows, world, file)


class WantsHeights(Good):
    tables = ("truth",)

    def write(self, rows: Any, world: ExportContext, file: Any) -> None:
        file.write(b"".join(b"%d" % round(z) for z in rows.z))


class AsciiNames(Good):
    tables = ("boxes",)

    def write(self, rows: Any, world: ExportContext, file: Any) -> None:
        for values in zip(rows.t_ns, rows.sensor, rows.left_px, strict=True):
            file.write(" ".join(map(str, values)).encode("ascii"))


class PositiveTimes(Good):
    def write(self, rows: Any, world: ExportContext, file: Any) -> None:
        assert (rows.t_ns >= 0).all()
        super().write(rows, world, file)


class WholeSeconds(Good):
    def write(self, rows: Any, world: ExportContext, file: Any) -> None:
        columns = {c.name: getattr(rows, c.name) for c in rows.columns()}
        super().write(type(rows).of(**{**columns, "t_ns": rows.t_ns // 10**9 * 10**9}), world, file)


class MetresAlone(Good):
    def write(self, rows: Any, world: ExportContext, file: Any) -> None:
        file.write({"m": b"metres "}[world.length_unit])
        super().write(rows, world, file)


class CountsFiles(Good):
    files = 0

    def write(self, rows: Any, world: ExportContext, file: Any) -> None:
        self.files += 1
        file.write(b"%d" % self.files)
        super().write(rows, world, file)


class OwnEntropy(Good):
    def write(self, rows: Any, world: ExportContext, file: Any) -> None:
        file.write(b"%d" % next(NUMBER))
        super().write(rows, world, file)


NUMBER = itertools.count()


class Hoards(Good):
    def write(self, rows: Any, world: ExportContext, file: Any) -> None:
        hoard()
        super().write(rows, world, file)


FAULTS = {
    **common_faults(Good, "write"),
    "tables": Trucks,
    "writes": WritesNothing,
    "rows": LeavesOutTheLast,
    "inputs": ChangesInputs,
    "empty": WantsRows,
    "one-row": WantsTwoRows,
    "absent-values": WantsHeights,
    "names": AsciiNames,
    "old-times": PositiveTimes,
    "exact-times": WholeSeconds,
    "unit": MetresAlone,
    "reuse": CountsFiles,
    "determinism": OwnEntropy,
    "memory": Hoards,
}
"""An exporter with one fault, by the check that must find it."""


@pytest.mark.parametrize("name", FAULTS)
def test_a_seeded_fault_is_found_by_name(name: str) -> None:
    check_seeded(CHECKS, FAULTS, name)


def test_the_kit_is_complete_and_finds_nothing_in_a_good_one(tmp_path: Path) -> None:
    check_kit(CHECKS, FAULTS, Good, tmp_path)


def test_a_file_that_is_closed_or_read_is_noticed() -> None:
    class Seeks(Good):
        def write(self, rows: Any, world: ExportContext, file: Any) -> None:
            super().write(rows, world, file)
            file.seek(0)

    check_seeded(CHECKS, {"writes": Seeks}, "writes")
