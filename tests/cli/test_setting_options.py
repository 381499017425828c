"""Options made from declared settings, and commands whose options depend on what the arguments choose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import click
import pytest
from click.testing import CliRunner, Result

from occlog.cli.setting_options import (
    CommandVariant,
    SettingsCommand,
    VariantCommand,
    add_options,
    given,
    options_of,
    value_after,
)
from occlog.settings import Settings, configure, option_setting, setting


@dataclass(frozen=True)
class Lamp(Settings):
    OWNER: ClassVar[str] = "lamp"

    power: float = setting(1.0, "Of the lamp.", above=0, at_most=5, option="--power")
    noise: float = setting(0.0, "Flicker.", at_least=0, option="--flicker")
    warm: bool = setting(False, "Warm light.", option="--warm")
    shade: bool = setting(True, "A shade.", option="--shade/--bare")
    size: float = setting(3.0, "Of the lamp.", unit="length", people=0.3)


@dataclass(frozen=True)
class Siren(Settings):
    OWNER: ClassVar[str] = "siren"

    noise: float = option_setting(2.0, "Of the siren.", unit="dB", at_least=0)
    tones: tuple[float, ...] | None = option_setting(None, "Heights.", counts=(2,), nothing="one tone")


@click.command(cls=SettingsCommand)
@add_options(options_of(Lamp, prefix="lamp_"))
@add_options(options_of(Siren))
def both(**values: Any) -> None:
    """Two classes of settings, each with a `noise`."""
    lamp = configure(Lamp(), given(Lamp, values, prefix="lamp_"))
    siren = configure(Siren(), given(Siren, values))
    click.echo(f"{lamp} {siren}")


def chosen(args: Sequence[str]) -> str | None:
    return value_after(args, "--kind")


def switch(shows_default: bool) -> click.Command:
    @click.command(
        cls=VariantCommand,
        variants={
            "plain": CommandVariant("nothing", list, called="no kind"),
            "lamp": CommandVariant("a lamp", lambda: options_of(Lamp)),
            "siren": CommandVariant("a siren", lambda: options_of(Siren)),
            "horn": CommandVariant("a horn", lambda: options_of(Siren, without=("tones",))),
        },
        choose=chosen,
        default="lamp",
        shows_default=shows_default,
        what="kind",
        chosen_by="--kind {}",
    )
    @click.option("--kind")
    def command(kind: str | None, **own: Any) -> None:
        click.echo(f"{kind} {own}")

    return command


def call(command: click.Command, *args: str) -> Result:
    return CliRunner().invoke(command, args)


def test_settings_of_one_name_from_two_classes_keep_apart() -> None:
    out = call(both, "--flicker", "0.5", "--noise", "3").output
    assert "Lamp(power=1.0, noise=0.5" in out
    assert "Siren(noise=3.0" in out


def test_a_flag_is_given_or_left_to_its_default() -> None:
    assert "warm=False, shade=True" in call(both).output
    assert "warm=True, shade=False" in call(both, "--warm", "--bare").output


@pytest.mark.parametrize(("power", "good"), [("5", True), ("5.001", False), ("0", False), ("0.001", True)])
def test_the_range_of_an_option_is_that_of_the_setting(power: str, good: bool) -> None:
    assert call(both, "--power", power).exit_code == (0 if good else 2)


def test_a_value_that_only_the_settings_refuse_is_reported_as_it_was_typed() -> None:
    done = call(both, "--tones", "1,2,3")
    assert done.exit_code == 2
    assert "--tones 1,2,3: must be 2 numbers" in done.output


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["--noise", "1"], "--noise is an option of --kind siren, horn, not of --kind lamp"),
        (["--kind", "siren", "--bare"], "--bare is an option of --kind lamp, not of --kind siren"),
        (["--kind", "plain", "--tones", "1"], "--tones is an option of --kind siren, not of no kind"),
        (["--kind", "lmap"], "no kind 'lmap'; did you mean 'lamp'?"),
    ],
)
def test_an_option_of_another_variant_is_refused_with_those_that_have_it(args: list[str], words: str) -> None:
    done = call(switch(False), *args)
    assert done.exit_code == 2
    assert words in done.output


def test_help_without_a_choice_shows_the_default_variant_only_where_asked_to() -> None:
    shared, shown = call(switch(False), "--help").output, call(switch(True), "--help").output
    for text in (shared, shown):
        assert "Kinds (--kind NAME --help lists the options of each)" in text
        assert "no kind" in text
    assert "Options of --kind lamp" not in shared
    assert "Options of --kind lamp" in shown
    assert "Kinds (" not in call(switch(True), "--kind", "siren", "--help").output


def test_a_default_is_reported_for_metres_and_for_units_of_their_own() -> None:
    (row,) = [p for p in options_of(Lamp) if p.name == "power"]
    assert row.help == "Of the lamp. [default: 1]"
    tones = next(p for p in options_of(Siren) if p.name == "tones")
    assert tones.help == "Heights. [default: one tone]"


def test_the_placeholder_of_a_value_is_that_of_its_unit() -> None:
    ctx = click.Context(both)
    words = {p.name: p.make_metavar(ctx) for p in [*options_of(Lamp), *options_of(Siren)]}
    assert (words["noise"], words["tones"]) == ("DB", "TEXT")
