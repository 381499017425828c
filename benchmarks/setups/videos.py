"""Videos made by FFmpeg, as occlog stores their frames, against the frames that FFmpeg decodes.

    python -m benchmarks.setups.videos --ffmpeg PATH [--json]

30 videos of 24 frames of a pattern that moves: codecs, containers, pixel formats, interlaced, turned and mirrored by
metadata, values of 10 and 16 bits, pixels that are not square, variable frame rate, edit lists, full and limited range.
A video is right if it is refused, or its frames lost, with the cause in words, or if each stored frame differs from
FFmpeg's gray by at most 3 levels in the mean (FFmpeg applies rotation, and keeps pixels as they are stored).
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import tempfile
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import occlog
from occlog.array_types import Floats
from occlog.io.open import open_input

SIZE, FRAMES, RATE = (320, 240), 24, 25
MAX_DIFFERENCE = 3.0
"""Mean absolute difference of a frame from FFmpeg's [grey levels]."""
H264 = ("-c:v", "libx264", "-crf", "12")
INTERLACED = (*H264, "-flags", "+ilme+ildct", "-x264opts", "tff=1")


class Video(NamedTuple):
    """A video: its suffix, the options of FFmpeg, a filter before encoding, and the cause if it may be refused."""

    suffix: str
    options: tuple[str, ...]
    filters: str = ""
    refusal: str = ""
    remux: tuple[str, ...] = ()


VIDEOS: dict[str, Video] = {
    "H.264 in MP4": Video("mp4", H264),
    "H.264 in MKV": Video("mkv", H264),
    "H.264 in MOV": Video("mov", H264),
    "H.264 with many B-frames": Video("mp4", (*H264, "-bf", "8")),
    "H.264 with 4:4:4": Video("mp4", (*H264, "-pix_fmt", "yuv444p")),
    "H.264 with 4:2:2": Video("mkv", (*H264, "-pix_fmt", "yuv422p")),
    "H.264 of 10 bits": Video("mkv", (*H264, "-pix_fmt", "yuv420p10le")),
    "H.264 of full range": Video("mp4", (*H264, "-pix_fmt", "yuvj420p")),
    "H.264 gray": Video("mp4", (*H264, "-pix_fmt", "gray")),
    "H.265 in MP4": Video("mp4", ("-c:v", "libx265", "-crf", "12", "-x265-params", "log-level=error")),
    "H.265 of 10 bits": Video(
        "mkv", ("-c:v", "libx265", "-crf", "12", "-pix_fmt", "yuv420p10le", "-x265-params", "log-level=error")
    ),
    "VP8 in WebM": Video("webm", ("-c:v", "libvpx", "-b:v", "4M")),
    "VP9 in WebM": Video("webm", ("-c:v", "libvpx-vp9", "-b:v", "4M")),
    "MPEG-4 in AVI": Video("avi", ("-c:v", "mpeg4", "-q:v", "2")),
    "MPEG-2 in MKV": Video("mkv", ("-c:v", "mpeg2video", "-q:v", "2")),
    "Motion JPEG in AVI": Video("avi", ("-c:v", "mjpeg", "-q:v", "2")),
    "FFV1 in MKV": Video("mkv", ("-c:v", "ffv1")),
    "FFV1 gray": Video("mkv", ("-c:v", "ffv1", "-pix_fmt", "gray")),
    "FFV1 gray of 16 bits": Video("mkv", ("-c:v", "ffv1", "-pix_fmt", "gray16le"), refusal="16|bits"),
    "FFV1 gray, 12 of 16 bits used": Video(
        "mkv", ("-c:v", "ffv1", "-pix_fmt", "gray16le"), "format=gray16le,lut=y=val/16", refusal="16|bits"
    ),
    "FFV1 gray of 10 bits": Video("mkv", ("-c:v", "ffv1", "-pix_fmt", "gray10le")),
    "interlaced H.264": Video("mp4", INTERLACED, refusal="interlaced"),
    "interlaced MPEG-2": Video(
        "mkv", ("-c:v", "mpeg2video", "-q:v", "2", "-flags", "+ilme+ildct"), "setfield=tff", refusal="interlaced"
    ),
    "turned by 90 degrees": Video("mp4", H264, remux=("-display_rotation", "90")),
    "turned by 180 degrees": Video("mp4", H264, remux=("-display_rotation", "180")),
    "mirrored": Video("mp4", H264, remux=("-display_hflip",), refusal="mirror"),
    "pixels not square": Video("mp4", H264, "setsar=4/3"),
    "variable frame rate": Video("mkv", (*H264, "-fps_mode", "vfr"), "select='mod(n,3)'"),
    "edit list": Video("mp4", H264, remux=("-ss", "0.2")),
    "start at 1.4 s in MPEG-TS": Video("ts", H264),
}


