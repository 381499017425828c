"""`occlog epipolar`: open matches, poses or matrices, estimate or check, and write."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from occlog.errors import InputError, UsageError, option
from occlog.io.formats.models.fundamental_matrices import (
    EPIPOLAR_ATTACHMENT,
    attached_epipolar,
    epipolar_bytes,
    read_epipolar,
    read_matches,
    write_epipolar,
)
from occlog.io.formats.models.motion_models import model_losses
from occlog.io.open import is_recording_name, load_scene, open_input
from occlog.io.recording.copy import copy_recording
from occlog.io.recording.reader import McapRecording, open_recording
from occlog.records.declared.views import ViewTracks
from occlog.records.losses import Loss
from occlog.records.scene import Scene
from occlog.records.tables import TruthBoxes
from occlog.records.view_pairs import PointMatches, ViewPair, ViewPairs
from occlog.runner import Job

from .config import EpipolarConfig
from .request import EpipolarRequest
from .stage import PairCheck, calibrated_pairs, checked_pairs, estimated_pairs, matches_of_tracks


def run_epipolar(request: EpipolarRequest, job: Job) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Estimate and write fundamental matrices, or check them; return the summary and the losses of the inputs."""
    _check_usage(request)
    config = EpipolarConfig(**request.settings)  # type: ignore[arg-type]
    recording = open_recording(request.recording) if request.recording is not None else None
    scene = _scene(request, recording)
    made = () if recording is None else recording.losses
    losses = tuple(dict.fromkeys((*made, *model_losses([request.tracks, request.fundamental]))))
    if request.output is None:
        checks = _checks(request, config, recording, scene)
        agree = all(check.fits for check in checks)
        return {"pairs": {f"{c.a}-{c.b}": _check_summary(c) for c in checks}, "agree": agree}, losses
    pairs, output = _only(_find(request, config, scene), request.cameras), request.output
    provenance = job.provenance({**asdict(config), "only": ",".join(request.cameras)}, losses)
    if is_recording_name(output) and recording is not None:
        _check_names(pairs, recording)
        attached = {EPIPOLAR_ATTACHMENT: epipolar_bytes(pairs, provenance)}
        copy_recording(recording, output, attached, provenance, overwrite=job.overwrite)
    else:
        write_epipolar(output, pairs, provenance, overwrite=job.overwrite)
    _warn(pairs, scene, job)
    return {"epipolar": str(output), "pairs": {f"{p.a}-{p.b}": _summary(p) for p in pairs.pairs}}, losses


def _check_usage(request: EpipolarRequest) -> None:
    output = request.output
    if request.matches is not None and request.tracks is not None:
        raise UsageError(
            f"{option('matches')} and {option('from_tracks')} are two sources of matches; give one",
            id="conflicting-options",
        )
    some = request.matches is not None or request.tracks is not None
    if request.check and not some:
        raise UsageError(
            f"{option('check')} requires matches; give {option('matches')} or {option('from_tracks')}",
            id="missing-option",
        )
    if request.check and output is not None:
        raise UsageError(f"{option('check')} writes nothing; leave -o out, or {option('check')}", id="not-applicable")
    if not request.check and output is None:
        raise UsageError(f"name the output with -o, or give {option('check')}", id="missing-option")
    if not request.check and some and request.fundamental is not None:
        raise UsageError(
            f"{option('fundamental')} and matches both give matrices; leave one out, or give {option('check')} to "
            "compare them",
            id="conflicting-options",
        )
    if output is not None and is_recording_name(output) and request.recording is None:
        raise UsageError(
            f"{output}: is to be a copy of RECORDING with the matrices; give RECORDING, or an output that ends in "
            ".json",
            id="missing-option",
        )


def _scene(request: EpipolarRequest, recording: McapRecording | None) -> Scene | None:
    if request.scene is not None:
        return load_scene(request.scene, None, request.scene)
    return recording.scene if recording is not None else None


def _find(request: EpipolarRequest, config: EpipolarConfig, scene: Scene | None) -> ViewPairs:
    """Fundamental matrices from a file, from matches or tracks, or from the poses of the scene.

    UsageError without any of these.
    """
    if request.fundamental is not None:
        return read_epipolar(request.fundamental)
    if request.matches is not None or request.tracks is not None:
        return estimated_pairs(_matches(request, config), scene, config)
    if scene is None:
        raise UsageError(
            f"the geometry of the views is unknown; give {option('scene')}, "
            f"{option('matches')}, {option('from_tracks')} or {option('fundamental')}",
            id="missing-option",
        )
    return calibrated_pairs(scene)


