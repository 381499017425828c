"""Tables of many recordings in one: all rows, the recording next to each, and nothing that does not go together."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from random_tables import random_table

from occlog.errors import InputError
from occlog.io import dataset as joined
from occlog.io.dataset import join_tables
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import describe, read_provenance, read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.records.losses import Loss
from occlog.records.tables import PeopleTracks, Tracks

MADE = Provenance("batch", losses=(Loss("b: cam1", "frame 3", "cannot be decoded", 1),))


def parts(folder: Path, kind: type = Tracks, **units: str) -> dict[str, Path]:
    made = {}
    for seed, name in enumerate(("a", "b", "c")):
        made[name] = folder / f"{name}.parquet"
        write_table(
            made[name], random_table(kind, 5 + seed, seed), Provenance("test"), length_unit=units.get(name, "m")
        )
    return made


@pytest.mark.parametrize("rows", [4, 65_536])
def test_all_rows_are_there_next_to_their_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rows: int) -> None:
    monkeypatch.setattr(joined, "ROWS_PER_GROUP", rows)
    made = parts(tmp_path)
    assert join_tables(tmp_path / "all.parquet", made, "tracks", MADE) == 5 + 6 + 7
    whole = pq.read_table(tmp_path / "all.parquet")
    assert whole["recording"].to_pylist() == ["a"] * 5 + ["b"] * 6 + ["c"] * 7
    expected = np.concatenate([read_table(path, Tracks).x for path in made.values()])
    assert np.array_equal(whole["x"].to_numpy(), expected)
    reported = describe(tmp_path / "all.parquet")
    assert (reported["schema"], reported["length_unit"], reported["rows"]) == ("batch.tracks", "m", 18)
    assert read_provenance(tmp_path / "all.parquet").losses == MADE.losses


def test_no_command_takes_it_for_the_table_of_one_recording(tmp_path: Path) -> None:
    join_tables(tmp_path / "all.parquet", parts(tmp_path), "tracks", MADE)
    with pytest.raises(InputError, match=r"holds batch.tracks/1, expected tracks/"):
        read_table(tmp_path / "all.parquet", Tracks)


def test_columns_that_a_part_does_not_have_are_empty_there(tmp_path: Path) -> None:
    made = parts(tmp_path)
    write_table(tmp_path / "d.parquet", random_table(PeopleTracks, 4, 9), Provenance("test"))
    join_tables(tmp_path / "all.parquet", {**made, "d": tmp_path / "d.parquet"}, "tracks", MADE)
    whole = pq.read_table(tmp_path / "all.parquet")
    assert whole["seen_by"].null_count == 18
    assert whole["existence_probability"].null_count == 18
    assert whole["x"].null_count == 0
    assert not whole.schema.field("x").nullable


def test_what_does_not_go_together_is_refused_and_nothing_is_left(tmp_path: Path) -> None:
    made = parts(tmp_path, c="cm")
    with pytest.raises(InputError, match="lengths are in m in a and in cm in c"):
        join_tables(tmp_path / "all.parquet", made, "tracks", MADE)
    with pytest.raises(InputError, match="holds tracks, expected errors"):
        join_tables(tmp_path / "all.parquet", made, "errors", MADE)
    assert not (tmp_path / "all.parquet").exists()


def changed(table: pa.Table, name: str, values: pa.Array) -> pa.Table:
    field = pa.field(name, values.type)
    if name in table.schema.names:
        return table.set_column(table.schema.get_field_index(name), field, values)
    return table.append_column(field, values)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: changed(t, "x", pa.array([None, 1.0, 2.0, 3.0, 4.0, 5.0])), "column x: 1 missing values"),
        (lambda t: changed(t, "recording", pa.array(["b"] * 6)), "column recording would occur twice"),
        (lambda t: t.append_column("t_ns", t["t_ns"]), "column t_ns is there twice"),
        (lambda t: t.append_column("more", t["x"]).append_column("more", t["x"]), "column more would occur twice"),
        (lambda t: t.drop_columns(["cov_xx"]), "column cov_xx of tracks is missing"),
        (lambda t: t.replace_schema_metadata({**t.schema.metadata, b"occlog.schema": b"tracks/9"}), "is newer than"),
    ],
)
def test_a_part_that_is_no_such_table_is_refused_by_its_name(
    tmp_path: Path, change: Callable[[pa.Table], pa.Table], words: str
) -> None:
    made = parts(tmp_path)
    pq.write_table(change(pq.read_table(made["b"])), made["b"])
    with pytest.raises(InputError, match=f"b.parquet: .*{words}"):
        join_tables(tmp_path / "all.parquet", made, "tracks", MADE)
    assert not (tmp_path / "all.parquet").exists()
