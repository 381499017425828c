"""Request of `occlog evaluate`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from occlog.plugins.loading import Chosen
from occlog.request import SCENE_HELP as SCENE
from occlog.request import Request, group, plugged, sink, source
from occlog.settings import option_setting, setting

from .matching.config import AZIMUTHS, GROUND, IMAGES, KINDS, OTHERS, WORLD, EvaluateConfig
from .mot.config import MANY, MultiTargetConfig


@dataclass(frozen=True, kw_only=True)
class EvaluateRequest(Request):
    """Evaluate TRACKS against ground truth, the Cramer-Rao bound, and the bearings that they were made from.

    Every metric that the given files allow is computed: errors (tracks and truth), detection rates and the posterior
    Cramer-Rao bound (bearings and truth), triangulation residuals and prediction of held-out sensors (no truth
    needed), recall of views (true boxes). Tracks of many targets, in images (view_tracks, boxes with identities,
    MOTChallenge text) or on the ground, get CLEAR-MOT, IDF1, HOTA, GOSPA, and the failure rates of [Qu] Eq. 9.

    \b
      occlog evaluate tracks.parquet --truth recording.mcap --bearings bearings.parquet -o metrics.json
      occlog evaluate tracks.parquet --truth recording.mcap --errors errors.parquet --fail-if 'rmse>0.5'
      occlog evaluate without_cam4.parquet --bearings all.parquet --scene scene.yaml --held-out cam4
      occlog evaluate --views views.parquet --truth recording.mcap --json | jq .views_recall
      occlog evaluate --doa doa.parquet --truth-azimuths azimuths.csv
      occlog evaluate view_tracks.parquet --truth recording.mcap --failures failures.parquet
      occlog evaluate test.txt --truth gt.txt --fail-if 'mota<0.5'
      occlog evaluate a.txt --truth gt_a.txt --also b.txt gt_b.txt
    """

    OWNER: ClassVar[str] = "evaluate"
    RUN: ClassVar[str] = "occlog.evaluate.run:run_evaluate"
    JUDGED: ClassVar[bool] = True
    KIND: ClassVar[str] = "occlog.evaluate.run:kind_of_input"
    KINDS: ClassVar[Mapping[str, str]] = KINDS

    tracks: Path | None = source("Tracks to evaluate.", argument=True, required=False)
    truth: Path | None = source(
        "Truth: a recording, or a table of positions (t_s, target_id, x, y) or true boxes; for tracks in images also "
        "MOTChallenge text, XML (PETS), VATIC's or KITTI's text.",
        kinds=(IMAGES, GROUND, OTHERS),
    )
    bearings: Path | None = source(
        "Bearings (table or recording), for detection rates, bound and triangulation residuals.", kinds=WORLD
    )
    measurements: Path | None = source(
        "Ranges, signal strengths, time differences or reads of tags, for the bound; their settings are those stated "
        "in TRACKS.",
        kinds=WORLD,
    )
    doa: Path | None = source(
        "Directions of arrival: a table or recording. Used together with --bearings, or compared with "
        "--truth-azimuths. [default: those in the recording of --bearings]",
        kinds=(AZIMUTHS, *WORLD),
    )
    doa_labels: bool = option_setting(
        False,
        "Source IDs in the directions of arrival are target IDs. [default: directions are unlabelled candidates]",
        shown="",
        kinds=WORLD,
    )
    truth_azimuths: Path | None = source(
        "True directions to compare --doa with: a log (columns time, azimuth_deg) or a table.", kinds=(AZIMUTHS,)
    )
    doa_gate_deg: float | None = setting(
        None,
        "Gate: a direction farther than this from every true one is a false alarm, and the true one is missed.",
        unit="deg",
        at_least=0,
        at_most=180,
        option="--doa-gate",
        nothing="10 deg",
        kinds=(AZIMUTHS,),
    )
    views: Path | None = source(
        "Views (table of `occlog detect --views`) to compare with the true boxes of --truth. With --held-out: views "
        "or boxes of all people, of which those of held-out cameras are predicted from the tracks.",
        kinds=WORLD,
    )
    cooperation: Path | None = source(
        "Camera requests (Parquet) of `occlog track --cooperation`, to report their number and mean period, answers "
        "and requested frames.",
        kinds=WORLD,
    )
    diagnostics: Path | None = source(
        "Filter diagnostics (Parquet) of `occlog track --diagnostics`, for the consistency checks.", kinds=WORLD
    )
    scene: Path | None = source(SCENE, scene=True, kinds=(AZIMUTHS, *WORLD))
    output: Path | None = sink("Write all metrics as one JSON object.", option="-o/--output", asked="never")
    errors: Path | None = sink("Write the error of each estimate (Parquet).", "errors", kinds=WORLD)
    bound: Path | None = sink(
        "Write the posterior Cramer-Rao bound of each target at each time (Parquet).", "bound", kinds=WORLD
    )
    write_scene: Path | None = sink(
        "Write the scene (YAML) with the measurement noise of each camera as estimated from truth; needs --bearings "
        "and --truth.",
        asked="never",
        kinds=WORLD,
    )
    fail_if: tuple[str, ...] = option_setting(
        (),
        "Exit with code 6 if this condition holds or is undefined, e.g. 'rmse>0.5'; may be repeated.",
        metavar="CONDITION",
        repeat=True,
        whole=True,
        shown="",
    )
    metrics: tuple[Chosen, ...] = plugged(
        "metric", "Also report the metrics of this plug-in; may be repeated.", "--metric", (GROUND,)
    )
    settings: Mapping[str, object] = group(lambda: EvaluateConfig)
    multi_target: Mapping[str, object] = group(lambda: MultiTargetConfig)
    frames: tuple[int, int] | None = option_setting(
        None,
        "Only frames A <= number < B; on the ground the times of the truth (else of the bearings) are numbered from 0.",
        counts=(2,),
        frames=True,
        metavar="A:B",
        shown="",
        kinds=(IMAGES, *WORLD),
    )
    additional: tuple[tuple[Path, Path], ...] = source(
        "Tracks and truth of one more recording: a row for each recording in one table, and a combined total; may "
        "be repeated.",
        option="--also",
        together=2,
        metavar="TRACKS TRUTH",
        kinds=MANY,
    )
    failures: Path | None = sink(
        "Write each failure of a tracker: frame, camera, target, cause (Parquet).", "failures", asked="also", kinds=MANY
    )
    counts: Path | None = sink(
        "Write the numbers of targets and tracks at each time of the truth (Parquet).",
        "counts",
        asked="also",
        kinds=(GROUND,),
    )
    mot: Path | None = sink(
        "Write truth and tracks as MOTChallenge files in the folder layout of TrackEval; DIR may already hold "
        "results of other trackers.",
        metavar="DIR",
        asked="never",
        kinds=(IMAGES,),
    )

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """Generate the rule (field, whether it holds, words) that `frames` is a range."""
        if self.frames is not None:
            yield "frames", 0 <= self.frames[0] < self.frames[1], "A:B with 0 <= A < B"

    @property
    def outputs(self) -> list[Path]:
        """All files that are written and must not exist; the folder of MOTChallenge files may exist."""
        return [path for name, path in self.files(output=True).items() if name != "mot"]

    @property
    def directions(self) -> Path | None:
        """File of bearings, or else of directions of arrival; None without both."""
        return self.bearings or self.doa

    @property
    def inputs(self) -> list[Path]:
        """Paths of all input files, without duplicates."""
        pairs = tuple(path for pair in self.additional or () for path in pair)
        files = (self.tracks, self.truth, *pairs, self.bearings, self.doa, self.views, self.cooperation)
        more = (self.diagnostics, self.measurements, self.scene, self.truth_azimuths)
        return list(dict.fromkeys(path for path in (*files, *more) if path is not None))
