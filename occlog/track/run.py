"""`occlog track`: open the measurements, track, write the tables, and summarise."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from occlog import console
from occlog.consistency.bearings import AngleConventionCheck, ComparedBearings, StatedNoiseCheck
from occlog.consistency.frozen import FrozenValues
from occlog.consistency.labels import MotionCheck, label_checks, motion_checks
from occlog.consistency.range_biases import RangeBiases
from occlog.consistency.systematic_errors import SYSTEMATIC, SystematicErrors
from occlog.consistency.verdict import MOTION, ConsistencyEvidence
from occlog.errors import InputError, UsageError, option
from occlog.io.formats.models.motion_models import model_losses, read_motion, read_path_loss
from occlog.io.open import open_input
from occlog.records.declared.world import END_TO_END
from occlog.records.tables import Bearings, Delays
from occlog.records.verdicts import Check, finding, outcome, summary_of, texts_of
from occlog.runner import Job
from occlog.scans.config import DistanceMeasurementConfig
from occlog.scans.distance_measurements import DistanceMeasurementFeed, Radio, SignalErrors
from occlog.scans.grouping import checked, choose_sensors, sensor_names
from occlog.scans.inputs import MeasurementInputs
from occlog.scans.label_continuity import LabelEvents
from occlog.scans.sources import only_measured, round_robin
from occlog.settings import METRES, Settings, configure
from occlog.track.drivers.rows import NetworkTraffic
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.methods.apf.config import SelectConfig
from occlog.track.methods.imm.config import START_NUMBERS, ImmConfig
from occlog.track.request import TrackRequest

from .catalogue import METHODS, settings_of, tracker
from .interface import AnyMethod, Batch, Joint, Online
from .smoothing_and_lag import LagConfig

if TYPE_CHECKING:
    from occlog.records.losses import Loss
    from occlog.records.scene import Scene
    from occlog.track.drivers.rows import Solve, TrackChunk


NUMBER = "number of targets"
"""Name of a check."""


class TrackSummary:
    """Counts over a stream of output tables, for the figures and checks of the summary of `occlog track`."""

    def __init__(
        self, scene: Scene, *, joint: bool, smoothed: bool = False, measured: DistanceMeasurementFeed | None = None
    ) -> None:
        """Start with all counts at 0.

        Args:
            scene: scene with the sensors.
            joint: whether the method associates measurements with targets itself.
            smoothed: whether estimates use later measurements.
            measured: distance measurements, of which there are residuals, too; None: there are none.
        """
        self.scene, self.joint, self.smoothed = scene, joint, smoothed
        self.targets: set[int] = set()
        self.evidence = ConsistencyEvidence(distances=measured is not None, unit=scene.length_unit)
        self.sensors, self.measured = SystematicErrors(scene), measured
        self.ranges = None if measured is None else RangeBiases(scene, measured.names)
        self.compass, self.sharp, self.frozen = AngleConventionCheck(scene), StatedNoiseCheck(), FrozenValues()
        self.messages = NetworkTraffic()
        self.solves: list[Solve] = []
        self.asked: Counter[str] = Counter()
        self.labels: LabelEvents | None = None
        self.motion: MotionCheck | None = None
        self.outliers_matter = False
        self.cooperated = False
        self.requests = self.answered = self.frames = self.offered = 0

    def add(self, part: TrackChunk) -> None:
        """Add one chunk of output tables, and what was found with them, to the counts."""
        self.targets.update(part.tracks.target_id.tolist())
        self.labels = part.labels or self.labels
        self.motion = part.motion or self.motion
        self.outliers_matter |= part.outliers_matter
        self.evidence.add_diagnostics(part.diagnostics)
        if part.residuals is not None:
            self.evidence.saw(part.tracks, ComparedBearings(part.residuals, part.frames), self.scene)
        if not self.joint:
            self.sensors.add(part.tracks, part.stated)
        if self.ranges is not None and self.measured is not None and len(part.tracks):
            self.ranges.add(part.tracks, part.stated, self.measured.passed(int(part.tracks.t_ns[-1])))
        for solve in part.solves:
            if solve.noise is not None:
                self.evidence.agreements.moves(solve.target, solve.noise.motion)
            if solve.rivals is not None:
                self.evidence.competes(solve.target, solve.rivals)
        self.messages.add(part.diagnostics)
        self.solves += part.solves
        self.offered += part.offered
        if (asked := part.cooperation) is not None:
            self.cooperated = True
            self.requests += int((asked.cause != "shared").sum())
            self.answered += int((asked.answered & (asked.cause != "shared")).sum())
            self.frames += int(asked.frames.sum())
            self.asked.update(cause for text in asked.cause.tolist() for cause in text.split(","))

    def figures(self) -> dict[str, Any]:
        """Return all figures of the summary, by name."""
        found, network = self.evidence, self.messages.summary()
        return {
            "targets": len(self.targets),
            "rows": found.rows,
            **(self._searches() if self.solves else self._particles()),
            "fallbacks": dict(sorted(found.fallbacks.items())),
            **({"quality_flags": dict(sorted(found.doubts.items()))} if found.doubts else {}),
            **found.figures(),
            **({"network": network} if network else {}),
            **(self._cooperation() if self.cooperated else {}),
        }

    def _cooperation(self) -> dict[str, Any]:
        """Return the figures of camera requests by name: number, answered, by cause, frames requested and available.

        A request with several causes counts for each.
        """
        return {
            "requests": self.requests,
            "answered": self.answered,
            "requests_by_cause": dict(sorted(self.asked.items())),
            "frames_asked": self.frames,
            "frames_offered": self.offered,
        }

    def checks(self) -> tuple[Check, ...]:
        """Return the checks of the estimates with their findings; without any row only the finding `no-tracks`."""
        if not self.evidence.rows:
            return (finding(NUMBER, "no-tracks"),)
        found = self.evidence.checks(one_target=not self.joint, smoothed=self.smoothed)
        number = outcome(NUMBER, (), targets=len(self.targets))
        rows = self.evidence.rows if self.outliers_matter else 0
        labels = label_checks(self.labels, self.scene.length_unit, rows)
        against = "bearings contradict the motion" if any(check.found for check in labels) else ""
        reading = self.compass.checks()
        frozen = self.frozen.checks()
        wrong = "a sensor is frozen" if any(check.found for check in frozen) else ""
        if any(check.status == "failed" for check in reading):
            wrong = "bearings fit each other in another reading"
        sensors: tuple[Check, ...] = ()
        if wrong:
            sensors = outcome(SYSTEMATIC, (), unless=wrong)
        elif not self.joint:
            sensors = self.sensors.checks(unless=against, ranges=self.ranges is not None)
        if self.ranges is not None and not wrong:
            sensors = (*sensors, *self.ranges.checks(self.scene.length_unit, estimated=bool(self._biases())))
        off = "a sensor is off" if any(check.status == "failed" for check in sensors) else ""
        motion = motion_checks(self.labels, self.motion, self.evidence.rows, off)
        if motion:
            found = tuple(check for check in found if check.name != MOTION)
        return (*number, *frozen, *self.sharp.checks(), *reading, *labels, *sensors, *motion, *found)

    def _particles(self) -> dict[str, Any]:
        """Return the mean effective sample size as a figure by name; {} if the method has no particles."""
        mean = self.evidence.particles.mean
        return {} if math.isnan(mean) else {"mean_effective_sample_size": mean}

    def _searches(self) -> dict[str, Any]:
        """Return the figures of a batch method by name.

        These are iterations for each target, number of optimisation runs, how many did not converge, and range biases.
        """
        iterations: Counter[int] = Counter()
        for solve in self.solves:
            iterations[solve.target] += solve.iterations
        return {
            "iterations": {str(k): n for k, n in sorted(iterations.items())},
            "searches": len(self.solves),
            "not_converged": sum(not s.converged for s in self.solves),
            **({"range_biases": biases} if (biases := self._biases()) else {}),
        }

    def _biases(self) -> dict[str, dict[str, dict[str, float]]]:
        """Return the estimated range biases with their standard errors, by target and station."""
        return {
            str(solve.target): {name: {"bias": bias, "standard_error": error} for name, bias, error in solve.biases}
            for solve in self.solves
            if solve.biases
        }


def run_track(request: TrackRequest, job: Job) -> tuple[dict[str, Any], tuple[Loss, ...]]:
    """Track by bearings and other measurements as requested, and write the tables.

    Return the figures of the summary, and the losses recorded in the inputs.

    Raises:
        UsageError: options that do not go together.
        InputError: no row is of the chosen targets and sensors.
    """
    # Open the measurements, and settle method, sensors and selection
    inputs = MeasurementInputs(
        request.bearings,
        request.scene,
        request.doa,
        request.doa_labels,
        request.occluders,
        request.measurements,
        distances=takes_distances(tracker(request.method)),
        # Reads of tags alone are for methods of their own, unless options state how they count here
        reads=bool(request.measured) or request.path_loss is not None,
    )
    config = make_config(request, inputs.scene.length_unit)
    if request.calibration is not None and not estimates_poses(tracker(request.method), config):
        raise UsageError(
            f"{option('calibration')} needs estimated poses to write; add "
            f"{option('set.calibrate')}joint or {option('set.calibrate')}initial",
            id="missing-option",
        )
    frozen = FrozenValues()
    if inputs.measurements is not None:
        inputs.measurements = frozen.watch_ranges(inputs.measurements)
    measured, reported = distance_measurements(request, inputs)
    sensors = choose_sensors(inputs.scene, request.cameras, request.without, readers=measured is not None)
    targets = request.targets or None
    selection = make_selection(request)
    # Choose the rows
    chunks = job.progress(inputs.chunks, "track")
    if not request.use_recovered:
        chunks = only_measured(chunks)
    if request.round_robin_s is not None:
        chunks = one_at_a_time(chunks, inputs.scene, sensors, request.round_robin_s)
    # Track
    plugin = METHODS[request.method].plugin
    tracking = TrackingTask(
        config,
        request.seed,
        method=request.method,
        sensors=sensors,
        targets=targets,
        unlabelled=not request.labelled_only,
        window_ns=request.window_ns or 0,
        selection=selection,
        particles=request.particle_cloud is not None,
        repair_labels=not request.keep_labels,
        reject_outliers=request.reject_outliers,
    )
    joint = isinstance(tracker(request.method), Joint)
    smoothed = isinstance(config, LagConfig) and config.smoothed
    summary = TrackSummary(inputs.scene, joint=joint, smoothed=smoothed, measured=measured)
    summary.frozen = frozen
    chunks = frozen.watch(summary.sharp.watch(summary.compass.watch(chunks)))
    tracked = track(chunks, inputs.scene, tracking, inputs.occluders, measured)
    parameters = {
        "method": request.method,
        "sensors": sorted(sensors),
        "targets": targets,
        "unlabelled": not request.labelled_only,
        "window_ns": request.window_ns or 0,
        "in_turn_s": request.round_robin_s,
        **({"keep_labels": True} if request.keep_labels else {}),
        **({"reject_outliers": True} if request.reject_outliers else {}),
        "doa_labels": request.doa_labels,
        "selection": None if selection is None else asdict(selection),
        **asdict(config),
        **({"use_recovered": True} if request.use_recovered else {}),
        **reported,
        **({} if plugin is None else {"plugin": f"{plugin.package} {plugin.version}"}),
    }
    # Write all tables while they stream
    losses = tuple(dict.fromkeys((*inputs.losses, *model_losses([request.motion, request.path_loss]))))
    provenance = job.provenance(parameters, losses, request.seed)
    with job.tables(provenance, inputs.scene.length_unit) as tables:
        for part in tracked:
            tables.write(
                output=part.tracks,
                diagnostics=part.diagnostics,
                calibration=part.calibration,
                cooperation=part.cooperation,
                residuals=part.residuals,
                particle_cloud=part.particles,
            )
            summary.add(part)
        if not summary.evidence.rows and not joint:
            why = "no row is of the chosen targets and sensors; choose others"
            if request.method == "fix":
                why = "no time step of the chosen targets and sensors gives a position: it needs two directions "
                why += f"at one time ({option('window')}) with lines that meet; check angles and poses"
                if measured is not None:
                    why = "no time step of the chosen targets and stations gives a position; a fix needs 3 ranges, or "
                    why += f"as many other measurements, at one time ({option('window')})"
            raise InputError(f"{request.bearings}: {why}")
        made = provenance.with_checks(summary.checks())
        tables.annotate(made)
    console.note_findings(texts_of(made.judged, "track"), job.quiet)
    found = {"tracks": str(request.output), "method": request.method, **summary.figures(), **summary_of(made.judged)}
    return found, losses


def takes_distances(method: AnyMethod) -> bool:
    """Return whether a method takes ranges, signal strengths and time differences."""
    return isinstance(method, Online | Batch) and method.measured


def distance_measurements(
    request: TrackRequest, inputs: MeasurementInputs
) -> tuple[DistanceMeasurementFeed | None, dict[str, Any]]:
    """Open the distance measurements of the inputs; return their feed and their provenance entry.

    None and an empty entry without any.

    Raises:
        UsageError: settings of measurements that are missing, that the method does not use, or that a fitted path loss
            model states, too.
    """
    if inputs.measurements is None:
        if request.measured or request.path_loss is not None:
            first = next(iter(request.measured), "path_loss").replace("_", "-")
            raise UsageError(
                f"--{first} goes with ranges, strengths or time differences; give {option('measurements')}",
                id="missing-option",
            )
        return None, {}
    config = configure(DistanceMeasurementConfig.in_unit(inputs.scene.length_unit), dict(request.measured))
    method = tracker(request.method)
    if config.range_bias and not (isinstance(method, Batch) and method.biases):
        raise UsageError(
            f"range-bias: only method map estimates constant errors of ranges; give {option('method')} map",
            id="not-applicable",
        )
    radio = None if request.path_loss is None else radio_of(request, inputs.scene)
    name = None if request.path_loss is None else request.path_loss.name
    reported = {
        "measurements": {**asdict(config), "path_loss": name, "radio": None if radio is None else _note_inputs(radio)}
    }
    return DistanceMeasurementFeed(
        inputs.measurements, inputs.scene, config, radio, with_times=request.method == "fix"
    ), reported


def _note_inputs(radio: Radio) -> dict[str, Any]:
    """Return the provenance entry of a path loss model: its parameters by name."""
    return {**radio._asdict(), "shadowing": radio.shadowing._asdict()}


def radio_of(request: TrackRequest, scene: Scene) -> Radio:
    """Return the path loss model from the file of the request.

    Raises:
        UsageError: its unit is not that of the scene, or settings state the same parameters.
    """
    assert request.path_loss is not None
    spec = read_path_loss(request.path_loss)
    if spec.length_unit != scene.length_unit:
        raise UsageError(
            f"{request.path_loss}: lengths are in {spec.length_unit}, but the scene's in "
            f"{scene.length_unit}; fit path losses in this scene (`occlog fit-readers`)",
            id="unit-mismatch",
        )
    for twice in ("rssi_power", "rssi_exponent"):
        if twice in request.measured:
            raise UsageError(
                f"{option('path_loss')} and --{twice.replace('_', '-')} state the same quantity; give one of them",
                id="conflicting-options",
            )
    power = {r.name: r.power for r in spec.readers}
    return Radio(power, spec.exponent, SignalErrors(spec.noise_db, spec.shadow_db, spec.shadow_s), spec.height)


def estimates_poses(method: AnyMethod, config: Any) -> bool:
    """Return whether a method with the settings `config` estimates errors of sensor poses."""
    return isinstance(method, Online) and method.calibrates is not None and method.calibrates(config)


def one_at_a_time(
    chunks: Iterable[Bearings], scene: Scene, sensors: frozenset[str], seconds: float
) -> Iterator[Bearings]:
    """Generate the rows of one sensor at a time, in round-robin order of the scene, each for `seconds`.

    Sensors without a pose are skipped.

    Args:
        chunks: rows in the order of time.
        scene: scene with the sensors.
        sensors: names of the sensors in use.
        seconds: time of each turn [s].

    Raises:
        UsageError: no sensor is left.
    """
    blind = {c.name for c in scene.cameras if not c.placed}
    names = [n for n in sensor_names(scene) if n in sensors and n not in blind]
    if not names:
        raise UsageError(
            f"{option('round_robin')}: no sensor with a pose is left; exclude fewer "
            f"({option('without')}), or calibrate cameras",
            id="too-few-sensors",
        )
    return round_robin(checked(chunks, scene, sensors), names, seconds)


def make_config(request: TrackRequest, unit: str) -> Settings:
    """Return the settings of the method: defaults in the scene's length unit `unit`, changed by the request's options.

    Raises:
        UsageError: options that state the same quantity, or invalid values.
    """
    defaults = settings_of(request.method).in_unit(unit)
    values: dict[str, Any] = dict(request.settings)
    if request.motion is not None:
        values |= motion_settings(request.motion, unit, values)
    if request.initial_positions:
        if "start" in values:
            raise UsageError(
                f"{option('start')} and {option('set.start')} state the same quantity; give one of them",
                id="conflicting-options",
            )
        values["start"] = parse_starts(request.initial_positions, request.method, unit)
    if request.answer_delay is not None:
        if "answer_delay_s" in values:
            raise UsageError(
                f"{option('answer_delay')} and {option('set.answer_delay_s')} state the same quantity; give one "
                "of them",
                id="conflicting-options",
            )
        delay = request.answer_delay
        values["answer_delay_s"] = max_router_delay(delay) if isinstance(delay, Path) else delay
    return configure(defaults, values)


def motion_settings(path: Path, unit: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of method `map` that a fitted motion model from a file stands for, by name.

    Args:
        path: the file.
        unit: length unit of the scene.
        given: settings from the options, by name.

    Raises:
        UsageError: the file has another unit, or `given` states the same parameters.
    """
    motion = read_motion(path)
    if motion.length_unit != unit:
        raise UsageError(
            f"{path}: lengths are in {motion.length_unit}, but the scene's in {unit}; fit a "
            "motion model in this scene (`occlog fit-motion`)",
            id="unit-mismatch",
        )
    for name in ("A", "Sigma", "model_step_s", "process_noise_velocity", "process_noise_position"):
        if name in given:
            raise UsageError(
                f"{option('motion')} and {option('set')} {name}=... both state how targets move; give one of them",
                id="conflicting-options",
            )
    A, sigma = tuple(motion.A.ravel().tolist()), tuple(motion.sigma.ravel().tolist())
    return {"A": A, "Sigma": sigma, "model_step_s": motion.step_s}


