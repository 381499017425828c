"""The work of `occlog fit-motion`: read positions, fit a motion model, write it."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError, UsageError, option
from occlog.io.formats.models.motion_models import MotionModel, write_motion
from occlog.io.open import check_unit, common_unit, input_losses, open_input
from occlog.records.tables import Tracks, Truth
from occlog.runner import Job
from occlog.settings import configure

from .config import COVARIANCE, ESTIMATED, FitConfig
from .em import fit_differences, fit_em
from .parameters import Shape
from .report import MotionFit
from .request import FitMotionRequest
from .smoother import MeasuredPath, median_step

if TYPE_CHECKING:
    from occlog.records.losses import Loss

GAP_STEPS = 5.0
LARGEST_FILL = 50
"""Most nodes for each position: a shorter step would only make gaps."""


def run_fit(request: FitMotionRequest, job: Job) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Fit a motion model to the request's positions, and write it to the request's output.

    Return the figures of the summary, and the losses recorded in the inputs.

    Raises:
        InputError: the positions do not suffice.
    """
    config = configure(FitConfig(), request.settings)
    paths, unit, losses = read_paths(request, config)
    where = ", ".join(str(p) for p in request.positions)
    try:
        step_s = config.step_s or median_step(paths)
        gap_s = config.max_gap_s if config.max_gap_s is not None else GAP_STEPS * step_s
        _check_step(paths, step_s, gap_s)
        fit = _fit(config, paths, step_s, gap_s)
    except ValueError as error:
        raise InputError(f"{where}: {error}", id="insufficient-data") from error
    motion = MotionModel(fit.model.A, fit.model.sigma, step_s, unit)
    figures = {**_figures(fit, config), "objects": len(paths), "gap_s": gap_s}
    details = {
        "noise": fit.noise,
        "A_error": fit.A_error.tolist(),
        "sigma_error": fit.sigma_error.tolist(),
        "fit": figures,
    }
    noise = config.measurement_noise if config.noise_length is None else config.noise_length
    if config.noise_length is not None:
        details["noise"] = noise
    used = {"measurement_noise": noise, "step_s": step_s, "max_gap_s": gap_s, "targets": request.targets}
    made = job.provenance(asdict(config) | used, losses)
    write_motion(request.output, motion, details, made, overwrite=job.overwrite)
    for line in warnings(fit, config, paths):
        job.note(f"warning: {line}")
    shown = {"A": motion.A.tolist(), "sigma": motion.sigma.tolist()}
    shown["noise"] = noise if details["noise"] is None else details["noise"]
    return {"motion": str(request.output), "step_s": step_s, "length_unit": unit, **figures, **shown}, losses


def _check_step(paths: list[MeasuredPath], step_s: float, gap_s: float) -> None:
    """Raise ValueError for a model step that does not fit the paths.

    The longest gap `gap_s` [s] must be at least the step `step_s` [s], and the step at least 1 / `LARGEST_FILL` of the
    median time between positions.
    """
    if gap_s < step_s:
        raise ValueError(
            f"the longest gap to bridge, {gap_s:g} s, is shorter than the step, {step_s:g} s; "
            f"give a larger {option('max_gap')} or a smaller {option('step')}"
        )
    median = median_step(paths)
    if step_s * LARGEST_FILL < median:
        raise ValueError(
            f"a step of {step_s:g} s is under 1/{LARGEST_FILL} of the time between positions, {median:g} s; "
            f"give a larger {option('step')}"
        )


def _fit(config: FitConfig, paths: list[MeasuredPath], step_s: float, gap_s: float) -> MotionFit:
    """Return the motion model fitted to the paths by the method of the settings: EM, or regression on differences.

    `step_s` is the model's step [s], `gap_s` the longest gap within a trajectory [s].
    """
    shape = Shape(
        config.form,
        config.process_noise_form,
        similar=config.process_noise_axes == "same",
        noise=config.measurement_noise == ESTIMATED,
    )
    if config.method == "differences":
        return fit_differences(paths, step_s, shape, longest_gap_s=gap_s)
    return fit_em(paths, step_s, shape, longest_gap_s=gap_s, noise=config.noise_length)


def _figures(fit: MotionFit, config: FitConfig) -> dict[str, object]:
    """Return the summary figures of a fit by name: method, counts, log likelihood, parameters and their errors."""
    return {
        "method": config.method,
        "form": config.form,
        "process_noise_form": config.process_noise_form,
        "process_noise_axes": config.process_noise_axes,
        "transitions": fit.transitions,
        "measurements": fit.measurements,
        "skipped": fit.skipped,
        "trajectories": fit.trajectories,
        "log_likelihood": fit.log_likelihood,
        "spectral_radius": spectral_radius(fit.model.A),
        "iterations": fit.iterations,
        "converged": fit.converged,
        "parameters": fit.parameters,
        "errors": fit.errors,
        "at_limit": list(fit.at_limit),
        "undecided": list(fit.undecided),
    }


