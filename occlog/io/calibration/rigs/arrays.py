"""Projection matrices, or K, R, t, in files of arrays: NumPy's `.npz` and MATLAB's `.mat` (up to version 7).

    P              (3, 4), (n, 3, 4) or (3, 4, n): projection matrices; or one (3, 4) array a camera, under its name
    K, R, t        (3, 3) each, (n, 3, 3) or (3, 3, n); t (3,), (n, 3) or (3, n), with Xc = R Xw + t
    dist           (5,), (n, 5): k1, k2, p1, p2, k3; perhaps
    image_size     width and height [px], one for all or (n, 2); perhaps

A file with one camera gives it its own name; cameras of a stack are cam1, cam2, ...
"""

from __future__ import annotations

import re
import struct
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from occlog.array_types import Floats
from occlog.errors import InputError
from occlog.io.files.texts.registry import Probe
from occlog.io.files.untrusted.guard import FAILURES
from occlog.io.files.untrusted.inputs import check_input
from occlog.records.scene import Camera

from ..common import MAX_BYTES, CalibrationOptions
from ..opencv_toml import rotation_from_vector
from ..projection import camera_of_parts, take_apart
from .matlab import read_matlab

SUFFIXES = (".npz", ".npy", ".mat")
PARTS = {
    "P": ("p", "projection", "proj", "projections", "projmat", "camera_matrices"),
    "K": ("k", "intrinsic", "intrinsics", "camera_matrix", "mtx"),
    "R": ("r", "rotation", "rvec", "rvecs"),
    "t": ("t", "tvec", "tvecs", "translation"),
    "dist": ("dist", "distortion", "dist_coeffs", "d"),
    "size": ("image_size", "size", "resolution", "imsize"),
}
"""What arrays may be called, in small letters."""
_FAILURES = (
    *(*FAILURES, OSError, EOFError, MemoryError, NotImplementedError, RuntimeError),
    *(zipfile.BadZipFile, zlib.error, struct.error, tokenize.TokenError, SyntaxError),
)
_HDF5 = b"\x89HDF\r\n\x1a\n"


def is_arrays(probe: Probe) -> bool:
    """Whether a file is named as one of arrays."""
    return probe.path.suffix.lower() in SUFFIXES


def read(paths: list[Path], options: CalibrationOptions) -> tuple[Camera, ...]:
    """The cameras of all files."""
    return tuple(camera for path in paths for camera in _cameras(path, options))


def _load(path: Path) -> dict[str, Floats]:
    """Arrays of numbers in a file, by name; InputError where it cannot be read."""
    check_input(path, "a file of arrays")
    if path.stat().st_size > MAX_BYTES:
        raise InputError(f"{path}: {path.stat().st_size} bytes; a calibration of at most {MAX_BYTES} was expected")
    content = path.read_bytes()
    if _HDF5 in content[:600]:
        raise InputError(
            f"{path}: MATLAB file of version 7.3 (HDF5), which is not read; save('{path.name}', ..., '-v7')"
        )
    try:
        found = _read(path, content)
    except _FAILURES as error:
        text = " ".join(str(error).split())[:100]
        raise InputError(f"{path}: cannot be read as arrays ({text}); save plain arrays of numbers") from None
    for key, value in found.items():
        if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiu":
            raise InputError(
                f"{path}: {key} is no array of numbers (structures and objects are not read); save P or K, R, t"
            )
    return {key: np.asarray(value, dtype=np.float64) for key, value in found.items()}


def _read(path: Path, content: bytes) -> Mapping[str, NDArray[np.generic] | None]:
    """Arrays by name as the libraries give them, with what they raise."""
    if path.suffix.lower() == ".mat":
        return read_matlab(content, MAX_BYTES)
    _check_unpacked(path, content)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # NumPy's of heads of files that Python 2 wrote
        if path.suffix.lower() == ".npy":
            return {"P": np.load(BytesIO(content), allow_pickle=False)}
        with np.load(BytesIO(content), allow_pickle=False) as file:
            return {key: file[key] for key in file.files}


def _check_unpacked(path: Path, content: bytes) -> None:
    """InputError for arrays that are packed and would unpack to more than a calibration may have."""
    size = 0
    if zipfile.is_zipfile(BytesIO(content)):
        with zipfile.ZipFile(BytesIO(content)) as archive:
            size = sum(part.file_size for part in archive.infolist())
    if size > MAX_BYTES:
        raise InputError(f"{path}: unpacks to more than {MAX_BYTES} bytes, more than a calibration may have")


