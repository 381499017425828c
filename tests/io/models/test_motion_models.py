"""Motion files: what was written is read again; every wrong field is one clear line."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from occlog.errors import InputError, OcclogError
from occlog.io.files.provenance import Provenance
from occlog.io.formats.models.motion_models import MotionModel, motion_schema, read_motion, write_motion

A = np.kron(np.eye(2), [[1.0, 0.25], [0.0, 1.0]])
GOOD = {"occlog_motion": 1, "length_unit": "m", "step_s": 0.25, "A": A.tolist(), "sigma": np.eye(4).tolist()}


def test_written_is_read_again(tmp_path: Path) -> None:
    path = tmp_path / "motion.json"
    sigma = np.diag([0.1, 0.2, 0.3, 1 / 3])
    details = {"noise": float("nan"), "A_error": np.full((4, 4), np.nan).tolist(), "fit": {"form": "cv"}}
    write_motion(path, MotionModel(A, sigma, 0.25, "ft"), details, Provenance("fit-motion"))
    back = read_motion(path)
    assert_array_equal(back.A, A)
    assert_array_equal(back.sigma, sigma)
    assert (back.step_s, back.length_unit) == (0.25, "ft")
    values = json.loads(path.read_text())
    jsonschema.validate(values, motion_schema())
    assert values["noise"] is None
    assert values["A_error"][0] == [None] * 4
    assert values["_provenance"]["command"] == "fit-motion"
    with pytest.raises(OcclogError, match="exists"):
        write_motion(path, MotionModel(A, sigma, 0.25, "ft"), details, Provenance("fit-motion"))


def changed(**values: object) -> str:
    return json.dumps({k: v for k, v in {**GOOD, **values}.items() if v != "gone"})


def without(i: int, j: int, value: float) -> list[list[float]]:
    sigma = np.eye(4)
    sigma[i, j] = value
    return sigma.tolist()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{", "line 1: not valid JSON"),
        ("[1]", "expected a JSON object"),
        (changed(occlog_motion="gone"), "not a motion file"),
        (changed(occlog_motion=2), "occlog_motion"),
        (changed(A="gone"), "`A`"),
        (changed(A=A.tolist()[:3]), r"length >= 4.*\$\.A"),
        (changed(A=[[1.0, 2.0]] * 4), r"\$\.A\[0\]"),
        (changed(A=[["x", 0, 0, 0]] * 4), r"\$\.A\[0\]\[0\]"),
        (changed(A=[[float("nan")] * 4] * 4), "A: row 1, column 1 is nan"),
        (changed(sigma=without(2, 3, float("inf"))), "sigma: row 3, column 4 is inf"),
        (changed(sigma=without(0, 1, 0.5)), "sigma is not symmetric: row 1, column 2 is 0.5, but"),
        (changed(sigma=without(3, 3, 0.0)), "not positive definite"),
        (changed(sigma=without(3, 3, -1.0)), "not positive definite"),
        (changed(sigma=np.ones((4, 4)).tolist()), "not positive definite"),
        (changed(step_s=0), r"> 0.*step_s"),
        (changed(step_s=float("inf")), "step_s is inf"),
        (changed(length_unit="km"), "length_unit"),
        (changed(velocity=1), "velocity"),
    ],
)
def test_what_is_wrong_is_named_in_one_line(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "motion.json"
    path.write_text(text)
    with pytest.raises(InputError, match=says) as caught:
        read_motion(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_small_units_are_no_reason_to_refuse(tmp_path: Path) -> None:
    """Sigma of the example of [Rahimi] Sec. 6: positive definite, though its entries differ 10,000 times."""
    path = tmp_path / "motion.json"
    path.write_text(changed(sigma=(1e-6 * np.diag([1e-4, 1, 1e-4, 1])).tolist()))
    assert read_motion(path).sigma[0, 0] == 1e-10