def spectral_radius(A: Floats) -> float:
    """Return the largest absolute eigenvalue of the transition matrix A (4, 4), exact for block-triangular A."""
    pairs = A.reshape(2, 2, 2, 2)
    if not (pairs[0, :, 1].any() or pairs[1, :, 0].any() or A[1, 0] or A[3, 2]):
        return float(np.abs(np.diag(A)).max())
    return float(np.abs(np.linalg.eigvals(A)).max())


def warnings(fit: MotionFit, config: FitConfig, paths: list[MeasuredPath]) -> list[str]:
    """Return the texts of the warnings about a fit: instability, no convergence, limits, undetermined parameters."""
    out = []
    radius = spectral_radius(fit.model.A)
    if radius > 1.0:
        out.append(f"the model is unstable: spectral radius {radius:.6g}; positions grow without bound")
    if not fit.converged:
        out.append(
            f"not converged after {fit.iterations} steps; simplify {option('form')} or {option('process_noise_form')}"
        )
    if fit.at_limit:
        out.append(f"at its limit, so indistinguishable from 0 (or too large): {', '.join(fit.at_limit)}")
    if fit.undecided:
        out.append(f"not decided by the data: {', '.join(fit.undecided)}; their standard errors are null")
    if config.form == "full":
        xy = np.concatenate([p.xy for p in paths])
        if (np.abs(xy.mean(axis=0)) > xy.std(axis=0)).any():
            out.append(
                f"{option('form')} full pulls towards the origin of the scene, which is far from these positions"
            )
    return out


def read_paths(request: FitMotionRequest, config: FitConfig) -> tuple[list[MeasuredPath], str, tuple[Loss, ...]]:
    """Return the path of each object in each input file, their length unit, and the lost data that the files list.

    `request` names the files and the objects to use, `config` states the measurement noise.

    Raises:
        UsageError: covariances are to be used, and the input is truth, which has none.
        InputError: no position is left, or the inputs have different units.
    """
    paths: list[MeasuredPath] = []
    inputs = [open_input(file, Truth, Tracks) for file in request.positions]
    unit, source = common_unit(inputs)
    for opened in inputs:
        check_unit(opened, unit, source, InputError)
    for opened in inputs:
        table = opened.read(Truth) if opened.has(Truth) else opened.read(Tracks)
        if config.measurement_noise == COVARIANCE and not isinstance(table, Tracks):
            raise UsageError(
                f"{opened.path}: truth has no covariance, which {option('measurement_noise')} "
                "covariance needs; give a LENGTH, or omit it",
                id="missing-option",
            )
        paths += paths_of(table, request.targets)
    found = sum(len(p.t_ns) for p in paths)
    if not found:
        names = ", ".join(str(p) for p in request.positions)
        of = f" of target {', '.join(map(str, request.targets))}" if request.targets else " of a target"
        raise InputError(f"{names}: no positions{of}; choose others with {option('target')}", id="insufficient-data")
    return paths, unit, input_losses(inputs)


def paths_of(table: Truth | Tracks, targets: tuple[int, ...]) -> list[MeasuredPath]:
    """Return the measured path (times, positions, covariances) of each object, by ascending identity.

    Of several positions at one time the first is used. `targets` are the identities to use; empty: all, but of truth
    those with the role `target`.
    """
    used = np.isin(table.target_id, targets) if targets else np.ones(len(table), np.bool_)
    if isinstance(table, Truth) and not targets:
        used &= table.role == "target"
    out = []
    for identity in np.unique(table.target_id[used]):
        rows = np.flatnonzero(used & (table.target_id == identity))
        rows = rows[np.concatenate([[True], np.diff(table.t_ns[rows]) > 0])]
        cov = None
        if isinstance(table, Tracks) and not np.isnan(table.cov_xx[rows]).any():
            xx, xy, yy = table.cov_xx[rows], table.cov_xy[rows], table.cov_yy[rows]
            cov = np.stack([np.stack([xx, xy], axis=1), np.stack([xy, yy], axis=1)], axis=1)
        out.append(MeasuredPath(table.t_ns[rows], np.stack([table.x[rows], table.y[rows]], axis=1), cov))
    return out
