from __future__ import annotations

import math
from dataclasses import fields

import pytest

from occlog.errors import InputError, UsageError
from occlog.plan.config import PlanConfig
from occlog.settings import SettingError, configure, declaration, json_schema
from occlog.simulate.config import WorldConfig
from occlog.track.catalogue import METHODS, settings_of
from occlog.track.methods.apf.config import ApfConfig


def test_texts_are_read_as_the_type_of_the_setting():
    values = {
        "particles": "500",
        "process_noise_position": "0.2",
        "use_score": "no",
        "start": "1,2.5,0.3",
        "detection_probability": "none",
    }
    config = configure(ApfConfig(detection_probability=0.9), values)
    assert (config.particles, config.process_noise_position, config.use_score) == (500, 0.2, False)
    assert config.start == (1.0, 2.5, 0.3)
    assert config.detection_probability is None
    assert configure(config, {"detection_probability": "0.8"}).detection_probability == 0.8


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("process_noise_positon", "1", "did you mean 'process_noise_position'?"),
        ("xyzzy", "1", "no setting 'xyzzy'; it has: smooth"),
        ("particles", "many", "setting particles: expected a whole number, got 'many'"),
        ("particles", "1.5", "setting particles: expected a whole number, got '1.5'"),
        ("process_noise_position", "", "setting process_noise_position: expected a number, got ''"),
        ("use_score", "maybe", "setting use_score: expected true or false, got 'maybe'"),
        ("start", "1,a", "setting start: expected numbers with commas, got '1,a'"),
    ],
)
def test_what_is_no_setting_or_no_value_is_refused_in_one_line(name, value, message):
    with pytest.raises(UsageError) as caught:
        configure(ApfConfig(), {name: value})
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "values",
    [
        {"particles": 0},
        {"initial_particle_factor": 0},
        {"reference_step_s": 0.0},
        {"process_noise_position": -0.1},
        {"velocity_memory": 1.5},
        {"beta1": -0.1},
        {"beta1": 0.96, "lambda1": 0.05},
        {"beta2": 0.2, "lambda2": 0.9},
        {"defensive_fraction": 2.0},
        {"detection_probability": 0.0},
        {"candidate_detection_probability": 0.0},
        {"clutter_rate": 0.0},
        {"start": (1.0, 2.0)},
        {"start": (1.0, 2.0, -1.0)},
        {"max_gap_s": 0.0},
        {"start": (math.nan, 0.0, 1.0)},
        {"initial_speed": math.nan},
        {"process_noise_position": math.inf},
        {"track_loss_count": -1},
        {"calibration_s": 1e300},
        {"prior_max_age_s": 1e300},
    ],
)
def test_settings_out_of_their_limits_are_refused(values):
    with pytest.raises(InputError, match=r"^apf: .* must be "):
        ApfConfig(**values)


def test_defaults_suit_the_length_unit():
    metres, feet, own = ApfConfig.in_unit("m"), ApfConfig.in_unit("ft"), ApfConfig.in_unit("unit")
    assert own == ApfConfig()
    assert feet.initial_speed == pytest.approx(metres.initial_speed / 0.3048)
    assert feet.process_noise_position == pytest.approx(metres.process_noise_position / 0.3048)
    assert feet.velocity_memory == metres.velocity_memory


def test_every_method_has_valid_defaults_for_every_unit():
    for method in METHODS:
        for unit in ("m", "ft", "in", "unit"):
            assert isinstance(settings_of(method).in_unit(unit), settings_of(method))


def test_the_schema_has_the_default_of_people_where_it_is_another():
    properties = json_schema(WorldConfig)["properties"]
    assert (properties["diameter"]["default"], properties["diameter"]["default_in_metres"]) == (3.33, 0.5)
    assert properties["diameter"]["exclusiveMinimum"] == 0
    assert "default_in_metres" not in properties["redirect_probability"]
    assert properties["object_height"]["type"] == ["number", "null"]


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"redirect_probability": 1.001}, "world: redirect_probability is 1.001, must be at least 0 and at most 1"),
        ({"diameter": 0.0}, "world: diameter is 0.0, must be above 0"),
        ({"steps": 1.5}, "world: steps is 1.5, must be a whole number"),
        ({"steps": True}, "world: steps is True, must be a whole number"),
        ({"object_height": math.nan}, "world: object_height is nan, must be finite and at least 0"),
    ],
)
def test_a_value_beyond_its_range_is_reported_with_the_range(values, says):
    with pytest.raises(InputError, match=says):
        WorldConfig(**values)


def test_values_at_the_ends_of_their_ranges_are_taken():
    assert WorldConfig(redirect_probability=0).redirect_probability == 0
    assert WorldConfig(redirect_probability=1).redirect_probability == 1
    assert WorldConfig(steps=1, object_height=0.0).steps == 1


def test_a_setting_like_another_has_its_default_and_range_and_words_of_its_own():
    (mine,) = (f for f in fields(PlanConfig) if f.name == "redirect_probability")
    (other,) = (f for f in fields(WorldConfig) if f.name == "redirect_probability")
    assert mine.default == other.default
    spec, model = declaration(mine), declaration(other)
    assert spec.help != model.help
    assert (spec.at_least, spec.at_most, spec.below) == (model.at_least, None, 1)
    for unit in ("m", "ft", "unit"):
        plan, world = PlanConfig.in_unit(unit), WorldConfig.in_unit(unit)
        assert (plan.person_diameter, plan.speed, plan.process_noise_position) == (
            world.diameter,
            world.speed,
            world.process_noise_position,
        )


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("particles", "9" * 30, f"particles is {'9' * 30}, must be within 1e+12"),
        ("process_noise_position", "1e300", "process_noise_position is 1e+300, must be within 1e+12"),
        ("clutter_rate", "1e-300", "clutter_rate is 1e-300, must be above 0, at least 1e-15"),
        ("reference_step_s", "1e-9", "reference_step_s is 1e-09, must be at least 0.001"),
    ],
)
def test_numbers_whose_squares_are_none_are_refused(name: str, value: str, message: str) -> None:
    with pytest.raises(SettingError) as caught:
        configure(ApfConfig(), {name: value})
    assert message in str(caught.value)
