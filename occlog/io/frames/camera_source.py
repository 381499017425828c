"""Frames of one camera for ingest, with times and losses."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import chain, islice
from pathlib import Path

import numpy as np

from occlog.array_types import NS
from occlog.errors import InputError, option
from occlog.io.files.timing.frame_times import FrameTimes, as_rate
from occlog.records.columns import MAX_NS
from occlog.records.losses import Loss

from .decoders.process import Decoder, DecodingJob, Delivered, start_decoder
from .streams import ImageFolder, rate_times

TRIAL = 4
"""Frames with time stamps that must rise before the stamps of a container that we cannot read are accepted."""


@dataclass
class CameraSource:
    """Frames of one camera from a running decoder, with their times; `losses` is complete when all have been read."""

    name: str
    path: Path
    decoder: Decoder
    times: FrameTimes
    whole: bool = True  # no range of frames was asked for
    losses: list[Loss] = field(default_factory=list)

    def frames(self) -> Iterator[tuple[int, Delivered]]:
        """Yield (world time [ns], frame) sorted by time.

        Frames without a time stamp, or with one that is not later than the previous, are skipped and added to `losses`.
        """
        stream = self._with_times()
        last: int | None = None
        late: list[int] = []
        for t_ns, frame in stream:
            self._check(t_ns, frame)
            if last is not None and t_ns <= last:
                late.append(frame.index)
                continue
            last = t_ns
            yield t_ns, frame
        if late:
            what = "time stamps repeat or go back; these frames were skipped"
            self.losses.append(Loss(self.path.name, f"from frame {late[0]} on", what, len(late)))
        self.losses.extend(self.decoder.losses)

    def _check(self, t_ns: int, frame: Delivered) -> None:
        if t_ns > MAX_NS:
            raise InputError(
                f"{self.path}: frame {frame.index}: a time of {t_ns / NS:.6g} s is out of range; times from 1970 to "
                f"2115 can be held; give the frame rate ({option('fps')}), or time stamps ({option('timestamps')})",
                id="time-out-of-range",
            )

    def _with_times(self) -> Iterator[tuple[int, Delivered]]:
        delivered = self.decoder.delivered()
        if self.times.table_ns is None and self.times.rate is None:
            yield from self._streamed(delivered)
            return
        count, missing, last = self.times.count, 0, -1
        for frame in delivered:
            last = frame.index
            if count is not None and frame.index >= count:
                missing += 1
                continue
            yield int(self.times.at(np.array([frame.index]))[0]), frame
        if missing:
            what = f"frames without a time: {self.times.source} gives {count}"
            self.losses.append(Loss(self.path.name, f"from frame {count} on", what, missing))
        announced = self.decoder.frames if self.decoder.frames is not None else last + 1
        if self.whole and count is not None and count > announced and self.times.source.startswith("sidecar"):
            what = f"{self.times.source} gives {count} times, but the video has only {announced} frames"
            self.losses.append(Loss(self.path.name, f"from frame {announced} on", what, count - announced))

    def _streamed(self, delivered: Iterator[Delivered]) -> Iterator[tuple[int, Delivered]]:
        """Yield (world time [ns], frame) of a video container that only the decoder can read.

        Times are the decoder's time stamps if those of the first frames increase, else follow from the frame rate.
        """
        head = list(islice(delivered, TRIAL))
        stamps = [frame.pos_ns for frame in head]
        good = all(s is not None for s in stamps) and bool((np.diff([s or 0 for s in stamps]) > 0).all())
        if not good:
            if not self.decoder.rate_hz:
                raise InputError(
                    f"{self.path}: has neither time stamps nor a frame rate; give {option('fps')} or "
                    f"{option('timestamps')}",
                    id="missing-times",
                )
            rate = as_rate(self.decoder.rate_hz)
            self.times = rate_times(rate, "stated by the file", self.times.start_ns).by(self.times.clock)
        for frame in chain(head, delivered):
            if good:
                t_ns = self.times.start_ns + (frame.pos_ns or 0)
                self._check(t_ns, frame)
                yield int(self.times.world(np.array([t_ns]))[0]), frame
            else:
                yield int(self.times.at(np.array([frame.index]))[0]), frame


def video_source(
    name: str,
    path: Path,
    times: FrameTimes,
    *,
    start: int,
    stop: int | None,
    store: str,
    quality: int,
    keys: list[int] | None = None,
) -> CameraSource:
    """Start decoding a video in another process.

    Args:
        name: of the camera.
        path: of the video.
        times: of its frames.
        start: first frame.
        stop: frame after the last; None: to the end.
        store: form in which frames are delivered: png, jpeg, raw or none (times only).
        quality: of JPEG, 1 to 100.
        keys: numbers of key frames, after which damage ends; None: frames after damage are used.
    """
    job = DecodingJob(kind="video", path=str(path), start=start, stop=stop, store=store, quality=quality)
    if keys is not None:
        job["keys"] = keys
    return CameraSource(name, path, start_decoder(job), times, whole=stop is None)


def image_source(
    name: str, folder: ImageFolder, *, start: int, stop: int | None, store: str, quality: int
) -> CameraSource:
    """Start reading an image folder in another process; InputError if it has none of the frames.

    Args:
        name: of the camera.
        folder: its images and times.
        start: first frame.
        stop: frame after the last; None: to the end.
        store: form in which frames are delivered: png, jpeg, raw, none (times only), or keep: PNG and JPEG files as
            they are.
        quality: of JPEG, 1 to 100.
    """
    files = [(i, str(file)) for i, file in folder.files if i >= start and (stop is None or i < stop)]
    if not files:
        raise InputError(
            f"{folder.path}: holds no image of frames {start} to {stop or 'the end'}; choose others "
            f"({option('frames')})",
            id="empty-input",
        )
    job = DecodingJob(kind="images", path=str(folder.path), files=files, store=store, quality=quality)
    return CameraSource(name, folder.path, start_decoder(job), folder.times, whole=False)
