"""Public names of the last release are answered with the names that replace them."""

import csv
from pathlib import Path

import pyarrow as pa
import pytest

import occlog
from occlog.cli.main import run
from occlog.errors import LONGEST_LIST, ExitCode, InputError, UsageError, abridged, did_you_mean, nearest
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.arrow import arrow_schema, check_schema
from occlog.io.formats.scenes.scene import scene_from_yaml, scene_to_yaml
from occlog.records.tables import Diagnostics

ROOT = Path(__file__).parents[1]
ROWS = list(csv.DictReader((ROOT / "occlog" / "renamed.csv").read_text("utf-8").splitlines()))
SCENE = """occlog_scene: 1
cameras:
- {name: east, position: [0, 0], yaw_deg: 45, focal_px: 320, fov_deg: 90, noise: {NOISE}}
"""


def test_the_map_names_each_old_name_once():
    keys = [(row["kind"], row["owner"], row["old"]) for row in ROWS]
    assert len(set(keys)) == len(keys)
    assert all(row["old"] != row["new"] for row in ROWS)


def test_a_new_name_is_preferred_to_one_that_is_spelled_alike():
    assert nearest("sigma_v", ["sigma_w", "process_noise_position"]) == ["process_noise_position"]
    assert nearest("--no-learn", ["--learn-background", "--lean"]) == ["--learn-background"]
    assert nearest("sigma_v", ["sigma_w"]) == ["sigma_w"]


@pytest.mark.parametrize(
    ("words", "new"),
    [
        (["track", "x.parquet", "-o", "y.parquet", "--method", "apf", "--count", "2"], "--n-cameras"),
        (["track", "x.parquet", "-o", "y.parquet", "--method", "apf", "--set", "sigma_v=1"], "process_noise_position"),
        (["listen", "x.wav", "-o", "y.mcap", "--apart", "20"], "--min-separation"),
        (["fit-motion", "x.parquet", "-o", "y.json", "--sigma", "full"], "--process-noise-form"),
    ],
)
def test_old_options_and_settings_of_a_command_are_answered(words: list[str], new: str, capsys: pytest.CaptureFixture):
    assert run(words) == ExitCode.USAGE
    assert new in capsys.readouterr().err


def test_old_settings_in_python_are_answered():
    with pytest.raises(UsageError, match="process_noise_position"):
        occlog.track("x.parquet", method="ekf", sigma_v=1.0)


def test_scenes_with_the_old_keys_of_noise_are_the_same():
    old = scene_from_yaml(SCENE.replace("{NOISE}", "{read_px: 3, detection: 0.9, false_alarm: 0.1}"), "old")
    new = "{measurement_noise_px: 3, detection_probability: 0.9, false_alarm_probability: 0.1}"
    assert scene_to_yaml(old) == scene_to_yaml(scene_from_yaml(SCENE.replace("{NOISE}", new), "new"))
    with pytest.raises(InputError, match="read_px"):
        scene_from_yaml(SCENE.replace("{NOISE}", "{measurement_noise_px: 3, read_px: 3}"), "both")


def test_an_old_column_is_answered():
    schema = arrow_schema(Diagnostics, Provenance("track", {}, 7, (), ()))
    old = [field.with_name("doubt") if field.name == "quality_flags" else field for field in schema]
    with pytest.raises(InputError, match="quality_flags"):
        check_schema(Path("diagnostics.parquet"), pa.schema(old, schema.metadata), Diagnostics)


def test_a_list_of_valid_names_is_as_long_as_a_line_has_space() -> None:
    names = [f"name_{n}" for n in range(100)]
    assert did_you_mean("q", names[:2]) == "there are name_0, name_1"
    text = did_you_mean("q", names)
    shown = text.removeprefix("there are ").partition(" and ")[0].split(", ")
    assert shown == names[: len(shown)]
    assert text.endswith(f" and {len(names) - len(shown)} more")
    assert len(", ".join(shown)) <= LONGEST_LIST


def test_long_lists_of_names_are_cut_and_the_rest_counted() -> None:
    names = [f"camera{n:04d}" for n in range(1000)]
    text = abridged(names)
    assert len(text) <= LONGEST_LIST + len(" and 1000 more")
    shown, _, more = text.rpartition(" and ")
    assert more == f"{1000 - len(shown.split(', '))} more"
    assert abridged(["a" * 1000, "b"]) == f"{'a' * LONGEST_LIST} and 1 more"
    assert (abridged([]), abridged([1, 2])) == ("none", "1, 2")
