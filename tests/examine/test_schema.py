"""`occlog schema`: the settings of every verb as JSON Schemas that are published, valid, and hold the defaults."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from places import ROOT

from occlog.cli.main import COMMANDS, run
from occlog.errors import ExitCode
from occlog.examine.schema import every_schema, part_key, settings_of, settings_schema, settings_schemas, verbs
from occlog.io.formats.models.schemas import SCHEMAS, schema_text
from occlog.settings import declared
from occlog.track.catalogue import METHODS

FOLDER = ROOT / "schemas"


def validator(verb: str, name: str) -> Draft202012Validator:
    """Of one class of a verb's settings."""
    schema = settings_schema(verb)
    if "$defs" in schema:
        schema = {"$ref": f"#/$defs/{part_key(name)}", "$defs": schema["$defs"]}
    return Draft202012Validator(schema)


def as_json(values: dict[str, Any]) -> Any:
    return json.loads(json.dumps(values))


def test_everything_that_is_published_is_up_to_date() -> None:
    schemas = every_schema()
    assert len(schemas) == len(SCHEMAS) + len(settings_schemas()) + 1
    assert sorted(p.stem for p in FOLDER.glob("*.json")) == sorted(schemas), "run `make schemas`"
    for name in (*settings_schemas(), "doctor"):
        assert (FOLDER / f"{name}.json").read_text() == schema_text(name, schemas), "run `make schemas`"


def test_every_schema_is_a_schema() -> None:
    assert set(verbs()) <= set(COMMANDS)
    for verb in verbs():
        Draft202012Validator.check_schema(settings_schema(verb))


def test_every_tracking_method_has_a_definition() -> None:
    assert set(METHODS) <= set(settings_schema("track")["$defs"])


@pytest.mark.parametrize("verb", verbs())
def test_defaults_of_every_unit_are_valid_and_settings_that_are_not_there_are_not(verb: str) -> None:
    for name, of in settings_of(verb).items():
        check = validator(verb, name)
        fields = {f.name for f in declared(of)}
        for unit in ("m", "ft", "px") if len(fields) == len(of.__dataclass_fields__) else ():
            values = {key: value for key, value in asdict(of.in_unit(unit)).items() if key in fields}
            check.validate(as_json(values))
        check.validate({})
        assert not check.is_valid({"no_such_setting": 1}), name


@pytest.mark.parametrize(
    ("verb", "name", "values", "good"),
    [
        ("simulate", "world", {"redirect_probability": 1}, True),
        ("simulate", "world", {"redirect_probability": 1.001}, False),
        ("simulate", "world", {"diameter": 0}, False),
        ("simulate", "world", {"object_height": None}, True),
        ("simulate", "sound", {"sound_and_silence_s": [4, 1]}, True),
        ("simulate", "sound", {"sound_and_silence_s": [4]}, False),
        ("simulate", "video", {"store": "jpeg"}, False),
        ("track", "map", {"loss": "huber", "lag_s": 2}, True),
        ("track", "map", {"particles": 100}, False),
        ("track", "apf", {"particles": 0}, False),
        ("ingest", "ingest", {"calibration_unit": None, "jpeg_quality": 100}, True),
        ("ingest", "ingest", {"jpeg_quality": 101}, False),
    ],
)
def test_ranges_choices_and_counts_are_in_the_schema(verb: str, name: str, values: dict[str, Any], good: bool) -> None:
    assert validator(verb, name).is_valid(values) == good


def test_the_command_prints_settings_and_lists_them(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["schema", "track"]) == ExitCode.DONE
    assert json.loads(capsys.readouterr().out) == as_json(settings_schema("track"))
    assert run(["schema"]) == ExitCode.DONE
    assert {"tracks", "track", "simulate"} <= set(capsys.readouterr().out.split())
