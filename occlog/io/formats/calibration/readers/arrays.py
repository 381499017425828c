"""Projection matrices, or K, R, t, in files of arrays: NumPy's `.npz` and MATLAB's `.mat` (up to version 7).

    P              (3, 4), (n, 3, 4) or (3, 4, n): projection matrices; or one (3, 4) array a camera, under its name
    K, R, t        (3, 3) each, (n, 3, 3) or (3, 3, n); t (3,), (n, 3) or (3, n), with Xc = R Xw + t
    dist           (5,), (n, 5): OpenCV's 4, 5, 8, 12 or 14 coefficients; optional
    fisheye        1 for a fisheye lens, 0 for none, one for all or (n,); optional
    image_size     width and height [px], one for all or (n, 2); optional

A file with one camera gives it its own name; cameras of a stack are cam1, cam2, ...

Arrays of numbers in MATLAB files of the versions 4 to 7, after the format that MathWorks describes (MAT-File).

Read here and not by SciPy, since a damaged file of a few hundred bytes can crash its reader.
"""

from __future__ import annotations

import re
import struct
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from occlog.array_types import Floats
from occlog.errors import InputError
from occlog.io.files.limits import FAILURES, check_input
from occlog.io.files.texts.formats import Probe
from occlog.records.scene import Camera

from ..common import MAX_BYTES, CalibrationOptions, centre_of_extrinsics, keys_of
from ..lenses import Lens
from .opencv_toml import checked_rotation
from .projection import STRAIGHT, camera_of_parts, take_apart

HEAD = 128
"""Bytes before the first element of a file from version 5 on."""
ORDERS = {b"IM": "<", b"MI": ">"}
"""Order of bytes by the end of that head."""
COMPRESSED, MATRIX = 15, 14
TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""Types of stored numbers; those of small whole numbers are smaller than their array's."""
NUMBERS = range(6, 16)
"""Classes of arrays that hold numbers."""
COMPLEX = 0x0800
OLD_TYPES = ("f8", "f4", "i4", "i2", "u2", "u1")
"""Types of numbers in version 4."""
_OLD = 20
"""Bytes of the head of an array in version 4."""


class _Element(NamedTuple):
    kind: int
    data: bytes


def read_matlab(content: bytes, limit: int) -> dict[str, Floats | None]:
    """Parse a MATLAB file (versions 4 to 7) to arrays by name; None for texts, structures and complex numbers.

    Args:
        content: bytes of the file.
        limit: maximum decompressed size [bytes].

    Raises:
        ValueError, struct.error, zlib.error: it is damaged, or decompresses to more.
    """
    if 0 in content[:4]:
        return dict(_old(content))
    order = ORDERS.get(content[HEAD - 2 : HEAD])
    if order is None:
        raise ValueError("not a MATLAB file")
    found, left = {}, limit
    for element in _elements(content[HEAD:], order):
        part = element
        if element.kind == COMPRESSED:
            unpacker = zlib.decompressobj()
            data = unpacker.decompress(element.data, left + 1)
            left -= len(data)
            if left < 0:
                raise ValueError(f"unpacks to more than {limit} bytes")
            if not unpacker.eof:
                raise ValueError("ends within a compressed array")
            part = next(_elements(data, order), element)
        if part.kind != MATRIX:
            raise ValueError(f"a MATLAB element of type {part.kind} where an array was expected")
        name, values = _matrix(part.data, order)
        if name:  # without a name it is not a variable
            found[name] = values
    return found


def _elements(data: bytes, order: str) -> Iterator[_Element]:
    at = 0
    while at + 8 <= len(data):
        kind, length = struct.unpack_from(f"{order}II", data, at)
        if kind >> 16:  # up to four bytes in place of the length
            kind, length = kind & 0xFFFF, kind >> 16
            if length > 4:
                raise ValueError(f"a short MATLAB element of {length} bytes, which has at most 4")
            yield _Element(kind, data[at + 4 : at + 4 + length])
            at += 8
            continue
        at += 8
        if at + length > len(data):
            raise ValueError("ends within an array")
        yield _Element(kind, data[at : at + length])
        at += length if kind == COMPRESSED else length + -length % 8


