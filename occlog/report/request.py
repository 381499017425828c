"""Request of `occlog report`: a page of a run, tracks drawn over a video, or a page of two runs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import ClassVar

from occlog.request import Form, Request, Verb, VerbKind, group, load, scene_file, sink, source
from occlog.settings import option_setting, setting

from .comparison.config import RunComparisonConfig

PAGE, OVERLAY, BESIDE = "page", "overlay", "beside"
OUTPUT_HELP = "Page to write: one self-contained HTML file."
PNG_HELP = "Also write the main figures as a picture; with --frame instead that frame with overlay, and no page."
MARKDOWN_HELP = "Also write text and metrics as Markdown."


@dataclass(frozen=True, kw_only=True)
class ReportRequestBase(Request):
    """Show TRACKS or a run folder as one HTML page: floor plan, errors and bound, observation coverage.

    Of a run folder everything is shown that is not named otherwise. Without TRACKS only the scene is drawn. Two runs
    are shown side by side, with their differences. Of tracks in images the page has no floor plan. With --video or
    --frame no page is made: TRACKS, in images or on the ground, and true boxes are drawn over the frames of the video
    of --recording.

    \b
      occlog report run/ -o report.html --png report.png
      occlog report run/old run/new -o comparison.html --markdown comparison.md
      occlog report tracks.parquet --scene scene.yaml --bearings bearings.parquet -o report.html
      occlog report --scene scene.yaml -o scene.html
      occlog report view_tracks.parquet --recording walk.mcap -o report.html
      occlog report view_tracks.parquet --recording balls.mcap --truth balls.mcap --video balls.webm
    """

    OWNER: ClassVar[str] = "report"

    tracks: Path | None = source("Tracks, or a run folder.", argument=True, required=False)
    scene: Path | None = scene_file()
    truth: Path | None = source("True positions: a recording or a table.")
    png: Path | None = sink(PNG_HELP, result="report", suffix=".png", asked="png")


@dataclass(frozen=True, kw_only=True)
class PageRequest(ReportRequestBase):
    """Request of the report page of one run: tables, images, and outputs."""

    RUN: ClassVar[str] = "occlog.report.run:run_report"
    JUDGED: ClassVar[bool] = True

    output: Path | None = sink(OUTPUT_HELP, option="-o/--output", result="report", suffix=".html")
    bearings: Path | None = source("Bearings (a table or a recording), for observation coverage and lines of sight.")
    errors: Path | None = source("Errors of `occlog evaluate`.")
    bound: Path | None = source("Bound of `occlog evaluate`.")
    diagnostics: Path | None = source("Filter diagnostics of `occlog track`.")
    events: Path | None = source(
        "Events of `occlog track` or `occlog fuse`: initiations, terminations, possible identity switches."
    )
    occluders: Path | None = source("Occluder priors used by the tracker (hulls or occluders).")
    metrics: Path | None = source("Metrics of `occlog evaluate` (JSON).")
    images: Path | None = source("Recording with images, shown small next to the plan with the tracks drawn over them.")
    recording: Path | None = source("The same as --images, or what --video and --frame draw over.")
    images_limit: float = option_setting(
        5.0,
        "Maximum size of the images in the page; further images are omitted.",
        at_least=0.01,
        at_most=500,
        metavar="MB",
    )
    markdown: Path | None = sink(MARKDOWN_HELP, result="report", suffix=".md", asked="markdown")
    title: str = option_setting("Tracking report", "Heading of the page.")

    @cached_property
    def found(self) -> PageRequest:
        """This request with missing inputs replaced by files of the run folder."""
        found: PageRequest = load("occlog.report.run:from_folder")(self)
        return found

    @cached_property
    def in_images(self) -> bool:
        """Whether the tracks are in images, so that there is no floor plan."""
        found: bool = load("occlog.report.run:has_tracks_in_images")(self.found.tracks)
        return found

    @property
    def inputs(self) -> list[Path]:
        """All files that are read, including those of a run folder, without duplicates."""
        own = self.found
        first = (own.tracks, own.scene, own.truth, own.bearings, own.errors, own.bound, own.diagnostics)
        files = (*first, own.events, own.occluders, own.metrics, own.images, own.recording)
        return list(dict.fromkeys(path for path in files if path is not None))


@dataclass(frozen=True, kw_only=True)
class OverlayRequest(ReportRequestBase):
    """Request to draw tracks and true boxes over the video of a recording."""

    RUN: ClassVar[str] = "occlog.report.overlay.run:run_overlay"

    png: Path | None = sink(PNG_HELP, result="frame", suffix=".png", asked="frame")
    recording: Path = source("Recording with the video to draw over.", required=True)
    video: Path | None = sink(
        "Video to write: .webm (VP8) for browsers; .mp4 (MPEG-4), which they may not play; .avi (Motion JPEG, "
        "larger, no smears).",
        asked="video",
    )
    frame: int | None = option_setting(
        None, "Number, in the first camera, of the frame for --png.", at_least=0, shown=""
    )
    frames: tuple[int, int] | None = option_setting(
        None,
        "Video of frames A <= number < B of the first camera only.",
        counts=(2,),
        frames=True,
        metavar="A:B",
        shown="",
    )
    cameras: tuple[str, ...] = setting(
        (),
        "Only this camera; may be repeated. The first one counts the frames.",
        option="--camera",
        metavar="NAME",
        repeat=True,
        shown="all",
    )
    failures: Path | None = source("Failures of `occlog evaluate`, drawn in red.")
    ground_tracks: Path | None = source(
        "Ground tracks for the plan next to the images. [default: TRACKS, if on the ground or a folder]"
    )
    diagnostics: Path | None = source(
        "Filter diagnostics of `occlog track`, for the cameras that detect a target where tracks do not state "
        "them. [default: of the folder]"
    )
    plan: bool = setting(
        True, "Draw the floor plan next to the images, for ground tracks.", option="--plan/--no-plan", shown="plan"
    )
    trail_s: float = setting(
        2.0, "Length of the trail behind each target.", unit="s", at_least=0, at_most=3600, option="--trail"
    )
    fundamental: Path | None = source("Epipolar geometry used by the tracker, if not that of the recording.")
    scale: float | None = option_setting(
        None,
        "Enlarge images.",
        at_least=0.05,
        at_most=16,
        shown="by a whole number to about 360 px; no video is larger than 3840 x 2160 px",
    )
    fps: float | None = option_setting(
        None, "Frame rate of the video.", unit="Hz", at_least=0.1, at_most=1000, shown="those of the recording"
    )

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """Generate the rule (field, whether it holds, words) that `frames` is a range."""
        if self.frames is not None:
            yield "frames", 0 <= self.frames[0] < self.frames[1], "A:B with 0 <= A < B"


@dataclass(frozen=True, kw_only=True)
class RunComparisonRequest(ReportRequestBase):
    """Request of a page that compares two runs."""

    RUN: ClassVar[str] = "occlog.report.comparison.run:run_beside"
    JUDGED: ClassVar[bool] = True

    other: Path = source("The other run.", argument=True)
    output: Path | None = sink(OUTPUT_HELP, option="-o/--output")
    settings: Mapping[str, object] = group(lambda: RunComparisonConfig)
    seed: int = option_setting(0, "Seed of the random draws.", at_least=0)
    markdown: Path | None = sink(MARKDOWN_HELP)
    title: str = option_setting("Two runs side by side", "Heading of the page.")

    @cached_property
    def runs(self) -> tuple[PageRequest, PageRequest]:
        """Requests of a page of each of the two runs, with the files in their folders."""
        files_of = load("occlog.report.comparison.run:files_of")
        shared = PageRequest(scene=self.scene, truth=self.truth)
        return files_of(self.tracks, shared), files_of(self.other, shared)

    @property
    def inputs(self) -> list[Path]:
        """Paths of all input files of both runs, without duplicates."""
        return list(dict.fromkeys(path for run in self.runs for path in run.inputs))


VERB = Verb(
    ReportRequestBase,
    {
        PAGE: VerbKind("One offline page, and a picture of the main figures.", lambda: Form(PageRequest), "a page"),
        OVERLAY: VerbKind(
            "Tracks and true boxes drawn over the video of a recording.",
            lambda: Form(OverlayRequest),
            "--recording with --video or --frame (tracks drawn over its video)",
        ),
        BESIDE: VerbKind(
            "Two runs side by side: differences, divergences, identity switches.",
            lambda: Form(RunComparisonRequest),
            "TRACKS OTHER (two runs side by side)",
        ),
    },
    default=PAGE,
    by={"video": lambda _: OVERLAY, "frame": lambda _: OVERLAY},
    counted={2: BESIDE},
    chosen_by="report [--recording PATH --video FILE]",
)
