"""[Ercan] Sec. 4: Kalman filters instead of particles, in the room and among the occluders of Fig. 6.

The filters are the methods `ekf`, `ukf` and `iekf` of `occlog track` with their defaults; the paper's motion is theirs
in its first two moments.  Information that only particles can use, priors and "not seen", is skipped but
where a series states it.
"""

from __future__ import annotations

from occlog.papers import verdicts as v
from occlog.papers.verdicts import Execute, Experiment, Size, StatementVerdict, Table, quotient_of
from occlog.pipeline.sweep.trial import Values

from .square import M40
from .trial import SQUARE_ORDER, TrialPoint, kalman, names, run_points, square_room, trial

APF, EKF, UKF, IEKF = "apf", "ekf", "ukf", "iekf"
CONSTRAINED, DESCENT = "ukf, constraints considered", "iekf, from the prediction alone"
FILTERS: dict[str, Values] = {
    APF: {},
    EKF: {"method": "ekf"},
    UKF: {"method": "ukf"},
    CONSTRAINED: {"method": "ukf", "sigma_points": "visible"},
    IEKF: {"method": "iekf"},
    DESCENT: {"method": "iekf", "visibility_constraint": "descent"},
}
SHARP, FALSE, PRIORS = "sharp bearings", "false bearings", "priors"
"""Further settings, each with four cameras."""
CAMERAS = 4
SHARP_NOISE = "noise: {position: 0, yaw: 0, measurement_noise_px: 0.2}"
"""Noise of precise cameras in the YAML of a scene: with a focal length of 70 px, 0.16 degrees."""
DISTURBED: Values = {"miss_probability": 0.1, "false_alarm_probability": 0.05}
AS_GOOD, NEARLY = 1.1, 1.35
"""Quotients of errors that count as equally good, and as that in part."""


def baselines(size: Size, execute: Execute) -> Table:
    """Table of the RMSE of every filter against the number of cameras, and with four cameras in further settings."""
    room = square_room(pillar=True)
    counts = (CAMERAS,) if size.quick else (2, 3, CAMERAS, 6, 8)
    points = [_point(name, n, room, size, FILTERS[name]) for n in counts for name in FILTERS]
    sharp = room.replace("noise: {position: 1, yaw: 0.01, measurement_noise_px: 2}", SHARP_NOISE)
    for name in (APF, EKF):
        points.append(_point(f"{name}, {SHARP}", CAMERAS, sharp, size, FILTERS[name], simulate={"occluders": 0}))
    values = {"detection_probability": 0.9, "false_alarm_probability": 0.05}
    for name in (APF, EKF, UKF, IEKF):
        settings = FILTERS[name] if name != APF else values
        points.append(_point(f"{name}, {FALSE}", CAMERAS, room, size, settings, observe=DISTURBED))
    points.append(_point(f"{APF}, {PRIORS}", CAMERAS, room, size, FILTERS[APF], priors=kalman(8.0)))
    return run_points(points, size, execute)


def _point(
    series: str,
    n: int,
    scene: str,
    size: Size,
    settings: Values,
    *,
    simulate: Values = M40,
    priors: Values | None = None,
    observe: Values | None = None,
) -> TrialPoint:
    """Point of the table: series, x and the specification of its trial.

    Args:
        series: name of the series.
        n: number of cameras (x).
        scene: YAML text of the scene.
        size: steps and seed.
        settings: settings of the filter; for particles in addition to those of all figures.
        simulate: settings of the world.
        priors: kind of priors; None: none.
        observe: settings of the measurements; None: the defaults.
    """
    more = {} if observe is None else {"observe": {"diameter": 3.33, **observe}}
    spec = trial(scene, size, simulate, priors or {"kind": "none"}, cameras=names(SQUARE_ORDER[:n]), **more)
    track = dict(settings) if "method" in settings else {**spec["track"], **settings}
    return TrialPoint(series, n, {**spec, "track": track})


def judge(table: Table) -> list[StatementVerdict]:
    """Verdicts on what [Ercan] Sec. 4 states about Kalman filters, for every number of cameras."""

    def lower(key: str, statement: str, low: str, high: str) -> StatementVerdict:
        return v.pairs(f"baselines-{key}", statement, v.matched(table, low, high))

    out = [
        lower("ekf", "An extended Kalman filter has a larger error than particles.", APF, EKF),
        lower("ukf", "An unscented Kalman filter has a lower error than an extended one.", UKF, EKF),
        lower(
            "ukf-constraints",
            "Its error is larger when sigma points that cameras cannot see are discarded.",
            UKF,
            CONSTRAINED,
        ),
        lower("ukf-particles", "Its error is then larger than that of particles.", APF, CONSTRAINED),
        lower(
            "map",
            "The search for the maximum from the prediction alone fails: its error is larger than with further starts.",
            IEKF,
            DESCENT,
        ),
        lower("map-particles", "MAP estimates in a Kalman filter have a larger error than particles.", APF, DESCENT),
        lower("priors", "Particles with priors have a lower error than a filter without.", f"{APF}, {PRIORS}", EKF),
    ]
    apf, ekf = (v.row_of(table, f"{name}, {SHARP}") for name in (APF, EKF))
    statement = (
        "With sharp bearings and no person in between an extended Kalman filter is as good as particles: quotient."
    )
    rule = f"quotient of the errors at most {AS_GOOD}; in part up to {NEARLY}"
    good, fair = v.at_most(AS_GOOD), v.at_most(NEARLY)
    out.append(v.judge("baselines-sharp", statement, quotient_of(ekf, apf), good, fair, rule=rule))
    apf, *rest = (v.row_of(table, f"{name}, {FALSE}") for name in (APF, EKF, UKF, IEKF))
    statement = "With false bearings every Kalman filter has a larger error than particles."
    out.append(v.pairs("baselines-false", statement, [(apf, r) for r in rest]))
    return out


BASELINES = Experiment(
    item="baselines",
    title="Kalman filters instead of particles",
    x_label="cameras",
    y_label="RMSE",
    runs=5,
    steps=4000,
    quick=(2, 40),
    compute=baselines,
    judge=judge,
    note="The room of Fig. 6 with M = 40 and without priors; methods ekf, ukf and iekf of `occlog track`.",
)
