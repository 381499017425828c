"""The functions take what the requests declare, under the same names and with the same defaults."""

from __future__ import annotations

import inspect
from collections.abc import Callable

import pytest

import occlog
from occlog.errors import SPELLING, option
from occlog.measure.associate.request import LabelRequest
from occlog.measure.fuse.request import FuseRequest
from occlog.request import Form, Request

FUNCTIONS: list[tuple[Callable[..., object], type[Request]]] = [
    (occlog.fuse, FuseRequest),
    (occlog.label, LabelRequest),
]


@pytest.mark.parametrize(("function", "request_of"), FUNCTIONS)
def test_a_function_has_the_fields_of_its_request(function: Callable[..., object], request_of: type[Request]) -> None:
    parameters = inspect.signature(function).parameters
    doc = inspect.getdoc(function) or ""
    for entry in Form(request_of).entries():
        if entry.group or (entry.file and entry.file.output):
            continue
        argument = parameters[entry.field]
        assert f"\n    {entry.field}: " in doc
        if entry.required:
            assert argument.default is inspect.Parameter.empty
        else:
            assert argument.default == entry.of.default


def test_a_message_names_an_option_as_the_surface_spells_it() -> None:
    error = occlog.UsageError(f"{option('max_gap')} is short; or {option('set.person_height')}")
    assert error.options == ("max_gap", "set.person_height")
    assert str(error) == "--max-gap is short; or --set person_height="
    reset = SPELLING.set(lambda name: f"<{name}>")
    assert str(error) == "<max_gap> is short; or <set.person_height>"
    SPELLING.reset(reset)
