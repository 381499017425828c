"""`detect`, `fuse` and `label` in Python: from images to bearings, and who is in them."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

from occlog.cli import options

from .folders import Folder
from .keywords import Setting, names_of, settings_by_class
from .results import DetectResult, sentences, tables_in, warn
from .sources import Inputs, SceneSource, Source


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
    workers: int | None = None,
    progress: bool = False,
    **settings: Setting,
) -> DetectResult:
    """Reduce the frames of a recording to bearings of its targets, as `occlog detect` does.

    Args:
        recording: with video, with boxes of a detector, or with simulated bearings.
        scene: where the cameras are; None: the recording holds it.
        cameras: only these; empty: all.
        target: file with the appearances of targets; None: those attached to the recording.
        target_boxes: boxes around targets from which their appearance is learnt, each `[ID:]CAM:FRAME:X,Y,W,H` [px].
        near: tracks around which targets are looked for.
        learn: look through the recording first, for what it shows when nobody is there.
        fuse: fuse the detections of the cameras; settings of the fusion, or True for its defaults.
        workers: threads; None: one a processor. The result is the same.
        progress: show a bar on standard error, if it is a terminal.
        **settings: of detection, by their names in docs/settings.md, in their units.

    Returns:
        Bearings of the targets, and every region of the size of a person.

    Raises:
        UsageError: a setting that there is not, or arguments that contradict each other.
        InputError: an input is missing, damaged, or says something that cannot be.

    Warns:
        OcclogWarning: frames were lost, or the world seems not to be upright.
    """
    from occlog.measure.detect.config import DetectConfig
    from occlog.measure.detect.run import DetectRequest, run_detect
    from occlog.measure.fuse.config import FuseConfig

    (chosen,) = settings_by_class("detect", settings, [("", DetectConfig)], ("scene", "cameras", "target", "near"))
    fusion = None
    if fuse is not False:
        (fusion,) = settings_by_class("fuse", {} if fuse is True else fuse, [("", FuseConfig)], ())
    home = Folder()
    with Inputs() as inputs, options.notes_kept() as notes:
        request = DetectRequest(
            recording=inputs.rows(recording, "recording"),
            scene=inputs.scene(scene),
            only=names_of(cameras),
            references=inputs.optional(target, "target"),
            boxes=tuple(target_boxes),
            learn=learn,
            settings=chosen,
            workers=workers or os.cpu_count() or 1,
            near=inputs.optional(near, "near"),
            fusion=fusion,
        )
        bearings, views = home.file("bearings.parquet"), home.file("views.parquet")
        summary, losses = run_detect(request, bearings, views, False, not progress)
        said = [inputs.in_words_of_python(text) for text in notes]
    told, rest = sentences(said)
    warn(told, losses, stacklevel=2)
    tables = tables_in(home, ("bearings", "views"))
    return DetectResult(home.without_paths(summary), tables, tuple(losses), told, rest)


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
        **settings: of the fusion, by their names in docs/settings.md.

    Raises:
        UsageError: a setting that there is not.
        InputError: an input is missing, damaged, or cannot be fused.

    Warns:
        OcclogWarning: input was lost, or the fusion cannot be believed.
    """
    from occlog.measure.fuse.config import FuseConfig
    from occlog.measure.fuse.run import FuseFiles, run_fuse

    (chosen,) = settings_by_class("fuse", settings, [("", FuseConfig)], ("views", "scene"))
    home = Folder()
    with Inputs() as inputs, options.notes_kept() as notes:
        files = FuseFiles(
            bearings=inputs.rows(bearings, "bearings"),
            views=inputs.optional(views, "views"),
            scene=inputs.scene(scene),
            output=home.file("bearings.parquet"),
            fused_views=None if views is None else home.file("views.parquet"),
            overwrite=False,
        )
        summary, losses = run_fuse(files, chosen, True)
        said = [inputs.in_words_of_python(text) for text in notes]
    told, rest = sentences(said)
    warn(told, losses, stacklevel=2)
    return DetectResult(home.without_paths(summary), tables_in(home, ("bearings", "views")), tuple(losses), told, rest)


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
        **settings: by their names in docs/settings.md.

    Raises:
        UsageError: a setting that there is not.
        InputError: an input is missing or damaged, or no track is there at the time of any frame.

    Warns:
        OcclogWarning: input was lost.
    """
    from occlog.measure.label.config import LabelConfig
    from occlog.measure.label.run import LabelFiles, Sensors, run_label
    from occlog.settings import configure

    (chosen,) = settings_by_class("label", settings, [("", LabelConfig)], ("scene", "doa", "cameras", "without"))
    home = Folder()
    with Inputs() as inputs, options.notes_kept() as notes:
        files = LabelFiles(
            bearings=inputs.rows(bearings, "bearings"),
            tracks=inputs.rows(tracks, "tracks"),
            scene=inputs.scene(scene),
            doa=inputs.optional(doa, "doa"),
            doa_labels=doa_labels,
            output=home.file("bearings.parquet"),
            overwrite=False,
        )
        use = Sensors(names_of(cameras), names_of(without))
        summary, losses = run_label(files, use, configure(LabelConfig(), chosen), True)
        said = [inputs.in_words_of_python(text) for text in notes]
    told, rest = sentences(said)
    warn(told, losses, stacklevel=2)
    return DetectResult(home.without_paths(summary), tables_in(home, ("bearings",)), tuple(losses), told, rest)
