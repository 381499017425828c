"""Table of messages: every finding of a verdict and of `occlog doctor` by its id, with its text and its remedy.

Texts and remedies are templates of `str.format`: code states the id and the values.  `{sensors}` and `{targets}` are
those of the finding, and `{option[NAME]}` is an option in the spelling of the surface in use.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from typing import NamedTuple

from occlog.errors import option

MAX_NAMES = 3
"""Sensors or targets that a text names; the finding lists all."""
GAP_INTERVALS = 2.5
"""An interval of more than this many usual ones is a gap."""


class Severity(StrEnum):
    """Severity of a finding; `occlog doctor` states the reaction of a command that reads the file."""

    ERROR = "error"
    """The command stops, and states it (exit code 4)."""
    WARNING = "warning"
    """The result is not plausible; of a file: the command goes on, and something is lost or may be wrong."""
    NOTE = "note"
    """Worth knowing."""


class Message(NamedTuple):
    """Text and remedy of a kind of finding.

    Attributes:
        severity: how bad it is, unless the code states another severity.
        text: what is wrong, with the limit.
        remedy: what to do; empty: the text or a value states it.
        limit: of a finding of `occlog doctor`: what is allowed; empty: none can be stated, or the value states it.
    """

    severity: Severity
    text: str
    remedy: str = ""
    limit: str = ""

    def fill(self, sensors: Sequence[str] = (), targets: Sequence[int] = (), **values: object) -> str:
        """Text and remedy, joined by "; ", with the placeholders replaced by sensors, targets and the other values."""
        template = f"{self.text}; {self.remedy}" if self.remedy else self.text
        return template.format(option=_OPTIONS, sensors=listed(sensors), targets=listed(targets), **values)


class _Options:
    """Mapping for templates: `{option[initial_ellipses]}` is this option in the spelling of the surface in use."""

    def __getitem__(self, name: str) -> str:
        return option(name)


def listed(names: Sequence[object]) -> str:
    """First `MAX_NAMES` names, separated by commas, and how many more there are: `a, b, c, 2 more`."""
    more = [f"{len(names) - MAX_NAMES} more"] if len(names) > MAX_NAMES else []
    return ", ".join([*map(str, names[:MAX_NAMES]), *more])


_OPTIONS = _Options()
E, W, N = Severity.ERROR, Severity.WARNING, Severity.NOTE
_ROWS = "{count} of {rows} rows (allowed: {allowed:.0%}): "
_MEET = "{now:.0%} match within {gate:g} {unit}, {met:.0%} if tracks are changed ({change})"
VERDICT: dict[str, Message] = {
    # Estimates of one target, or of labelled targets
    "no-tracks": Message(
        N,
        "no target was found, and the tracks are empty",
        "check detections, calibration and the settings of track initiation",
    ),
    "particles-depleted": Message(
        W,
        "{share:.0%} of the rows have fewer than {least:.0f} effective particles (allowed: {allowed:.0%}): their "
        "covariances are too small",
        "use more particles, or state more measurement noise",
    ),
    "track-loss": Message(
        W,
        "the target was lost and the filter restarted in {count} of {rows} rows (allowed: {allowed:.0%})",
        "check the motion model, the noises and the labels",
    ),
    "gaps": Message(
        W,
        "{count} of {rows} rows follow a gap and restart the filter: rows are {interval_s:.3g} s apart",
        "use method fix, a larger max_gap_s, or state the unit (--input-units t=ms)",
    ),
    "targets-never-detected": Message(
        N,
        "no sensor detected {count} of {of} targets ({targets}): their rows only state where they may be",
        "add sensors, or leave these targets out",
    ),
    "selection-without-view": Message(
        W,
        "fewer than two of the selected sensors see the target in {count} of {rows} rows (allowed: {allowed:.0%})",
        "use {option[select]} greedy, or a larger {option[n_cameras]}",
    ),
    "region-edge": Message(
        W,
        _ROWS + "the target may be at the edge of the region that was guessed from the sensors",
        "add `room` to the scene",
    ),
    "single-sensor": Message(
        W,
        _ROWS + "a single sensor sees the target: its distance is unknown",
        "add a sensor, or use images and a target height (occlog ground)",
    ),
    "out-of-view": Message(
        W,
        _ROWS + "the estimate is outside the view of the sensors that detect the target",
        "check the calibration, the region and the labels",
    ),
    "undetected-in-view": Message(
        W,
        _ROWS + "no sensor detects the target, but its estimate is in clear view of cameras",
        "check labels and detector; it may be elsewhere",
    ),
    "inconsistent-sensor": Message(
        W,
        _ROWS + "most measurements of one sensor in the last second are rejected",
        "check its clock, pose, labels (occlog track --residuals)",
    ),
    "few-inliers": Message(W, _ROWS + "fewer than half of the bearings are accepted", "check poses, clocks and labels"),
    "unverified": Message(
        W,
        _ROWS + "only two measurements determine the position, and either may be false",
        "add sensors, or use {option[method]} apf or map",
    ),
    "possible-outlier": Message(
        W,
        _ROWS + "an accepted measurement may be false, so that another position would be right",
        "add sensors, or use {option[method]} apf or map",
    ),
    "infeasible-constraints": Message(
        W,
        _ROWS + "no position fulfils all constraints; the measurements there were omitted",
        "check the poses of the sensors and the labels",
    ),
    "no-path": Message(
        W,
        _ROWS + "the path passes through a wall, around which no path was found",
        "give a smaller max_state_gap_s (more states)",
    ),
    "not-converged": Message(
        W,
        _ROWS + "the search for the trajectory did not converge",
        "give a larger max_iterations",
    ),
    "unobservable": Message(
        N, _ROWS + "the measurements do not determine the position, so its covariance is large", "add sensors"
    ),
    "ambiguous": Message(
        N,
        _ROWS + "measurements fit several positions, which the covariance covers",
        "add a sensor elsewhere, or use method apf or map",
    ),
    "rival-mode": Message(
        W,
        "target {targets}: another path is nearly as probable (1 to {odds:.2g}), up to {distance:.3g} "
        "{unit} away in {count} of {rows} rows, from {first_s:.4g} to {last_s:.4g} s",
        "add a sensor, or give {option[start]}",
    ),
    "no-matching-region": Message(
        W,
        _ROWS + "no position is in range of exactly the readers that read the tag",
        "check or fit their ranges (occlog fit-readers)",
    ),
    "reads-unexplained": Message(
        W,
        _ROWS + "no position explained the reads",
        "check the path losses and the positions of the readers",
    ),
    # Residuals of measurements
    "measurements-rejected": Message(
        W,
        "{sensors}: {share:.0%} of {count} {what} are rejected (allowed: {allowed:.0%})",
        "check its pose, clock and labels, or whether the target was lost",
    ),
    "measurements-unconfirmed": Message(
        W,
        "{share:.0%} of {count} {what} are rejected, where sensors see the target one at a time (allowed: "
        "{allowed:.0%})",
        "add overlapping sensors, or check labels",
    ),
    "nis-large": Message(
        W,
        "{what} are {factor:.1f} times as far from the track as stated (NIS {nis:.2g}, allowed: {allowed:g})",
        "state more measurement noise, or check poses and clocks",
    ),
    "nis-small": Message(
        N,
        "the stated standard deviations of {what} are {factor:.1f} times too large (NIS {nis:.2g}, "
        "at least {allowed:g})",
        "state a smaller measurement noise",
    ),
    "process-noise-small": Message(
        W,
        "target {targets} moves {factor:.1f} times as irregularly as the process noise states (allowed: "
        "{allowed:.1f} times)",
        "state a larger {setting}",
    ),
    "labels-exchanged": Message(
        W,
        "bearings of targets {targets} have exchanged labels (target_id) from {begin_s:.4g} s to {until} {where} "
        "(here {done})",
        "check the labels; {option[keep_labels]} keeps them",
    ),
    "sensor-turned": Message(
        W,
        "bearings of {sensors} are {size:+.2g} +- {error:.1g} degrees off those of the other sensors (allowed: "
        "{allowed:.1g}){rivals}",
        "subtract it from its yaw, or use occlog calibrate",
    ),
    "sensor-late": Message(
        W,
        "time stamps of {sensors} are {offset} +- {error:.1g} s too {sense} (allowed: {allowed:.1g}){rivals}",
        "ingest with --clock-offset {sensors}={correction}",
    ),
    "sensors-unverified": Message(
        N,
        "no third sensor sees the targets of {sensors}: a wrong yaw or clock leaves no trace, and moves the tracks",
        "check poses and clocks, or add a sensor",
    ),
    "sensor-noise-small": Message(
        W,
        "bearings of {sensors} scatter by {factor:.2g} times their stated standard deviation (allowed: {allowed:g})",
        "state a larger one: noise of the scene, or detect --sigma-px",
    ),
    "range-bias": Message(
        W,
        "ranges of {sensors} are {size:.2g} +- {error:.1g} {unit} too {sense} (allowed: {allowed:.1g}){rivals}",
        "use occlog track --method map --range-bias, or subtract it from them",
    ),
    "ranges-fit-if": Message(
        W,
        "ranges meet to {misfit:.2g} {unit} (as given {given:.2g}) if {change}",
        "correct the table or the scene",
    ),
    "outliers": Message(
        W,
        _ROWS + "bearings of {sensors} contradict the motion; other bearings may be false too",
        "use method map or apf, or check labels",
    ),
    "label-jump": Message(
        W,
        "bearings with target_id {targets} jump by {distance:.3g} {unit} at {at_s:.4g} s ({count} jumps): {speed:.3g} "
        "{unit}/s (allowed: {allowed:.3g})",
        "check the clocks, and whether another target got the label",
    ),
    "outside-room": Message(
        W,
        "the bearings meet outside the room in {count} of {rows} rows (allowed: {allowed:.0%})",
        "check the poses, and enlarge the room if the target left it",
    ),
    "detection-through-wall": Message(
        W,
        "{sensors} sees the target behind a wall in {count} of {rows} rows (allowed: {allowed:.0%})",
        "check occluders, room and poses of the scene",
    ),
    "several-targets": Message(
        W,
        "of {candidates:.1f} candidates a frame in {sensors}, {unassociated:.1f} persist near no track, as of "
        "further targets",
        "use method jipda, label candidates, or give {option[start]}",
    ),
    "compass": Message(
        W,
        "bearings seem to be clockwise from north (compass): misfit {misfit_deg:.2g} degrees, as given {given_deg:.2g}",
        "name the column compass_deg, or give ingest --doa-convention compass",
    ),
    "bearings-fit-if": Message(
        W,
        "bearings meet to {misfit_deg:.2g} degrees (as given {given_deg:.2g}) if {change}",
        "correct the table or the scene",
    ),
    "sensor-frozen": Message(
        W,
        "{sensors}: {count} identical {what} in {duration_s:.3g} s from {begin_s:.4g} s on, while others change",
        "leave these rows out if its program or link had stopped",
    ),
    "noise-unit": Message(
        W,
        "bearings of {sensors} scatter by {scatter_deg:.2g} degrees, and state {sigma_deg:.2g}: their sigma may be in "
        "{unit}",
        "name it after its unit: sigma_deg, sigma_rad (scene: sigma)",
    ),
    "measurement-noise-small": Message(
        N,
        "{count} bearings of {sensors} state standard deviations as small as {least_rad:.2g} rad (below "
        "{allowed:g} rad)",
        "give their true standard deviations",
    ),
    # Estimates against the truth
    "no-covariance": Message(
        N,
        "estimates have no covariance, so that errors and residuals are not compared with it",
        "give tracks with cov_xx, cov_xy and cov_yy",
    ),
    "truth-of-another-target": Message(
        W,
        "the bearings agree with the tracks (NIS {nis_of_tracks:.2g}), not with the truth (NIS {nis:.2g}, allowed: "
        "{allowed:.0f})",
        "give the truth of this target, with times of the same clock",
    ),
    "tracks-delayed": Message(
        W,
        "tracks are {delay_s:.2g} s (+- {sigma_s:.1g}) {side} the truth: RMSE {rmse:.3g}, without the delay "
        "{without:.3g} {unit}",
        "check frame numbers, clocks and process noise",
    ),
    "tracks-clock-drift": Message(
        W,
        "tracks: clock about {ppm:.2g} ppm too {side} for the truth: RMSE {rmse:.3g}, without {without:.3g} {unit}",
        "check frame rates (29.97 for 30 fps) and clocks",
    ),
    "time-unit-differs": Message(
        W,
        "times of tracks and truth differ in unit: " + _MEET,
        "{remedy}",
    ),
    "times-in-days": Message(
        W,
        "times of the {which} are in days: {now:.0%} match within {gate:g} {unit}, {met:.0%} with {change}",
        "write seconds, or dates as 2024-05-01T12:00:00.25Z",
    ),
    "times-shifted": Message(
        W, "times of tracks and truth differ by a shift: " + _MEET, "check first frame numbers, start times and clocks"
    ),
    "frame-rate-differs": Message(
        W, "frame rates of tracks and truth differ: " + _MEET, "check the frame rates of both"
    ),
    "length-unit-differs": Message(
        W,
        "lengths of tracks and truth differ in unit: " + _MEET,
        "{remedy}",
    ),
    "axes-differ": Message(
        W,
        "world axes of tracks and truth differ: " + _MEET,
        "give the truth in the world of the scene",
    ),
    "tracks-doubled": Message(
        W,
        "{count:.1f} tracks are within {gate:g} {unit} of a true position: the file may hold tracks of several runs",
        "evaluate each run by itself, or remove duplicate tracks",
    ),
    "occluders-tracked": Message(
        N,
        "{share:.0%} of the occluders in the truth have a track, which counts as a false one",
        "state role target in the truth for all people that are to be tracked",
    ),
    "truth-frames-in-steps": Message(
        W,
        "the truth has one frame in {step} only: {share:.0%} of the tracks' boxes are in others and count as false",
        "leave these frames out of the tracks",
    ),
    "boxes-fit-if": Message(
        W,
        "boxes of tracks and truth differ: {now:.0%} overlap a true one, {fit:.0%} if tracks are changed ({change})",
        "check frame numbers, image size and columns of both",
    ),
    "covariances-singular": Message(
        W,
        "{count} of {rows} estimates have a singular covariance (allowed: {allowed:.0%})",
        "use more particles, or state more measurement noise",
    ),
    "nees-large": Message(
        W,
        "the covariances are too small for the errors (mean NEES {nees:.3g}, allowed: {allowed:.0f}; {outside:.0%} "
        "outside of 95 %, allowed: {allowed_outside:.0%})",
        "state more noise, check the truth",
    ),
    "nees-small": Message(
        N,
        "the covariances are too large: errors are {factor:.1f} times smaller (mean NEES {nees:.3g}, allowed: "
        "{allowed:.2g} and more)",
        "state less noise",
    ),
    "low-detection-rate": Message(
        W,
        "only {share:.0%} of the visible targets are detected at their true position (expected: {allowed:.0%} "
        "and more)",
        "check truth, clocks and calibration",
    ),
    "error-far-above-bound": Message(
        N,
        "the RMSE is {ratio:.1f} times the Cramer-Rao bound (usual: up to {allowed:.0f})",
        "check the tracker, and the motion model of the bound ({option[motion]})",
    ),
    # Multi-camera tracks of people
    "no-boxes": Message(
        N,
        "camera {sensors} has no box at any time",
        "check its name in the boxes, and whether a file of boxes is missing",
    ),
    "boxes-duplicated": Message(
        W,
        "camera {sensors}: {count} of {boxes} boxes duplicate another one of the frame (allowed: {allowed:.0%})",
        "they are skipped; check the non-maximum suppression",
    ),
    "boxes-outside-image": Message(
        W,
        "camera {sensors}: {count} of {boxes} boxes are outside the image (allowed: {allowed:.0%})",
        "check the image size of the calibration, and that the boxes are of this camera",
    ),
    "boxes-skipped": Message(
        W,
        "camera {sensors}: ingest skipped {count} of {boxes} boxes outside the image (allowed: {allowed:.0%})",
        "check the image size of the calibration",
    ),
    "boxes-unassociated": Message(
        W,
        "{share:.0%} of {boxes} boxes are associated with no track (allowed: {allowed:.0%})",
        "check poses, ground and unit of the calibration, and the class of the boxes",
    ),
    "camera-fits-if": Message(
        W,
        "only {now:.0%} of the people that other cameras see have a box; {fit:.0%} would if {change}",
        "correct the calibration or the files of boxes",
    ),
    "camera-error": Message(
        W,
        "{change}, by the boxes of several cameras",
        "correct the calibration or the times of this camera",
    ),
    "camera-gap": Message(
        W,
        "camera {sensors} has no box from {begin_s:.1f} to {end_s:.1f} s, though others detect people in its view "
        "({people} detections)",
        "check whether its boxes are complete",
    ),
    "camera-unassociated": Message(
        W,
        "camera {sensors}: {count} of {boxes} moving boxes are associated with no track (allowed: {allowed:.0%})",
        "check its extrinsics, image size and boxes",
    ),
    "camera-alone": Message(
        N,
        "camera {sensors} shares no person with another camera; {count} rows rest on it alone",
        "check its pose if its view overlaps with that of another camera",
    ),
    "people-outside-room": Message(
        W,
        "people are outside the room in {count} of {rows} rows (allowed: {allowed:.0%}), seen by {sensors}",
        "check the poses of these cameras, and the room of the scene",
    ),
    "camera-below-ground": Message(
        W,
        "camera {sensors} is below the ground (z < 0)",
        "check the vertical and the ground height of the calibration (ingest --up, --ground-height)",
    ),
    "camera-inconsistent": Message(
        W,
        "camera {sensors} detects {share:.0%} of the people in its view that others detect (allowed: {allowed:.0%} "
        "and more)",
        "check its clock, pose, boxes and video",
    ),
    "camera-clock-offset": Message(
        W,
        "camera {sensors}: its time stamps seem {offset} s too {sense}: as given it detects {share:.0%} of the people "
        "that others detect",
        "ingest with --clock-offset {sensors}={correction}",
    ),
    "camera-late": Message(
        W,
        "camera {sensors}: its time stamps are {offset} s too {sense} (allowed: {allowed:.1g}); later rows are "
        "corrected",
        "ingest with --clock-offset {sensors}={correction} to correct all",
    ),
    "camera-clock-drift": Message(
        W,
        "camera {sensors}: its clock gains {ppm:+.0f} ppm (minus: loses; significant: {allowed:.0f}), {size} s in all",
        "estimate the drift (occlog calibrate), and track with its scene",
    ),
    "camera-rotated": Message(
        W,
        "camera {sensors} is rotated from its calibration by {yaw_deg:+.1f} deg about the vertical, "
        "{pitch_deg:+.1f} deg about its horizontal axis; later rows are corrected",
        "calibrate again",
    ),
    "camera-not-calibrated": Message(
        W,
        "camera {sensors} shares too few people with the others and is left as it was stated",
        "record people who walk where views overlap, or from its view to others",
    ),
    "no-common-view": Message(
        N,
        "no two cameras share a view: poses are from {count} passages of one person between views, with equal clocks",
        "compare the poses with a floor plan",
    ),
    "views-disagree": Message(
        W,
        "camera {sensors} detects at most {share:.0%} of people that others see in its view (needed: {allowed:.0%}): a "
        "wrong pose",
        "give rough poses, or record one person at a time",
    ),
    "levels-not-stated": Message(
        W,
        "camera heights or tilts are estimated: standard deviations may be 3 times too small",
        "measure them; {option[set]} sigma_height=0.02 (m), {option[set]} sigma_tilt=0.2 (deg)",
    ),
    "passages-ambiguous": Message(
        W,
        "{count} of {total} passages from view to view may be of several people and are not used",
        "record one person at a time",
    ),
    "parameter-undetermined": Message(
        W,
        "camera {sensors}: the boxes do not determine its {parameter}, which is left as stated",
        "record people at more distances, or give a better value",
    ),
    "adjustment-not-converged": Message(
        W,
        "the bundle adjustment did not converge in its maximum of iterations",
        "use a longer recording, or more rounds of association and adjustment ({option[set]} rounds=4)",
    ),
    "camera-moved-far": Message(
        W,
        "camera {sensors} is {distance:.2g} m and {yaw_deg:.2g} deg from its stated pose, which is significant",
        "check the stated pose, or raise {option[sigma_position]} and {option[sigma_angle]}",
    ),
    "clock-offset-found": Message(
        N,
        "time stamps of {sensors} are {offset} +- {sigma_s:.3f} s too {sense}; the calibrated scene holds this offset",
        "ingest with this scene, or with {option[clock_offset]} {sensors}={correction}",
    ),
    "array-placed": Message(
        N,
        "microphone array {sensors} is {distance:.2g} m and {yaw_deg:+.3g} deg from its stated pose",
        "track with the calibrated scene, by which recorded directions are rotated, too",
    ),
    "array-not-calibrated": Message(
        W,
        "microphone array {sensors} is left as it was stated: {reason}",
        "record people who walk and speak where cameras see them",
    ),
    "lens-from-people": Message(
        N,
        "camera {sensors}: focal length {focal:.0f} px (+- {sigma:.0f}), estimated from people",
        "calibrate it with a chessboard ({option[board]} 9x6) if you can",
    ),
    "board-coverage": Message(
        W,
        "camera {sensors}: the board was in {share:.0%} of the image (needed: {allowed:.0%}); elsewhere the lens "
        "distortion is unknown",
        "record the board at the borders",
    ),
    "board-residual": Message(
        W,
        "camera {sensors}: the reprojection error of the board's corners is {residual:.2g} px (allowed: {allowed:.2g})",
        "record a flat board that is held still, with fixed focus",
    ),
    "clock-drift-found": Message(
        N,
        "the clock of camera {sensors} gains {ppm:+.1f} ppm (+- {sigma_ppm:.1f} ppm; minus: loses) on the "
        "others; the calibrated scene holds this drift",
        "ingest again with this scene",
    ),
    "clock-drift-undetermined": Message(
        N,
        "the recording does not determine the drift of the clock of camera {sensors}, which is left at 0",
        "use a longer recording if clocks drift",
    ),
    "camera-times-disjoint": Message(
        W,
        "camera {sensors} has no time in common with another camera: it begins {offset_s:+.10g} s after the "
        "others{cause}",
        "check its clock (ingest --clock-offset)",
    ),
    "calibration-inconsistent": Message(
        W,
        "camera {sensors}: people are {height:.3g} {unit} tall, unlike in the other cameras",
        "check its calibration, or leave it out",
    ),
    "correlated-region-errors": Message(
        N,
        "errors of background subtraction last for many frames: smoothed covariances are too small where people are "
        "close",
        "use boxes of a detector",
    ),
    "common-position-error": Message(
        N,
        "all cameras share an error of position of {sigma:.2g} {unit} per axis that lasts {time_s:.2g} s; the "
        "covariances contain it",
        "check the person height and the calibrations",
    ),
    "static-clutter": Message(
        N,
        "camera {sensors}: static objects that are reported as people ({count}) are not tracked",
        "mask pictures, statues and screens in the images (black)",
    ),
    "speeds-high": Message(
        W,
        "people are too fast: {speed:.2g} {unit}/s ({which}; limit {allowed:.2g}), and {births_per_s:.2g} tracks "
        "a second begin",
        "check the frame rate (ingest --fps) and the unit of times",
    ),
    "speeds-low": Message(
        W,
        "people are too slow: below {allowed:.2g} {unit}/s along {count} of {of} path segments of {leg:.2g} {unit}",
        "check the frame rate (ingest --fps) and the unit of times",
    ),
    "frame-numbers-sparse": Message(
        W,
        "camera {sensors}: only {count} of {frames} frame numbers follow the one before by 1 (expected: {allowed:.0%})",
        "number frames 0, 1, 2, ... in the file of boxes",
    ),
    "identity-switches-likely": Message(
        W,
        "about {switches:.1f} possible identity switches at close encounters ({per_person:.2f} per person; warning "
        "limit: {allowed:g})",
        "see them in {option[events]}",
    ),
    # Tracks in images
    "no-view-tracks": Message(
        N,
        "no target was found",
        "give initial ellipses ({option[initial_ellipses]}), or better {option[detections]}",
    ),
    "too-many-targets": Message(
        W,
        "view {sensors}: {per_frame:.0f} targets per frame (allowed: {allowed:.0f}) cannot all be people",
        "give the size of people (occlog detect --person-height-px), or boxes of a detector",
    ),
    "initial-ellipses-unused": Message(
        N,
        "{count} of {given} initial ellipses began no tracker: their times are after the end of the video",
        "check their times or frame numbers",
    ),
    "view-without-tracks": Message(
        N,
        "no initial ellipse began a tracker in {sensors}: nothing is tracked there",
        "give ellipses of this view, or omit it ({option[without]})",
    ),
    "single-view": Message(
        N, "there is one view only, so other views cannot assist it: {option[method]} {method} {does}"
    ),
    "views-without-links": Message(
        N,
        "no geometry links the views: {option[method]} {method} {does}",
        "give matrices ({option[fundamental]}) or poses",
    ),
    "view-ends-early": Message(
        N,
        "view {sensors} ends {early_s:.3g} s before the others, after {frames} frames",
        "check whether its video is complete",
    ),
    "fundamental-misfit": Message(
        W,
        "views {sensors}: the fundamental matrix does not fit: in {share:.0%} of {checks} checks a target is off its "
        "epipolar line (median {median_px:.0f} px)",
        "give another ({option[fundamental]})",
    ),
    "ground-single-view": Message(
        N,
        "{count} of {rows} positions are from a single view, at half a person's height",
        "to omit them: {option[set]} target_height=0",
    ),
    "ground-inconsistent-views": Message(
        N,
        "{count} of {rows} positions: the tracker of one view is on another object than those of the others; the "
        "covariance is enlarged",
    ),
    "ground-possible-switch": Message(
        N,
        "{count} of {rows} positions: a possible identity switch, which the covariance includes",
        "such rows have quality_flags possible_switch",
    ),
    "ground-single-view-targets": Message(
        N,
        "identities in a single view only, which may be false tracks: {targets}",
        "compare them with the images",
    ),
    "ground-views-disagree": Message(
        N,
        "positions of the views differ {factor:.1f} times as much as their covariances state",
        "check calibration and clocks, or raise centre_error_share (occlog ground)",
    ),
    # Calibrations and files of `ingest`
    "world-left-handed": Message(
        W,
        "everything is behind all cameras: the world seems left-handed (Unity, MultiviewX)",
        "mirror it ({option[mirror]} y), or for OpenGL cameras negate rows 2 and 3 of R and t",
    ),
    "world-mirrored": Message(
        W,
        "everything is behind all cameras in the mirrored world: the calibration's own is right-handed",
        "leave {option[mirror]} out",
    ),
    "world-not-upright": Message(
        W,
        "the world of the calibration seems not to be upright: by the horizons up is {up}, {off_deg:.0f} deg from {of}",
        "rotate it (ingest {mirror}--up {turn})",
    ),
    "extrinsics-fit-if": Message(
        W,
        "convention of extrinsics: if they are {change}, all cameras are upright and see one place",
        "correct the calibration",
    ),
    "camera-extrinsics-fit-if": Message(
        W,
        "camera {sensors}: convention of its extrinsics: if they are {change}, it is upright and sees what others see",
        "correct its file of the calibration",
    ),
    "scene-angles-fit-if": Message(
        W,
        "cameras of the scene view one place below them only if {change}",
        "correct the angles: degrees in yaw_deg, radians in yaw, from +x towards +y, pitch upwards",
    ),
    "vertical-uncertain": Message(
        W,
        "the vertical is uncertain, as all cameras have the same viewing direction: their pitch is assumed to be 0",
        "state the vertical ({option[up]} X,Y,Z)",
    ),
    "camera-not-above-ground": Message(
        W,
        "camera {sensors} is not above the ground (the lowest has z = {lowest:.2f} {unit})",
        "state the height of the ground along up ({option[ground_height]}), negative below the origin",
    ),
    "calibration-keys-unused": Message(
        W,
        "the calibration has keys that may change the cameras, but are not used: {keys}",
        "if one of them does, give a calibration of another format",
    ),
    "calibration-keys-other": Message(
        N, "the calibration has further keys that are not used: {keys}", "check whether one of them changes the cameras"
    ),
    "camera-distances-implausible": Message(
        W,
        "cameras are {span:.3g} m apart (expected: {least:g} to {most:g} m)",
        "state the unit of the calibration ({option[calibration_unit]}), or, if all have one pose, calibrate "
        "extrinsics",
    ),
    "camera-unit-differs": Message(
        W,
        "camera {sensors} is {away:.3g} m from the others, which are {span:.3g} m apart: its translation may be in mm",
        "write one unit for all cameras (divide it by 1000)",
    ),
    "cameras-same-pose": Message(
        W,
        "cameras {sensors} have exactly the same pose",
        "check whether the extrinsics of one were copied to the other",
    ),
    "principal-point-off": Message(
        W,
        "camera {sensors}: its principal point is the middle of images of {middle} px, not of {size} px ({change})",
        "check of which image size the camera matrix is",
    ),
    "distortion-missing": Message(
        W,
        "camera {sensors}: the calibration has no distortion, that of {other} with the same focal length has "
        "{offset_px:.0f} px at the border",
        "add its distortion coefficients",
    ),
    "focal-lengths-differ": Message(
        W,
        "camera {sensors}: focal lengths of {fx_px:.4g} and {fy_px:.4g} px, which means pixels that are not square",
        "check whether one row of its matrix is of images of another size",
    ),
    "images-before-rotation": Message(
        W,
        "camera {sensors}: rotation_count {turns} is not applied: the calibration is of images before their rotation",
        "give images before the rotation, or boxes of them",
    ),
    "time-shifts-unused": Message(
        W,
        "timeshift_cam_imu of Kalibr differs between the cameras and is not used",
        "give {options}",
    ),
    "boxes-end-inside": Message(
        W, "boxes of every camera reach to {found} px, though images have {stated} px (factor {factor:.4g})", "{hint}"
    ),
    "boxes-end-beyond": Message(
        W,
        "camera {sensors}: {share:.0%} of its boxes end beyond its images, at up to {found} px (allowed: "
        "{allowed:.0%})",
        "check {option[image_size]}, and that the boxes are of these images",
    ),
    "boxes-frame-id-exchanged": Message(
        W,
        "camera {sensors}: {share:.0%} of boxes with identities n and n + 1 of a frame overlap, as in "
        "frames of one person",
        "exchange the columns of frames and identities",
    ),
    "boxes-in-parts": Message(
        W,
        "camera {sensors}: its boxes end at {whole} in x and y, though images have {stated} px: they may be parts of "
        "{whole}",
        "multiply x by width / {whole}, y by height / {whole}",
    ),
    "boxes-restart": Message(
        W,
        "camera {sensors}: line {line}: frames begin again ({after} after {before}): two recordings in one file",
        "split the file there, and ingest each part with its own times",
    ),
    "boxes-counter-restart": Message(
        W,
        "camera {sensors}: line {line}: frame {after} after {before}: a counter of {bits} bits began again",
        "add {count} to the frames from there on",
    ),
    "boxes-wide": Message(
        W,
        "camera {sensors}: {share:.0%} of boxes are wider than high, unlike people (allowed: {allowed:.0%})",
        "check the order of columns (x, y), and whether images were rotated",
    ),
    "boxes-identical": Message(
        W,
        "cameras {sensors}: {share:.0%} of their boxes are identical (allowed: {allowed:.0%})",
        "check whether one file or video was used for both",
    ),
    "boxes-corners": Message(
        W,
        "camera {sensors}: widths and heights of boxes seem to be right and lower edges (xyxy for xywh): "
        "{share:.0%} end beyond its images",
        "name the columns right and bottom",
    ),
    "rows-duplicated": Message(
        N,
        "{file}: {what} skipped, as exact duplicates of rows of this file or an earlier one",
    ),
    "bag-count-differs": Message(N, "topic {topic}: {remark}"),
    "topic-frames": Message(
        W,
        "topic {topic}: messages with several frame_ids ({frames}) are taken for those of one sensor",
        "publish each sensor on its own topic, unless the frame was only renamed",
    ),
    "stamps-missing": Message(W, "topic {topic}: its headers have no time", "the times of recording are used"),
    "stamps-late": Message(
        W,
        "topic {topic}: recorded {low_s:.3g} to {high_s:.3g} s after its header stamps{cause}; the {used} are used",
        "choose the right ones ({option[timestamp_source]} header or log)",
    ),
    "stamps-since-boot": Message(
        W,
        "topic {topic}: header stamps count from another epoch: {low_s:.3g} s before recording{cause}; the "
        "{used} are used",
        "choose the right ones ({option[timestamp_source]} header or log)",
    ),
    # Stages before tracking, and batches
    "sensor-times-disjoint": Message(
        W,
        "{sensors} has no time in common with others: it begins {offset_s:+.10g} s after them{cause}",
        "check its clock and unit of times, or give an offset ({option[clock_offset]})",
    ),
    "clock-jump": Message(
        N,
        "{sensors}: its times jump by {jump_s:.6g} s at {time}{cause}",
        "check whether its clock was set or the recording interrupted",
    ),
    "recorder-clock": Message(
        N,
        "the clock of the recorder: times of recording {what}, against the header stamps of all topics",
        "use {option[timestamp_source]} header",
    ),
    "clock-offset": Message(
        W,
        "camera {sensors}: its times are {offset_s:+.6g} s after those of {other} at equal frame numbers{cause}",
        "check its clock, or give {option[clock_offset]} {sensors}={correction}",
    ),
    "clock-drift": Message(
        W,
        "{sensors}: its times gain {ppm:+.4g} ppm (minus: lose) on {other}",
        "check its clock and frame rate, or state the drift of its clock (drift_ppm) in a scene",
    ),
    "clock-rate-differs": Message(
        W,
        "{sensors}: its times advance at {factor} of the rate of {other}, too different for a clock drift",
        "check the unit of its times, and its frame rate",
    ),
    "rate-implausible": Message(
        W,
        "{sensors}: {rate_hz:.3g} frames a second (expected: {least:g} to {most:g})",
        "check the unit of its times (columns t_ms, t_s) or {option[fps]}",
    ),
    "truth-rate-implausible": Message(
        W,
        "truth: {rate_hz:.3g} positions of a target a second (expected: up to {most:g})",
        "check the unit of its times, which must not be days of Excel or MATLAB",
    ),
    "times-count-frames": Message(
        N,
        "{sensors}: the times of boxes increase by 1 s a frame, and may be numbers of frames",
        "if so, give {option[fps]} RATE, which replaces them",
    ),
    "time-stamps-unit": Message(
        W,
        "{sensors}: the unit of its times seems wrong: they span {ratio:.3g} times as much as those of {other}",
        "name their column after its unit (t_ms, t_s)",
    ),
    "pictures-turned": Message(
        N,
        "camera {sensors}: its images were {how} on reading, as the metadata of the file ask",
        "use a calibration of images with this rotation",
    ),
    "pictures-not-turned": Message(
        N,
        "camera {sensors}: its images are stored as coded, and not {how} as the metadata of the file ask",
        "use a calibration of images as they are coded",
    ),
    "pixels-not-square": Message(
        N,
        "camera {sensors}: its pixels are {across:g} wide to {down:g} high; the images are not stretched",
        "use a calibration of images that are not stretched",
    ),
    "values-dim": Message(
        N,
        "camera {sensors}: its first image has 16-bit values up to about {most:.0f} of 65535, so images are "
        "stored dark",
        "scale them to the whole range",
    ),
    "video-tracks": Message(
        N,
        "camera {sensors}: its file has {count} video tracks, of which the first is read",
        "extract another one: ffmpeg -i IN -map 0:v:1 -c copy OUT",
    ),
    "videos-identical": Message(
        W, "cameras {sensors} have one and the same video", "give each camera its own, or leave one out"
    ),
    "pictures-black": Message(
        W,
        "camera {sensors}: all {count} images are black (values up to {most:.0f} of 255)",
        "check lens cap, exposure, and how they were converted",
    ),
    "pictures-black-run": Message(
        W,
        "camera {sensors}: images {first} to {last} are black, for {seconds:.3g} s from {time} on{more}",
        "check whether it was covered, or the light off",
    ),
    "pictures-identical": Message(
        W, "camera {sensors}: all {count} images are identical", "check whether its stream or recorder stood still"
    ),
    "video-start": Message(
        N,
        "camera {sensors}: the first frame of its video is stamped {start_s:.6g} s, and counts as 0",
        "if the videos have one clock, give {option[start_time]} {sensors}={start_s:.6g}",
    ),
    "camera-frozen": Message(
        W,
        "camera {sensors}: {count} identical frames in {duration_s:.3g} s from {time}, while others go on",
        "if its stream had stopped, omit these frames",
    ),
    "boxes-repeated": Message(
        W,
        "camera {sensors}: boxes change in one of {n} frames only, and repeat for {lag_s:.2g} s (allowed: {allowed:g})",
        "leave the repeated frames out and keep the frame numbers",
    ),
    "boxes-looped": Message(
        W,
        "camera {sensors}: from {time} boxes of {count} frames equal those {later_s:.4g} s before, in no other camera",
        "its video was played again: omit them",
    ),
    "boxes-end-early": Message(N, "camera {sensors}: its boxes end at frame {last} of {frames} of its images; {hint}"),
    "truth-times-disjoint": Message(
        W,
        "the truth and the measurements have no time in common: they are {separation_s:.6g} s apart",
        "check start time, unit of times and clock",
    ),
    "no-detections": Message(
        N,
        "camera {sensors} has no detection in {frames} frames, while {other} has one in {share:.0%}",
        "check its images, its view and the expected size of people",
    ),
    "cameras-without-pose": Message(
        N,
        "no camera has a pose in space, so that there are no bearings",
        "ingest with a calibration, give {option[scene]}, or track in the images (occlog track --method sort)",
    ),
    "nothing-detected": Message(
        W,
        "no detection in {frames} frames of camera {sensors}",
        "check the images and the size of people, or choose another {option[method]}",
    ),
    "target-never-detected": Message(
        W,
        "target {targets} is never detected in {rows} frames",
        "check that its appearance is from video of this kind (colour or grey), and {option[min_similarity]}",
    ),
    "background-used": Message(
        N,
        "camera {sensors}: the network finds people in {found} of {frames} frames, but regions of their size "
        "move in {moving}; background subtraction is used instead",
    ),
    "static-detection": Message(
        N,
        "camera {sensors}: detection at about ({u_px:.0f}, {v_px:.0f}) px in {share:.0%} of its frames (noted from "
        "{allowed:.0%})",
        "if it is a false alarm, mask this position in the images (black)",
    ),
    "microphone-silent": Message(
        W,
        "array {sensors}: microphone {microphones} has under {allowed:.0%} of the level of the others",
        "check its cable and {option[channels]} (from 1), or remove it",
    ),
    "microphone-interrupted": Message(
        W,
        "array {sensors}: microphone {microphones} falls silent: no level in {share:.0%} of the sound of the others",
        "check its cable, or use a part of the recording with its sound",
    ),
    "microphones-identical": Message(
        W,
        "array {sensors}: microphones {microphones} have the same signal, so that directions are wrong",
        "check how the channels were recorded and their order",
    ),
    "microphone-drifts": Message(
        W,
        "array {sensors}: the clock of microphone {microphones} is {ppm:.0f} ppm {side}, by its delays to the others",
        "record all channels with one clock, or resample the channel",
    ),
    "microphone-late": Message(
        W,
        "array {sensors}: microphone {microphones} is {side} by {samples} samples, by its delays to the others",
        "record all channels with one clock, or shift the channel",
    ),
    "microphone-unrelated": Message(
        W,
        "array {sensors}: microphone {microphones} has no sound in common with the others",
        "check its cable and {option[channels]} (from 1), or remove it",
    ),
    "microphone-inverted": Message(
        W,
        "array {sensors}: microphone {microphones} is inverted: it has the opposite sign of the others",
        "exchange the wires of its cable, or negate the channel",
    ),
    "microphones-exchanged": Message(
        W,
        "array {sensors}: microphones {microphones} seem exchanged: delays fit a plane wave only then (as given, "
        "{misfit:.2g} samples off)",
        "check the order of the channels",
    ),
    "array-size-implausible": Message(
        W,
        "array {sensors}: measured delays are {share:.2g} times the longest that its microphones' positions allow",
        "check the unit of these positions and the sampling rate",
    ),
    "microphones-inconsistent": Message(
        W,
        "array {sensors}: delays are {misfit:.2g} samples off a plane wave, so that directions are wrong{cause}",
        "check order, clock and microphone positions of the channels",
    ),
    "microphone-gain": Message(
        N,
        "array {sensors}: microphone {microphones} is {level:.0f} dB {side} than others (noted from {allowed:.0f} dB)",
        "check its gain; directions do not depend on it",
    ),
    "clipped": Message(
        N,
        "array {sensors}: microphone {microphones} is at full scale in {share:.1%} of the samples (noted from "
        "{allowed:.1%})",
        "record at a lower gain",
    ),
    "no-directions": Message(
        N,
        "array {sensors} has no direction: of {frames} frames {silent} are silent, {unsure} of low confidence",
        "check levels and gain, or give a lower {option[min_confidence]}",
    ),
    "many-detections-rejected": Message(
        W,
        "camera {sensors}: {count} of {detections} detections contradict the other cameras (allowed: {allowed:.0%})",
        "check its pose, clock and labels",
    ),
    "group-without-tracks": Message(
        N,
        "{file}: contains no tracks of people",
        "track this group of cameras again, or omit its file",
    ),
    "group-times-disjoint": Message(
        W, "{file}: has no time in common with the tracks of the camera groups before it", "check its clock"
    ),
    "group-without-common-targets": Message(
        W,
        "{file}: no person matches the tracks of the camera groups before it, in {steps} time steps",
        "if both see the same positions, check poses and clocks",
    ),
    "group-misaligned": Message(
        W,
        "{file}: tracks are {offset:.3g} {unit} off those of the camera groups before it "
        "(allowed: {allowed:.3g} {unit})",
        "check poses and clocks",
    ),
    "recording-not-plausible": Message(
        W,
        "{recording}: {warning}",
        "see its warnings in the table of runs",
    ),
}
"""Findings of verdicts by id."""
_EACH_LATER = "increasing times"
DOCTOR: dict[str, Message] = {
    "unreadable": Message(
        E,
        "cannot be read",
    ),
    "unknown": Message(
        W,
        "not a file that occlog can read",
        "name a recording, a table, a scene or a video",
    ),
    "no-table": Message(
        N,
        "its columns are not those of an occlog table, so that its rows are not checked",
    ),
    "not-checked": Message(
        W,
        "not all files are checked",
        "name the files, or a folder with fewer",
    ),
    "damaged-recording": Message(
        E,
        "the recording is damaged",
        "salvage it: occlog recover {file} -o OUT.mcap",
    ),
    "no-index": Message(
        N,
        "no index, or an incomplete one: each command rebuilds it in a pass through the file",
        "write one: occlog recover {file} -o OUT.mcap",
    ),
    "damaged-table": Message(E, "damaged rows"),
    "damaged-bag": Message(
        W,
        "data of the bag are lost; `occlog ingest` lists them",
        "copy the bag again, if it is whole elsewhere",
    ),
    "message-count-mismatch": Message(N, "more messages than its metadata count; `occlog ingest` reads all"),
    "message": Message(
        E,
        "a message that does not match its type",
        "record again, or make the file again from its source",
    ),
    "row": Message(
        E,
        "invalid row",
        "correct the row, or remove it",
    ),
    "duplicate-row": Message(E, "duplicate rows", "remove the copies", "once"),
    "two-positions": Message(E, "a person in two positions at one time", "keep one of them", "one row"),
    "duplicate-key": Message(
        W,
        "rows of one key (time and identity) with different values",
        "keep one of them",
        "one row",
    ),
    "order": Message(E, "a time before the preceding one", "sort by time", _EACH_LATER),
    "restart": Message(
        W,
        "times of a sensor or an identity that go back, in file order",
        "rows are read in the order of time: if a clock was set or restarted, give each run its own file",
        _EACH_LATER,
    ),
    "duplicate-time": Message(
        E,
        "a time that repeats that of another frame",
        "give each frame its own time",
        _EACH_LATER,
    ),
    "skipped-stamp": Message(
        W,
        "a header stamp that repeats or goes back, for which `occlog ingest` leaves the message out",
        "use the times of recording: ingest --timestamp-source log",
        _EACH_LATER,
    ),
    "lost-message": Message(
        W,
        "a message that cannot be read, since it does not match its type; `occlog ingest` leaves it out",
        "copy the bag again from where it was recorded, or record again",
    ),
    "undecoded": Message(
        N, "messages of this topic have a type that is not decoded: only their times of recording were checked"
    ),
    "linked-video": Message(E, "its linked video cannot be used"),
    "image": Message(W, "an image that cannot be decoded", "its frame is lost; ingest the source again"),
    "video-frames": Message(W, "lost frames", "copy or repair the file"),
    "sound": Message(W, "lost samples", "copy or repair the file"),
    "variable-frame-rate": Message(
        N, "frames at uneven times", "keep its time stamps: give no frame rate (ingest --fps) for it"
    ),
    "suspect": Message(
        W,
        "the calibration may be wrong",
    ),
    "losses": Message(
        N,
        "input that was lost when this file was made",
        "if the source is whole elsewhere, make this file again",
    ),
    "epoch-unit": Message(
        W, "times in another unit than stated", "name the column after its unit, or convert the times"
    ),
    "epoch": Message(W, "times outside 1970 to 2100", "give the origin of the times (ingest --start-time)"),
    "gap": Message(
        W,
        "no data",
        "check whether data of this time were lost: nothing is estimated from this sensor in the gap",
        f"{GAP_INTERVALS:g} times the usual frame interval",
    ),
    "jump": Message(
        W,
        "a clock jump",
        "use the times of another clock (of a bag: ingest --timestamp-source header or log)",
        f"{GAP_INTERVALS:g} times the usual frame interval",
    ),
    "drift": Message(
        W,
        "header stamps that gain on the times of recording (negative: that lose)",
        "use the better clock: ingest --timestamp-source header or log",
    ),
    "clock-disjoint": Message(
        W,
        "times far from those of the other sensors",
        "give an offset, added to its times (ingest --clock-offset SENSOR=SECONDS)",
    ),
    "truth-disjoint": Message(
        W,
        "a truth without a time in common with the sensors",
        "ingest it again with times of the same origin (ingest --start-time)",
    ),
    "clock-late": Message(
        W,
        "starts and ends later than the others by the same time (earlier, if negative)",
        "if its clock is off, give this offset (ingest --clock-offset SENSOR=SECONDS)",
        f"{GAP_INTERVALS:g} times the usual frame interval",
    ),
    "frozen-camera": Message(
        W,
        "identical frames of a camera, while others go on",
        "if its stream had stopped, omit these frames",
    ),
    "two-clocks": Message(
        W,
        "times of recording far from the header stamps",
        "use the right ones: ingest --timestamp-source header or log",
    ),
}
"""Findings of `occlog doctor` by id."""
