"""The page in a browser: scrub, play, hover, keyboard, widths, colours, print, and nothing that reaches out or runs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser_pages import EVIL, Open, clock, pixels, settled
from made_up import run

from docs.browser import CHROMIUM
from occlog.records.losses import Loss
from occlog.records.tables import Bearings
from occlog.report.page import build_page

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium; install it, or name it in OCCLOG_CHROMIUM"),
    pytest.mark.drawn,
]
ADD_SCRIPT = """() => {
  const script = document.createElement("script");
  script.textContent = "window.evil = 4";
  document.body.append(script);
}"""
CURSOR = """figure => {
  const svg = figure.querySelector("svg");
  const left = element => element.getBoundingClientRect().left;
  return (left(figure.querySelector(".cursor")) - left(svg)) / svg.clientWidth;
}"""


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("page") / "report.html"
    path.write_text(build_page(run(steps=120, targets=3, cameras=4)), encoding="utf-8")
    return path


def test_scrubbing_moves_plan_table_clock_and_cursors(opened: Open) -> None:
    page = opened()
    assert clock(page) == 0.0
    before = pixels(page)
    page.locator("#replay-time").fill("60")
    settled(page)
    assert clock(page) == 6.0
    assert pixels(page) != before
    assert page.get_attribute("#replay-time", "aria-valuetext") == "6.00 s"
    rows = page.locator("#replay-rows tr")
    assert [rows.nth(k).locator("th").inner_text().strip() for k in range(3)] == ["0", "1", "2"]
    data = run(steps=120, targets=3, cameras=4)
    assert data.tracks is not None
    assert data.errors is not None
    at = np.flatnonzero((data.tracks.t_ns == 6 * 10**9) & (data.tracks.target_id == 1))[0]
    cells = rows.nth(1).locator("td").all_inner_texts()
    place = [float(v) for v in cells[0].split(",")]
    np.testing.assert_allclose(place, [data.tracks.x[at], data.tracks.y[at]], atol=0.01)
    wanted = data.errors.error[(data.errors.t_ns == 6 * 10**9) & (data.errors.target_id == 1)][0]
    assert float(cells[2]) == pytest.approx(wanted, abs=0.01)
    figure = page.locator("figure[data-x0]").first
    share = page.evaluate(CURSOR, figure.element_handle())
    x0, x1, t0, t1 = (float(figure.get_attribute(f"data-{name}")) for name in ("x0", "x1", "t0", "t1"))
    assert share == pytest.approx(x0 + (6.0 - t0) / (t1 - t0) * (x1 - x0), abs=0.003)


def test_playing_goes_on_at_the_speed_that_is_chosen_and_stops(opened: Open) -> None:
    page = opened()
    page.click("#replay-play")
    assert page.get_attribute("#replay-play", "aria-pressed") == "true"
    page.wait_for_function("() => parseFloat(document.getElementById('replay-clock').textContent) > 0.3")
    page.click("#replay-play")
    settled(page)  # a time that was asked for before the click
    stopped = clock(page)
    assert 0.3 < stopped < 11.9  # at its own speed it would take 12 s
    settled(page)
    assert clock(page) == stopped
    page.select_option("#replay-speed", "100")
    page.click("#replay-play")
    page.wait_for_function("() => document.getElementById('replay-play').textContent === 'Play'")
    settled(page)
    assert clock(page) == 11.9


def test_everything_can_be_done_by_keyboard(opened: Open) -> None:
    page = opened()
    page.focus("#replay-time")
    for key, time in (("ArrowRight", 0.1), ("End", 11.9), ("ArrowLeft", 11.8), ("Home", 0.0)):
        page.keyboard.press(key)
        settled(page)
        assert clock(page) == time
    page.focus("#replay-plan")
    for key, time in (("ArrowRight", 0.1), ("PageDown", 1.1), ("PageUp", 0.1), ("End", 11.9), ("Home", 0.0)):
        page.keyboard.press(key)
        settled(page)
        assert clock(page) == time
    page.keyboard.press("Space")
    assert page.get_attribute("#replay-play", "aria-pressed") == "true"
    page.keyboard.press("Space")
    assert page.get_attribute("#replay-play", "aria-pressed") == "false"
    page.keyboard.press("Shift+Tab")
    outline = page.evaluate("() => getComputedStyle(document.activeElement).outlineStyle")
    assert outline != "none"


def test_hovering_says_the_values_of_a_target(opened: Open) -> None:
    page = opened(at="#t=3", viewport={"width": 1280, "height": 1600})
    assert clock(page) == 3.0
    data = run(steps=120, targets=3, cameras=4)
    assert data.tracks is not None
    row = data.tracks.take((data.tracks.t_ns == 3 * 10**9) & (data.tracks.target_id == 2))
    box = page.locator("#replay-plan").bounding_box()
    # The plan is the room with 6 % around it
    low, size = -6.0, 112.0
    x = box["x"] + (row.x[0] - low) / size * box["width"]
    y = box["y"] + (size + low - row.y[0]) / size * box["height"]
    page.mouse.move(x, y)
    tip = page.locator("#replay-tip")
    tip.wait_for(state="visible")
    assert "target: 2" in tip.inner_text()
    reported = tip.inner_text().split("x, y [m]: ")[1].split("\n")[0]
    np.testing.assert_allclose([float(v) for v in reported.split(",")], [row.x[0], row.y[0]], atol=0.01)
    page.mouse.move(box["x"] + 2, box["y"] + 2)
    tip.wait_for(state="hidden")


def test_layers_and_targets_can_be_switched_off(opened: Open) -> None:
    page = opened(at="#t=4")
    seen = {pixels(page)}
    for box in ("#layer-sight", "#layer-shadows", "#layer-ellipses", "#layer-names", "#layer-truth", "#layer-views"):
        page.click(box)
        settled(page)
        seen.add(pixels(page))
    page.click("[data-target='1']")
    settled(page)
    seen.add(pixels(page))
    assert len(seen) == 8


def test_peaks_figures_and_the_time_line_lead_to_their_moments(opened: Open) -> None:
    page = opened()
    link = page.locator("ol.peaks a").first
    link.click()
    settled(page)
    assert clock(page) == float(link.get_attribute("data-time"))
    strip = page.locator("#replay-strip").bounding_box()
    page.mouse.click(strip["x"] + 8 + 0.5 * (strip["width"] - 16), strip["y"] + 20)
    settled(page)
    assert clock(page) == pytest.approx(5.95, abs=0.1)
    figure = page.locator("figure[data-x0]").first
    figure.scroll_into_view_if_needed()
    box = figure.locator("svg").bounding_box()
    x0, x1, t0, t1 = (float(figure.get_attribute(f"data-{name}")) for name in ("x0", "x1", "t0", "t1"))
    page.mouse.click(box["x"] + box["width"] * (x0 + 0.25 * (x1 - x0)), box["y"] + 30)
    settled(page)
    assert clock(page) == pytest.approx(t0 + 0.25 * (t1 - t0), abs=0.11)


@pytest.mark.parametrize("width", [390, 1600])
def test_the_page_fits_phones_and_wide_screens(opened: Open, width: int) -> None:
    page = opened(viewport={"width": width, "height": 844})
    assert page.evaluate("() => document.documentElement.scrollWidth") <= width
    sizes = page.evaluate(
        "() => [...document.querySelectorAll('svg.plot')].flatMap(svg => { const k = svg.clientWidth /"
        " svg.viewBox.baseVal.width; return [...svg.querySelectorAll('text')].map(t => k *"
        " parseFloat(getComputedStyle(t).fontSize)); })"
    )
    assert min(sizes) > 10.2
    assert page.evaluate("() => document.getElementById('replay-plan').clientWidth") > min(0.75 * width, 550)
    text = page.evaluate(
        "() => Math.min(...[...document.querySelectorAll('p, td, th, dd, dt, label, li, figcaption')]"
        ".filter(e => e.offsetWidth).map(e => parseFloat(getComputedStyle(e).fontSize)))"
    )
    assert text >= 11.5


def test_colours_follow_the_system_and_the_choice(opened: Open) -> None:
    def paper(page: Any) -> int:
        text = page.evaluate("() => getComputedStyle(document.body).backgroundColor")
        return sum(int(part) for part in text[4:-1].split(","))

    dark = opened(color_scheme="dark")
    light = opened(color_scheme="light")
    assert paper(dark) < 120 < 700 < paper(light)
    assert pixels(dark) != pixels(light)
    dark.click("input[value=light]")
    light.click("input[value=dark]")
    assert paper(light) < 120 < 700 < paper(dark)


def test_on_paper_there_are_the_figures_and_no_controls(opened: Open) -> None:
    page = opened(color_scheme="dark")
    page.emulate_media(media="print")
    assert not page.locator("#replay").is_visible()
    assert not page.locator("#themes").is_visible()
    assert page.locator("svg.plot").first.is_visible()
    assert page.evaluate("() => getComputedStyle(document.body).backgroundColor") in (
        "rgb(255, 255, 255)",
        "rgba(0, 0, 0, 0)",
    )
    assert len(page.pdf()) > 10_000


def test_names_from_the_data_execute_nothing(opened: Open, tmp_path: Path) -> None:
    data = run(steps=20, cameras=2)
    scene, bearings, diagnostics = data.scene, data.bearings, data.diagnostics
    assert scene is not None
    assert bearings is not None
    assert diagnostics is not None
    named = {c.name: getattr(bearings, c.name) for c in Bearings.columns()}
    named["sensor"] = np.where(bearings.sensor == "camera 1", EVIL, bearings.sensor)
    cameras = (replace(scene.cameras[0], name=EVIL), *scene.cameras[1:])
    path = tmp_path / "evil.html"
    evil = replace(
        data,
        title=EVIL,
        scene=replace(scene, cameras=cameras),
        bearings=Bearings.of(**named),
        diagnostics=replace(
            diagnostics, fallback=np.full(20, EVIL), seen_by=np.full(20, EVIL), quality_flags=np.full(20, EVIL)
        ),
        metrics={EVIL: 1.0},
        losses=(Loss(EVIL, EVIL, EVIL, 1),),
    )
    path.write_text(build_page(evil), encoding="utf-8")
    page = opened(path)
    page.locator("#replay-time").fill("10")
    settled(page)
    assert page.evaluate("() => window.evil") is None
    assert page.locator("img").count() == 0
    assert EVIL in page.locator("#replay-rows").inner_text()
    # Nor would anything that got into the page: the policy allows one script alone
    with page.expect_console_message(lambda message: "Content Security Policy" in message.text):
        page.evaluate(ADD_SCRIPT)
    assert page.evaluate("() => window.evil") is None
    page.context.complaints.clear()


def test_without_scripts_the_page_is_what_it_was(opened: Open) -> None:
    page = opened(java_script_enabled=False)
    assert not page.locator("#replay").is_visible()
    assert page.locator("svg.plot").count() > 5
