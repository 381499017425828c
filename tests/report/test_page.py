from __future__ import annotations

import base64
import hashlib
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from xml.etree import ElementTree

import cv2
import matplotlib
import numpy as np
import pytest
from made_up import merged, ring_scene, run

from occlog.errors import InputError
from occlog.records.losses import Loss
from occlog.records.scene import Camera, Scene
from occlog.records.tables import Bearings, Bound, Diagnostics, Errors, Tracks, Truth
from occlog.report.content.model import ReportInput, TimeAxis
from occlog.report.page import build_page, headline, row_counts
from occlog.report.picture import build_picture
from occlog.report.plots.floorplan import plan_limits

EVIL = '<script>alert("x")</script>\' onload=$x_1$ style="color: red" ]]>\x07'


class Tags(HTMLParser):
    """Collects tags with their attributes and the text between them."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def parsed(html: str) -> Tags:
    tags = Tags()
    tags.feed(html)
    return tags


def rows_of(html: str, heading: str) -> dict[str, list[str]]:
    """Cells of the table after a heading by the row's first cell."""
    section = html[html.index(f">{heading}</h2>") :]
    body = section[section.index("<tbody>") : section.index("</tbody>")]
    out = {}
    for row in re.findall(r"<tr>(.*?)</tr>", body, re.DOTALL):
        cells = [re.sub("<.*?>", "", c).strip() for c in re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row, re.DOTALL)]
        out[cells[0]] = cells[1:]
    return out


@pytest.fixture(scope="module")
def page() -> str:
    return build_page(run(steps=150, targets=2, cameras=4))


@pytest.mark.drawn
def test_same_input_same_bytes_whatever_the_users_settings() -> None:
    data = run(steps=10, cameras=2)
    page, picture = build_page(data), build_picture(data)
    with matplotlib.rc_context({"font.size": 30, "axes.grid": False, "svg.fonttype": "path", "lines.linewidth": 9}):
        assert build_page(run(steps=10, cameras=2)) == page
        assert build_picture(run(steps=10, cameras=2)) == picture
        assert matplotlib.rcParams["font.size"] == 30


@pytest.mark.drawn
def test_page_needs_nothing_from_outside_and_runs_its_own_script_alone(page: str) -> None:
    tags = parsed(page)
    assert not {"link", "iframe", "object", "embed", "base"} & {t for t, _ in tags.tags}
    scripts = re.findall(r"<script([^>]*)>(.*?)</script>", page, re.DOTALL)
    assert [given for given, _ in scripts] == [' type="application/json" id="replay-data"', ""]
    json.loads(scripts[0][1])
    assert not set("<>&") & set(scripts[0][1])
    digest = base64.b64encode(hashlib.sha256(scripts[1][1].encode()).digest()).decode()
    for tag, attributes in tags.tags:
        for name, value in attributes.items():
            assert not name.startswith("on"), (tag, name)
            assert name != "style", tag
            if name in ("href", "src", "xlink:href"):
                assert (value or "").startswith("#"), (tag, value)
    outside = re.sub(r'xmlns(:\w+)?="[^"]*"', "", page)
    assert "http://" not in outside
    assert "https://" not in outside
    policy = next(a["content"] for _, a in tags.tags if a.get("http-equiv") == "Content-Security-Policy")
    assert "default-src 'none'" in (policy or "")
    assert f"script-src 'sha256-{digest}';" in (policy or "")


@pytest.mark.drawn
def test_ids_are_unique_and_references_lead_somewhere(page: str) -> None:
    ids = re.findall(r'\sid="([^"]*)"', page)
    assert len(ids) == len(set(ids))
    referred = {name for name in re.findall(r'(?:url\(#|href="#)([^")]+)', page) if not name.startswith("t=")}
    for names in re.findall(r'aria-labelledby="([^"]*)"', page):
        referred |= set(names.split())
    assert referred <= set(ids)
    assert len(referred) > 10