def _checks(
    request: EpipolarRequest, config: EpipolarConfig, recording: McapRecording | None, scene: Scene | None
) -> tuple[PairCheck, ...]:
    pairs = read_epipolar(request.fundamental) if request.fundamental is not None else None
    if pairs is None and recording is not None:
        pairs = attached_epipolar(recording)
    if pairs is None:
        if scene is None:
            raise UsageError(
                f"{option('check')} requires something to check; give {option('fundamental')}, "
                f"{option('scene')} or a recording with either",
                id="missing-option",
            )
        pairs = calibrated_pairs(scene)
    return checked_pairs(pairs, _matches(request, config), scene, config.inlier_threshold_px)


def _matches(request: EpipolarRequest, config: EpipolarConfig) -> tuple[PointMatches, ...]:
    """Matches between images of two cameras, from a file of matches or from tracks.

    Args:
        request: has the files, and the names of the selected cameras; none: all.
        config: its `points` selects the points of a person that are matched.

    Raises:
        InputError: no pair of the selected cameras has matches.
    """
    found = _of_tracks(request.tracks, config.points) if request.tracks is not None else ()
    if request.matches is not None:
        found = read_matches(request.matches)
    only = request.cameras
    kept = tuple(m for m in found if not only or (m.a in only and m.b in only))
    if not kept:
        pairs = ", ".join(f"{m.a}-{m.b}" for m in found) or "none"
        raise InputError(
            f"{request.matches or request.tracks}: no matches between two of the selected cameras; pairs in the "
            f"file: {pairs}",
            id="insufficient-data",
        )
    return kept


def _of_tracks(path: Path, points: str) -> tuple[PointMatches, ...]:
    """Matches from view tracks or true boxes in a file; `points` is `centres`, or `ends` (tops and bottoms)."""
    opened = open_input(path, TruthBoxes, ViewTracks)
    if opened.has(TruthBoxes):
        return matches_of_tracks(opened.rows(TruthBoxes), str(path), points)
    window = opened.provenance.parameters.get("window_ns")
    return matches_of_tracks(opened.rows(ViewTracks), str(path), points, window if isinstance(window, int) else 0)


def _only(pairs: ViewPairs, only: tuple[str, ...]) -> ViewPairs:
    kept = tuple(p for p in pairs.pairs if not only or (p.a in only and p.b in only))
    if not kept:
        there = ", ".join(f"{p.a}-{p.b}" for p in pairs.pairs)
        raise UsageError(
            f"{option('cameras')} {','.join(only)}: no matrix is of two of these; there are: {there}",
            id="unknown-sensor",
        )
    return ViewPairs(kept)


def _check_names(pairs: ViewPairs, recording: McapRecording) -> None:
    """InputError if a pair names a camera that is not in the recording."""
    known = [*recording.cameras, *(c.name for c in (recording.scene.cameras if recording.scene else ()))]
    for pair in pairs.pairs:
        for name in (pair.a, pair.b):
            if name not in known:
                cameras = ", ".join(sorted(set(known))) or "none"
                raise InputError(
                    f"{recording.path}: has no camera {name!r} of the matrix {pair.a}-{pair.b}; it has: {cameras}",
                    id="unknown-sensor",
                )


def _warn(pairs: ViewPairs, scene: Scene | None, job: Job) -> None:
    """Note cameras of the scene that are in no pair."""
    used = {name for p in pairs.pairs for name in (p.a, p.b)}
    if rest := [c.name for c in (scene.cameras if scene is not None else ()) if c.name not in used]:
        job.note(f"no fundamental matrix of {', '.join(rest)}")


def _summary(pair: ViewPair) -> dict[str, object]:
    """Figures of one pair of views for the summary: its source, and, unless from poses, quality of the fit [px]."""
    out: dict[str, object] = {"source": pair.source, "undistorted": pair.undistorted}
    if pair.source == "calibration":
        return out
    return out | {
        "matches": pair.matches,
        "inliers": pair.inliers,
        "noise_px": pair.noise_px,
        "error_px": pair.error_px,
        "parallax_px": pair.parallax_px,
        "affine": pair.affine,
    }


def _check_summary(check: PairCheck) -> dict[str, object]:
    return {k: v for k, v in check._asdict().items() if k not in ("a", "b")}