def _matrix(data: bytes, order: str) -> tuple[str, Floats | None]:
    """Parse name and values of one array element of a MATLAB file; values are None unless real numbers.

    `order` is the byte order, `<` or `>`.
    """
    parts = _elements(data, order)
    (flags,) = struct.unpack_from(f"{order}I", next(parts, _Element(0, b"")).data)
    sizes = next(parts, _Element(0, b""))
    if flags & 0xFF not in NUMBERS or flags & COMPLEX:
        # The name of an object is where others have their sizes
        name = sizes if TYPES.get(sizes.kind) == "i1" else next(parts, _Element(0, b""))
        return name.data.decode("latin-1") or "", None
    shape = np.frombuffer(sizes.data, f"{order}i4").tolist()
    name, numbers = next(parts, _Element(0, b"")), next(parts, _Element(0, b""))
    if numbers.kind not in TYPES:
        raise ValueError(f"numbers of type {numbers.kind}")
    return name.data.decode("latin-1"), _shaped(np.frombuffer(numbers.data, order + TYPES[numbers.kind]), shape)


def _old(content: bytes) -> Iterator[tuple[str, Floats | None]]:
    """Yield name and values of the arrays in a MATLAB version 4 file; None for texts and complex numbers.

    ValueError if the bytes are damaged.
    """
    at = 0
    while at < len(content):
        order = "<" if 0 <= struct.unpack_from("<i", content, at)[0] < 1000 else ">"
        kind, rows, columns, imaginary, length = struct.unpack_from(f"{order}5i", content, at)
        if order == ">" and not 1000 <= kind < 2000:
            raise ValueError(f"not the header of a MATLAB array of numbers: type {kind}")
        numbers, text = kind % 100 // 10, kind % 10
        if kind % 1000 >= 100 or numbers >= len(OLD_TYPES) or min(rows, columns) < 0 or length < 1:
            raise ValueError(f"not the header of a MATLAB array of numbers: type {kind}, {rows} x {columns}")
        at += _OLD
        name = content[at : at + length].rstrip(b"\0").decode("latin-1")
        at += length
        dtype = np.dtype(order + OLD_TYPES[numbers])
        size = rows * columns * dtype.itemsize
        real = content[at : at + size]
        at += size * (2 if imaginary else 1)
        if at > len(content):
            raise ValueError("ends within an array")
        yield name, None if text or imaginary else _shaped(np.frombuffer(real, dtype), [rows, columns])


def _shaped(values: NDArray[np.generic], shape: list[int]) -> Floats:
    """Reshape numbers in column-major order to floats; ValueError if their number does not fit the shape."""
    if min(shape, default=-1) < 0:
        raise ValueError(f"an array of {shape}")
    return np.asarray(values, dtype=np.float64).reshape(shape, order="F")


SUFFIXES = (".npz", ".npy", ".mat")
PARTS = {
    "P": ("p", "projection", "proj", "projections", "projmat", "camera_matrices"),
    "K": ("k", "intrinsic", "intrinsics", "camera_matrix", "mtx"),
    "R": ("r", "rotation", "rvec", "rvecs"),
    "t": ("t", "tvec", "tvecs", "translation"),
    "dist": ("dist", "distortion", "dist_coeffs", "d"),
    "size": ("image_size", "size", "resolution", "imsize", "img_size", "imagesize"),
    "fisheye": ("fisheye", "fisheye_model"),
}
"""Accepted names of arrays, in small letters."""
WITHOUT_EFFECT = keys_of("ret rms error errors reprojection_error mean_error objpoints imgpoints date time")
"""Names of arrays that change no camera: how it was calibrated, and how well."""
_FAILURES = (
    *(*FAILURES, OSError, EOFError, MemoryError, NotImplementedError, RuntimeError),
    *(zipfile.BadZipFile, zlib.error, struct.error, tokenize.TokenError, SyntaxError),
)
_HDF5 = b"\x89HDF\r\n\x1a\n"


