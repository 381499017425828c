"""Style, SVG and templates of report pages.

Templates with escaped values; figures with text descriptions and the position of their time axis; a house style
independent of the user's Matplotlib settings; SVG that is small, themed by CSS variables, and readable by screen
readers (presentation attributes, which a content security policy allows); and thinning of curves that keeps extremes,
so that pages do not grow with the recording.
"""

from __future__ import annotations

import base64
import hashlib
import io
import re
import unicodedata
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from html import escape
from importlib import resources
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup
from matplotlib.figure import Figure, FigureBase
from matplotlib.figure import Figure as Canvas

from occlog.array_types import Bools, Floats, Ints
from occlog.colours import TARGETS, TARGETS_DARK

from .content.model import TIME_LABEL


@cache
def template(name: str, package: str = "occlog.report", folder: str = "templates") -> Template:
    """Load the template `name` from a folder of a package; when rendered, a missing value is an error."""
    environment = Environment(
        loader=PackageLoader(package, folder),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template(name)


class PageScript(NamedTuple):
    """A script of a page.

    Attributes:
        text: the script.
        digest: its SHA-256, for the page's Content Security Policy.
    """

    text: Markup
    digest: str


def script(*names: str) -> PageScript:
    """Return the concatenated scripts of these names, with their hash for the page's security policy."""
    folder = resources.files("occlog.report").joinpath("templates")
    text = "\n".join(folder.joinpath(name).read_text(encoding="utf-8") for name in names)
    return PageScript(Markup(text), base64.b64encode(hashlib.sha256(text.encode()).digest()).decode())


COLOURS = {
    "ink": "#1f2933",
    "muted": "#5f6b76",
    "grid": "#dde2e7",
    "room": "#f5f7f9",
    "wall": "#3d4853",
    "pillar": "#9aa5b1",
    "absent": "#e4e7eb",
    "seen": "#0072b2",
    "hidden": "#e69f00",
    "bound": "#c44e00",
    "moving": "#7d7a00",
    "view": "#6b8fb5",
    "halo": "#fffffe",
    **{f"t{n}": colour for n, colour in enumerate(TARGETS)},
}
"""Colours on white paper, each used for one thing only, so that the page can change them in the dark."""

DARK = {
    "ink": "#e3e8ee",
    "muted": "#9fabb8",
    "grid": "#333d48",
    "room": "#1d242c",
    "wall": "#b8c2cc",
    "pillar": "#66727f",
    "absent": "#2f3842",
    "seen": "#4fa8e0",
    "hidden": "#e69f00",
    "bound": "#ff8b3d",
    "moving": "#c9c43a",
    "view": "#7fa6d0",
    "halo": "#161b21",
    **{f"t{n}": colour for n, colour in enumerate(TARGETS_DARK)},
}
"""Colours on a dark screen."""

Style = dict[str, Any]
"""Keyword arguments of an artist of Matplotlib."""
RC: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "occlog",
    "text.parse_math": False,
    "axes.formatter.use_mathtext": False,
    "axes.unicode_minus": True,
    "font.family": ["DejaVu Sans"],
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlepad": 7.0,
    "axes.labelsize": 9.0,
    "axes.edgecolor": COLOURS["muted"],
    "axes.linewidth": 0.7,
    "axes.labelcolor": COLOURS["ink"],
    "axes.titlecolor": COLOURS["ink"],
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": COLOURS["grid"],
    "grid.linewidth": 0.6,
    "text.color": COLOURS["ink"],
    "xtick.color": COLOURS["muted"],
    "ytick.color": COLOURS["muted"],
    "xtick.labelcolor": COLOURS["ink"],
    "ytick.labelcolor": COLOURS["ink"],
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "legend.handlelength": 1.8,
    "legend.columnspacing": 1.5,
    "lines.linewidth": 1.4,
    "lines.solid_capstyle": "round",
    "lines.solid_joinstyle": "round",
    "path.simplify": False,
    "hatch.linewidth": 0.6,
    "figure.facecolor": "white",
    "axes.facecolor": "none",
}

TARGET_COLOURS = ("t0", "t1", "t2", "t3", "t4", "t5")
LABEL_LENGTH = 28


