"""OpenCV calibrations in two files a camera: `intr_NAME` with the lens, `extr_NAME` with the position.

So are those of WILDTRACK (`calibrations/intrinsic_zero/intr_CVLab1.xml`, `calibrations/extrinsic/extr_CVLab1.xml`),
with a unit that is the centimetre and images of 1920 x 1080 px; neither is stated in the files.  `rvec` is a rotation
vector, Xc = R Xw + t.  The intrinsic files in `intrinsic_zero` are of images without distortion, which are those that
the data set ships; they are preferred to `intrinsic_original`.
"""

from __future__ import annotations

import re
from pathlib import Path

from occlog.errors import InputError
from occlog.io.files.names import is_hidden
from occlog.records.scene import Camera

from ..common import CalibrationOptions, centre_of_extrinsics, check_camera_matrix, read_text
from .opencv_storage import (
    DISTORTION,
    MATRIX,
    PLAIN_MATRIX,
    ROTATION,
    TRANSLATION,
    WITHOUT_EFFECT,
    extrinsics_of,
    lens_of,
    matrix_of,
    size_of,
    storage_values,
    unused_keys,
)
from .projection import camera_of_parts

WILDTRACK = {**{f"CVLab{n}": f"C{n}" for n in range(1, 5)}, **{f"IDIAP{n}": f"C{n + 4}" for n in range(1, 4)}}
"""Names of WILDTRACK's calibrations, and of the cameras as its images and annotations call them."""
WILDTRACK_SIZE = (1920, 1080)
FOLDERS = ("intrinsic_zero", "intrinsic", "intrinsic_original")
"""Folders of intrinsic files, in order of preference."""
_MARK = re.compile(r"^(intr|extr)(insics?|insic)?[_-]|[_-]?(intr|extr)(insics?|insic)?$", re.IGNORECASE)


def folder_files(path: Path) -> list[Path] | None:
    """Calibration files of a folder with `extrinsic` and `intrinsic_zero` (or another of `FOLDERS`).

    None for other folders.
    """
    poses_folder = path / "extrinsic"
    lenses = next((path / name for name in FOLDERS if (path / name).is_dir()), None)
    if lenses is None or not poses_folder.is_dir():
        return None
    kept = (".xml", ".yml", ".yaml", ".json")
    every = (p for folder in (poses_folder, lenses) for p in folder.iterdir())
    return sorted(p for p in every if p.suffix.lower() in kept and not is_hidden(p))


def detect(text: str) -> bool:
    """Whether a text is an OpenCV file with either intrinsics or extrinsics, not both."""
    if not ("opencv_storage" in text[:400] or text.startswith("%YAML")):
        return False
    lower = text.lower()

    def has(names: tuple[str, ...]) -> bool:
        return any(re.search(rf"^[ \t]*[<\"]?{name}[>\":\s]", lower, re.MULTILINE) is not None for name in names)

    return has(PLAIN_MATRIX) != (has(ROTATION) or has(TRANSLATION))


def read(paths: list[Path], options: CalibrationOptions) -> tuple[Camera, ...]:
    """Read one camera per pair of OpenCV files, with its intrinsics and its extrinsics.

    Files are paired by names without `intr_`, `extr_` and the like; cameras of WILDTRACK get the names C1 to C7.

    Raises:
        InputError: a file has no partner, or a camera has two files of one kind.
    """
    lenses: dict[str, Path] = {}
    extrinsics: dict[str, Path] = {}
    for path in paths:
        values = storage_values(read_text(path), path)
        found = lenses if any(name in values for name in MATRIX) else extrinsics
        name = _MARK.sub("", path.stem) or path.stem
        if name in found:
            raise InputError(
                f"{path}: a second file of camera {name}, next to {found[name]}; keep one", id="duplicate-name"
            )
        found[name] = path
    for name in sorted(lenses.keys() ^ extrinsics.keys()):
        path, lacks = (lenses[name], "extrinsic") if name in lenses else (extrinsics[name], "intrinsic")
        known = f"rotation {' or '.join(ROTATION[::3])}, translation {' or '.join(TRANSLATION[:2])}"
        if lacks == "intrinsic":
            known = f"camera matrix {', '.join(MATRIX)}"
        raise InputError(
            f"{path}: camera {name} has no {lacks} file; give both, named as {_example(lacks, name)}; if this file has "
            f"both, rename its keys: {known}",
            id="missing-value",
        )
    wildtrack = set(lenses) <= WILDTRACK.keys()
    if wildtrack:
        statement = ", ".join(f"{WILDTRACK[name]} = {name}" for name in sorted(lenses))
        options.notes.append(f"WILDTRACK: lengths are cm, images of 1920 x 1080 px, {statement}")
    return tuple(_camera(name, lenses[name], extrinsics[name], wildtrack, options) for name in sorted(lenses))


def unit_of(paths: list[Path]) -> str:
    """Default length unit of calibration files: cm if they are named as WILDTRACK's, else m."""
    return "cm" if {_MARK.sub("", path.stem) for path in paths} <= WILDTRACK.keys() else "m"


def _example(kind: str, name: str) -> str:
    return f"{kind[:4]}_{name}.xml"


def _camera(name: str, lens: Path, path: Path, wildtrack: bool, options: CalibrationOptions) -> Camera:
    where = f"{path}: camera {name}"
    values, of_place = storage_values(read_text(lens), lens), storage_values(read_text(path), path)
    matrix = matrix_of(values, MATRIX, f"{lens}: camera {name}")
    rotation, translation = extrinsics_of(of_place, where)
    size = size_of(values) or options.image_size or (WILDTRACK_SIZE if wildtrack else None)
    check_camera_matrix(matrix, size[1] if size else 1080, f"{lens}: camera {name}")
    parts = (MATRIX, DISTORTION), (ROTATION, TRANSLATION)
    for held, used in zip((values, of_place), parts, strict=True):
        options.check_keys(name, unused_keys(held, used), WITHOUT_EFFECT)
    called, unit = (WILDTRACK[name], "cm") if wildtrack else (name, "m")
    model, centre = lens_of(values, f"{lens}: camera {name}"), centre_of_extrinsics(rotation, translation)
    return camera_of_parts(matrix, rotation, centre, size, options, name=called, where=where, lens=model, unit=unit)