def is_arrays(probe: Probe) -> bool:
    """Whether a file has the suffix of an array file of NumPy or MATLAB."""
    return probe.path.suffix.lower() in SUFFIXES


def read(paths: list[Path], options: CalibrationOptions) -> tuple[Camera, ...]:
    """Read the cameras in files of arrays (NumPy `.npz`, MATLAB `.mat`).

    They are named by their arrays, by the file if it has one camera, or cam1, cam2, ...
    """
    return tuple(camera for path in paths for camera in _cameras(path, options))


def _load(path: Path) -> dict[str, Floats]:
    """Arrays of numbers in a file, by name; InputError if it cannot be read, is too large, or has other values."""
    check_input(path, "a file of arrays")
    if path.stat().st_size > MAX_BYTES:
        raise InputError(
            f"{path}: {path.stat().st_size} bytes; a calibration of at most {MAX_BYTES} was expected",
            id="input-too-large",
        )
    content = path.read_bytes()
    if _HDF5 in content[:600]:
        raise InputError(
            f"{path}: MATLAB file of version 7.3 (HDF5), which is not read; save('{path.name}', ..., '-v7')",
            id="unsupported-format",
        )
    try:
        found = _read(path, content)
    except _FAILURES as error:
        text = " ".join(str(error).split())[:100]
        raise InputError(
            f"{path}: cannot be read as arrays ({text}); save plain arrays of numbers", id="unsupported-format"
        ) from None
    for key, value in found.items():
        if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiu":
            raise InputError(
                f"{path}: {key} is no array of numbers (structures and objects are not read); save P or K, R, t",
                id="unsupported-format",
            )
    return {key: np.asarray(value, dtype=np.float64) for key, value in found.items()}


def _read(path: Path, content: bytes) -> Mapping[str, NDArray[np.generic] | None]:
    """Arrays by name, as NumPy or the MATLAB parser returns them; None: not real numbers.

    `content` are the bytes of the file. Exceptions of the libraries are not converted.
    """
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
    """InputError if a compressed file (`.npz`) with the bytes `content` would decompress to more than `MAX_BYTES`."""
    size = 0
    if zipfile.is_zipfile(BytesIO(content)):
        with zipfile.ZipFile(BytesIO(content)) as archive:
            size = sum(part.file_size for part in archive.infolist())
    if size > MAX_BYTES:
        raise InputError(
            f"{path}: unpacks to more than {MAX_BYTES} bytes, more than a calibration may have", id="input-too-large"
        )


def _cameras(path: Path, options: CalibrationOptions) -> list[Camera]:
    arrays = _load(path)
    parts = {name: arrays[key] for name, keys in PARTS.items() for key in arrays if key.lower() in keys}
    if not parts.keys() & {"P", "K"}:
        named = {key: value for key, value in arrays.items() if value.shape == (3, 4)}
        if not named:
            shapes = ", ".join(f"{key} {value.shape}" for key, value in arrays.items())
            raise InputError(
                f"{path}: has {shapes or 'nothing'}; expected P (3, 4) of each camera, or K, R and t",
                id="invalid-calibration",
            )
        return [_camera(path, key, {"P": value}, options) for key, value in named.items()]
    matrices = _stack(parts["P" if "P" in parts else "K"], (3, 4) if "P" in parts else (3, 3), path)
    n = len(matrices)
    if "P" not in parts:
        for key in ("R", "t"):
            if key not in parts:
                raise InputError(f"{path}: has K, but no {key}; expected K, R and t, or P", id="missing-value")
        if n == 1 and (rotation := parts["R"]).size > 9 and rotation.size % 3 == 0:
            raise InputError(
                f"{path}: has rotations of {rotation.size // 3} images of a board; state one R and t, from the "
                "world to the camera",
                id="invalid-calibration",
            )
    unused = [key for key in arrays if not any(arrays[key] is value for value in parts.values())]
    options.check_keys(path.name, unused, WITHOUT_EFFECT)
    columns = {key: _per_camera(value, key, n, path) for key, value in parts.items()}
    names = [path.stem] if n == 1 else [f"cam{k + 1}" for k in range(n)]
    return [_camera(path, names[k], {key: value[k] for key, value in columns.items()}, options) for k in range(n)]


