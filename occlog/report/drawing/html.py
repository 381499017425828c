"""Pages from templates, in which every value is escaped, and their one script."""

from __future__ import annotations

import base64
import hashlib
from importlib import resources
from typing import NamedTuple

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup


def template(name: str, package: str = "occlog.report", folder: str = "templates") -> Template:
    """A template of a package; a value that is missing is an error."""
    environment = Environment(
        loader=PackageLoader(package, folder),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template(name)


class Script(NamedTuple):
    """A script of a page, with the SHA-256 by which a Content Security Policy allows it and no other."""

    text: Markup
    digest: str


def script(*names: str) -> Script:
    """The scripts of these names, one after the other, as one."""
    folder = resources.files("occlog.report").joinpath("templates")
    text = "\n".join(folder.joinpath(name).read_text(encoding="utf-8") for name in names)
    return Script(Markup(text), base64.b64encode(hashlib.sha256(text.encode()).digest()).decode())
