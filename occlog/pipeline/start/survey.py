"""Survey of the given files and folders: possible kinds, and camera or array names."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from occlog.errors import InputError, UsageError, did_you_mean
from occlog.ingest.plan import is_wildtrack
from occlog.io.files.names import natural_key, safe_name
from occlog.io.frames.streams import SUFFIXES
from occlog.io.messages.bag import METADATA
from occlog.io.recognition import CONTAINERS, FileContent, FileKind, contents_of

UNUSED = "unused"
"""Word for a file that is not to be used."""
MAX_ENTRIES = 1000
"""Entries of a folder that are looked at; images and labels of frames do not count."""
DEEPEST = 5
"""Folders within folders that are looked into."""
GENERIC = {
    *("det", "gt", "detection", "detections", "boxes", "labels", "label", "yolo", "video", "videos", "images", "image"),
    *("img", "img1", "frames", "color", "rgb", "annotation", "annotations", "data", "predictions", "results", "truth"),
    *("ground_truth", "groundtruth", "sst", "ssl", "odas", "doa", "obj_train_data", "train", "instances"),
}
"""Names of files and folders that state no camera; that of the folder above is taken."""
_ENDING = re.compile(
    r"[ ._-]+(detections?|det|boxes|labels|gt|truth|annotations?|sst|ssl|odas|microphones?|mics?)$", re.IGNORECASE
)
THUMBNAILS = re.compile(r"thumb|preview|icon|screenshot|snapshot", re.IGNORECASE)
TRUE = re.compile(r"(^|[^a-z])(gt|truth|true|ground|annot|groundtruth|reference|mocap)", re.IGNORECASE)
"""Names of files that hold a ground truth."""


class Stated(NamedTuple):
    """What the user states about a file (`--as`): its kind (None: not to be used), and its sensor's name or ""."""

    kind: FileKind | None
    name: str


class Item(NamedTuple):
    """A file or folder that can be used.

    Attributes:
        path: path of the file or folder.
        kind: kind of input as which it is used.
        words: name of its format.
        name: name of its camera or array, by its path or by the user.
        others: other kinds of input that it may be.
        stated: whether the user states its kind.
        named: whether the user states its name.
    """

    path: Path
    kind: FileKind
    words: str
    name: str
    others: tuple[FileKind, ...] = ()
    stated: bool = False
    named: bool = False


@dataclass
class Survey:
    """Files found in the sources: usable items, and unused paths with the reason."""

    items: list[Item] = field(default_factory=list)
    unused: list[tuple[Path, str]] = field(default_factory=list)

    def of(self, *kinds: FileKind) -> list[Item]:
        """Return the items of these kinds, in natural order of paths."""
        return [item for item in self.items if item.kind in kinds]

    def drop(self, item: Item, reason: str) -> None:
        """Move an item to the unused inputs, with the reason."""
        self.items.remove(item)
        self.unused.append((item.path, reason))

    def replace(self, item: Item, kind: FileKind) -> None:
        """Change the kind of an item to another one of its possible kinds."""
        others = tuple(dict.fromkeys((item.kind, *(other for other in item.others if other is not kind))))
        self.items[self.items.index(item)] = item._replace(kind=kind, others=others)


def read_stated(texts: Sequence[str], sources: Sequence[Path]) -> dict[Path, Stated]:
    """Return the user's statements about files (`--as PATH=KIND[:NAME]`) by resolved path.

    A path is as given, or relative to a source.

    Raises:
        UsageError: a path does not exist, or a kind is unknown.
    """
    out: dict[Path, Stated] = {}
    words = [kind.value for kind in FileKind] + [UNUSED]
    for text in texts:
        where, _, what = text.rpartition("=")
        word, _, name = what.partition(":")
        places = [Path(where), *(source / where for source in sources if source.is_dir())]
        path = next((place for place in places if where and place.exists()), None)
        if path is None:
            raise UsageError(f"--as {text}: no such file; expected PATH=KIND or PATH=KIND:NAME", id="file-not-found")
        if word not in words:
            raise UsageError(f"--as {text}: no kind {word!r}; {did_you_mean(word, words)}", id="unknown-name")
        if name and safe_name(name) != name:
            raise UsageError(f"--as {text}: {name!r} cannot be the name of a sensor; try {safe_name(name)!r}")
        out[path.resolve()] = Stated(None if word == UNUSED else FileKind(word), name)
    return out


def survey(sources: Sequence[Path], stated: Mapping[Path, Stated]) -> Survey:
    """Find the files in the sources, and what each may be.

    Args:
        sources: files and folders given by the user.
        stated: kinds and sensors that the user states for files, by resolved path.

    Raises:
        InputError: a source does not exist.
    """
    found = Survey()
    seen: set[Path] = set()
    for source in sources:
        if not source.exists():
            raise InputError(f"{source}: no such file or folder; give a folder, a bag, or files", id="file-not-found")
        _look(source, source, 0, stated, found, seen)
    return found