def max_router_delay(path: Path) -> float:
    """Return the largest end-to-end delay [s] in a table of delays.

    A reply arrives within the cycle of the slowest router, from the detection to its final estimate, including the
    transfer of images.

    Raises:
        InputError: the table has no end-to-end delays.
        UsageError: it has delays of several cases.
    """
    delays = Delays.concat(list(open_input(path, Delays, remedy="make delays by `occlog traffic`").rows(Delays)))
    ends = delays.take(delays.kind == END_TO_END)
    names = zip(ends.protocol, ends.channel, ends.image_kb, ends.objects_share, strict=True)
    cases = sorted({f"{protocol}, {channel}, {kb:g} kB, {share:g}" for protocol, channel, kb, share in names})
    if not cases:
        raise InputError(f"{path}: has no end-to-end delays; make them with `occlog traffic`", id="missing-value")
    if len(cases) > 1:
        raise UsageError(
            f"{path}: has delays of {len(cases)} cases ({cases[0]}; {cases[1]}...); make those of "
            "one protocol, channel, image_kb and objects_share by `occlog traffic`",
            id="incompatible-inputs",
        )
    return float(ends.delay_s.max())


def make_selection(request: TrackRequest) -> SelectConfig | None:
    """Return the settings of the camera selection; None if the request has none.

    Raises:
        UsageError: options of the selection without --select, or a camera order with another policy than `fixed`.
    """
    given = request.select
    if not given:
        return None
    if "policy" not in given:
        raise UsageError(
            f"{option('n_cameras')}, {option('selection_interval')}, {option('max_blind_scans')}, "
            f"{option('select_model')} and {option('camera_order')} go with {option('select')}; add it",
            id="missing-option",
        )
    if "camera_order" in given and given["policy"] != "fixed":
        raise UsageError(
            f"{option('camera_order')} goes with {option('select')} fixed, not {given['policy']}",
            id="conflicting-options",
        )
    return configure(SelectConfig(), given)


