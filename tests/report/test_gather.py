"""Long tables on a page: a part is drawn, by a rule, and every number is of all rows."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_up import run as made_up
from people_in_groups import walk

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.evaluate import sources
from occlog.evaluate.verdict import TrackProvenance
from occlog.io import open as opening
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import iter_table
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.records.columns import ColumnTable
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Diagnostics, Errors, Events, Occluders, PeopleTracks, Tracks, Truth
from occlog.report.content import downsampled as rule
from occlog.report.content.downsampled import ErrorsSoFar, TableTotals, downsample, downsample_with, every_nth
from occlog.report.content.model import ReportInput
from occlog.report.gather import gather, in_files
from occlog.report.page import build_markdown
from occlog.report.plots.floorplan import plan_limits
from occlog.report.replay.build import replay
from occlog.report.replay.steps import ReplaySteps

STEPS = 400
RANDOM = np.random.default_rng(5)
T_NS = np.repeat(np.arange(STEPS) * 10**8, 2)
IDS = np.tile(np.array([3, 8], dtype=np.int32), STEPS)
KEEP = (IDS == 3) | ((T_NS > 30 * 10**8) & (T_NS < 333 * 10**8))
"""The second target comes later and goes earlier."""


def tables() -> tuple[Tracks, Truth, Errors]:
    x, y = np.cos(T_NS / 1e9), np.sin(T_NS / 1e9) + IDS
    dx, dy = RANDOM.normal(0.0, 0.5, (2, len(T_NS)))
    dx[777] = 25.0
    values = {"t_ns": T_NS, "target_id": IDS}
    ones, zero = np.ones(len(x)), np.zeros(len(x))
    covariance = {"cov_xx": 0.1 * ones, "cov_xy": zero, "cov_yy": 0.1 * ones}
    error = np.hypot(dx, dy)
    tracks = Tracks.of(**values, x=x + dx, y=y + dy, vx=ones, vy=ones, **covariance)
    truth = Truth.of(**values, role=np.full(len(x), "target"), x=x, y=y, z=zero)
    more = {"z": ones, "truth_z": zero, "error_z": ones, "error_space": np.hypot(error, 1.0), "nees_space": 30.0 * ones}
    errors = Errors.of(
        **values,
        x=x + dx,
        y=y + dy,
        truth_x=x,
        truth_y=y,
        error_x=dx,
        error_y=dy,
        error=error,
        nees=10 * error**2,
        **more,
    )
    return tracks.take(KEEP), truth.take(KEEP), errors.take(KEEP)


def chunks(table: Errors, rows: int) -> Iterator[Errors]:
    for start in range(0, len(table), rows):
        yield table.take(slice(start, start + rows))


@pytest.mark.parametrize("rows", [10**6, 97, 40])
def test_what_is_kept(rows: int) -> None:
    *_, errors = tables()
    found = downsample(chunks(errors, rows), Errors, len(errors), most=100)
    assert found.whole == TableTotals(len(errors), STEPS, -(-len(errors) // 100))
    np.testing.assert_array_equal(found.table.t_ns, errors.t_ns[found.rows])
    assert len(np.unique(found.rows)) == len(found.rows)
    assert len(found.rows) < 400
    regular = np.isin(errors.t_ns, np.unique(errors.t_ns)[:: found.whole.every])
    assert np.isin(np.flatnonzero(regular), found.rows).all()
    for target in (3, 8):
        own = np.flatnonzero(errors.target_id == target)
        worst = own[np.argmax(errors.error[own])]
        assert np.isin([own[0], own[-1], worst], found.rows).all()


def test_a_short_table_stays_whole() -> None:
    *_, errors = tables()
    found = downsample(chunks(errors, 50), Errors, len(errors), most=10_000)
    np.testing.assert_array_equal(found.rows, np.arange(len(errors)))


def test_figures_up_to_each_row_are_those_of_all_rows() -> None:
    *_, errors = tables()
    found = ErrorsSoFar()
    so_far = np.concatenate([found.add(part) for part in chunks(errors, 13)])
    for target in (3, 8):
        own = errors.target_id == target
        running = np.sqrt(np.cumsum(errors.error[own] ** 2) / np.arange(1, own.sum() + 1))
        np.testing.assert_allclose(so_far[own], running, rtol=1e-12)
        assert found.rmse(target) == pytest.approx(float(so_far[own][-1]), rel=1e-12)
        assert found.worst(target) == errors.error[own].max()
    assert found.rmse() == pytest.approx(float(np.sqrt(np.mean(errors.error**2))), rel=1e-12)
    assert found.rmse_in_space() == pytest.approx(float(np.sqrt(np.mean(errors.error_space**2))), rel=1e-12)


def test_rows_of_some_times_are_kept_in_addition() -> None:
    *_, errors = tables()
    also = np.array([1, 3, 7], dtype=np.int64) * 10**8
    found = downsample(chunks(errors, 60), Errors, len(errors), most=100, also=also)
    assert np.isin(np.flatnonzero(np.isin(errors.t_ns, also)), found.rows).all()
    without = downsample(chunks(errors, 60), Errors, len(errors), most=100)
    more = downsample_with(without, chunks(errors, 33), lambda part: np.flatnonzero(np.isin(part.t_ns, also)))
    np.testing.assert_array_equal(more.rows, found.rows)
    np.testing.assert_array_equal(more.table.error, found.table.error)
    assert found.whole.step_ns == 10**8
    assert found.whole.span_ns == (0, int(errors.t_ns[-1]))
    np.testing.assert_array_equal(found.whole.at, np.unique(errors.t_ns)[:: found.whole.every])


@pytest.mark.parametrize(
    ("counts", "most", "every"), [([3, 3, 3, 3], 12, 1), ([3, 3, 3, 3], 11, 2), ([9, 1, 9, 1], 10, 3)]
)
def test_the_smallest_step_that_leaves_few_enough(counts: list[int], most: int, every: int) -> None:
    assert every_nth(np.array(counts), most) == every


def words(page: Path) -> list[str]:
    """What a page says outside of its figures and times."""
    text = re.sub(r"<(style|svg|script).*?</\1>", "", page.read_text(), flags=re.DOTALL)
    text = re.sub(r'<section class="replay".*?</section>', "", text, flags=re.DOTALL)
    return [html.unescape(part).strip() for part in re.split(r"<[^>]+>", text) if part.strip()]


CAPTIONS = re.compile(r" Drawn: .*|\. Drawn: .*|The paths are long: .*?faint\.|\d+ estimates? .*outside the drawing\.")
"""What pages of long tables say of their drawings alone, and how long a path is as it is drawn."""


def pages(
    args: list[str], folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> tuple[list[str], list[str], Path]:
    """Words of a page of whole tables and of one of long ones, read in pieces, which are to be the same; the latter."""
    statement, summaries = [], []
    for most, rows in ((10**6, 10**6), (100, 37)):
        monkeypatch.setattr(rule, "MAX_ROWS", most)
        monkeypatch.setattr(opening, "iter_table", partial(iter_table, rows=rows))
        monkeypatch.setattr(sources, "AT_ONCE", rows)
        page = folder / f"{most}.html"
        assert run([*args, "--overwrite", "--json", "-o", str(page)]) == ExitCode.DONE
        statement.append(words(page))
        summaries.append(json.loads(capsys.readouterr().out.splitlines()[-1]) | {"page": ""})
    assert summaries[0] == summaries[1]
    whole, part = statement
    assert not any("Drawn:" in text for text in whole)
    plain = [[" ".join(CAPTIONS.sub("", text).strip(" .").split()) for text in page] for page in statement]
    assert plain[0] == plain[1]
    return whole, part, page


def moments(page: Path) -> dict[str, Any]:
    """What the script of a page is given."""
    found = re.search(r'<script type="application/json"[^>]*>(.*?)</script>', page.read_text(), flags=re.DOTALL)
    assert found is not None
    values: dict[str, Any] = json.loads(found[1])
    return values


def written(folder: Path, **given: ColumnTable) -> list[str]:
    """The options of tables that are written."""
    out = []
    for name, table in given.items():
        write_table(folder / f"{name}.parquet", table, Provenance("track"))
        out += [str(folder / "tracks.parquet")] if name == "tracks" else [f"--{name}", str(folder / f"{name}.parquet")]
    return out


def test_a_page_of_long_tables_has_the_numbers_of_the_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    args = written(tmp_path, **dict(zip(("tracks", "truth", "errors"), tables(), strict=True)))
    whole, part, _ = pages(["report", *args], tmp_path, monkeypatch, capsys)
    rows = f"{int(KEEP.sum()):,} rows of"
    assert any(f"one time in 8 of the {rows} tracks, one time in 8 of the {rows} truth." in text for text in part)
    assert any(f"Drawn: one time in 8 of the {rows} errors, and the largest errors between them;" in t for t in part)
    assert any("covariances are too small" in text for text in whole)


def placed(folder: Path, data: ReportInput) -> Bearings:
    """Write the scene, with names that a file may have; the bearings with the same names."""
    assert data.scene is not None
    assert data.bearings is not None
    cameras = tuple(replace(c, name=c.name.replace(" ", "")) for c in data.scene.cameras)
    (folder / "scene.yaml").write_text(scene_to_yaml(replace(data.scene, cameras=cameras, occluders=())))
    return replace(data.bearings, sensor=np.strings.replace(data.bearings.sensor, " ", ""))


def selected(diagnostics: Diagnostics) -> Diagnostics:
    """Cameras are selected now and then; some rows are doubtful."""
    n = np.arange(len(diagnostics))
    return replace(
        diagnostics,
        predicted_mse=np.where(n % 30 < 2, 1.0 + n % 7, np.nan),
        selected=np.where(n % 60 < 30, "camera1,camera3", "camera2,camera4"),
        quality_flags=np.where(n % 50 == 7, "walls,late", ""),
    )


@pytest.mark.parametrize(
    ("labels", "without"),
    [
        ("own", ()),
        ("nobody's", ("errors", "bound", "truth")),
        ("own", ("bearings", "diagnostics", "truth")),
    ],
)
def test_a_page_with_bearings_bound_and_diagnostics_has_the_numbers_of_the_whole(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    without: tuple[str, ...],
    labels: str,
) -> None:
    data = made_up(steps=120, targets=2, cameras=4)
    assert data.diagnostics is not None
    bearings = placed(tmp_path, data)
    if labels == "nobody's":
        bearings = replace(bearings, target_id=np.full(len(bearings), -1, dtype=np.int32))
    names = ("tracks", "bearings", "truth", "errors", "bound", "diagnostics")
    given = {name: getattr(data, name) for name in names if name not in without}
    given |= {"diagnostics": selected(data.diagnostics)} if "diagnostics" in given else {}
    given |= {"bearings": bearings.sorted()} if "bearings" in given else {}
    args = ["report", *written(tmp_path, **given), "--scene", str(tmp_path / "scene.yaml")]
    whole, part, page = pages(args, tmp_path, monkeypatch, capsys)
    text = " ".join(part)
    assert ("rows of diagnostics; figures are of all." in text) == ("diagnostics" in given)
    assert ("Selected cameras" in text) == ("diagnostics" in given)
    assert ("rows of bound, and the largest errors between them; figures are of all." in text) == ("bound" in given)
    if "bearings" in given:
        assert "What each sensor saw" in text
        shown = moments(page)
        assert shown["sight"]
        assert shown["sightEvery"] > 1 or len(bearings) < 100
    if "errors" not in given:
        assert "There is no truth to compare with." in " ".join(whole)
        assert "of these and the largest ones between them; figures are of all." in text


@pytest.mark.parametrize(("names", "what"), [((0, 1), "error"), ((1, 0), "stated spread")])
def test_errors_say_nothing_of_cameras_that_were_selected_for_tracks_with_names_of_their_own(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    names: tuple[int, int],
    what: str,
) -> None:
    data = made_up(steps=240, targets=2, cameras=4)
    assert data.tracks is not None
    assert data.errors is not None
    assert data.diagnostics is not None
    errors = replace(data.errors, x=data.tracks.x.copy(), y=data.tracks.y.copy())
    given: dict[str, ColumnTable] = {"errors": errors}
    for name, table in (("tracks", data.tracks), ("diagnostics", selected(data.diagnostics))):
        own = replace(table, target_id=np.array(names, dtype=np.int32)[table.target_id])
        given[name] = own.take(np.lexsort((own.target_id, own.t_ns)))
    _, part, _ = pages(["report", *written(tmp_path, **given)], tmp_path, monkeypatch, capsys)
    assert f"; {what} in those scans: " in " ".join(part)


NAMES = ("tracks", "bearings", "truth", "errors", "bound", "diagnostics")


def read(folder: Path, given: dict[str, ColumnTable], scene: Scene | None) -> ReportInput:
    """What a report shows of tables that are written."""
    written(folder, **given)
    files = in_files({name: folder / f"{name}.parquet" for name in given}, None, scene)
    tables, figures = gather(files, TrackProvenance(), scene, {})
    return ReportInput(scene=scene, collected=figures, **tables)


@pytest.mark.parametrize(
    ("given", "empty"),
    [*((NAMES, empty) for empty in ("", *NAMES)), (("bearings", "truth"), ""), (("truth", "errors", "bound"), "")],
)
def test_words_and_figures_are_those_of_the_whole_where_tables_are_empty_or_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, given: tuple[str, ...], empty: str
) -> None:
    data = made_up(steps=60, targets=2, cameras=3)
    tables = {name: getattr(data, name) for name in given}
    tables |= {empty: type(tables[empty]).empty()} if empty in given else {}
    monkeypatch.setattr(rule, "MAX_ROWS", 25)
    monkeypatch.setattr(opening, "iter_table", partial(iter_table, rows=31))
    monkeypatch.setattr(sources, "AT_ONCE", 31)
    part = read(tmp_path, tables, data.scene)
    assert any(each.every > 1 for each in part.whole.values()) == any(len(table) > 25 for table in tables.values())
    whole = ReportInput(scene=data.scene, **tables)
    assert build_markdown(part) == build_markdown(whole)
    assert (replay(part) is None) == (replay(whole) is None)
    assert part.time == whole.time
    assert part.targets == whole.targets


def test_without_anything_to_ask_there_is_no_verdict() -> None:
    data = made_up(steps=30)
    assert ReportInput(scene=data.scene).figures.judged is None
    assert ReportInput(tracks=data.tracks).figures.judged is None
    assert ReportInput(tracks=data.tracks, errors=data.errors).figures.judged is not None


def test_the_moments_of_long_tables_have_the_sight_lines_and_the_truth_of_their_own_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = made_up(steps=600, targets=2, cameras=4)
    given = {name: getattr(data, name) for name in ("tracks", "bearings", "truth", "diagnostics")}
    monkeypatch.setattr(rule, "MAX_ROWS", 300)
    part = read(tmp_path, given, data.scene)
    few, all_of = ReplaySteps(part, plan_limits(part)), ReplaySteps(data, plan_limits(data))
    step = part.figures.every
    assert step > 1
    np.testing.assert_array_equal(few.kept, all_of.kept[::step])
    assert few.count == all_of.count == 600
    every = part.figures.sight_every
    assert every > 1
    bearings = part.bearings
    assert bearings is not None
    assert data.bearings is not None
    for t_ns in few.kept[::every].tolist():
        now = data.bearings.take(data.bearings.t_ns == t_ns)
        np.testing.assert_array_equal(bearings.bearing[bearings.t_ns == t_ns], now.bearing)
    for name in ("truth", "diagnostics"):
        table, drawn = getattr(data, name), getattr(part, name)
        for t_ns in few.kept.tolist():
            assert np.count_nonzero(drawn.t_ns == t_ns) == np.count_nonzero(table.t_ns == t_ns)


def test_a_page_of_everybody_has_the_numbers_of_the_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    random, people, happened = np.random.default_rng(8), [], []
    for k in range(70):
        begin = int(random.integers(0, 200))
        one = walk(k, np.arange(begin, begin + 10 + k) / 10, (k % 9, k % 7), (0.2, 0.1))
        people.append(replace(one, seen_by=random.choice(["", "camera1", "camera1,camera2"], len(one))))
        happened += [(int(one.t_ns[0]), "initiated", k, -1, 0.9), (int(one.t_ns[-1]), "terminated", k, -1, 0.1)]
        pair = [(k, (k + 1) % 70), ((k + 1) % 70, k)] if k % 3 == 0 else []
        happened += [(int(one.t_ns[5]), "possible_switch", a, b, 0.4) for a, b in pair]
    tracks = PeopleTracks.merge(people)
    bearings = placed(tmp_path, made_up(steps=200, cameras=2))
    role, z = np.full(len(tracks), "target"), np.zeros(len(tracks))
    truth = Truth.of(t_ns=tracks.t_ns, target_id=tracks.target_id, role=role, x=tracks.x, y=tracks.y + 0.1, z=z)
    _, first = np.unique(tracks.t_ns, return_index=True)
    there = np.where(np.arange(len(first)) % 2, -1, 5).astype(np.int32)
    known = np.where(there < 0, np.nan, 1.0)
    places = {name: known * getattr(tracks, name)[first] for name in ("x", "y", "cov_xx", "cov_xy", "cov_yy")}
    occluders = Occluders.of(t_ns=tracks.t_ns[first], occluder_id=there, **places)
    events = Events.of_rows(happened)
    args = written(tmp_path, tracks=tracks, truth=truth, events=events, bearings=bearings, occluders=occluders)
    args += ["--scene", str(tmp_path / "scene.yaml")]
    whole, part, page = pages(["report", *args], tmp_path, monkeypatch, capsys)
    text = " ".join(part)
    assert f"of {len(np.unique(tracks.target_id))}" in text
    assert "70 track initiations, 70 track terminations, 24 possible identity switches" in text
    assert (
        f"rows of tracks, one time in {-(-len(tracks) // 100)} of the {len(truth):,} rows of truth, one time in 2"
        in text
    )
    assert "In 3" in " ".join(whole)
    assert moments(page)["hulls"]


def test_a_page_of_directions_of_a_recording_has_the_numbers_of_the_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    recording, tracks = str(tmp_path / "heard.mcap"), str(tmp_path / "tracks.parquet")
    arrays = str(Path(__file__).resolve().parents[2] / "examples" / "arrays.yaml")
    assert run(["simulate", arrays, "-o", recording, "--steps", "150", "--seed", "2", "--quiet"]) == ExitCode.DONE
    assert run(["track", recording, "-o", tracks, "--quiet", "--particles", "200"]) == ExitCode.DONE
    args = ["report", tracks, "--scene", recording, "--bearings", recording, "--truth", recording]
    whole, part, _ = pages(args, tmp_path, monkeypatch, capsys)
    assert not any("target seen" in text for text in whole)  # all rows are detections
    assert any("of these and the largest ones between them" in text for text in part)