@pytest.mark.drawn
def test_figures_are_well_formed_and_described(page: str) -> None:
    figures = re.findall(r"<svg.*?</svg>", page, re.DOTALL)
    assert len(figures) == 1 + 2 + 2 + 1  # plan; errors and sightings of two targets; filter
    for text in figures:
        root = ElementTree.fromstring(text)
        assert root.get("role") == "img"
        assert len(root.findtext("{http://www.w3.org/2000/svg}desc") or "") > 20
        assert "nan" not in text.lower().replace("nance", "")


@pytest.mark.drawn
def test_colours_can_be_changed_by_the_page(page: str) -> None:
    drawn = "".join(re.findall(r"<svg.*?</svg>", page, re.DOTALL))
    loose = set(re.findall(r'(?<!,)"?(#[0-9a-f]{6})\b', re.sub(r"var\([^)]*\)", "", drawn)))
    assert loose <= {"#000000", "#ffffff"}
    assert "var(--t0,#" in drawn
    assert "prefers-color-scheme: dark" in page


@pytest.mark.drawn
def test_tables_have_captions_and_scoped_headers(page: str) -> None:
    tags = [t for t, _ in parsed(page).tags]
    assert tags.count("table") == tags.count("caption") >= 3
    assert all(a.get("scope") in ("col", "row") for t, a in parsed(page).tags if t == "th")


def test_headline_is_the_rmse_of_the_errors() -> None:
    data = run(steps=200)
    want = np.sqrt(np.mean(data.errors.error**2))
    tile = next(item for item in headline(data) if item.name == "RMSE")
    assert tile.unit == "m"
    assert float(tile.value) == pytest.approx(want, rel=1e-3)


def test_sensor_table_in_degrees() -> None:
    data = run(steps=200, cameras=2)
    row = rows_of(build_page(data), "Sensors")["camera 1"]
    kind, _, heading, fov, observations, seen, share, off, ratio = row
    own = data.bearings.sensor == "camera 1"
    assert kind == "camera"
    assert float(heading.replace("\N{MINUS SIGN}", "-")) == pytest.approx(np.degrees(0.3 - np.pi), abs=0.06)
    assert fov == "80"
    assert int(observations) == own.sum()
    assert int(seen) == data.bearings.seen[own].sum()
    assert float(share) == pytest.approx(100 * data.bearings.seen[own].mean(), abs=0.06)
    assert 0.1 < float(off) < 10
    assert float(ratio) == pytest.approx(np.radians(float(off)) / 0.01, rel=0.02)


@pytest.mark.drawn
def test_every_label_is_escaped() -> None:
    data = run(steps=40, cameras=2)
    text = np.where(data.bearings.sensor == "camera 1", EVIL, data.bearings.sensor)
    columns = {c.name: getattr(data.bearings, c.name) for c in Bearings.columns()} | {"sensor": text}
    page = build_page(
        run(
            steps=40,
            cameras=2,
            bearings=Bearings.of(**columns),
            title=EVIL,
            metrics={EVIL: 1.0, "note": EVIL},
            provenance={EVIL: EVIL},
            losses=(Loss(EVIL, EVIL, EVIL, 3),),
        )
    )
    found = parsed(page)
    assert [a for t, a in found.tags if t == "script"] == [{"type": "application/json", "id": "replay-data"}, {}]
    assert all(not name.startswith("on") for _, a in found.tags for name in a)
    assert any('<script>alert("x")</script>' in text for text in found.text)
    for text in re.findall(r"<svg.*?</svg>", page, re.DOTALL):
        ElementTree.fromstring(text)


@pytest.mark.drawn
@pytest.mark.statistics
def test_long_tracks_make_small_pages() -> None:
    data = run(steps=40_000, cameras=4)
    page = build_page(data)
    assert len(page.encode()) < 1_500_000
    assert len(build_picture(data)) < 2_500_000
    assert "the last" in page


