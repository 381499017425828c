"""Method map where numbers are extreme, where the estimate must be led around walls again, and with one state."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from map_scenes import place, record, scans_of

from occlog.array_types import Floats
from occlog.errors import InputError
from occlog.records.scene import Occluder, Scene
from occlog.track.interface import SmoothedTrajectory
from occlog.track.methods.map.config import MapConfig
from occlog.track.methods.map.method import advance, begin
from occlog.track.methods.map.record import TargetRecord

NS = 1_000_000_000
WALL = np.array([[-0.2, -10.0], [0.2, -10.0], [0.2, 4.0], [-0.2, 4.0]])


def walled() -> Scene:
    """Two cameras that do not overlap, on either side of a wall with a gap at its end."""
    open_room = place((-10, -10, 55), (10, -10, 125))
    return replace(open_room, occluders=(Occluder("wall", WALL),))


def estimate(scene: Scene, one: TargetRecord, **settings: object) -> SmoothedTrajectory:
    config = replace(MapConfig.in_unit("m"), **settings)
    return advance(begin(scene, config), scans_of(one), True)[1]


def around_the_wall(seed: int) -> TargetRecord:
    """A walk from one side of the wall to the other, seen with noise, and not at all near the gap."""
    corners = np.array([[-5.0, -4.0], [-4.0, 2.0], [-1.0, 6.0], [1.0, 6.0], [4.0, 2.0], [5.0, -4.0]])
    along = np.r_[0.0, np.cumsum(np.hypot(*np.diff(corners, axis=0).T))]
    t = np.arange(0.0, along[-1], 0.5)
    xy = np.column_stack([np.interp(t, along, corners[:, i]) for i in (0, 1)])
    dark = np.abs(xy[:, 0]) < 3.5
    blind = {(k, s) for k in np.flatnonzero(dark) for s in (0, 1)}
    blind |= {(k, s) for k in range(len(t)) for s in (0, 1) if (xy[k, 0] < 0) != (s == 0)}
    return record(walled(), t, xy, noise=np.random.default_rng(seed), blind=blind)


def depth_in_wall(xy: Floats) -> float:
    """How long the path is inside the wall."""
    return float(shapely.LineString(xy).intersection(shapely.Polygon(WALL).buffer(-1e-6)).length)


@pytest.mark.jit
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("kind", ["mode", "invariant"])
def test_no_estimate_runs_through_a_wall_without_a_flag(kind: str, seed: int) -> None:
    out = estimate(walled(), around_the_wall(seed), estimate=kind)
    assert "no_path" not in out.fallback
    assert depth_in_wall(out.xy) == 0.0


def test_one_state_is_not_inside_a_wall() -> None:
    scene = replace(place((-10, -10, 45)), occluders=(Occluder("pillar", WALL + np.array([0.0, 3.0])),))
    out = estimate(scene, record(scene, [0.0], [[5.0, 5.0]], blind={(0, 0)}))
    inside = shapely.Polygon(WALL + np.array([0.0, 3.0])).buffer(-1e-6)
    assert not inside.contains(shapely.Point(*out.xy[0]))
    assert np.isfinite(out.covariance).all()


def test_nanoseconds_after_many_years() -> None:
    scene = place((-10, -10, 45))
    t_ns = np.array([0, 1, NS, 10**18, 10**18 + 1])
    one = record(scene, np.arange(5.0), np.tile([[2.0, 3.0]], (5, 1)))._replace(t_ns=t_ns)
    out = estimate(scene, one)
    assert np.isfinite(out.xy).all()
    assert np.isfinite(out.covariance).all()


def growing(factor: float) -> dict[str, object]:
    """A model whose velocity grows by a factor in a second."""
    axis = np.array([[1.0, 1.0], [0.0, factor]])
    A = np.kron(np.eye(2), axis)
    return {"A": tuple(A.ravel().tolist()), "Sigma": tuple((0.01 * np.eye(4)).ravel().tolist()), "model_step_s": 1.0}


@pytest.mark.parametrize(("factor", "last_s"), [(9.0, 500.0), (1.3, 1e4)])
def test_motion_that_grows_without_bound_is_an_error(factor: float, last_s: float) -> None:
    scene = place((-10, -10, 45))
    t = np.array([0.0, 1.0, 2.0, last_s])
    with pytest.raises(InputError, match=r"grows without bound"):
        estimate(scene, record(scene, t, np.tile([[2.0, 3.0]], (4, 1))), **growing(factor))


def test_motion_that_grows_a_little_is_used() -> None:
    scene = place((-10, -10, 45))
    out = estimate(scene, record(scene, np.arange(20.0), np.tile([[2.0, 3.0]], (20, 1))), **growing(1.01))
    assert np.isfinite(out.covariance).all()


@pytest.mark.parametrize("column", ["u_px", "sigma_px"])
def test_readings_beyond_all_measure_are_an_error_or_finite(column: str) -> None:
    scene = place((-10, -10, 45))
    one = record(scene, np.arange(6.0), np.tile([[2.0, 3.0]], (6, 1)))
    getattr(one.rows, column)[2] = 1e200
    with np.errstate(all="ignore"):
        try:
            out = estimate(scene, one)
        except InputError as error:
            assert error.id == "invalid-value"
        else:
            assert np.isfinite(out.xy).all()
            assert np.isfinite(out.covariance).all()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("process_noise_velocity", 1e200),
        ("process_noise_position", 1e200),
        ("model_step_s", 1e300),
        ("sigma_initial_velocity", 1e-200),
        ("initial_depth", 1e300),
        ("start", (1e300, 0.0, 1.0)),
        ("start", (1.0, 1.0, 1e-200)),
        ("lag_s", 1e300),
        ("loss_threshold", 0.0),
    ],
)
def test_settings_beyond_all_measure_are_errors(name: str, value: object) -> None:
    with pytest.raises(InputError, match=rf"map: {name} is"):
        MapConfig(**{name: value})


def test_a_linear_start_survives_a_contradiction() -> None:
    """The other states start from the linear problem all the same: the minimum is that of the axes."""
    scene = place((-10, 0, 0), (-10, 0.01, 180), (0, -10, 90))
    t = np.arange(12.0)
    one = record(scene, t, np.column_stack([-4.0 + 0.6 * t, np.zeros(12)]))
    back, rows = np.flatnonzero((one.rows.sensor == 1) & (one.state == 5)), one.rows
    rows.seen[back], rows.bearing[back], rows.u_px[back] = True, np.pi - 1e-3, 0.5
    rows.sigma[:], rows.sigma_px[:] = np.where(rows.seen, 1e-3, np.nan), np.where(rows.seen, 0.5, np.nan)
    axes, linear = (estimate(scene, one, initialisation=start) for start in ("axes", "linear"))
    assert axes.fallback[5] == linear.fallback[5] == "infeasible_constraints"
    np.testing.assert_allclose(linear.xy, axes.xy, atol=1e-4)
