from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from occlog.papers.lee.cooperation.environments import environment
from occlog.papers.lee.cooperation.parallel_projection import judge_errors
from occlog.papers.lee.cooperation.projected_places import PROJECTIONS, crossed, projected, relocated, sights_of
from occlog.papers.verdicts import PaperRow
from occlog.track.methods.imm.camera_requests import CameraAnswer, CameraQuestion, CameraRequest


def seen(cameras, xy):
    away = xy[:, None] - np.array([c.ground for c in cameras])
    return sights_of(cameras, np.arctan2(away[..., 1], away[..., 0]), 0.01)


@pytest.mark.jit
def test_passes_of_the_projection_end_where_sight_lines_cross():
    cameras = environment("pair", 0, 0).scene.cameras
    rng = np.random.default_rng(0)
    xy = 25.0 + rng.uniform(-12.0, 12.0, (50, 2))
    sights, reference = seen(cameras, xy), xy + 3.0 * rng.standard_normal((50, 2))
    lines, met = crossed(sights)
    assert met.all()
    np.testing.assert_allclose(lines, xy, atol=1e-6)
    error = []
    for way in ("Eq. 5.39", "Eq. 5.39, 3 passes", "Eq. 5.39, 10 passes"):
        positions, found = projected(reference, sights, PROJECTIONS[way])
        assert found.all()
        error.append(np.median(np.hypot(*(positions - xy).T)))
    assert error[0] > 5 * error[1] > 5 * error[2]


@pytest.mark.jit
def test_an_answer_is_moved_from_the_estimate_and_one_in_vain_stays_in_vain():
    scene = environment("pair", 0, 0).scene
    ask = CameraQuestion(1, ("count",), 1, np.array([27.0, 24.0]), np.eye(2))
    request = CameraRequest(CameraAnswer(ask, np.array([25.0, 25.0]), np.eye(2), 1), ("cam1", "cam2"), 2)
    found = relocated(request, scene, PROJECTIONS["Eq. 5.39"])
    sights = seen(scene.cameras, np.array([[25.0, 25.0]]))
    expected, _ = projected(ask.position[None], sights, PROJECTIONS["Eq. 5.39"])
    np.testing.assert_allclose(found.answer.position, expected[0])
    in_vain = request._replace(answer=request.answer._replace(position=None, covariance=None))
    assert relocated(in_vain, scene, PROJECTIONS["Eq. 5.40"]) is in_vain


@pytest.mark.jit
def test_parallel_cameras_have_no_place_by_projection():
    scene = environment("field", 0, 0).scene
    ask = CameraQuestion(1, ("count",), 1, np.array([27.0, 24.0]), np.eye(2))
    request = CameraRequest(CameraAnswer(ask, np.array([25.5, 25.0]), np.eye(2), 1), ("cam2", "cam3"), 2)
    assert relocated(request, scene, PROJECTIONS["Eq. 5.39"]).answer.position is None


def test_projection_and_sight_lines_are_judged_side_by_side():
    names = {"reference": 6.0, "Eq. 5.39": 2.0, "Eq. 5.40": 2.5, "Eq. 5.39, 3 passes": 1.0}
    names |= {"Eq. 5.39, 10 passes": 0.5, "lines of sight": 0.5}
    table = [PaperRow(n, 3.0, tuple(x + 0.01 * k for k in range(30))) for n, x in names.items()]
    table += [replace(row, series=f"track, {row.series}", x=math.nan) for row in table]
    words = {v.id: v.verdict for v in judge_errors(table)}
    assert words["sec3.2.2-improves"] == words["sec3.2.2-lines"] == words["sec3.2.2-passes"] == "reproduced"
    assert words["sec3.2.2-depth"] == words["sec3.2.2-track-often"] == "not reproduced"
    assert words["sec3.2.2-limit"] == words["sec3.2.2-track-once"] == "reproduced"
