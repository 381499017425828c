"""The page of ten people: its size for an hour, and how fast Chromium paints and scrubs ten minutes of them."""

from __future__ import annotations

import os
import tempfile
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from docs.browser import browser
from occlog.core.geometry.camera import rotation_from_angles
from occlog.records.declared.people import PeopleTracks
from occlog.records.scene import Camera, Scene
from occlog.records.tables import Bearings, Bound, Diagnostics, Errors, Truth
from occlog.report.content.model import ReportInput
from occlog.report.page import build_page

NAME = "page"
SUMMARY = "page of ten people: time to draw a moment of ten minutes in Chromium to that of a frame at 30 a second"
LIMIT = 1.0
PEOPLE, HZ, SIZE = 10, 10, 20.0
SCRUB = """async steps => {
  const slider = document.getElementById("replay-time"), spent = [];
  for (let k = 0; k < steps; k++) {
    const began = performance.now();
    slider.value = String(Math.round(k * slider.max / steps));
    slider.dispatchEvent(new Event("input", { bubbles: true }));
    await new Promise(done => requestAnimationFrame(() => setTimeout(done)));
    spent.push(performance.now() - began);
  }
  return spent;
}"""
PAINT = "() => performance.getEntriesByName('first-contentful-paint')[0].startTime"


def crowd(seconds: float) -> ReportInput:
    """Ten people who walk in a room with four cameras, each seen by all of them."""
    steps = int(seconds * HZ)
    t_ns = np.repeat(np.arange(steps, dtype=np.int64) * (10**9 // HZ), PEOPLE)
    who, s = np.tile(np.arange(PEOPLE), steps), np.repeat(np.arange(steps) / 40.0, PEOPLE)
    x = SIZE * (0.5 + 0.4 * np.sin(s + who))
    y = SIZE * (0.5 + 0.4 * np.sin(1.3 * s + 2 * who))
    nothing, all_of = np.full(len(who), np.nan), np.full(len(who), "cam0,cam1,cam2,cam3")
    rng = np.random.default_rng(0)
    error = rng.normal(0, 0.1, (2, len(who)))
    tracks = PeopleTracks.of(
        t_ns=t_ns, target_id=who, x=x + error[0], y=y + error[1], vx=nothing, vy=nothing,
        cov_xx=np.full(len(who), 0.01), cov_xy=np.zeros(len(who)), cov_yy=np.full(len(who), 0.01),
        existence_probability=np.ones(len(who)), seen_by=all_of, quality_flags=np.full(len(who), ""),
    )  # fmt: skip
    truth = Truth.of(t_ns=t_ns, target_id=who, role=np.full(len(who), "target"), x=x, y=y, z=nothing)
    corners = SIZE * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    cameras = tuple(
        Camera(
            name=f"cam{k}",
            position=np.array([*corner, 3.0]),
            rotation=rotation_from_angles(np.pi / 4 + k * np.pi / 2, 0.0, 0.0),
            focal_px=np.full(2, 500.0),
            principal_px=np.array([320.0, 240.0]),
            fov=np.pi / 2,
        )
        for k, corner in enumerate(corners)
    )
    azimuth = np.concatenate([np.arctan2(y - corner[1], x - corner[0]) for corner in corners])
    order = np.lexsort((np.tile(who, 4), np.repeat(np.arange(4), len(who)), np.tile(t_ns, 4)))
    count = 4 * len(who)
    bearings = Bearings.of(
        t_ns=np.tile(t_ns, 4)[order], sensor=np.repeat([c.name for c in cameras], len(who))[order],
        target_id=np.full(count, -1), seen=np.ones(count, np.bool_), bearing=azimuth[order],
        sigma=np.full(count, 0.01), u_px=np.zeros(count), sigma_px=np.ones(count), score=np.ones(count),
    )  # fmt: skip
    scene = Scene(cameras=cameras, room=corners)
    return ReportInput(scene=scene, tracks=tracks, truth=truth, bearings=bearings)


def with_everything(data: ReportInput) -> ReportInput:
    """The same with errors, bound, diagnostics, and bearings that have labels, a fifth of which saw nobody."""
    tracks, truth, bearings = data.tracks, data.truth, data.bearings
    assert tracks is not None
    assert truth is not None
    assert bearings is not None
    rng, n = np.random.default_rng(1), len(tracks)
    who = {"t_ns": tracks.t_ns, "target_id": tracks.target_id}
    off, level = np.stack([tracks.x - truth.x, tracks.y - truth.y]), 0.08 + 0.02 * rng.random(n)
    errors = Errors.of(
        **who, x=tracks.x, y=tracks.y, truth_x=truth.x, truth_y=truth.y, error_x=off[0], error_y=off[1],
        error=np.hypot(*off), nees=np.sum(off**2, axis=0) / 0.01,
    )  # fmt: skip
    bound = Bound.of(
        **who, bound_xx=level**2 / 2, bound_xy=0 * level, bound_yy=level**2 / 2, bound=level, n_detected=np.full(n, 4)
    )
    diagnostics = Diagnostics.of(
        **who, ess=rng.uniform(500, 700, n), log_likelihood=0 * level, n_observing=np.full(n, 4),
        n_detected=np.full(n, 4),
        fallback=np.full(n, ""), cameras=np.full(n, "cam0,cam1,cam2,cam3"), seen_by=np.full(n, "cam0,cam1,cam2,cam3"),
        n_available=np.full(n, 4), selected=np.full(n, ""), predicted_mse=0 * level, quality_flags=np.full(n, ""),
    )  # fmt: skip
    seen = rng.random(len(bearings)) < 0.8
    reported = {
        name: np.where(seen, getattr(bearings, name), np.nan)
        for name in ("bearing", "sigma", "u_px", "sigma_px", "score")
    }
    labels = np.tile(np.arange(PEOPLE, dtype=np.int32), len(bearings) // PEOPLE)
    bearings = replace(bearings, seen=seen, target_id=labels, **reported)
    return replace(data, errors=errors, bound=bound, diagnostics=diagnostics, bearings=bearings)


def run(repeats: int) -> dict[str, Any]:
    """Time of a moment, from its being asked for to its being painted, to 1/30 s; medians."""
    parts: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as name, browser() as chromium:
        page_of = {}
        for what, seconds in (("an hour", 3600.0), ("ten minutes", 600.0)):
            page_of[what] = Path(name) / f"{seconds:g}.html"
            page_of[what].write_text(build_page(crowd(seconds)), encoding="utf-8")
            parts[f"size of {what} [MB]"] = page_of[what].stat().st_size / 1e6
        everything = build_page(with_everything(crowd(3600.0)))
        parts["size of an hour with errors, bound and diagnostics [MB]"] = len(everything.encode()) / 1e6
        for what, path in page_of.items():
            paints, steps = [], list[float]()
            for _ in range(repeats):
                page = chromium.new_page(viewport={"width": 1280, "height": 900})
                page.goto(path.as_uri())
                page.wait_for_timeout(300)
                paints.append(float(page.evaluate(PAINT)))
                steps += page.evaluate(SCRUB, 200)
                page.close()
            parts[f"first paint of {what} [ms]"] = median(paints)
            parts[f"a moment of {what} [ms]"] = median(steps)
            parts[f"a moment of {what}, 95 % below [ms]"] = float(np.percentile(steps, 95))
    parts["load of the machine"] = os.getloadavg()[0]
    return {"ratio": parts["a moment of ten minutes [ms]"] * 30 / 1000, "limit": LIMIT, "parts": parts}