def _look(path: Path, root: Path, depth: int, stated: Mapping[Path, Stated], found: Survey, seen: set[Path]) -> None:
    """Add a path to `found`, as what it may be, and inspect the entries of a folder.

    Args:
        path: file or folder.
        root: source that the user named.
        depth: number of folders between both.
        stated: kinds and sensors that the user states for files, by resolved path.
        found: updated in place.
        seen: resolved paths that were inspected; updated in place.
    """
    own = path.resolve()
    if own in seen or (depth and path.name.startswith(".")):
        return
    seen.add(own)
    reported = stated.get(own)
    if reported is not None and reported.kind is None:
        found.unused.append((path, "as stated"))
        return
    if path.is_dir() and reported is None and (path / "run.json").is_file():
        found.unused.append((path, "a run folder"))
        return
    if path.is_dir() and reported is None and is_wildtrack(path):
        found.items.append(Item(path, FileKind.DATASET, "WILDTRACK as it ships", ""))
        return
    try:
        contents = contents_of(path)
    except InputError as error:
        found.unused.append((path, str(error).removeprefix(f"{path}: ")))
        return
    if reported is not None or contents:
        found.items.append(_item(path, root, contents, reported))
    elif not path.is_dir():
        found.unused.append((path, "no format that is known" if path.stat().st_size else "empty"))
    if path.is_dir() and not (found.items and found.items[-1].path == path and found.items[-1].kind in CLOSED):
        _look_into(path, root, depth, stated, found, seen)


CLOSED = (FileKind.CALIBRATION, FileKind.TRUTH)
"""Kinds of folders that are one input with all that is in them."""


def _look_into(
    path: Path, root: Path, depth: int, stated: Mapping[Path, Stated], found: Survey, seen: set[Path]
) -> None:
    """Inspect the entries of a folder; pictures and labels of single frames are represented by the folder.

    Args:
        path: the folder.
        root: source that the user named.
        depth: number of folders between both.
        stated: kinds and sensors that the user states for files, by resolved path.
        found: updated in place.
        seen: resolved paths that were inspected; updated in place.
    """
    if depth >= DEEPEST:
        found.unused.append((path, f"more than {DEEPEST} folders deep"))
        return
    kind = found.items[-1].kind if found.items and found.items[-1].path == path else None
    entries = sorted(path.iterdir(), key=lambda each: natural_key(each.name))
    pictures = [e for e in entries if e.suffix.lower() in SUFFIXES and e.is_file() and e.resolve() not in stated]
    skipped = set(pictures)
    if kind is FileKind.BOXES:
        skipped |= {e for e in entries if e.suffix.lower() == ".txt"}
    if kind is FileKind.BAG:
        skipped |= {e for e in entries if e.suffix in CONTAINERS or e.name == METADATA}
    if pictures and kind is not FileKind.IMAGES:
        names = f"{pictures[0].name}, ..." if len(pictures) > 1 else pictures[0].name
        found.unused.append((path / names, "pictures that are no sequence of frames"))
    rest = (entry for entry in entries if entry not in skipped)
    for entry in islice(rest, MAX_ENTRIES):
        _look(entry, root, depth + 1, stated, found, seen)
    if next(rest, None) is not None:
        found.unused.append((path, f"entries after the first {MAX_ENTRIES}"))


def _item(path: Path, root: Path, contents: Sequence[FileContent], stated: Stated | None) -> Item:
    name = stated.name if stated is not None and stated.name else name_of(path, root)
    kinds = tuple(content.kind for content in contents)
    if stated is not None and stated.kind is not None:
        words = next((c.words for c in contents if c.kind is stated.kind), "as stated")
        return Item(
            path, stated.kind, words, name, tuple(k for k in kinds if k is not stated.kind), True, bool(stated.name)
        )
    kind = kinds[0]
    if FileKind.TRUTH in kinds and FileKind.BOXES in kinds:
        # Boxes with identities are those of a tracker, or the truth: the name decides, and is stated
        within = "/".join((*path.relative_to(root).parts[-2:],)) if path != root else path.name
        kind = FileKind.TRUTH if TRUE.search(within) else FileKind.BOXES
    words = next(c.words for c in contents if c.kind is kind)
    return Item(path, kind, words, name, tuple(k for k in kinds if k is not kind))


def name_of(path: Path, root: Path) -> str:
    """Return the name of a sensor by its path: of the file, or of the nearest folder with a name that is not generic.

    `root`: source that the user named, beyond which no folder is considered.
    """
    for each in (path, *path.parents):
        stem = each.name if each.is_dir() else each.name.split(".")[0]
        stem = _ENDING.sub("", stem)
        if stem and stem.lower() not in GENERIC:
            return safe_name(stem)
        if each == root.parent:
            break
    stem = path.resolve().name.split(".")[0] or "camera"
    return safe_name(stem)


def shown(path: Path, sources: Sequence[Path]) -> str:
    """Return a path as the user knows it: relative to the source folder that it is in, else as given."""
    for source in sources:
        if source.is_dir() and path != source and path.is_relative_to(source):
            return path.relative_to(source).as_posix()
    return str(path)


def unused_lines(found: Survey, sources: Sequence[Path]) -> Iterator[str]:
    """Generate a line for each reason why files are unused, with the first paths.

    `sources`: files and folders that the user named, to which paths are relative.
    """
    reasons: dict[str, list[str]] = {}
    for path, reason in found.unused:
        reasons.setdefault(reason, []).append(shown(path, sources))
    for reason, paths in reasons.items():
        more = f" and {len(paths) - 3} more" if len(paths) > 3 else ""
        yield f"not used: {', '.join(paths[:3])}{more}: {reason}"