def _cameras(path: Path, options: CalibrationOptions) -> list[Camera]:
    arrays = _load(path)
    parts = {name: arrays[key] for name, keys in PARTS.items() for key in arrays if key.lower() in keys}
    if not parts.keys() & {"P", "K"}:
        named = {key: value for key, value in arrays.items() if value.shape == (3, 4)}
        if not named:
            shapes = ", ".join(f"{key} {value.shape}" for key, value in arrays.items())
            raise InputError(f"{path}: has {shapes or 'nothing'}; want P (3, 4) of each camera, or K, R and t")
        return [_camera(path, key, {"P": value}, options) for key, value in named.items()]
    matrices = _stack(parts["P" if "P" in parts else "K"], (3, 4) if "P" in parts else (3, 3), path)
    n = len(matrices)
    if "P" not in parts:
        for key in ("R", "t"):
            if key not in parts:
                raise InputError(f"{path}: has K, but no {key}; want K, R and t, or P")
    columns = {key: _per_camera(value, key, n, path) for key, value in parts.items()}
    names = [path.stem] if n == 1 else [f"cam{k + 1}" for k in range(n)]
    return [_camera(path, names[k], {key: value[k] for key, value in columns.items()}, options) for k in range(n)]


def _stack(value: Floats, shape: tuple[int, int], path: Path) -> Floats:
    """(n, ...) matrices of one shape, the cameras first; InputError where it is none or cannot be told."""
    if value.ndim == 2 and value.shape == shape:
        return value[None]
    if value.ndim == 3 and value.shape[1:] == shape and not (value.shape[:2] == shape and value.shape[0] == 3):
        return value
    if value.ndim == 3 and value.shape[:2] == shape and value.shape[1:] != shape:
        return np.moveaxis(value, 2, 0)
    if value.ndim == 3 and value.shape[1:] == shape:
        raise InputError(
            f"{path}: an array of {value.shape}; which axis counts the cameras cannot be told; save one each"
        )
    raise InputError(f"{path}: an array of {value.shape}; want {shape[0]} x {shape[1]} matrices, one a camera")


def _per_camera(value: Floats, key: str, n: int, path: Path) -> Floats:
    """The parts of n cameras, cameras first."""
    if key in ("P", "K"):
        return _stack(value, (3, 4) if key == "P" else (3, 3), path)
    if key == "R" and value.ndim >= 2 and value.shape[-2:] != (1, 3) and value.size == 9 * n:
        return _stack(value, (3, 3), path)
    flat = np.squeeze(value) if value.ndim > 2 else value
    if n == 1:
        return flat.reshape(1, -1)
    if key == "size" and flat.size == 2:
        return np.tile(flat.reshape(1, 2), (n, 1))
    if flat.ndim == 2 and flat.shape[0] == n and flat.shape[0] != flat.shape[1]:
        return flat
    if flat.ndim == 2 and flat.shape[1] == n and flat.shape[0] != n:
        return flat.T
    if flat.ndim == 2 and flat.shape[0] == flat.shape[1] == n and key != "t":
        return flat
    raise InputError(
        f"{path}: {key} has the shape {value.shape}, which does not fit {n} cameras; save it as ({n}, ...)"
    )


def _camera(path: Path, label: str, part: Mapping[str, Floats], options: CalibrationOptions) -> Camera:
    name = re.sub(r"[_-]?(P|proj|projection)$", "", label) or label
    where = f"{path}: camera {name}"
    if not all(np.isfinite(value).all() for value in part.values()):
        raise InputError(f"{where}: has numbers that are not finite")
    if "P" in part:
        k, rotation, centre = take_apart(part["P"], where)
    else:
        k = part["K"]
        rotation = rotation_from_vector(part["R"].reshape(3)) if part["R"].size == 3 else part["R"].reshape(3, 3)
        centre = -rotation.T @ part["t"].reshape(3)
    size = options.image_size or ((int(part["size"][0]), int(part["size"][1])) if "size" in part else None)
    distortion = part["dist"].reshape(-1).tolist() if "dist" in part else ()
    return camera_of_parts(k, rotation, centre, size, options, name=name, where=where, distortion=distortion)
