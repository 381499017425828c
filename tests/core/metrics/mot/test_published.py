"""Figures that were published for two recorded sequences, to the printed digits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mot_published import PUBLISHED

from occlog.core.metrics.mot.clear_mot import CHALLENGE, CLASSIC, ClearRule, clear_mot
from occlog.core.metrics.mot.frame_pairs import MatchedFrames, Objects, of_boxes
from occlog.core.metrics.mot.hota import hota, identity


def side(path: Path) -> Objects:
    rows = np.loadtxt(path, delimiter=",")
    return Objects(rows[:, 0].astype(np.int64), rows[:, 1].astype(np.int64), rows[:, 2:6])


def printed(frames: MatchedFrames, rule: ClearRule) -> dict[str, str]:
    """The figures as py-motmetrics prints them."""
    clear, who, higher = clear_mot(frames, rule), identity(frames), hota(frames).means()
    counts = {
        "GT": len(frames.truth_key),
        "MT": clear.mostly_tracked,
        "PT": clear.partly_tracked,
        "ML": clear.mostly_lost,
        "FP": clear.fp,
        "FN": clear.fn,
        "IDs": clear.switches,
        "FM": clear.fragmentations,
    }
    shares = {
        "IDF1": who.idf1,
        "IDP": who.idp,
        "IDR": who.idr,
        "Rcll": clear.recall,
        "Prcn": clear.precision,
        "MOTA": clear.mota,
        "DETA": higher["det_a"],
        "ASSA": higher["ass_a"],
        "HOTA": higher["hota"],
    }
    texts = {name: str(count) for name, count in counts.items()} | {name: f"{x:.1%}" for name, x in shares.items()}
    return texts | {"MOTP": f"{clear.motp:.3f}"}


@pytest.mark.parametrize("rule", [CLASSIC, CHALLENGE])
@pytest.mark.parametrize("name", list(PUBLISHED))
def test_published_figures_come_out(shared_data: Path, name: str, rule: ClearRule) -> None:
    folder = shared_data / "tud_mot" / name
    assert printed(of_boxes(side(folder / "gt.txt"), side(folder / "test.txt")), rule) == PUBLISHED[name]