def _stack(value: Floats, shape: tuple[int, int], path: Path) -> Floats:
    """Matrices (n, rows, columns), cameras first, from an array of one matrix or several.

    Args:
        value: array of the file.
        shape: rows and columns of a matrix.
        path: file, for messages.

    Raises:
        InputError: the shape does not fit, or it is ambiguous which axis counts the cameras.
    """
    if value.ndim == 2 and value.shape == shape:
        return value[None]
    if value.ndim == 3 and value.shape[1:] == shape and not (value.shape[:2] == shape and value.shape[0] == 3):
        return value
    if value.ndim == 3 and value.shape[:2] == shape and value.shape[1:] != shape:
        return np.moveaxis(value, 2, 0)
    if value.ndim == 3 and value.shape[1:] == shape:
        raise InputError(
            f"{path}: an array of {value.shape}, in which the axis of the cameras is ambiguous; save a file for each "
            "camera, or P of (n, 3, 4)",
            id="ambiguous-input",
        )
    raise InputError(
        f"{path}: an array of {value.shape}; expected {shape[0]} x {shape[1]} matrices, one a camera",
        id="invalid-calibration",
    )


def _per_camera(value: Floats, key: str, n: int, path: Path) -> Floats:
    """Rearrange an array of a file so that the first axis counts the cameras.

    Args:
        value: the array.
        key: what it is: P, K, R, t, dist, size or fisheye.
        n: number of cameras.
        path: file, for messages.

    Returns:
        (n, 3, 4) for P, (n, 3, 3) for K and for R as matrices, else (n, number of values).

    Raises:
        InputError: the shape does not fit n cameras.
    """
    if key in ("P", "K"):
        return _stack(value, (3, 4) if key == "P" else (3, 3), path)
    if key == "R" and value.ndim >= 2 and value.shape[-2:] != (1, 3) and value.size == 9 * n:
        return _stack(value, (3, 3), path)
    flat = np.squeeze(value) if value.ndim > 2 else value
    if n == 1:
        return flat.reshape(1, -1)
    if key == "fisheye" and flat.size == 1:
        return np.tile(flat.reshape(1, 1), (n, 1))
    if key == "size" and flat.size == 2:
        return np.tile(flat.reshape(1, 2), (n, 1))
    if flat.ndim == 2 and flat.shape[0] == n and flat.shape[0] != flat.shape[1]:
        return flat
    if flat.ndim == 2 and flat.shape[1] == n and flat.shape[0] != n:
        return flat.T
    if flat.ndim == 2 and flat.shape[0] == flat.shape[1] == n and key != "t":
        return flat
    raise InputError(
        f"{path}: {key} has the shape {value.shape}, which does not fit {n} cameras; save it as ({n}, ...)",
        id="invalid-calibration",
    )


def _model(part: Mapping[str, Floats]) -> str | None:
    """Lens model by the array `fisheye` of a camera: `equidistant`, `brown`, or None if it is not stated."""
    return None if "fisheye" not in part else "equidistant" if part["fisheye"].any() else "brown"


def _camera(path: Path, label: str, part: Mapping[str, Floats], options: CalibrationOptions) -> Camera:
    name = re.sub(r"[_-]?(P|proj|projection)$", "", label) or label
    where = f"{path}: camera {name}"
    if not all(np.isfinite(value).all() for value in part.values()):
        raise InputError(f"{where}: has numbers that are not finite", id="invalid-calibration")
    if "P" in part:
        k, rotation, centre = take_apart(part["P"], where)
    else:
        k = part["K"]
        rotation = checked_rotation(part["R"].reshape(3), where) if part["R"].size == 3 else part["R"].reshape(3, 3)
        centre = centre_of_extrinsics(rotation, part["t"].reshape(3))
    size = (int(part["size"][0]), int(part["size"][1])) if "size" in part else None
    lens = Lens(_model(part), part["dist"]) if "dist" in part else STRAIGHT
    return camera_of_parts(k, rotation, centre, size, options, name=name, where=where, lens=lens)
