"""Tables to Parquet and back; damage never passes as numbers."""

from __future__ import annotations

import gc
import os
import resource
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from random_tables import random_table

from occlog.errors import InputError, OutputError, OutputExistsError, UsageError
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables import table_writer
from occlog.io.files.tables.arrow import from_arrow
from occlog.io.files.tables.parquet import describe, iter_table, read_provenance, read_table
from occlog.io.files.tables.table_writer import TableWriter, write_table
from occlog.records.losses import Loss
from occlog.records.tables import APPEARANCE_BINS, TABLES, Bearings, Tracks, Truth, Views
from occlog.track.people.frame_detections import RegionFrameTimes

PROVENANCE = Provenance("detect", {"method": "em"}, 7, (("a.mcap", "00"),), (Loss("cam1", "frame 3", "lost", 1),))


def same(a, b) -> bool:
    return all(
        np.array_equal(getattr(a, c.name), getattr(b, c.name), equal_nan=c.kind.startswith("f")) for c in a.columns()
    )


@pytest.mark.parametrize("table", TABLES.values())
@pytest.mark.parametrize("rows", [0, 1, 1000])
def test_round_trip(tmp_path: Path, table: type, rows: int) -> None:
    want = random_table(table, rows).sorted()
    path = tmp_path / "t.parquet"
    write_table(path, want, PROVENANCE)
    got = read_table(path, table)
    assert same(got, want)
    assert read_provenance(path) == PROVENANCE
    assert describe(path)["rows"] == rows


def test_tables_are_written_and_read_without_pandas(tmp_path: Path) -> None:
    """pyarrow's own conversions import it, which takes longer than many a command."""
    code = """
import sys
from pathlib import Path
from random_tables import random_table
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.records.tables import TABLES
for table in TABLES.values():
    path = Path(table.NAME + ".parquet")
    write_table(path, random_table(table, 10), Provenance("detect"))
    read_table(path, table)
print("pandas" in sys.modules)
"""
    search = os.pathsep.join(["", *filter(None, sys.path)])
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": search},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "False\n"


