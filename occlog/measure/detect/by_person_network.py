"""Detection with occlog's person network in all cameras of a recording, or in some of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from occlog.io.files.provenance import hash_file
from occlog.measure.detections import Detections
from occlog.measure.networks.detector import Embedder, NetworkDetector
from occlog.measure.networks.running.runtimes import opencv_threads
from occlog.records.frames import Frame
from occlog.records.scene import Scene
from occlog.records.verdicts import Check

from .by_network import detect_by_network
from .checks import DETECTOR
from .choice import detect_in_both
from .config import NETWORK, DetectConfig


@dataclass
class Work:
    """Detection in a recording, still to be executed, and what is recorded about it.

    Attributes:
        parts: detections in the order of time, generated lazily.
        parameters: method and settings, for the provenance.
        files: files read in addition to those of the request.
        summary: figures of the detector for the user.
        checks: checks of the choice of the detector.
    """

    parts: Iterator[Detections]
    parameters: dict[str, object]
    files: tuple[Path, ...] = ()
    summary: dict[str, object] = field(default_factory=dict)
    checks: tuple[Check, ...] = ()


@dataclass(frozen=True)
class PersonDetector:
    """Detection by occlog's person network.

    Attributes:
        network: person network.
        embedder: re-identification network; None: none.
        config: settings.
        threads: number of threads.
    """

    network: NetworkDetector
    embedder: Embedder | None
    config: DetectConfig
    threads: int

    @property
    def files(self) -> tuple[Path, ...]:
        """Files of the networks, to be hashed for the provenance."""
        return (*self.network.network.file.files, *(self.embedder.network.file.files if self.embedder else ()))

    @property
    def used(self) -> dict[str, object]:
        """Parameters of the networks, for provenance."""
        more = {} if self.embedder is None else self.embedder.parameters()
        return {"network": self.network.network.file.path.name, **self.network.parameters(), **more}

    def work(self, frames: Iterable[Frame], scene: Scene, checks: tuple[Check, ...]) -> Work:
        """Set up the detection in all cameras with the network, lazily; `checks` precede those of the network."""
        parts = _with_threads(detect_by_network(frames, scene, self.network, self.embedder, self.config), self.threads)
        used = {"input": "images", "method": NETWORK, **self.used, **of_boxes(self.config)}
        summary = {"method": NETWORK, **described(self.network)}
        return Work(parts, used, self.files, summary, (*checks, check_of(self.network)))

    def work_with(
        self,
        frames: Iterable[Frame],
        scene: Scene,
        checks: tuple[Check, ...],
        cameras: Sequence[str],
        by_background: Callable[[Iterable[Frame]], Iterator[Detections]],
        used: Mapping[str, object],
    ) -> Work:
        """Set up the detection in some cameras with the network, in the others by background subtraction, lazily.

        Args:
            frames: frames of all cameras.
            scene: scene with the cameras.
            checks: earlier checks, which precede that of the network in the result.
            cameras: names of those for the network.
            by_background: generates the detections in frames of the others.
            used: parameters of background subtraction, for the provenance.
        """
        own = partial(detect_by_network, scene=scene, detector=self.network, embedder=self.embedder,
                      config=self.config, shapes={})  # fmt: skip
        length = 0 if self.embedder is None else self.embedder.length
        parts = _with_threads(detect_in_both(frames, cameras, own, by_background, length), self.threads)
        both = {**used, "of_network": {"cameras": list(cameras), **self.used, **of_boxes(self.config)}}
        summary = {"method": f"{NETWORK} ({', '.join(cameras)}), {used['method']}", **described(self.network)}
        return Work(parts, both, self.files, summary, (*checks, check_of(self.network)))


def _with_threads(parts: Iterator[Detections], threads: int) -> Iterator[Detections]:
    """Generate the parts unchanged, while OpenCV uses `threads` threads."""
    with opencv_threads(threads):
        yield from parts


def described(detector: NetworkDetector) -> dict[str, object]:
    """Name of the network with its hash, and its confidence threshold, for the summary."""
    return {"network": network_in_words(detector), "min_confidence": detector.least}


def network_in_words(detector: NetworkDetector) -> str:
    """File name of a network and first 12 digits of its SHA-256, for messages."""
    path = detector.network.file.path
    return f"{path.name} (sha256 {hash_file(path)[:12]})"


def check_of(detector: NetworkDetector) -> Check:
    """Passed check of the verdict that states the network and its confidence threshold."""
    text = f"{network_in_words(detector)}, boxes of confidence {detector.least:g} and more"
    return Check(DETECTOR, "passed", text=text, figures={"min_confidence": detector.least})


def of_boxes(config: DetectConfig) -> dict[str, object]:
    """Settings of detection that apply to external boxes and differ from the defaults, for provenance."""
    known = {name: getattr(config, name) for name in ("bit_depth", "sigma_px") if getattr(config, name) is not None}
    return known | ({"sigma_scale": config.sigma_scale} if config.sigma_scale != 1.0 else {})
