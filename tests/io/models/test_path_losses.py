"""Files of path losses: what was written is read again; every wrong field is one clear line."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import pytest

from occlog.errors import InputError
from occlog.io.files.provenance import Provenance
from occlog.io.formats.models.motion_models import (
    CoverageSpec,
    PathLossSpec,
    ReaderLoss,
    path_loss_schema,
    read_path_loss,
    write_path_loss,
)

SPEC = PathLossSpec(
    length_unit="m",
    height=1.2,
    exponent=1.7,
    noise_db=4.5,
    shadow_db=3.1,
    shadow_s=5.0,
    window_s=1.0,
    readers=[ReaderLoss(name="A", power=-59.0, error=0.2, reads=100), ReaderLoss(name="B", power=-60.0, reads=0)],
    coverage=CoverageSpec(range=5.5, detection=0.75, stray=0.2),
)


def test_written_is_read_again(tmp_path: Path) -> None:
    path = tmp_path / "loss.json"
    write_path_loss(path, SPEC, Provenance("fit-readers"))
    back = read_path_loss(path)
    assert (back.readers, back.coverage, back.exponent) == (SPEC.readers, SPEC.coverage, SPEC.exponent)
    values = json.loads(path.read_text())
    jsonschema.validate(values, path_loss_schema())
    assert values["_provenance"]["command"] == "fit-readers"


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("exponent", 0, "exponent"),
        ("readers", [], "readers"),
        ("coverage", {"range": 5, "detection": 1.0, "stray": 0.1}, "detection"),
        ("occlog_path_loss", None, "holds no path losses"),
        ("extra", 1, "extra"),
        ("readers", [{"name": "A", "power": -60, "reads": 1}, {"name": "A", "power": -60, "reads": 1}], "twice"),
    ],
)
def test_a_wrong_file_is_one_line(tmp_path: Path, key: str, value: object, says: str) -> None:
    path = tmp_path / "loss.json"
    write_path_loss(path, SPEC, Provenance("fit-readers"))
    values = {**json.loads(path.read_text()), key: value}
    path.write_text(json.dumps({k: v for k, v in values.items() if v is not None}))
    with pytest.raises(InputError, match=says) as caught:
        read_path_loss(path)
    assert "\n" not in str(caught.value)