class Result(NamedTuple):
    """Whether a video is right, and why."""

    right: bool
    words: str


def make(ffmpeg: str, video: Video, folder: Path) -> Path:
    """Write a video."""
    out = folder / f"made.{video.suffix}"
    source = f"testsrc2=size={SIZE[0]}x{SIZE[1]}:rate={RATE}:duration={FRAMES / RATE}"
    filters = ("-vf", video.filters) if video.filters else ()
    first = folder / f"first.{video.suffix}" if video.remux else out
    _ffmpeg(ffmpeg, "-f", "lavfi", "-i", source, *filters, *video.options, first)
    if video.remux:
        _ffmpeg(ffmpeg, *video.remux, "-i", first, "-c", "copy", out)
    return out


def decoded(ffmpeg: str, path: Path) -> list[Floats]:
    """Frames as FFmpeg decodes them, in gray."""
    gray = ("-pix_fmt", "gray", "-")
    first = (ffmpeg, "-i", path, "-frames:v", "1", "-f", "image2pipe", "-c:v", "pgm", *gray)
    head = subprocess.run(first, capture_output=True, check=True).stdout
    width, height = (int(number) for number in head.split(b"\n", 2)[1].split())
    data = subprocess.run(
        [ffmpeg, "-i", path, "-fps_mode", "passthrough", "-f", "rawvideo", *gray],
        capture_output=True,
        check=True,
    ).stdout
    return list(np.frombuffer(data, np.uint8).reshape(-1, height, width).astype(np.float64))


def compared(ffmpeg: str, video: Video, folder: Path) -> Result:
    """Make a video, ingest it, and compare its frames."""
    path = make(ffmpeg, video, folder)
    wanted = decoded(ffmpeg, path)
    try:
        made = occlog.ingest(video={"cam": path}, allow_uncalibrated=True, store="png", output=folder / "made.mcap")
    except occlog.OcclogError as error:
        text = str(error)
        return Result(bool(video.refusal) and re.search(video.refusal, text) is not None, f"refused: {text}")
    if made.losses:
        text = "; ".join(map(str, made.losses))
        return Result(bool(video.refusal) and re.search(video.refusal, text) is not None, f"lost: {text}")
    recording = open_input(made.source).recording
    frames = [frame.decode() for frame in recording.frames()] if recording is not None else []
    if len(frames) != len(wanted):
        return Result(False, f"{len(frames)} frames of {len(wanted)}")
    apart = [_apart(frame, other) for frame, other in zip(frames, wanted, strict=True)]
    return Result(max(apart) <= MAX_DIFFERENCE, f"largest mean difference {max(apart):.2f}")


def _apart(image: Any, wanted: Floats) -> float:
    """Mean absolute difference of a picture from a gray one; inf: of another size."""
    values = np.asarray(image, dtype=np.float64)
    gray = values if values.ndim == 2 else values @ [0.114, 0.587, 0.299]
    return float(np.mean(np.abs(gray - wanted))) if gray.shape == wanted.shape else float("inf")


def _ffmpeg(ffmpeg: str, *arguments: str | Path) -> None:
    subprocess.run([ffmpeg, "-v", "error", "-y", *arguments], check=True, capture_output=True)


def main() -> None:
    """Compare all videos."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ffmpeg", default="ffmpeg", help="the program; default: ffmpeg")
    parser.add_argument("--json", action="store_true", help="results as JSON")
    given = parser.parse_args()
    results: dict[str, Result] = {}
    for name, video in VIDEOS.items():
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                results[name] = compared(given.ffmpeg, video, Path(folder))
            except subprocess.CalledProcessError as error:
                results[name] = Result(False, f"not made: {error.stderr.decode().strip()[-200:]}")
        if not given.json:
            print(f"{'right' if results[name].right else 'WRONG'}  {name}: {results[name].words}", flush=True)
    right = sum(each.right for each in results.values())
    print(
        json.dumps({name: each._asdict() for name, each in results.items()})
        if given.json
        else f"{right} of {len(results)}"
    )


if __name__ == "__main__":
    main()
