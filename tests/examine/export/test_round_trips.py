"""What `occlog export` writes for other programs is read again: the same, up to what the format holds."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from random_tables import random_table

from occlog.array_types import NS
from occlog.cli.main import run
from occlog.errors import ExitCode, InputError
from occlog.examine.export.run import ExportRequest, run_export
from occlog.io.files.geodetic import Origin, degrees_of, places_of_degrees
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.files.timing.frame_choice import FrameChoice
from occlog.io.formats.boxes.reader import BoxFile, BoxOptions, read_boxes, survey_boxes
from occlog.io.formats.truth import TruthOptions, read_truth
from occlog.io.frames.streams import rate_times
from occlog.io.open import check_unit, is_external, open_input
from occlog.records.columns import ColumnTable
from occlog.records.tables import TABLES, Boxes, Tracks, Truth

EPOCH = 1_714_564_800 * NS
NARROW = [table for table in TABLES.values() if not any(c.width and c.nan is None for c in table.columns())]
FEW = settings(max_examples=15, deadline=None, phases=(Phase.explicit, Phase.generate))
NUMBER = st.floats(-1e4, 1e4, allow_nan=False).map(float)


def truth_of(rows: list[tuple[int, int, float, float, float]]) -> Truth:
    t_ns, identity, x, y, z = zip(*sorted(rows), strict=True)
    return Truth.of(t_ns=t_ns, target_id=identity, role=["target"] * len(rows), x=x, y=y, z=z)


@st.composite
def places(draw: st.DrawFn, targets: int = 3) -> Truth:
    """Some of a few targets at each of some uneven times, with heights."""
    times = draw(st.lists(st.integers(0, 10**12), min_size=1, max_size=5, unique=True))
    names = draw(st.lists(st.integers(0, 10**6), min_size=1, max_size=targets, unique=True))
    rows = [(EPOCH + t, n, draw(NUMBER), draw(NUMBER), draw(NUMBER)) for t in times for n in names]
    kept = [row for row in rows if draw(st.booleans())]
    return truth_of(kept or rows[:1])


@st.composite
def boxes(draw: st.DrawFn) -> Boxes:
    """Boxes of one camera at 10 Hz in frames from 0, of which the first and the last have one."""
    keys = draw(st.sets(st.tuples(st.integers(0, 6), st.integers(0, 50)), min_size=2, max_size=8))
    shift = min(frame for frame, _ in keys)
    frames, names = zip(*sorted((frame - shift, name) for frame, name in keys), strict=True)
    n = len(frames)
    edge = st.floats(-100, 2000, allow_nan=False)
    size = st.floats(110.0, 500, allow_nan=False)
    column = {
        name: draw(st.lists(values, min_size=n, max_size=n))
        for name, values in (("left_px", edge), ("top_px", edge), ("width_px", size), ("height_px", size))
    }
    sure = draw(st.lists(st.one_of(st.just(np.nan), st.floats(0.01, 1.0)), min_size=n, max_size=n))
    number = [sum(f == frame for f in frames[:k]) for k, frame in enumerate(frames)]
    t_ns = [frame * NS // 10 for frame in frames]
    return Boxes.of(t_ns=t_ns, sensor=["a"] * n, frame=frames, box=number, target_id=names, **column, confidence=sure)


def exported(folder: Path, table: ColumnTable, name: str, unit: str = "m", **options: object) -> Path:
    write_table(folder / "in.parquet", table, Provenance("test"), overwrite=True, length_unit=unit)
    usual: dict[str, object] = {"to": None, "table": None, "targets": (), "camera": None, "origin": None, "scene": None}
    run_export(ExportRequest(input=folder / "in.parquet", output=folder / name, overwrite=True, **(usual | options)))  # type: ignore[arg-type]
    return folder / name


def assert_same(found: Truth | Tracks, wanted: Truth, atol: float = 0.0, names: str = "xyz") -> None:
    np.testing.assert_array_equal(found.t_ns, wanted.t_ns)
    np.testing.assert_array_equal(found.target_id, wanted.target_id)
    for name in names:
        np.testing.assert_allclose(getattr(found, name), getattr(wanted, name), rtol=0.0, atol=atol, err_msg=name)


@FEW
@given(places(targets=1), st.integers(-(10**12), 10**12))
def test_tum_is_the_same_but_for_the_identity(wanted: Truth, shift: int) -> None:
    # Also times before the epoch
    moved = Truth.of(
        t_ns=wanted.t_ns - EPOCH + shift,
        target_id=wanted.target_id,
        role=wanted.role,
        x=wanted.x,
        y=wanted.y,
        z=wanted.z,
    )
    with TemporaryDirectory() as folder:
        path = exported(Path(folder), moved, "one.tum")
        for table in (Tracks, Truth):
            found = open_input(path, table).read(table)
            np.testing.assert_array_equal(found.t_ns, moved.t_ns)
            assert set(found.target_id.tolist()) == {0}
            for name in "xyz":
                np.testing.assert_array_equal(getattr(found, name), getattr(moved, name))


@FEW
@given(places())
def test_trc_is_the_same_with_times_from_the_first_one(wanted: Truth) -> None:
    start = int(wanted.t_ns[0])
    with TemporaryDirectory() as folder:
        found = open_input(exported(Path(folder), wanted, "a.trc"), Truth).read(Truth)
    np.testing.assert_array_equal(found.t_ns, wanted.t_ns - start)
    np.testing.assert_array_equal(found.target_id, wanted.target_id)
    for name in "xyz":
        np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name))


@FEW
@given(places(), st.floats(-85, 85), st.floats(-180, 180), st.floats(-180, 180))
def test_geojson_is_the_same_on_the_ground_to_a_tenth_of_a_millimetre(
    wanted: Truth, latitude: float, longitude: float, turned: float
) -> None:
    with TemporaryDirectory() as folder:
        path = exported(Path(folder), wanted, "a.geojson", origin=Origin(latitude, longitude, turned))
        found = open_input(path, Truth).read(Truth)
    assert_same(found, wanted, atol=1e-4, names="xy")
    assert np.isnan(found.z).all()


@FEW
@given(st.lists(st.tuples(NUMBER, NUMBER), min_size=1, max_size=5), st.floats(-85, 85), st.floats(-180, 180))
def test_places_of_degrees_undo_degrees_of(xy: list[tuple[float, float]], latitude: float, longitude: float) -> None:
    origin = Origin(latitude, longitude, 30.0)
    wanted = np.array(xy)
    np.testing.assert_allclose(places_of_degrees(degrees_of(wanted, origin), origin), wanted, rtol=0.0, atol=2e-7)


@FEW
@given(places())
def test_motchallenge_in_space_is_the_same_at_an_even_rate(drawn: Truth) -> None:
    _, frame = np.unique(drawn.t_ns, return_inverse=True)
    columns = {name: getattr(drawn, name) for name in ("target_id", "role", "x", "y", "z")}
    wanted = Truth.of(t_ns=EPOCH + frame * (NS // 4), **columns)
    with TemporaryDirectory() as folder:
        path = exported(Path(folder), wanted, "a.txt", to="mot3d")
        how = TruthOptions(times={"": rate_times(Fraction(4), "given", EPOCH)})
        (found,) = read_truth(path, how)
    assert isinstance(found, Truth)
    assert_same(found, wanted)


@FEW
@given(boxes(), st.sampled_from([("kitti", "a.txt"), ("mot", "a.txt"), ("coco", "a.json")]))
def test_boxes_are_the_same(wanted: Boxes, form: tuple[str, str]) -> None:
    with TemporaryDirectory() as folder:
        path = exported(Path(folder), wanted, form[1], to=form[0])
        files = [BoxFile(path, "a")]
        survey = survey_boxes(files, ("a",), BoxOptions())
        times = {"a": rate_times(Fraction(10), "given")}
        found = Boxes.concat(read_boxes(files, survey, times, ("a",), BoxOptions(), Boxes))
    found = found.take(found.box >= 0)  # without the frames in which no one was seen
    # Detections of MOTChallenge have no identities; KITTI has right and bottom edges, so that sizes are rounded
    for name in ("t_ns", "frame", "left_px", "top_px", *(() if form[0] == "mot" else ("target_id",))):
        np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name), err_msg=name)
    for name in ("width_px", "height_px"):
        atol = 1e-12 * 2500 if form[0] == "kitti" else 0.0
        np.testing.assert_allclose(getattr(found, name), getattr(wanted, name), rtol=0.0, atol=atol)
    np.testing.assert_array_equal(found.confidence, wanted.confidence)


TEXT = st.text(st.one_of(st.characters(exclude_categories=("Cs", "Cc")), st.sampled_from("\t,;\"'#")), max_size=12)
"""Without white space around it, which text of other programs may have."""


@st.composite
def odd_cells(draw: st.DrawFn) -> tuple[ColumnTable, str, str]:
    """A table with values in one column that are as odd as the column takes, that column, and how it is written."""
    made = random_table(draw(st.sampled_from(NARROW)), 6).sorted()
    named = draw(st.sampled_from([c for c in made.columns() if not c.width and c.name not in ("t_ns", *made.KEY)]))
    kinds = {
        "f": st.floats(allow_nan=named.nan is not None, allow_infinity=False, width=8 * named.dtype.itemsize),
        "i": st.integers(np.iinfo(np.int32).min, np.iinfo(np.int32).max),
        "b": st.booleans(),
        "U": TEXT.map(str.strip),
    }
    values = draw(st.lists(kinds[named.dtype.kind], min_size=len(made), max_size=len(made)))
    columns = {c.name: getattr(made, c.name) for c in made.columns()}
    try:
        odd = type(made).of(**{**columns, named.name: values})
    except InputError:
        odd = made  # the column does not take them, its table says so
    return odd, named.name, draw(st.sampled_from([".csv", ".csv.gz", "-plain.parquet"]))


@settings(FEW, max_examples=40)
@given(odd_cells())
def test_text_and_plain_parquet_are_the_same_or_refused_by_the_column(drawn: tuple[ColumnTable, str, str]) -> None:
    wanted, odd, ending = drawn
    with TemporaryDirectory() as folder:
        source, out = Path(folder) / "in.parquet", Path(folder) / f"out{ending}"
        write_table(source, wanted, Provenance("test"))
        assert run(["export", str(source), "-o", str(out)]) == ExitCode.DONE
        try:
            found = open_input(out, type(wanted)).read(type(wanted))
        except InputError as error:
            assert f": {odd}" in str(error).replace(": column ", ": ")
            return
    for c in wanted.columns():
        if not c.width:
            np.testing.assert_array_equal(getattr(found, c.name), getattr(wanted, c.name), err_msg=c.name)


def test_lengths_are_converted_to_the_unit_of_the_scene(tmp_path: Path) -> None:
    truth = truth_of([(0, 3, 100.0, -250.0, 0.0), (NS, 3, 125.0, -250.0, 0.0)])
    for name, options in (("a.trc", {}), ("a.geojson", {"origin": Origin(52.5, 13.4)})):
        opened = open_input(exported(tmp_path, truth, name, unit="cm", **options), Truth)
        assert is_external(opened.path)
        check_unit(opened, "cm")
        np.testing.assert_allclose(opened.read(Truth).x, truth.x, atol=0.01)


def test_identities_of_all_numbers_that_tracks_hold_are_read_from_trc(tmp_path: Path) -> None:
    """Those above 999,999,999 were refused."""
    truth = truth_of([(0, name, 1.0, 2.0, 3.0) for name in (0, 10**9, 2**31 - 1)])
    assert_same(open_input(exported(tmp_path, truth, "a.trc"), Truth).read(Truth), truth)


def test_tracks_of_a_geojson_are_evaluated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = truth_of([(k * NS, 1, float(k), 0.5 * k, 0.0) for k in range(20)])
    path = exported(tmp_path, truth, "a.geojson", origin=Origin(52.5, 13.4))
    assert run(["evaluate", str(path), "--truth", str(tmp_path / "in.parquet"), "--json"]) == ExitCode.DONE
    assert json.loads(capsys.readouterr().out)["rmse_m"] < 1e-4


TRC = "PathFileType\t4\nDataRate\tUnits\n1\t{unit}\nFrame#\tTime\t{marker}\t\t\n\t\tX1\tY1\tZ1\n\n1\t0.0\t{cells}\n"
FEATURE = {
    "geometry": {"type": "Point", "coordinates": [13.0, 52.0]},
    "properties": {"target_id": 1, "t_ns": [0]},
}


def geojson(**changes: object) -> str:
    whole = {"type": "FeatureCollection", "origin": {"latitude": 52.0, "longitude": 13.0}, "features": [FEATURE]}
    return json.dumps(whole | changes)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0 1 2 3 0 0 0 1\n1 1 2 x 0 0 0 1\n", "line 2: z is 'x'"),
        (TRC.format(unit="in", marker="target_1", cells="1\t2\t3"), "line 3: Units are 'in'; m or mm was expected"),
        (TRC.format(unit="m", marker="hip", cells="1\t2\t3"), "line 4: marker 'hip' is not a target"),
        (TRC.format(unit="m", marker="target_1", cells="1\t\t3"), "line 7: target_1 has a position with an empty cell"),
        (TRC.format(unit="m", marker="target_1", cells="1\t2\t3\t4"), "line 7: 6 cells; lines of 1 markers have 5"),
        ("PathFileType\t4\n", "1 lines, but the header of TRC alone has 5"),
        (geojson(origin=None), "does not state where the scene's origin is"),
        (geojson(origin={"latitude": 86, "longitude": 0}), "latitude must be within 85 degrees"),
        (geojson(features=[FEATURE | {"geometry": {"type": "Polygon"}}]), "feature 1: its geometry is 'Polygon'"),
        (
            geojson(features=[FEATURE | {"properties": {"target_id": 1, "t_ns": [0, 1]}}]),
            "one for each of its 1 positions",
        ),
        (geojson(features=[FEATURE | {"properties": {"t_ns": [0]}}]), "has no whole number target_id"),
        (geojson()[:-3], "not valid JSON: Expecting"),
    ],
)
def test_damage_is_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "file.txt"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        open_input(path, Truth).read(Truth)
    assert message in str(error.value)


def test_lines_of_kitti_that_are_no_boxes(tmp_path: Path) -> None:
    line = "0 1 Pedestrian -1 -1 -10 1 2 11 22 -1 -1 -1 -1000 -1000 -1000 -10"
    path = tmp_path / "kitti.txt"
    path.write_text(f"{line}\n0 -1 {line[4:].replace('Pedestrian', 'DontCare')}\n")
    survey = survey_boxes([BoxFile(path, "a")], ("a",), BoxOptions(frames=FrameChoice((0, 1))))
    assert (survey.rows, survey.kinds) == (1, ("KITTI text",))
    path.write_text(f"{line}\n{line} 0.5 7\n")
    with pytest.raises(InputError, match="line 2: 19 columns"):
        survey_boxes([BoxFile(path, "a")], ("a",), BoxOptions())
    with pytest.raises(InputError, match=r"does not name it; give CAMERA=kitti\.txt"):
        survey_boxes([BoxFile(path, None)], ("a",), BoxOptions())
