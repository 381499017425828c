"""Figures by TrackEval and py-motmetrics; runs in an environment that has them, reads and writes JSON.

    python mot_peers.py scenes.json    a list of scenes, each a list of frames
                                       {"truth": ids, "tracks": ids, "similarity": rows, "distance": rows}
    python mot_peers.py folder         truth/NAME/..., tracks/ours/data/NAME.txt, list.txt: evaluated as files
    python mot_peers.py layout folder  gt/..., trackers/...: as TrackEval points at them by itself, and py-motmetrics

A distance that must not be paired is null.
"""

from __future__ import annotations

import contextlib
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np


def of_scenes(scenes: list[list[dict[str, Any]]]) -> list[dict[str, Any]]:
    return [{"trackeval": _trackeval(scene), "motmetrics": _motmetrics(scene)} for scene in scenes]


def _trackeval(scene: list[dict[str, Any]]) -> dict[str, Any]:
    from trackeval import metrics

    targets = sorted({i for frame in scene for i in frame["truth"]})
    tracks = sorted({i for frame in scene for i in frame["tracks"]})
    similarity = [np.array(f["similarity"], dtype=float).reshape(len(f["truth"]), len(f["tracks"])) for f in scene]
    data = {
        "num_timesteps": len(scene),
        "num_gt_ids": len(targets),
        "num_tracker_ids": len(tracks),
        "num_gt_dets": sum(len(f["truth"]) for f in scene),
        "num_tracker_dets": sum(len(f["tracks"]) for f in scene),
        "gt_ids": [np.array([targets.index(i) for i in f["truth"]], dtype=int) for f in scene],
        "tracker_ids": [np.array([tracks.index(i) for i in f["tracks"]], dtype=int) for f in scene],
        "similarity_scores": similarity,
    }
    out: dict[str, Any] = {}
    for metric in (metrics.HOTA(), metrics.CLEAR(), metrics.Identity()):
        out |= metric.eval_sequence(data)
    return _plain(out)


def _motmetrics(scene: list[dict[str, Any]]) -> dict[str, Any]:
    import motmetrics

    accumulator = motmetrics.MOTAccumulator(auto_id=True)
    for f in scene:
        distance = np.array(f["distance"], dtype=float).reshape(len(f["truth"]), len(f["tracks"]))
        accumulator.update(f["truth"], f["tracks"], distance)
    names = ["num_detections", "num_false_positives", "num_misses", "num_switches", "num_fragmentations"]
    names += ["mostly_tracked", "partially_tracked", "mostly_lost", "mota", "motp", "recall", "precision"]
    names += ["idtp", "idfp", "idfn", "idf1", "idp", "idr"]
    table = motmetrics.metrics.create().compute(accumulator, metrics=names, name="all")
    return _plain({name: table[name].iloc[0] for name in names})


def of_folder(folder: Path) -> dict[str, Any]:
    """TrackEval's own evaluation of the files, with its defaults for three benchmarks."""
    import trackeval

    quiet = {"PRINT_CONFIG": False, "PRINT_RESULTS": False, "TIME_PROGRESS": False, "BREAK_ON_ERROR": True}
    save = {"OUTPUT_SUMMARY": False, "OUTPUT_DETAILED": False, "PLOT_CURVES": False, "LOG_ON_ERROR": None}
    files = {
        "GT_FOLDER": str(folder / "truth"),
        "TRACKERS_FOLDER": str(folder / "tracks"),
        "SEQMAP_FILE": str(folder / "list.txt"),
        "SKIP_SPLIT_FOL": True,
        "PRINT_CONFIG": False,
    }
    wanted = [trackeval.metrics.HOTA(), trackeval.metrics.CLEAR(), trackeval.metrics.Identity()]
    both = {}
    for benchmark in ("MOT15", "MOT17", "MOT20"):
        data = trackeval.datasets.MotChallenge2DBox({**files, "BENCHMARK": benchmark})
        results, _ = trackeval.Evaluator({**quiet, **save}).evaluate([data], wanted)
        both[benchmark] = results["MotChallenge2DBox"]["ours"]
    return {
        benchmark: {
            name: _plain({k: v for part in classes["pedestrian"].values() for k, v in part.items()})
            for name, classes in sequences.items()
        }
        for benchmark, sequences in both.items()
    }


def of_layout(folder: Path) -> dict[str, Any]:
    """Both programs on the folder; TrackEval is given nothing but where it is."""
    import trackeval

    places = {"GT_FOLDER": str(folder / "gt"), "TRACKERS_FOLDER": str(folder / "trackers"), "PRINT_CONFIG": False}
    data = trackeval.datasets.MotChallenge2DBox(places)
    wanted = [trackeval.metrics.HOTA(), trackeval.metrics.CLEAR(), trackeval.metrics.Identity()]
    how = {"PRINT_CONFIG": False, "PRINT_RESULTS": False, "TIME_PROGRESS": False, "BREAK_ON_ERROR": True}
    how |= {"OUTPUT_SUMMARY": False, "OUTPUT_DETAILED": False, "PLOT_CURVES": False, "LOG_ON_ERROR": None}
    found = trackeval.Evaluator(how).evaluate([data], wanted)[0]["MotChallenge2DBox"]
    return {
        tracker: {
            name: _plain({k: v for part in classes["pedestrian"].values() for k, v in part.items()})
            | ({} if name == "COMBINED_SEQ" else {"motmetrics": _motmetrics_files(folder, tracker, name)})
            for name, classes in sequences.items()
        }
        for tracker, sequences in found.items()
    }


def _motmetrics_files(folder: Path, tracker: str, name: str) -> dict[str, Any]:
    import motmetrics

    # py-motmetrics 1.4.0 wants what NumPy 2 no longer has.
    vars(np)["asfarray"] = lambda values: np.asarray(values, dtype=float)
    truth = motmetrics.io.loadtxt(folder / "gt" / "MOT17-train" / name / "gt" / "gt.txt", fmt="mot15-2D")
    tracks = motmetrics.io.loadtxt(folder / "trackers" / "MOT17-train" / tracker / "data" / f"{name}.txt")
    accumulator = motmetrics.utils.compare_to_groundtruth(truth, tracks, "iou", distth=0.5)
    names = ["num_false_positives", "num_misses", "num_switches", "mota", "motp", "idf1"]
    table = motmetrics.metrics.create().compute(accumulator, metrics=names, name="all")
    return _plain({k: table[k].iloc[0] for k in names})


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    """Numbers and lists for JSON; what is not finite as null."""
    made = {name: np.asarray(value, dtype=float) for name, value in values.items()}
    return {name: np.where(np.isfinite(v), v, None).tolist() for name, v in made.items()}


if __name__ == "__main__":
    given = Path(sys.argv[-1])
    with contextlib.redirect_stdout(sys.stderr):
        if sys.argv[1] == "layout":
            answer: Any = of_layout(given)
        else:
            answer = of_folder(given) if given.is_dir() else of_scenes(json.loads(given.read_text()))
    json.dump(answer, sys.stdout)
