"""`detect`, `fuse` and `label` in Python: from images to bearings, and who is in them."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from occlog.errors import UsageError
from occlog.measure.detect.request import NETWORK, VERB
from occlog.measure.fuse.request import FuseRequest, TrackFusionRequest
from occlog.measure.label.request import LabelRequest
from occlog.request import Form

from .call import call, check_taken
from .keywords import Setting
from .results import DetectResult, TrackResult
from .sources import SceneSource, Source


def detect(
    recording: Source,
    *,
    scene: SceneSource | None = None,
    cameras: str | Sequence[str] = (),
    target: Source | None = None,
    target_boxes: Sequence[str] = (),
    near: Source | None = None,
    learn: bool = True,
    fuse: Mapping[str, Setting] | bool = False,
    onnx: str | os.PathLike[str] | None = None,
    classes: Sequence[str] = (),
    names: str | os.PathLike[str] | None = None,
    embed: str | os.PathLike[str] | None = None,
    bearings: bool = False,
    method: str | None = None,
    workers: int | None = None,
    progress: bool = False,
    **settings: Setting,
) -> DetectResult:
    """Reduce the frames of a recording to bearings of its targets, as `occlog detect` does.

    With `onnx` a network finds boxes, with `method="NAME"` a detector of a plug-in: the result has their views.

    Args:
        recording: with video, with boxes of a detector, or with simulated bearings.
        scene: where the cameras are; None: the recording holds it.
        cameras: only these; empty: all.
        target: file with the appearances of targets; None: those attached to the recording.
        target_boxes: boxes around targets from which their appearance is learnt, each `[ID:]CAM:FRAME:X,Y,W,H` [px].
        near: tracks around which targets are looked for.
        learn: look through the recording first, for what it shows when nobody is there.
        fuse: fuse the detections of the cameras; settings of the fusion, or True for its defaults.
        onnx: detect with this network (ONNX).
        classes: with `onnx`: what to look for, by name or number; empty: people, or the only class.
        names: with `onnx`: file with the names of its classes, one a line.
        embed: with `onnx`: describe who is in each box with this network (ONNX).
        bearings: with `onnx` or a plug-in: also a candidate bearing for each box.
        method: how regions are found before the background (em, outlines, components), or the name of a plug-in's
            detector; None: em.
        workers: threads; None: one a processor. The result is the same.
        progress: show a bar on standard error, if it is a terminal.
        **settings: of detection, of networks or of the plug-in, by their names in docs/reference/settings.md, in their
            units.

    Returns:
        Bearings of the targets, and every region of the size of a person; of a network or plug-in the boxes as views.

    Raises:
        UsageError: a setting that there is not, or arguments that contradict each other.
        InputError: an input is missing, damaged, or says something that cannot be.
        PluginError: a plug-in fails.

    Warns:
        OcclogWarning: frames were lost, or the world seems not to be upright.
    """
    arguments = dict(locals())
    arguments |= {"bearings": bearings or None, "fuse": fuse is not False}
    kind = NETWORK if onnx is not None else method or VERB.default
    form = VERB.form(kind)
    own = {name: value for name, value in arguments.items() if name not in ("settings", "progress")}
    check_taken(form, {**own, "learn": not learn}, (), f"detector {kind}", VERB, settings)
    return call(form, {**arguments, "fusion": fuse}, DetectResult)


def fuse(
    bearings: Source,
    *,
    views: Source | None = None,
    scene: SceneSource | None = None,
    **settings: Setting,
) -> DetectResult:
    """Fuse the detections of several cameras, as `occlog fuse` does: remove false ones, recover missed ones.

    Args:
        bearings: detections of targets, or candidates.
        views: regions that the bearings are of.
        scene: where the cameras are; None: the input holds it.
        **settings: of the fusion, by their names in docs/reference/settings.md.

    Raises:
        UsageError: a setting that there is not.
        InputError: an input is missing, damaged, or cannot be fused.

    Warns:
        OcclogWarning: input was lost, or the fusion cannot be believed.
    """
    return call(Form(FuseRequest), locals(), DetectResult)


def fuse_tracks(tracks: Sequence[Source | TrackResult], **settings: Setting) -> TrackResult:
    """Fuse the tracks of several groups of cameras, as `occlog fuse --with` does: one track, one identity a person.

    Args:
        tracks: of each group, two or more, in one world.
        **settings: of the fusion of tracks, by their names in docs/reference/settings.md.

    Returns:
        The fused tracks; `events` are births, deaths and doubtful identities.

    Raises:
        UsageError: a setting that there is not, or fewer than two groups.
        InputError: an input is missing, damaged, or in another unit.

    Warns:
        OcclogWarning: input was lost, or groups do not agree.
    """
    if isinstance(tracks, str | os.PathLike) or len(tracks) < 2:
        raise UsageError("fuse_tracks: give the tracks of two or more groups of cameras in a list")
    first, *others = (each.tracks if isinstance(each, TrackResult) else each for each in tracks)
    arguments = {"bearings": first, "others": others, "settings": settings}
    names = {f"others[{place - 1}]" if place else "bearings": f"tracks[{place}]" for place in range(len(tracks))}
    found = call(Form(TrackFusionRequest), arguments, TrackResult, names)
    known = [Path(t).name if isinstance(t, str | os.PathLike) else f"tracks[{k}]" for k, t in enumerate(tracks)]
    if len(set(known)) < len(known):
        return found
    groups = dict(zip(known, found.summary["groups"].values(), strict=True))
    return replace(found, summary={**found.summary, "groups": groups})


def label(
    bearings: Source,
    tracks: Source,
    *,
    scene: SceneSource | None = None,
    doa: Source | None = None,
    doa_labels: bool = False,
    cameras: str | Sequence[str] = (),
    without: str | Sequence[str] = (),
    **settings: Setting,
) -> DetectResult:
    """Give candidates the identity of the track that they agree with, as `occlog label` does.

    Args:
        bearings: candidates, or a recording that holds them.
        tracks: whose identities are given.
        scene: where the sensors are; None: the recording holds it.
        doa: directions of arrival to label too.
        doa_labels: identities in the log of directions are those of targets.
        cameras: only these sensors; empty: all.
        without: leave these sensors out.
        **settings: by their names in docs/reference/settings.md.

    Raises:
        UsageError: a setting that there is not.
        InputError: an input is missing or damaged, or no track is there at the time of any frame.

    Warns:
        OcclogWarning: input was lost.
    """
    return call(Form(LabelRequest), locals(), DetectResult)
