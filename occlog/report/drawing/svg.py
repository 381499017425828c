"""Matplotlib's SVG made fit for a page: small, themed by the page, readable by a screen reader.

Style attributes become presentation attributes, so that the figures also show where a
content security policy forbids inline styles; colours become CSS variables with the
colour itself as what is used when there is no style sheet.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from html import escape

from .style import COLOURS

_TAG = re.compile(r"<[^>]+>")
_STYLE = re.compile(r'\sstyle="([^"]*)"')
_FONT = re.compile(r"(?:(\d{3}|bold)\s+)?(\d+(?:\.\d+)?)px\b")
_NUMBER = re.compile(r"-?\d+\.\d+")
_GEOMETRY = re.compile(r'\s(d|x|y|transform|width|height|points)="([^"]*)"')
_ID = re.compile(r'\sid="([^"]*)"')
_REFERENCE = re.compile(r'(?:url\(#|href="#)([^")]+)')
_TARGET = re.compile(r'(url\(|xlink:href=")#([^")]+)')
_NAMES = {value: name for name, value in COLOURS.items()}
_COLOUR = re.compile("|".join(_NAMES))


def page_svg(raw: str, prefix: str, title: str, description: str) -> str:
    """The `<svg>` element for the page.

    Args:
        raw: SVG document as matplotlib writes it.
        prefix: unique in the page; ids begin with it.
        title: short name of the figure.
        description: what the figure shows, in a sentence, for those who cannot see it.

    Returns:
        An `<svg role="img">` element with title and description.
    """
    body = raw[raw.index("<svg") :]
    size = re.search(r'width="([\d.]+)pt" height="([\d.]+)pt"', body)
    width, height = (float(v) for v in size.groups()) if size else (720.0, 480.0)
    inner = body[body.index(">") + 1 : body.rindex("</svg>")]
    inner = re.sub(r"<defs>\s*<style.*?</style>\s*</defs>", "", inner, count=1, flags=re.DOTALL)
    inner = _shrink(inner, prefix)
    named = f'<title id="{prefix}-title">{escape(title)}</title><desc id="{prefix}-desc">{escape(description)}</desc>'
    # One point of the figure is drawn as 4/3 of a pixel, which keeps the text as large as it was meant.
    head = (
        f'<svg class="plot" xmlns="http://www.w3.org/2000/svg" role="img" '
        f'aria-labelledby="{prefix}-title {prefix}-desc" viewBox="0 0 {width:g} {height:g}" '
        f'width="{width * 4 / 3:.0f}" height="{height * 4 / 3:.0f}" '
        f'font-family="system-ui, DejaVu Sans, sans-serif" stroke-linejoin="round">'
    )
    return head + named + inner + "</svg>"


def _shrink(text: str, prefix: str) -> str:
    """The tags made short and unique; text between them is left as it is (it may look like a tag's inside)."""
    # Matplotlib makes ids of coordinates to their last bit, which its layout does not keep from one time to the next
    used = {name: k for k, name in enumerate(dict.fromkeys(_REFERENCE.findall(text)))}
    text = _TAG.sub(lambda m: _tag(m[0], used, prefix), text)
    text = re.sub(r">\s*\n\s*<", ">\n<", text)
    # Groups that only carried an id say nothing any more.
    return re.sub(r"<g>\n<g>\n(<(?:path|text|use)[^\n]*)\n</g>\n</g>", r"\1", text)


def _tag(tag: str, used: Mapping[str, int], prefix: str) -> str:
    tag = _ID.sub(lambda m: f' id="{prefix}-{used[m[1]]}"' if m[1] in used else "", tag)
    tag = _TARGET.sub(lambda m: f"{m[1].replace('xlink:', '')}#{prefix}-{used[m[2]]}", tag)
    tag = _STYLE.sub(lambda m: _attributes(m[1]), tag)
    tag = _GEOMETRY.sub(lambda m: f' {m[1]}="{_numbers(m[2])}"', tag)
    return re.sub(r' transform="rotate\(-0 [^)]*\)"', "", tag)


def _attributes(style: str) -> str:
    """CSS declarations as presentation attributes; colours as variables of the page."""
    out = []
    for declaration in style.split(";"):
        name, _, value = (part.strip() for part in declaration.partition(":"))
        if name == "font":
            # Older versions of matplotlib write the shorthand, which is no attribute.
            weight, size = (_FONT.search(value) or re.match("()()", "")).groups()  # type: ignore[union-attr]
            out += [f'font-size="{size}"'] if size else []
            out += [f'font-weight="{weight}"'] if weight else []
        elif name and name != "font-family":
            out.append(f'{name}="{_COLOUR.sub(_variable, value)}"')
    return " " + " ".join(out) if out else ""


def _variable(match: re.Match[str]) -> str:
    return f"var(--{_NAMES[match[0]]},{match[0]})"


def _numbers(value: str) -> str:
    """Coordinates with two decimals and without line ends: a hundredth of a point cannot be seen."""
    value = " ".join(value.split())
    value = _NUMBER.sub(lambda m: f"{float(m[0]):.2f}".rstrip("0").rstrip("."), value)
    return re.sub(r" ?([A-Za-z]) (?=[-\d])", r"\1", value) if value[:1] == "M" else value