@contextmanager
def house_style() -> Iterator[None]:
    """Context manager for drawing figures in the report's style, independent of the user's Matplotlib settings.

    Warnings about glyphs missing in the font are suppressed, since the page uses the reader's fonts.
    """
    with matplotlib.rc_context(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing", category=UserWarning)
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(RC)
        yield


def target_colour(index: int) -> str:
    """Return the colour of the target with this index, as hex text; colours repeat after six."""
    return COLOURS[TARGET_COLOURS[index % len(TARGET_COLOURS)]]


def label(text: object, length: int = LABEL_LENGTH) -> str:
    """Return a text for a figure: one line, control characters replaced, cut in the middle to `length` characters."""
    plain = "".join(c if unicodedata.category(c)[0] != "C" else "\N{REPLACEMENT CHARACTER}" for c in str(text))
    if len(plain) <= length:
        return plain
    head = (length - 1) // 2
    return f"{plain[:head]}…{plain[-(length - 1 - head) :]}"


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure of a width and height in inches."""
    return Figure(figsize=(width, height), layout="constrained")


def raw_svg(figure: Figure) -> str:
    """Render the figure as Matplotlib's SVG, without dates."""
    out = io.StringIO()
    metadata = {"Date": None, "Creator": None, "Format": None, "Type": None}
    figure.savefig(out, format="svg", metadata=metadata, transparent=True)
    return out.getvalue()


def to_png(figure: Figure, dpi: float, texts: Mapping[str, str]) -> bytes:
    """Render the figure as PNG with `dpi` pixels an inch, without dates or software name.

    `texts`: text entries of the file.
    """
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=dpi, metadata={"Software": None, **texts})
    return out.getvalue()


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
    """Convert Matplotlib's SVG to the `<svg>` element of a page.

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
    """Return SVG text with shorter tags, and ids that begin with `prefix`; text between tags is unchanged."""
    # Matplotlib makes ids of coordinates to their last bit, which its layout does not keep from one time to the next
    used = {name: k for k, name in enumerate(dict.fromkeys(_REFERENCE.findall(text)))}
    text = _TAG.sub(lambda m: _tag(m[0], used, prefix), text)
    text = re.sub(r">\s*\n\s*<", ">\n<", text)
    # Groups that only carried an id have no use any more.
    return re.sub(r"<g>\n<g>\n(<(?:path|text|use)[^\n]*)\n</g>\n</g>", r"\1", text)


def _tag(tag: str, used: Mapping[str, int], prefix: str) -> str:
    tag = _ID.sub(lambda m: f' id="{prefix}-{used[m[1]]}"' if m[1] in used else "", tag)
    tag = _TARGET.sub(lambda m: f"{m[1].replace('xlink:', '')}#{prefix}-{used[m[2]]}", tag)
    tag = _STYLE.sub(lambda m: _attributes(m[1]), tag)
    tag = _GEOMETRY.sub(lambda m: f' {m[1]}="{_numbers(m[2])}"', tag)
    return re.sub(r' transform="rotate\(-0 [^)]*\)"', "", tag)


def _attributes(style: str) -> str:
    """Return CSS declarations (`style`) as SVG presentation attributes, with colours as CSS variables of the page."""
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
    """Return the `value` of an SVG attribute with numbers rounded to two decimals and without superfluous spaces."""
    value = " ".join(value.split())
    value = _NUMBER.sub(lambda m: f"{float(m[0]):.2f}".rstrip("0").rstrip("."), value)
    return re.sub(r" ?([A-Za-z]) (?=[-\d])", r"\1", value) if value[:1] == "M" else value


@dataclass(frozen=True)
class Plot:
    """A figure of the page.

    Attributes:
        heading: heading of the figure.
        svg: the drawing.
        caption: description of what it shows.
        time: position of its time axis; None: it has none.
    """

    heading: str
    svg: Markup
    caption: str
    time: TimeSpan | None = None


class TimeSpan(NamedTuple):
    """Position of a figure's time axis: ends `x0`, `x1` as shares of the width, and their times `t0`, `t1`.

    Times are in the unit of the page's axis.
    """

    x0: float
    x1: float
    t0: float
    t1: float


def plot(name: str, heading: str, caption: str, size: tuple[float, float], draw: Callable[[FigureBase], None]) -> Plot:
    """Draw a figure as SVG for the page; must be called inside `house_style`.

    Args:
        name: prefix of ids in the page.
        heading: heading of the figure.
        caption: description in words.
        size: width and height [inches].
        draw: draws into an empty figure.
    """
    canvas: Canvas = new_figure(*size)
    draw(canvas)
    svg = Markup(page_svg(raw_svg(canvas), name, heading, caption))
    return Plot(heading, svg, caption, _time_of(canvas))


def _time_of(canvas: Canvas) -> TimeSpan | None:
    """Return the position of the time axis in a figure (recognised by its label); None without one."""
    for axes in canvas.axes:
        if axes.get_xlabel().startswith(TIME_LABEL):
            box, (t0, t1) = axes.get_position(), axes.get_xlim()
            return TimeSpan(round(box.x0, 4), round(box.x1, 4), round(float(t0), 6), round(float(t1), 6))
    return None


GAP = 5.0
"""A line is broken where the gap of two samples exceeds this many usual steps."""


def buckets_of(n: int, buckets: int) -> tuple[int, int]:
    """Return the number of rows per bucket, and the number of buckets (at most `buckets`), to divide n rows."""
    width = max(1, -(-n // buckets))
    return width, -(-n // width)


def extremes(values: Floats, buckets: int) -> Ints:
    """Return sorted indices of the minimum and maximum of each of some sections of a series, and of both ends.

    Args:
        values: (N,) samples; NaN is never an extreme.
        buckets: number of sections of equal count.

    Returns:
        (K,) indices, at most 2 * buckets + 2; all N if N is at most 2 * buckets.
    """
    n = len(values)
    if n <= 2 * buckets:
        return np.arange(n)
    width, rows = buckets_of(n, buckets)
    padded = np.full(rows * width, np.nan)
    padded[:n] = values
    grid = padded.reshape(rows, width)
    start = np.arange(rows) * width
    low = start + np.argmin(np.where(np.isnan(grid), np.inf, grid), axis=1)
    high = start + np.argmax(np.where(np.isnan(grid), -np.inf, grid), axis=1)
    return np.unique(np.concatenate([[0, n - 1], low, high]))


def thin_path(xy: Floats, buckets: int) -> Ints:
    """Return sorted indices of the points of a path `xy` (N, 2) that keep its shape when it is thinned.

    They are the extremes of x and y in each of `buckets` sections.
    """
    return np.union1d(extremes(xy[:, 0], buckets), extremes(xy[:, 1], buckets))


def envelope(t: Floats, low: Floats, high: Floats, buckets: int) -> tuple[Floats, Floats, Floats]:
    """Return times, minima of `low` and maxima of `high` in each of `buckets` sections of N samples.

    `t`, `low`, `high`: (N,); up to 2 `buckets` samples are returned unchanged.
    """
    n = len(t)
    if n <= 2 * buckets:
        return t, low, high
    width, rows = buckets_of(n, buckets)
    starts = np.arange(rows) * width
    middle = t[np.minimum(starts + width // 2, n - 1)]
    middle[0], middle[-1] = t[0], t[-1]
    return middle, np.minimum.reduceat(low, starts), np.maximum.reduceat(high, starts)


def gaps(t_ns: Ints) -> Bools:
    """Return the mask (N,) of times after an unusually long gap (`GAP` median steps), where a line is broken."""
    out = np.zeros(len(t_ns), dtype=bool)
    if len(t_ns) > 2:
        steps = np.diff(t_ns)
        out[1:] = steps > GAP * max(float(np.median(steps)), 1.0)
    return out


def broken(t_ns: Ints, keep: Ints, *series: Floats) -> tuple[Floats, ...]:
    """Return the kept samples of each series, with NaN inserted at gaps in time, for a line plot.

    Args:
        t_ns: (N,) times of all samples [ns].
        keep: (K,) ascending indices of the samples to draw.
        series: arrays (N,) on the same times.

    Returns:
        One array (K + gaps,) for each series.
    """
    before = np.concatenate([[0], np.cumsum(gaps(t_ns))])[1:][keep]
    at = np.flatnonzero(np.diff(before) > 0) + 1
    return tuple(np.insert(np.asarray(s, dtype=np.float64)[keep], at, np.nan) for s in series)


def sensible_top(*series: Floats) -> float:
    """Return an upper limit for an axis that ignores few outliers; 1 without finite values.

    1.06 times the maximum if that is at most twice the 99th percentile, else 1.3 times the percentile; at least 1e-9.
    """
    values = np.concatenate([s[np.isfinite(s)] for s in series]) if series else np.empty(0)
    if not len(values):
        return 1.0
    high, usual = float(values.max()), float(np.percentile(values, 99))
    top = high * 1.06 if high <= 2.0 * usual else usual * 1.3
    return max(top, 1e-9)
