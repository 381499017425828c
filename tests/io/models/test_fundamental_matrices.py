"""Fundamental matrices as JSON files and attached to recordings: what is written is read, and faults are named."""

import json

import numpy as np
import pytest

from occlog.errors import InputError
from occlog.io.files.provenance import Provenance
from occlog.io.formats.models.fundamental_matrices import (
    attached_epipolar,
    epipolar_bytes,
    read_epipolar,
    write_epipolar,
)
from occlog.io.recording.reader import open_recording
from occlog.io.recording.writer import RecordingWriter
from occlog.records.view_pairs import ViewPair, ViewPairs

MADE = Provenance("epipolar", {})
F = np.array([[1e-6, 2e-5, -3e-3], [-1e-5, 3e-6, 0.02], [2e-3, -0.03, 1.0]])


def rank_two(matrix):
    u, s, v = np.linalg.svd(matrix)
    s[2] = 0.0
    out = u @ np.diag(s) @ v
    return out / np.linalg.norm(out)


PAIRS = ViewPairs(
    (
        ViewPair("left", "right", rank_two(F), "matches", 0.7, 1.3, False, False, 60, 51, 9.5),
        ViewPair("right", "top", rank_two(F.T), "calibration", undistorted=True),
    )
)


def similar(found, wanted):
    for x, y in zip(found.pairs, wanted.pairs, strict=True):
        assert np.allclose(x.matrix, y.matrix, rtol=1e-14, atol=0)
        for name in x._fields:
            if name != "matrix":
                assert getattr(x, name) == getattr(y, name) or np.isnan(getattr(y, name)), name
    return True


def test_what_is_written_is_read(tmp_path):
    write_epipolar(tmp_path / "e.json", PAIRS, MADE)
    assert similar(read_epipolar(tmp_path / "e.json"), PAIRS)


def test_pairs_are_found_in_either_order():
    assert PAIRS.find("left", "top") is None
    pair = PAIRS.find("right", "left")
    assert (pair.a, pair.b) == ("right", "left")
    assert np.array_equal(pair.matrix, PAIRS.pairs[0].matrix.T)


def test_a_recording_holds_them(tmp_path):
    for name, held in (("with", True), ("without", False)):
        with RecordingWriter(tmp_path / f"{name}.mcap", None, MADE) as writer:
            if held:
                writer.attach("epipolar.json", "application/json", epipolar_bytes(PAIRS, MADE))
    assert similar(read_epipolar(tmp_path / "with.mcap"), PAIRS)
    assert attached_epipolar(open_recording(tmp_path / "without.mcap")) is None
    with pytest.raises(InputError, match="holds no epipolar geometry"):
        read_epipolar(tmp_path / "without.mcap")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda p: {"pears": p}, r"e\.json: is not epipolar geometry"),
        (lambda p: {"pairs": []}, "pairs"),
        (lambda p: {"pairs": [{"a": "x", "matrix": p[0]["matrix"]}]}, "missing required field `b`"),
        (lambda p: {"pairs": [{**p[0], "b": "left"}]}, r"pairs\[0\]: a and b are both 'left'"),
        (lambda p: {"pairs": [p[0], {**p[0], "a": "right", "b": "left"}]}, r"pairs\[1\]: .* are there twice"),
        (lambda p: {"pairs": [{**p[0], "matrix": np.zeros((3, 3)).tolist()}]}, r"\(left, right\): .* rank 1"),
        (lambda p: {"pairs": [{**p[0], "matrix": np.diag([1e-6, 1e-6, 1.0]).tolist()}]}, "far from rank 2"),
        (lambda p: {"pairs": [{**p[0], "matrix": [[1, 2], [3, 4]]}]}, "length >= 3"),
        (lambda p: {"pairs": [{**p[0], "source": "guess"}]}, "source"),
        (lambda p: {"pairs": [{**p[0], "colour": 1}]}, "unknown field `colour`"),
    ],
)
def test_faults_are_named_in_one_line(tmp_path, change, says):
    path = tmp_path / "e.json"
    path.write_text(json.dumps(change(json.loads(epipolar_bytes(PAIRS, MADE))["pairs"])))
    with pytest.raises(InputError, match=says) as caught:
        read_epipolar(path)
    assert "\n" not in str(caught.value)


def test_matrices_of_a_few_digits_are_taken(tmp_path):
    path = tmp_path / "e.json"
    rounded = [[float(f"{v:.4g}") for v in row] for row in PAIRS.pairs[0].matrix]
    path.write_text(json.dumps({"pairs": [{"a": "left", "b": "right", "matrix": rounded}]}))
    pair = read_epipolar(path).pairs[0]
    assert np.allclose(pair.matrix, PAIRS.pairs[0].matrix, rtol=1e-3)
    assert (pair.source, pair.undistorted, np.isnan(pair.error_px)) == ("matches", False, True)