def parse_starts(texts: tuple[str, ...], method: str, unit: str) -> str:
    """Return the value of the setting `start` of a method from texts of initial positions (X,Y or X,Y,SIGMA).

    For `imm` several are joined, each with a velocity. `unit` is the scene's length unit.

    Raises:
        UsageError: several positions for a method with one filter per target, or an invalid text.
    """
    if method == "imm":
        return ",".join(_with_velocity(text, unit) for text in texts)
    if len(texts) > 1:
        raise UsageError(
            f"{option('start')} is the position of one target; give it once, or use {option('method')} imm "
            f"(method {method})",
            id="not-applicable",
        )
    return parse_start(texts[0], unit)


def _with_velocity(text: str, unit: str) -> str:
    """Return X,Y,SIGMA,VX,VY,SIGMA_V from a text that is such, X,Y or X,Y,SIGMA.

    Without velocity: at rest, with the usual speed of method `imm` in `unit` as standard deviation.

    Raises:
        UsageError: another number of values.
    """
    parts = text.split(",")
    if len(parts) == START_NUMBERS:
        return text
    if len(parts) > 3:
        raise UsageError(f"{option('start')} {text}: expected X,Y, X,Y,SIGMA or X,Y,SIGMA,VX,VY,SIGMA_V")
    return f"{parse_start(text, unit)},0,0,{ImmConfig.in_unit(unit).sigma_initial_velocity}"


def parse_start(text: str, unit: str) -> str:
    """Return X,Y,SIGMA from X,Y[,SIGMA]; SIGMA is 0.5 m by default, 1 in a scene-specific `unit`.

    Raises:
        UsageError: another number of values.
    """
    parts = text.split(",")
    if len(parts) == 2:
        parts.append(str(0.5 / METRES[unit] if unit in METRES else 1.0))
    if len(parts) != 3:
        raise UsageError(f"{option('start')} {text}: expected X,Y or X,Y,SIGMA")
    return ",".join(parts)
