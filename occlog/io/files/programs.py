"""Files of other programs that are not read, recognised by their beginning, with what to write in their place."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

from occlog.errors import InputError

START = 8192
"""Bytes at the beginning of a file by which it is recognised."""
BOXES = "export COCO or YOLO, or write CSV: frame,left,top,width,height"
EDGES_PX = "write CSV in pixels: frame,x1,y1,x2,y2"
CAMERAS = "write camera_matrix, distortion_coefficients, R and T of each camera by cv2.FileStorage"
POSITIONS = "write CSV: time,id,x,y, in metres, with z up"


class UnreadProgram(NamedTuple):
    """A format of another program.

    Attributes:
        words: what a file of it is.
        remedy: what to write in its place.
        pattern: regular expression of the first bytes; a text of several parts has each of them, in any order.
    """

    words: str
    remedy: str
    pattern: bytes


def _program(words: str, remedy: str, *parts: bytes, begin: bytes = b"") -> UnreadProgram:
    pattern = rb"\A" + begin + b"".join(rb"(?=.*?" + part + rb")" for part in parts)
    return UnreadProgram(words, remedy, pattern)


_XML, _JSON = rb"(?:\xef\xbb\xbf)?\s*(?=<)", rb"(?:\xef\xbb\xbf)?\s*[\[{]"
PROGRAMS = (
    _program("a web page", "download the file itself", begin=rb"(?:\xef\xbb\xbf)?\s*<(?:!(?i:doctype) )?(?i:html)\b"),
    _program(
        "a pointer of Git LFS in place of a file", "fetch the file (git lfs pull)", begin=rb"version https://git-lfs"
    ),
    _program("XML of UA-DETRAC", BOXES, rb"<sequence\b", rb"<target_list", begin=_XML),
    _program("XML of Pascal VOC", BOXES, rb"<annotation\b", rb"<(?:filename|size|object)>", begin=_XML),
    _program("XML of Metashape", CAMERAS, rb"<document\b", rb"<sensors?\b", begin=_XML),
    _program("XML of Acoular", "write CSV: x,y,z of each microphone in metres", rb"<MicArray\b", begin=_XML),
    _program("XML of Xsens", POSITIONS, rb"<mvnx\b", begin=_XML),
    _program("JSON of LabelMe", BOXES, rb'"shapes"', rb'"(?:shape_type|imagePath|flags)"', begin=_JSON),
    _program(
        "JSON of Roboflow (x, y are centres)",
        "write CSV: frame,cx,cy,width,height",
        rb'"predictions"',
        rb'"image"',
        begin=_JSON,
    ),
    _program("JSON of Gemini (y, x of 0 to 1000)", EDGES_PX, rb'"box_2d"', begin=_JSON),
    _program("JSON of Qwen (pixels, or 0 to 1000)", EDGES_PX, rb'"bbox_2d"', begin=_JSON),
    _program("JSON of Detectron2 (bbox in several modes)", EDGES_PX, rb'"bbox_mode"', begin=_JSON),
    _program(
        "JSON of keypoints",
        "write CSV: frame,left,top,width,height",
        rb'"keypoints"',
        rb'"(?:idx|box|center)"',
        begin=_JSON,
    ),
    _program("a camera file of CMU Panoptic", CAMERAS, rb'"cameras"', rb'"distCoef"', begin=_JSON),
    _program("a scene of Meshroom", CAMERAS, rb'"(?:views|intrinsics)"', rb'"intrinsicId"', begin=_JSON),
    _program("a camera trajectory of Open3D", CAMERAS, rb'"PinholeCamera', begin=_JSON),
    _program("a reconstruction of OpenSfM", CAMERAS, rb'"cameras"', rb'"projection_type"', begin=_JSON),
    _program("cameras of Nerfstudio (camera-to-world, OpenGL's axes)", CAMERAS, rb'"transform_matrix"', begin=_JSON),
    _program("a calibration of MMPTRACK", CAMERAS, rb'"ExtrinsicParameters"', begin=_JSON),
    _program("a calibration of AI City", CAMERAS, rb'"(?:extrinsicMatrix|cameraMatrix)"', begin=_JSON),
    _program("a device calibration of a depth camera", CAMERAS, rb'"CalibrationInformation"', begin=_JSON),
    _program("a calibration of EasyMocap", CAMERAS, rb"\nnames:\s", rb"\n(?:K|R|Rot)_"),
    _program("a stereo pair, without poses in the world", CAMERAS, rb"\n(?:M|K)1:", rb"\n(?:M|K)2:"),
    _program("settings of ORB-SLAM, without a pose", CAMERAS, rb"\nCamera1?\.fx:"),
    _program("a device calibration of a ZED camera", CAMERAS, rb"\[(?:LEFT|RIGHT)_CAM_"),
    _program("a calibration of Bouguet's toolbox", CAMERAS, rb"\n(?:fc|omc_1)\s*=\s*\["),
    _program("JSON with matrices as lists", CAMERAS, rb'"(?:mtx|camera_matrix|K)"\s*:\s*\[\s*\[', begin=_JSON),
    _program("YAML with matrices as lists", CAMERAS, rb"(?:\A|\n)(?:mtx|camera_matrix|K):\s*(?:\[\s*\[|- - )"),
    _program(
        "a pickle of Python",
        "write its rows as Parquet or CSV, matrices as .npz: np.savez(FILE, K=..., R=...)",
        begin=rb"\x80[\x02-\x05]",
    ),
    _program("a lens model of OCamCalib", CAMERAS, begin=rb"#polynomial coefficients for the DIRECT"),
    _program("intrinsics of RealSense, without a pose", CAMERAS, rb'"ppx"', rb'"ppy"', begin=_JSON),
    _program("camera parameters of Pix4D", CAMERAS, begin=rb"fileName imageWidth imageHeight"),
    _program("a Bundler model", CAMERAS, begin=rb"# Bundle file"),
    _program("a model of VisualSFM", CAMERAS, begin=rb"NVM_V"),
    _program("an export of OptiTrack Motive", POSITIONS, begin=rb"(?:\xef\xbb\xbf)?Format Version,"),
    _program("an export of Vicon", POSITIONS, begin=rb"(?:\xef\xbb\xbf)?(?:Trajectories|Model Outputs)\s*\n\d"),
    _program("an export of Qualisys", POSITIONS, begin=rb"NO_OF_FRAMES\t"),
    _program("C3D", "export it as TRC or CSV", begin=rb"[\x01-\x10]\x50"),
    _program("motion of a skeleton (BVH)", POSITIONS, begin=rb"HIERARCHY\s"),
    _program("TrajNet++", POSITIONS, begin=rb'\{"(?:scene|track)": ?\{'),
    _program("text of VisDrone", BOXES, begin=rb"(?:\d+,){7}\d+,[012],[012]\r?\n"),
    _program(
        "text of AI City (camera, id, frame, box, position)",
        "write CSV: frame,camera,id,left,top,width,height",
        begin=rb"(?:\d+ ){2}\d+(?: -?\d+){4}(?: -?\d+\.\d+){2}\s",
    ),
    _program(
        "text of KITTI's detection (DeepStream), one file a frame",
        BOXES,
        begin=rb"[A-Za-z_]+ -?\d+(?:\.\d+)? -?\d -?\d+\.\d+(?: -?\d+\.\d+){4}(?: -?\d+(?:\.\d+)?){7,8}\s",
    ),
    _program("text of AVA", BOXES, begin=rb"[^,\n]+,\d+(?:\.\d+)?(?:,[01]?\.\d+){4}(?:,\d+){1,2}\r?\n"),
    _program("text of DarkLabel", BOXES, begin=rb"\d+,[1-9]\d*(?:,-?\d+){5},[A-Za-z]"),
)
"""The most particular first."""


def describe_program(head: bytes) -> str | None:
    """Text on a file of a program that is not read, with the remedy, by the first bytes of the file; None: unknown."""
    found = next((each for each in PROGRAMS if re.match(each.pattern, head, re.DOTALL)), None)
    return None if found is None else f"is {found.words}, which is not read; {found.remedy}"


def refuse_unread(path: Path) -> None:
    """InputError if a file, or the first non-empty file of a folder, is of a program that is not read."""
    if path.is_dir():
        files = sorted(each for each in path.iterdir() if each.is_file() and not each.name.startswith("."))
        path = next((each for each in files if each.stat().st_size), path)
    if not path.is_file():  # the reader reports it; a pipe has no beginning to come back to
        return
    try:
        with path.open("rb") as file:
            head = file.read(START)
    except OSError:
        return  # the reader reports it
    if (words := describe_program(head)) is not None:
        raise InputError(f"{path}: {words}", id="unsupported-format")
