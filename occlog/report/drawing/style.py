"""Colours, fonts and sizes of all figures; figures as SVG and PNG without global state."""

from __future__ import annotations

import io
import unicodedata
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from occlog.colours import TARGETS, TARGETS_DARK

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
"""The same on a dark screen."""

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
    """The house style inside the block, whatever the user's matplotlib settings are.

    Names in scripts that the font does not have are drawn as boxes in the picture;
    that is no reason to warn, the page shows them with the reader's fonts.
    """
    with matplotlib.rc_context(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing", category=UserWarning)
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(RC)
        yield


def target_colour(index: int) -> str:
    """Colour of the index-th target; they repeat after six."""
    return COLOURS[TARGET_COLOURS[index % len(TARGET_COLOURS)]]


def label(text: object, length: int = LABEL_LENGTH) -> str:
    """Text fit for a figure: one line, no control characters, cut in the middle where it is too long."""
    plain = "".join(c if unicodedata.category(c)[0] != "C" else "\N{REPLACEMENT CHARACTER}" for c in str(text))
    if len(plain) <= length:
        return plain
    head = (length - 1) // 2
    return f"{plain[:head]}…{plain[-(length - 1 - head) :]}"


def new_figure(width: float, height: float) -> Figure:
    """Empty figure of a size in inches."""
    return Figure(figsize=(width, height), layout="constrained")


def raw_svg(figure: Figure) -> str:
    """The figure as matplotlib's SVG, without dates."""
    out = io.StringIO()
    metadata = {"Date": None, "Creator": None, "Format": None, "Type": None}
    figure.savefig(out, format="svg", metadata=metadata, transparent=True)
    return out.getvalue()


def to_png(figure: Figure, dpi: float, texts: Mapping[str, str]) -> bytes:
    """The figure as PNG with text entries, without dates or the library's name."""
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=dpi, metadata={"Software": None, **texts})
    return out.getvalue()