def test_units_and_meanings_are_in_the_file(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    write_table(path, random_table(Tracks, 3), PROVENANCE, length_unit="ft")
    schema = pq.read_schema(path)
    assert schema.field("x").metadata[b"unit"] == b"ft"
    assert schema.field("cov_xx").metadata[b"unit"] == b"ft^2"
    assert schema.field("vx").metadata[b"nan"]
    assert schema.metadata[b"occlog.schema"] == b"tracks/3"


def test_copies_of_rows_are_refused_where_they_have_an_identity_or_a_measurement(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    for target in (3, -1):
        one = replace(random_table(Bearings, 1), target_id=np.array([target], np.int32))
        write_table(path, Bearings.concat([one, one]), PROVENANCE, overwrite=True)
        with pytest.raises(InputError, match=rf"t\.parquet: Bearings: a row is repeated \(t_ns .*target_id {target}"):
            read_table(path, Bearings)
    blind = replace(
        one,
        seen=np.array([False]),
        **{
            name: np.array([np.nan])
            for name in ("bearing", "sigma", "u_px", "sigma_px", "elevation", "sigma_elevation")
        },
    )
    write_table(path, Bearings.concat([blind, blind]), PROVENANCE, overwrite=True)
    assert len(read_table(path, Bearings)) == 2
    # What two rows differ in may be in columns that no one asks for
    views = Views.concat([random_table(Views, 1)] * 2)
    views = replace(views, cluster=np.array([0, 1], np.int32))
    write_table(path, views, PROVENANCE, overwrite=True)
    assert len(read_table(path, RegionFrameTimes)) == 2


def test_same_rows_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_table(tmp_path / name, random_table(Bearings, 500), PROVENANCE)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_chunks_are_written_in_groups_and_read_in_chunks(tmp_path: Path) -> None:
    want = random_table(Bearings, 5000)
    path = tmp_path / "t.parquet"
    with TableWriter(path, Bearings, PROVENANCE) as writer:
        for i in range(0, 5000, 50):
            writer.write(want.take(slice(i, i + 50)))
    assert pq.ParquetFile(path).num_row_groups == 1
    parts = list(iter_table(path, Bearings, rows=700))
    assert max(len(p) for p in parts) <= 700
    assert same(Bearings.concat(parts), want)


def test_what_was_read_of_a_file_is_not_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table_writer, "ROWS_PER_GROUP", 500)
    path, rows = tmp_path / "t.parquet", 40_000
    write_table(path, random_table(Tracks, rows).sorted(), PROVENANCE)
    before, most, count = pa.total_allocated_bytes(), 0, 0
    for part in iter_table(path, Tracks, rows=500):
        most, count = max(most, pa.total_allocated_bytes() - before), count + len(part)
    assert count == rows
    assert pq.ParquetFile(path).num_row_groups == 80
    assert 0 < most < 0.2 * path.stat().st_size


def test_provenance_known_at_the_end_replaces_the_first(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    with TableWriter(path, Bearings, Provenance("detect")) as writer:
        writer.write(random_table(Bearings, 3))
        writer.annotate(PROVENANCE)
    assert read_provenance(path) == PROVENANCE


def test_an_error_while_writing_leaves_nothing(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "t.parquet"
    with pytest.raises(ZeroDivisionError), TableWriter(path, Bearings, PROVENANCE) as writer:
        writer.write(random_table(Bearings, 100_000))
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr().err == ""


def test_existing_output_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    write_table(path, random_table(Bearings, 3), PROVENANCE)
    before = path.read_bytes()
    with pytest.raises(OutputExistsError):
        write_table(path, random_table(Bearings, 4), PROVENANCE)
    assert path.read_bytes() == before


def test_flipped_bits_and_cuts_never_pass_as_numbers(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    want = random_table(Bearings, 2000).sorted()
    write_table(path, want, PROVENANCE)
    raw, rng = path.read_bytes(), np.random.default_rng(1)
    refused = 0
    for trial in range(150):
        data = bytearray(raw)
        if trial < 100:
            data[rng.integers(len(data))] ^= 1 << rng.integers(8)
        else:
            data = data[: rng.integers(1, len(data))]
        path.write_bytes(data)
        try:
            assert same(read_table(path, Bearings), want)  # a flip in text that does not matter
        except InputError as error:
            refused += 1
            assert "\n" not in str(error)
            assert str(path) in str(error)
    assert refused >= 100


def test_wrong_tables_are_named(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    write_table(path, random_table(Tracks, 3), PROVENANCE)
    with pytest.raises(InputError, match=r"holds tracks/3, expected bearings/2"):
        read_table(path, Bearings)
    pq.write_table(pa.table({"a": [1]}), path)
    with pytest.raises(InputError, match="not an occlog table"):
        describe(path)
    with pytest.raises(InputError, match="expected bearings/2"):
        read_table(path, Bearings)


def test_older_files_are_read_and_newer_ones_refused(tmp_path: Path) -> None:
    want, path = random_table(Tracks, 5), tmp_path / "t.parquet"
    write_table(path, want, PROVENANCE)
    old = pq.read_table(path).drop_columns(["z", "cov_vx_vx"])

    def save(version: bytes) -> None:
        pq.write_table(old.replace_schema_metadata({**old.schema.metadata, b"occlog.schema": version}), path)

    save(b"tracks/1")
    have = read_table(path, Tracks)
    assert np.isnan(have.z).all()
    assert np.isnan(have.cov_vx_vx).all()
    assert np.array_equal(have.x, want.x)
    save(b"tracks/99")
    with pytest.raises(InputError, match="holds tracks/99, which is newer than tracks/3; update occlog"):
        read_table(path, Tracks)


def rewrite(path: Path, change) -> None:
    table = pq.read_table(path)
    metadata = table.schema.metadata
    pq.write_table(change(table).replace_schema_metadata(metadata), path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.drop_columns(["sigma"]), "column sigma of bearings is missing"),
        (lambda t: t.set_column(0, "t_ns", t["t_ns"].cast(pa.float64(), safe=False)), "t_ns is double, expected int64"),
        (lambda t: t.set_column(4, "bearing", pa.array([None] * len(t), pa.float64())), "nulls, which are not allowed"),
        (lambda t: t.set_column(4, "bearing", pa.array([7.0] * len(t))), "must be in"),
        (lambda t: t.take(list(range(len(t)))[::-1]), "t_ns goes back"),
    ],
)
def test_tables_of_others_are_checked(tmp_path: Path, change, message: str) -> None:
    path = tmp_path / "t.parquet"
    write_table(path, random_table(Bearings, 20), PROVENANCE)
    rewrite(path, change)
    with pytest.raises(InputError, match=message):
        read_table(path, Bearings)


def test_plain_strings_of_other_writers_are_accepted(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    want = random_table(Bearings, 20).sorted()
    write_table(path, want, PROVENANCE)
    rewrite(path, lambda t: t.set_column(1, "sensor", t["sensor"].cast(pa.large_string())))
    assert same(read_table(path, Bearings), want)


@pytest.mark.parametrize(("content", "message"), [(None, "no such file"), (b"", "empty"), (b"PAR1x", "not a Parquet")])
def test_files_that_are_none(tmp_path: Path, content: bytes | None, message: str) -> None:
    path = tmp_path / "t.parquet"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_table(path, Bearings)


def test_appearance_is_a_fixed_list(tmp_path: Path) -> None:
    path = tmp_path / "v.parquet"
    table = random_table(Views, 4)
    table.appearance[1] = np.arange(APPEARANCE_BINS)
    write_table(path, table, PROVENANCE)
    assert read_table(path, Views).appearance[1].tolist() == list(range(APPEARANCE_BINS))


@pytest.mark.parametrize(
    ("name", "good"), [("t.parquet", True), ("t", True), ("t.pq", True), ("t.csv", False), ("t.JSON", False)]
)
def test_a_name_that_promises_another_format_is_refused(tmp_path: Path, name: str, good: bool) -> None:
    if good:
        write_table(tmp_path / name, Tracks.empty(), Provenance("test"))
        assert (tmp_path / name).is_file()
        return
    with pytest.raises(UsageError, match=r"tables are written as Parquet, not \.\w+; name it t\.parquet"):
        write_table(tmp_path / name, Tracks.empty(), Provenance("test"))
    assert not (tmp_path / name).exists()


def embedded(rows: int, length: int) -> Views:
    """Views with embeddings of so many numbers."""
    return replace(random_table(Views, rows), embedding=np.ones((rows, length), np.float32))


def test_vectors_of_any_length_come_back_and_are_nan_where_there_are_none(tmp_path: Path) -> None:
    for length in (0, 5, 512):
        write_table(tmp_path / "v.parquet", embedded(4, length), PROVENANCE, overwrite=True)
        assert read_table(tmp_path / "v.parquet", Views).embedding.shape == (4, length)
    both = Views.merge([embedded(2, 0), embedded(3, 4)])
    assert np.isnan(both.embedding).all(axis=1).sum() == 2
    assert (both.embedding == 1).all(axis=1).sum() == 3
    with pytest.raises(InputError, match="vectors of 3 and of 4 numbers"):
        Views.concat([embedded(2, 3), embedded(2, 4)])


def test_vectors_of_several_lengths_in_a_file_are_refused(tmp_path: Path) -> None:
    write_table(tmp_path / "v.parquet", embedded(2, 3), PROVENANCE)
    whole = pq.read_table(tmp_path / "v.parquet")
    place = whole.schema.get_field_index("embedding")
    ragged = whole.set_column(
        place, whole.schema.field(place), pa.array([[1.0], [1.0, 2.0]], whole.schema.field(place).type)
    )
    pq.write_table(ragged, tmp_path / "w.parquet", write_page_checksum=True)
    with pytest.raises(InputError, match="column embedding: lists of 1 and of 2 numbers"):
        read_table(tmp_path / "w.parquet", Views)


def test_a_name_that_is_not_utf_8_is_a_name(tmp_path: Path) -> None:
    path = tmp_path / os.fsdecode(b"b\xff.parquet")
    write_table(path, random_table(Bearings, 3).sorted(), PROVENANCE)
    assert describe(path)["schema"] == "bearings"


@pytest.mark.parametrize("most", [0, 50_000])
def test_a_disk_that_is_full_at_any_write_leaves_no_table_and_is_one_error(most: int, tmp_path: Path) -> None:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, before[1]))
    try:
        with pytest.raises(OutputError, match=r"t\.parquet: the file would be larger than this system allows"):
            write_table(tmp_path / "t.parquet", random_table(Bearings, 5000).sorted(), PROVENANCE)
        gc.collect()  # a writer that is not closed would complain
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not list(tmp_path.iterdir())


def test_a_changed_unit_or_provenance_is_damage(tmp_path: Path) -> None:
    """Parquet has no check sum of its footer, where both stand."""
    path = tmp_path / "t.parquet"
    with TableWriter(path, Tracks, Provenance("track"), length_unit="ft") as writer:
        writer.write(random_table(Tracks, 20).sorted())
        writer.annotate(PROVENANCE)
    whole = pq.read_table(path)
    entries = {**whole.schema.metadata, **pq.read_metadata(path).metadata}
    for key, value in (("occlog.length_unit", b"m"), ("occlog.provenance", Provenance("track").json().encode())):
        changed = {k: v for k, v in entries.items() if k != b"ARROW:schema"} | {key.encode(): value}
        pq.write_table(whole.replace_schema_metadata(changed), tmp_path / "c.parquet")
        with pytest.raises(InputError, match=r"c\.parquet: damaged: its unit of lengths or its provenance changed"):
            read_table(tmp_path / "c.parquet", Tracks)
    read_table(path, Tracks)


def test_a_column_of_occlog_under_another_name_is_damage(tmp_path: Path) -> None:
    """An optional column, which would be taken for one that is not there."""
    path = tmp_path / "t.parquet"
    write_table(path, random_table(Tracks, 20).sorted(), PROVENANCE)
    whole = pq.read_table(path)
    fields = [field.with_name("w") if field.name == "z" else field for field in whole.schema]
    pq.write_table(pa.Table.from_arrays(whole.columns, schema=pa.schema(fields, whole.schema.metadata)), path)
    with pytest.raises(InputError, match=r"t\.parquet: damaged: tracks has no column 'w'"):
        read_table(path, Tracks)
    pq.write_table(whole.append_column("mood", pa.array(["merry"] * 20)), path)  # of another program
    assert len(read_table(path, Tracks)) == 20


@pytest.mark.parametrize("index", [-1, 1, 200])
def test_names_that_are_not_there_are_damage(index: int) -> None:
    """Groups of rows that somebody damaged are read without Arrow's own point at all indices."""
    names = pa.DictionaryArray.from_arrays(pa.array([0, index], pa.int32()), pa.array(["a"]), safe=False)
    columns = {"t_ns": [1, 2], "target_id": [0, 0], "role": names, "x": [0.0, 0.0], "y": [0.0, 0.0], "z": [0.0, 0.0]}
    with pytest.raises(InputError, match=r"column role: .* refers to a missing text"):
        from_arrow(pa.table(columns), Truth)


@pytest.mark.parametrize("rows", [1, 2, 3, 10])
def test_copies_behind_others_of_their_time_are_refused(tmp_path: Path, rows: int) -> None:
    """A table and a copy of it, put in the order of time alone, were read, and gave other figures."""
    one = random_table(Tracks, 1)
    people = Tracks.concat([replace(one, target_id=np.array([n], np.int32)) for n in range(4)])
    path = tmp_path / "t.parquet"
    write_table(path, people, PROVENANCE)
    whole = pq.read_table(path)
    pq.write_table(pa.concat_tables([whole, whole.slice(2)]), path)
    with pytest.raises(InputError, match=r"t\.parquet: Tracks: a row is repeated \(t_ns .*target_id [23]\)"):
        list(iter_table(path, Tracks, rows))
    pq.write_table(whole.take([3, 1, 2, 0]), path)
    assert sum(len(chunk) for chunk in iter_table(path, Tracks, rows)) == 4


@pytest.mark.parametrize("apart", [False, True])
def test_somebody_in_two_places_at_one_time_is_refused(tmp_path: Path, apart: bool) -> None:
    """`evaluate` took both rows; the second lay in another group of rows."""
    one = replace(random_table(Tracks, 1), target_id=np.array([3], np.int32))
    both = Tracks.concat([one, replace(one, x=one.x + 1)])
    path = tmp_path / "t.parquet"
    write_table(path, both, PROVENANCE)
    with pytest.raises(InputError, match=r"t\.parquet: Tracks: t_ns .*target_id 3: is there twice"):
        list(iter_table(path, Tracks, 1 if apart else 10))
