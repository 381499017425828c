"""Provenance of tracks made from video: where their trackers came from, and from which recording."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from occlog.io.files.provenance import Provenance, hash_file
from occlog.io.open import open_if_ours

FROM_DETECTIONS = "trackers were born from detections, so that their numbers are not those of targets"


def video_provenance(tracks: Path | None) -> Provenance | None:
    """How `occlog track` made a table from video; None for anything else."""
    opened = None if tracks is None else open_if_ours(tracks)
    if opened is None or opened.recording is not None:
        return None
    made = opened.provenance
    return made if made.command == "track" and "births" in made.parameters else None


def born_from_detections(tracks: Path | None) -> bool:
    """Whether trackers came from detections, perhaps beside those that were given."""
    made = video_provenance(tracks)
    return made is not None and made.parameters["births"] != "initial"


def own_notes(tracks: Path | None, own: str, asked: str | None) -> list[str]:
    """A line on which target is a tracker's own where trackers came from detections.

    Args:
        tracks: the tracks.
        own: how it is found.
        asked: value of --own; None: not given.
    """
    if not born_from_detections(tracks) or asked not in (None, "label"):
        return []
    how = f"--own {own} is used" if asked is None else "FR needs --own start"
    return [f"{tracks}: {FROM_DETECTIONS}; {how}"]


def other_video(tracks: Path | None, recordings: Iterable[Path | None]) -> list[str]:
    """A line for each recording with video that is not what the tracks were made from.

    Two recordings may have the same times and cameras, so that nothing else tells them apart; but a
    copy is another file too, so that this is no error.

    Args:
        tracks: the tracks; tables that `occlog track` did not make from video are not judged.
        recordings: files that belong to the tracks, as the user says; those without video are passed over.
    """
    made = video_provenance(tracks)
    if made is None or not made.inputs:
        return []
    used = {digest for _, digest in made.inputs}
    names = ", ".join(name for name, _ in made.inputs if name.lower().endswith(".mcap")) or made.inputs[0][0]
    return [
        f"{path}: {tracks} was made from another file ({names}); right only if both are of the same video"
        for path in dict.fromkeys(recordings)
        if path is not None and _has_video(path) and hash_file(path) not in used
    ]


def _has_video(path: Path) -> bool:
    """Whether a file is a recording with images."""
    opened = open_if_ours(path)
    return opened is not None and opened.recording is not None and bool(opened.recording.cameras)
