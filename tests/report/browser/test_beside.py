"""Two runs in a browser: both plans in step, keyboard, widths, colours, print, hostile names."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser_pages import EVIL, Open, clock, pixels, settled
from two_runs import exchanged_at, moved, tracks, truth, write_run

from docs.browser import CHROMIUM
from occlog.cli.main import run
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.records.tables import PeopleTracks

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium; install it, or name it in OCCLOG_CHROMIUM"),
    pytest.mark.drawn,
]


def other_run() -> PeopleTracks:
    """A person is aside from 1.0 to 1.9 s, and two are exchanged at 4 s."""

    def change(*columns: np.ndarray) -> None:
        moved(2, 10, 19, 0.7)(*columns)
        exchanged_at(40)(*columns)

    return tracks(60, change)


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("beside")
    a, b = write_run(folder / "old", tracks()), write_run(folder / "new", other_run())
    write_table(folder / "truth.parquet", truth(), Provenance("simulate"))
    args = (str(a), str(b), "--truth", str(folder / "truth.parquet"), "-o", str(folder / "beside.html"), "-q")
    assert run(["report", *args]) == 0
    return folder / "beside.html"


def rows(page: Any) -> list[list[str]]:
    """Cells of the table of the time."""
    found = page.locator("#replay-rows tr").all()
    return [[cell.strip() for cell in row.locator("th, td").all_inner_texts()] for row in found]


def test_scrubbing_moves_both_plans_and_the_table(opened: Open) -> None:
    page = opened()
    assert clock(page) == 0.0
    before = pixels(page, "replay-plan-a"), pixels(page, "replay-plan-b")
    assert [row[:3] for row in rows(page)] == [[k, k, "0.00"] for k in ("10", "11", "12")]
    page.locator("#replay-time").fill("15")
    settled(page)
    assert clock(page) == 1.5
    assert pixels(page, "replay-plan-a") != before[0]
    assert pixels(page, "replay-plan-b") != before[1]
    assert pixels(page, "replay-plan-a") != pixels(page, "replay-plan-b")  # somebody is aside in B
    assert [row[:2] for row in rows(page)] == [[k, k] for k in ("10", "11", "12")]
    apart = [float(row[2]) for row in rows(page)]
    np.testing.assert_allclose(apart, [0, 0, 0.7], atol=0.01)
    place = [float(v) for v in rows(page)[2][4].split(",")]
    np.testing.assert_allclose(place, [1.5, 8.7], atol=0.01)
    page.locator("#replay-time").fill("50")
    settled(page)
    assert [row[:2] for row in rows(page)] == [["10", "11"], ["11", "10"], ["12", "12"]]


def test_the_first_parting_is_one_click_away(opened: Open) -> None:
    page = opened()
    link = page.locator(".verdict a[data-time]")
    assert link.inner_text() == "1.00 s"
    link.click()
    settled(page)
    assert clock(page) == 1.0
    assert page.evaluate("() => document.activeElement.id") == "replay-plan-a"
    assert abs(page.evaluate("() => document.getElementById('replay').getBoundingClientRect().top")) < 200
    page.locator("td.pieces a", has_text="11 (4.00").first.click()
    settled(page)
    assert clock(page) == 4.0


def test_every_link_leads_to_its_moment(opened: Open) -> None:
    page = opened()
    links = page.locator("[data-time]")
    assert links.count() > 8
    for k in range(links.count()):
        wanted = float(links.nth(k).get_attribute("data-time"))
        links.nth(k).click()
        settled(page)
        assert clock(page) == pytest.approx(wanted, abs=0.01)


def test_playing_moves_both_and_stops_at_the_end(opened: Open) -> None:
    page = opened()
    page.select_option("#replay-speed", "10")
    page.click("#replay-play")
    page.wait_for_function("() => document.getElementById('replay-play').textContent === 'Play'")
    settled(page)
    assert clock(page) == 5.9
    assert page.get_attribute("#replay-play", "aria-pressed") == "false"


def test_everything_can_be_done_by_keyboard(opened: Open) -> None:
    page = opened()
    for plan in ("replay-time", "replay-plan-a", "replay-plan-b", "replay-strip"):
        page.focus(f"#{plan}")
        for key, time in (("End", 5.9), ("ArrowLeft", 5.8), ("Home", 0.0), ("ArrowRight", 0.1)):
            page.keyboard.press(key)
            settled(page)
            assert clock(page) == time
    page.focus("#replay-plan-b")
    page.keyboard.press("Space")
    assert page.get_attribute("#replay-play", "aria-pressed") == "true"
    page.keyboard.press("Space")
    assert page.get_attribute("#replay-play", "aria-pressed") == "false"
    reached = set()
    page.focus("#replay-play")
    for _ in range(40):
        page.keyboard.press("Tab")
        reached.add(page.evaluate("() => document.activeElement.id"))
    assert {"replay-speed", "replay-trail", "layer-names", "replay-strip", "replay-time"} <= reached
    assert {"replay-plan-a", "replay-plan-b"} <= reached


def test_what_is_shown_has_names_for_screen_readers(opened: Open) -> None:
    page = opened(at="#t=1.5")
    nameless = page.evaluate(
        "() => [...document.querySelectorAll('button, select, input, canvas, [tabindex], a')].filter(e =>"
        " !(e.getAttribute('aria-label') || e.getAttribute('aria-labelledby') || e.textContent.trim() ||"
        " (e.labels && e.labels.length))).map(e => e.outerHTML)"
    )
    assert nameless == []
    assert page.locator("table:not(:has(caption))").count() == 0
    assert page.text_content("#replay-said") == "At 1.50 s: 3 in A, 3 in B, at most 0.700 m apart."


def test_hovering_says_both_runs_and_people_can_be_switched_off(opened: Open) -> None:
    page = opened(at="#t=1.5", viewport={"width": 1280, "height": 1600})
    page.locator("#replay-plan-b").scroll_into_view_if_needed()
    box = page.locator("#replay-plan-b").bounding_box()
    low, high = page.evaluate("() => JSON.parse(document.getElementById('replay-data').textContent).b.limits")
    x = box["x"] + (1.5 - low[0]) / (high[0] - low[0]) * box["width"]
    y = box["y"] + (high[1] - 8.7) / (high[1] - low[1]) * box["height"]
    page.mouse.move(x, y)
    tip = page.locator("#replay-tip-b")
    tip.wait_for(state="visible")
    reported = tip.bounding_box()
    assert 0 < reported["y"] - y < 60
    assert "A: 12" in tip.inner_text()
    assert "apart [m]: 0.700" in tip.inner_text()
    page.mouse.move(box["x"] + 2, box["y"] + 2)
    tip.wait_for(state="hidden")
    seen = {(pixels(page, "replay-plan-a"), pixels(page, "replay-plan-b"))}
    for box in ("[data-person='0']", "#layer-names", "#layer-truth"):
        page.click(box)
        settled(page)
        seen.add((pixels(page, "replay-plan-a"), pixels(page, "replay-plan-b")))
    assert len({a for a, _ in seen}) == len({b for _, b in seen}) == 4


@pytest.mark.parametrize("width", [390, 1600])
def test_the_page_fits_phones_and_wide_screens(opened: Open, width: int) -> None:
    page = opened(viewport={"width": width, "height": 844})
    assert page.evaluate("() => document.documentElement.scrollWidth") <= width
    boxes = [page.locator(f"#replay-plan-{plan}").bounding_box() for plan in "ab"]
    if width < 640:
        assert boxes[1]["y"] > boxes[0]["y"] + boxes[0]["height"]
        assert boxes[0]["width"] > 0.5 * width
    else:
        assert boxes[0]["y"] == boxes[1]["y"]
        assert boxes[1]["x"] >= boxes[0]["x"] + boxes[0]["width"]
    text = page.evaluate(
        "() => Math.min(...[...document.querySelectorAll('p, td, th, dd, dt, label, li, figcaption')]"
        ".filter(e => e.offsetWidth).map(e => parseFloat(getComputedStyle(e).fontSize)))"
    )
    assert text >= 11.5


def test_colours_follow_the_system_and_the_choice(opened: Open) -> None:
    def paper(page: Any) -> int:
        text = page.evaluate("() => getComputedStyle(document.body).backgroundColor")
        return sum(int(part) for part in text[4:-1].split(","))

    dark, light = opened(color_scheme="dark"), opened(color_scheme="light")
    assert paper(dark) < 120 < 700 < paper(light)
    assert pixels(dark, "replay-plan-b") != pixels(light, "replay-plan-b")
    dark.click("input[value=light]")
    settled(dark)
    assert paper(dark) > 700
    assert pixels(dark, "replay-plan-b") == pixels(light, "replay-plan-b")


def test_on_paper_there_are_words_tables_and_figures(opened: Open) -> None:
    page = opened(color_scheme="dark")
    page.emulate_media(media="print")
    assert not page.locator("#replay").is_visible()
    assert page.locator("#verdict").is_visible()
    assert page.locator("svg.plot").first.is_visible()
    assert page.locator("#identities").is_visible()
    assert len(page.pdf()) > 10_000
    without = opened(java_script_enabled=False)
    assert not without.locator("#replay").is_visible()
    assert without.locator("svg.plot").count() == 2


def test_names_from_the_data_execute_nothing(opened: Open, tmp_path: Path) -> None:
    many = np.full(180, EVIL)
    table = tracks(60, seen_by=many, quality_flags=many, existence_probability=np.full(180, 0.9))
    folders = [write_run(tmp_path / name, run) for name, run in ((EVIL.replace("/", "|"), table), ("b", tracks()))]
    out = tmp_path / "evil.html"
    assert run(["report", *map(str, folders), "-o", str(out), "--title", EVIL, "-q"]) == 0
    page = opened(out)
    page.locator("#replay-time").fill("10")
    settled(page)
    assert page.evaluate("() => window.evil") is None
    assert page.locator("img").count() == 0
    assert EVIL in page.locator("#replay-rows").inner_text()
    assert math.isfinite(clock(page))