@pytest.mark.drawn
def test_an_outlier_is_named_and_does_not_set_the_scale() -> None:
    data = run(steps=300)
    x = data.tracks.x.copy()
    x[100] = 1e5
    error = data.errors.error.copy()
    error[100] = 1e5
    tracks = Tracks.of(**{c.name: getattr(data.tracks, c.name) for c in Tracks.columns()} | {"x": x})
    errors = Errors.of(**{c.name: getattr(data.errors, c.name) for c in Errors.columns()} | {"error": error})
    page = build_page(run(steps=300, cameras=2, tracks=tracks, errors=errors, bearings=None, diagnostics=None))
    assert "1 estimate outside the drawing" in page
    assert "1 step above, up to 1e+05 m at 10 s" in page


@pytest.mark.parametrize("missing", ["scene", "tracks bearings", "truth errors", "bound diagnostics"])
def test_any_part_may_be_missing(missing: str) -> None:
    data = run(steps=20, cameras=2, **dict.fromkeys(missing.split()))
    assert build_page(data).endswith("</html>\n")


@pytest.mark.drawn
def test_picture_has_its_size_and_says_how_it_was_made() -> None:
    picture = build_picture(run(steps=20, cameras=2, errors=None))
    assert b"ab" * 32 in picture
    image = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR)
    assert image.shape == (1056, 1650, 3)


def test_without_truth_the_sight_lines_are_shown() -> None:
    page = build_page(run(steps=100, cameras=4, truth=None, errors=None, bound=None, metrics={}))
    assert "Track and lines of sight" in page
    assert "Error and bound" not in page
    assert "off lines of sight" in page


@pytest.mark.drawn
def test_scene_alone_and_tracks_alone() -> None:
    assert "Floor plan" in build_page(ReportInput(scene=ring_scene(3)))
    assert "Floor plan" in build_page(ReportInput(tracks=run(steps=5).tracks))
    with pytest.raises(InputError, match="neither a scene nor tracks"):
        ReportInput(truth=run(steps=5).truth)


@pytest.mark.drawn
def test_empty_tables() -> None:
    page = build_page(
        ReportInput(
            scene=ring_scene(2),
            tracks=Tracks.empty(),
            bearings=Bearings.empty(),
            truth=Truth.empty(),
            errors=Errors.empty(),
            diagnostics=Diagnostics.empty(),
        )
    )
    assert rows_of(page, "Tables read")["tracks"] == ["0", "empty"]


@pytest.mark.drawn
def test_a_single_step() -> None:
    assert "Floor plan" in build_page(run(steps=1, cameras=2))


@pytest.mark.drawn
def test_a_target_that_stands_still_with_a_singular_covariance() -> None:
    n = 10
    zero = np.zeros(n)
    still = merged(
        Tracks,
        [
            {
                "t_ns": np.arange(n),
                "target_id": np.zeros(n, int),
                "x": zero + 3,
                "y": zero,
                "vx": zero,
                "vy": zero,
                "cov_xx": zero,
                "cov_xy": zero,
                "cov_yy": zero,
            }
        ],
    )
    assert "Floor plan" in build_page(ReportInput(tracks=still))


def test_losses_are_listed() -> None:
    page = build_page(ReportInput(scene=ring_scene(1), losses=(Loss("cam1.mp4", "frame 80", "ends early", 20),)))
    assert rows_of(page, "Input that was lost")["cam1.mp4"] == ["frame 80", "ends early", "20"]
    assert re.search(r"<dt>input lost</dt><dd class=\"value\">20<", page)


def test_many_targets_get_no_figures_of_their_own() -> None:
    page = build_page(run(steps=30, cameras=1, targets=8, bearings=None, diagnostics=None))
    assert page.count("Error and bound over time") == 2 * 6  # heading and title of the figure
    assert "2 more targets" in page


