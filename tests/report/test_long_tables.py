"""Long tables on a page: a part is drawn, by a rule, and every number is of all rows."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.parquet import write_table
from occlog.io.files.provenance import Provenance
from occlog.records.tables import Errors, Tracks, Truth
from occlog.report import long_tables
from occlog.report.content.thinned import ErrorsSoFar, Whole, thinned
from occlog.report.drawing.thin import running_rms

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
    found = thinned(chunks(errors, rows), Errors, len(errors), most=100)
    assert found.whole == Whole(len(errors), STEPS, -(-len(errors) // 100))
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
    found = thinned(chunks(errors, 50), Errors, len(errors), most=10_000)
    np.testing.assert_array_equal(found.rows, np.arange(len(errors)))


def test_figures_up_to_each_row_are_those_of_all_rows() -> None:
    *_, errors = tables()
    found = ErrorsSoFar()
    so_far = np.concatenate([found.add(part) for part in chunks(errors, 13)])
    for target in (3, 8):
        own = errors.target_id == target
        np.testing.assert_allclose(so_far[own], running_rms(errors.error[own]), rtol=1e-12)
        assert found.rmse(target) == pytest.approx(float(so_far[own][-1]), rel=1e-12)
        assert found.worst(target) == errors.error[own].max()
    assert found.rmse() == pytest.approx(float(np.sqrt(np.mean(errors.error**2))), rel=1e-12)
    assert found.rmse_in_space() == pytest.approx(float(np.sqrt(np.mean(errors.error_space**2))), rel=1e-12)


def words(page: Path) -> list[str]:
    """What a page says outside of its figures and moments."""
    text = re.sub(r"<(style|svg|script).*?</\1>", "", page.read_text(), flags=re.DOTALL)
    text = re.sub(r'<section class="replay".*?</section>', "", text, flags=re.DOTALL)
    return [html.unescape(part).strip() for part in re.split(r"<[^>]+>", text) if part.strip()]


def test_a_page_of_long_tables_has_the_numbers_of_the_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    names = ("tracks", "truth", "errors")
    for name, table in zip(names, tables(), strict=True):
        write_table(tmp_path / f"{name}.parquet", table, Provenance("track"))
    args = ["report", str(tmp_path / "tracks.parquet"), "--overwrite", "--json"]
    for name in names[1:]:
        args += [f"--{name}", str(tmp_path / f"{name}.parquet")]
    pages, summaries = [], []
    for most in (10**6, 100):
        monkeypatch.setattr(long_tables, "MOST_ROWS", most)
        page = tmp_path / f"{most}.html"
        assert run([*args, "-o", str(page)]) == ExitCode.DONE
        pages.append(words(page))
        summaries.append(json.loads(capsys.readouterr().out) | {"page": ""})
    whole, part = pages
    rows = f"{int(KEEP.sum()):,} rows of"
    assert summaries[0] == summaries[1]
    assert summaries[1]["tracks"] == int(KEEP.sum())
    assert not any("Drawn:" in text for text in whole)
    assert any(f"one time in 8 of the {rows} tracks, one time in 8 of the {rows} truth." in text for text in part)
    assert any(f"Drawn: one time in 8 of the {rows} errors, and the largest errors between them;" in t for t in part)
    assert any("covariances are too small" in text for text in whole)
    # But for the captions, and how long a path is as it is drawn, the pages say the same
    captions = re.compile(
        r" Drawn: .*|\. Drawn: .*|The paths are long: .*?faint\.|\d+ estimates? .*outside the drawing\."
    )
    plain = [[" ".join(captions.sub("", text).strip(" .").split()) for text in page] for page in pages]
    assert plain[0] == plain[1]
