"""`occlog appearance learn`: read boxes with their images, collect their colours, write a gallery.

Also inputs shared with `occlog label --gallery`: boxes, images, tracks, and the scene.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from occlog.errors import InputError, UsageError, option
from occlog.io.open import Opened, check_unit, input_losses, load_scene, open_input
from occlog.records.declared.people import Gallery
from occlog.records.frames import Frame
from occlog.records.losses import Loss
from occlog.records.scene import Scene
from occlog.records.tables import Boxes, Tracks, Truth, TruthBoxes, Views
from occlog.runner import Job
from occlog.settings import configure

from .config import LearnConfig, SightingConfig
from .request import LearnRequest
from .sightings import PersonPath as Walk
from .sightings import Sighting, SightingTally, boxes_of_frames, observe_boxes, paths_of_boxes, paths_of_rows
from .stage import learn

SOURCES = (TruthBoxes, Boxes, Views)
"""Tables with boxes; where a recording has several, the first of them is read."""


@dataclass(frozen=True)
class SightingFiles:
    """Input files for sightings of people: boxes, images, tracks and scene.

    Attributes:
        boxes: recording or table with boxes or views.
        images: recording with the frames; None: those of `boxes`, or the table has colours.
        tracks: positions and identities of people; None: the truth of the recordings, or the floor below boxes that
            have an identity.
        scene: scene file; None: the scene of a recording.
    """

    boxes: Path
    images: Path | None
    tracks: Path | None
    scene: Path | None


class SightingInput:
    """Opened inputs of sightings: boxes with their images, and the paths of all people.

    Attributes:
        files: input files.
        scene: cameras and length unit.
        own_identity: the boxes bring the identities of the paths, so that they need not be associated by position.
        positions: source of the paths: `tracks`, `truth` or `floor` (below labelled boxes).
    """

    def __init__(self, files: SightingFiles, labelled: bool) -> None:
        """Open all inputs; only headers are read.

        InputError if there are neither images nor boxes with colours, or units differ.

        Args:
            files: files to read.
            labelled: the identities of boxes are those of the tracks.
        """
        self.files = files
        self._boxes = open_input(files.boxes, *SOURCES, remedy="give a recording or a table with boxes or views")
        self._images = None if files.images is None or files.images == files.boxes else open_input(files.images)
        recordings = [o for o in (self._images, self._boxes) if o is not None and o.recording is not None]
        own = next((o.scene for o in recordings if o.scene is not None), None)
        self.scene: Scene = load_scene(files.scene, own, files.images or files.boxes)
        truths = [o for o in recordings if o.has(Truth)]
        self._tracks = open_input(files.tracks, Tracks, Truth) if files.tracks is not None else next(iter(truths), None)
        self.positions = "floor" if self._tracks is None else "truth" if self._tracks.has(Truth) else "tracks"
        true = self.positions == "truth" and self._boxes.has(TruthBoxes)
        self.own_identity = labelled or true or self._tracks is None
        for opened in (self._boxes, self._tracks):
            if opened is not None and opened.made_in_a_scene:
                check_unit(opened, self.scene.length_unit)
        if not self._boxes.has(Views) and not any(o.recording is not None and o.recording.cameras for o in recordings):
            raise InputError(
                f"{files.images or files.boxes}: holds no images, and the boxes bring no colours; give the recording "
                "with the video, or views of `occlog detect`",
                id="wrong-content",
            )

    @property
    def losses(self) -> tuple[Loss, ...]:
        """Losses recorded in the provenance of the inputs."""
        return input_losses([self._images, self._boxes, self._tracks])

    def sightings(
        self, job: Job, what: str, config: SightingConfig, levels: int, tally: SightingTally
    ) -> Iterator[Sighting]:
        """Generate the sightings of all boxes, frame by frame (`observe_boxes`), with the progress of `what`."""
        return observe_boxes(
            job.progress(boxes_of_frames(self._chunks()), what),
            self._frames(),
            self._walks(config),
            self.scene,
            config,
            levels=levels,
            own_identity=self.own_identity,
            tally=tally,
        )

    def _chunks(self) -> Iterator[Boxes] | Iterator[Views]:
        table = next(t for t in SOURCES if self._boxes.has(t))
        return self._boxes.rows(table)  # type: ignore[return-value]

    def _frames(self) -> Iterator[Frame]:
        """Generate the frames sorted by time; empty if no recording has video, as the boxes then have appearances."""
        for opened in (self._images, self._boxes):
            if opened is not None and opened.recording is not None and opened.recording.cameras:
                return opened.recording.frames()
        return iter(())

    def _walks(self, config: SightingConfig) -> dict[int, Walk]:
        """Paths of all people by identity; InputError if there are none."""
        if self._tracks is None:
            found = paths_of_boxes(self._chunks(), self.scene, config)
            if not found:
                raise InputError(
                    f"{self.files.boxes}: no box has an identity with a path on the floor; give {option('tracks')}, "
                    "for example of `occlog track --method jipda`",
                    id="missing-labels",
                )
            return found
        source: Opened = self._tracks
        rows = source.read(Truth) if source.has(Truth) else source.read(Tracks)
        if not len(rows):
            raise InputError(f"{source.path}: has no rows; tracks of people were expected", id="empty-input")
        return paths_of_rows(rows, config)


def run_learn(request: LearnRequest, job: Job) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Learn the appearance gallery from boxes and images, and write it; return the summary and the losses.

    Raises:
        UsageError: boxes and views are both given.
        InputError: no viewing angle of any person has enough boxes.
    """
    if request.boxes is not None and request.views is not None:
        raise UsageError(
            f"{option('boxes')} and {option('views')} are two sources of boxes; give one of them",
            id="conflicting-options",
        )
    boxes = request.boxes or request.views or request.recording
    inputs = SightingInput(SightingFiles(boxes, request.recording, request.tracks, request.scene), request.labelled)
    config: LearnConfig = configure(LearnConfig.in_unit(inputs.scene.length_unit), request.settings)
    tally = SightingTally()
    gallery = learn(inputs.sightings(job, "learn", config, config.colour_levels, tally), config)
    if not len(gallery):
        raise InputError(
            f"{boxes}: no person has {config.min_samples} boxes of one viewing angle; {tally.of_tracks} of "
            f"{tally.boxes} boxes are of a track: check that boxes, images and {inputs.positions} are of one recording",
            id="insufficient-data",
        )
    losses = (*inputs.losses, *tally.losses())
    parameters = {"positions": inputs.positions, "labelled": inputs.own_identity, **asdict(config)}
    with job.tables(job.provenance(parameters, losses), inputs.scene.length_unit) as tables:
        tables.write(output=gallery.sorted())
    return {"gallery": str(request.output), **_figures(gallery, tally), "positions": inputs.positions}, losses


def _figures(gallery: Gallery, tally: SightingTally) -> dict[str, object]:
    """Return the figures of the summary by name: numbers of frames, boxes and samples, and the gallery's content.

    `sides` has the indices of the learned viewing angles of each target as text, for example "1 2 5".

    Args:
        gallery: learned gallery, not empty.
        tally: counts of frames and boxes read.
    """
    sides: dict[int, list[int]] = {}
    for target, angle in zip(gallery.target_id.tolist(), gallery.angle.tolist(), strict=True):
        sides.setdefault(target, []).append(angle)
    return {
        "frames": tally.frames,
        "boxes": tally.boxes,
        "boxes_of_tracks": tally.of_tracks,
        "samples": int(gallery.samples.sum()),
        "angles": int(gallery.angles[0]),
        "bins": int(gallery.bins[0]),
        "targets": len(sides),
        "sides": {str(target): " ".join(map(str, angles)) for target, angles in sides.items()},
    }