@pytest.mark.parametrize(
    ("start", "length_s", "unit", "begin"),
    [
        (0, 100, "s", "0.000 s"),
        (1_700_000_000_123_456_789, 1200, "min", "2023-11-14 22:13:20.123 UTC"),
        (5, 86_400, "h", "0.000 s"),
        (2**63 - 10**15, 100, "s", "2262-03-31 "),
    ],
)
def test_time_axis(start: int, length_s: int, unit: str, begin: str) -> None:
    axis = TimeAxis(start, start + length_s * 10**9)
    assert axis.unit == unit
    assert axis.start.startswith(begin)
    per_unit = {"s": 1, "min": 60, "h": 3600}[unit]
    assert axis.of(np.array([axis.end_ns]))[0] == pytest.approx(length_s / per_unit)
    assert axis.duration == f"{length_s / per_unit:.4g} {unit}"


def test_long_times_are_reported_in_a_unit_that_suits_them() -> None:
    """Of hours they were written as `3e+04 s`."""
    data = run(steps=200)
    assert data.tracks is not None
    t_ns = data.tracks.t_ns[0] + np.arange(len(data.tracks), dtype=np.int64) * 10**9 * 150
    counts = row_counts(replace(data, tracks=replace(data.tracks, t_ns=t_ns)))
    (note,) = [figure.note for figure in counts if figure.name == "tracks"]
    assert note == "8.292 h, 200 times"


def test_heights_have_figures_and_a_row_of_their_own() -> None:
    data = run(steps=200)
    n, columns = len(data.errors), {c.name: getattr(data.errors, c.name) for c in Errors.columns()}
    up = np.where(np.arange(n) < n // 2, np.nan, 0.5)
    errors = Errors.of(**columns | {"error_z": up, "error_space": np.hypot(data.errors.error, up)})
    bounds = {c.name: getattr(data.bound, c.name) for c in Bound.columns()}
    bounds |= {"bound_zz": np.full(len(data.bound), 0.04), "bound_space": np.hypot(data.bound.bound, 0.2)}
    high = run(steps=200, errors=errors, bound=Bound.of(**bounds))
    page, flat = build_page(high), build_page(data)
    assert "The lowest row is the height" in page
    assert "The lowest row is the height" not in flat
    tiles = {item.name: item for item in headline(high)}
    half, least = np.hypot(data.errors.error[n // 2 :], 0.5), high.bound.bound_space[n // 2 :]
    rmse = np.sqrt(np.mean(half**2))
    assert float(tiles["RMSE in space"].value) == pytest.approx(rmse, rel=1e-3)
    ratio = float(tiles["RMSE in space"].note.removesuffix(" × bound"))
    assert ratio == pytest.approx(rmse / np.sqrt(np.mean(least**2)), rel=2e-3)
    assert "RMSE in space" not in {item.name for item in headline(data)}


@pytest.mark.drawn
def test_cameras_far_away_do_not_make_the_room_a_dot() -> None:
    camera = {"rotation": np.eye(3), "focal_px": np.full(2, 1e6), "principal_px": np.zeros(2), "fov": 1e-3}
    near = Camera("near", np.array([-5.0, 0.0, 1.0]), **camera)
    scene = Scene(
        cameras=(near, Camera("remote", np.array([-1e6, 0.0, 1.0]), **camera)),
        room=np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 8.0], [0.0, 8.0]]),
    )
    data = ReportInput(scene=scene)
    low, high = plan_limits(data)
    assert (high - low < 30).all()
    assert (low < [-5, 0]).all()
    assert "far away: remote" in build_page(data)


def test_doubtful_rows_are_counted_with_their_reasons() -> None:
    data = run()
    assert data.diagnostics is not None
    assert "Doubtful" not in build_page(data)
    doubt = np.full(len(data.diagnostics), "", dtype="U32")
    doubt[:2] = ["region_edge", "region_edge,out_of_view"]
    columns = {c.name: getattr(data.diagnostics, c.name) for c in data.diagnostics.columns()}
    doubtful = replace(data, diagnostics=type(data.diagnostics)(**(columns | {"quality_flags": doubt})))
    assert f"Doubtful: 2 of {len(doubt)} steps (out_of_view, region_edge)." in build_page(doubtful)
