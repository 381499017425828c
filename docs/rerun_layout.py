"""Makes the layout that Rerun opens files of `occlog export` with, which only its SDK can write.

    pip install rerun-sdk==0.41.0
    python -m docs.rerun_layout

It is package data: nobody who looks at a file needs the SDK.  A plot of an identity would show every number that a
file has of it, so the layout names the main one, of the first identities.
"""

from __future__ import annotations

from pathlib import Path

OUT = Path(__file__).parents[1] / "occlog" / "examine" / "viewers" / "rerun.rbl"
APPLICATION = "occlog"
"""Application of the recordings that the layout is for, as `occlog view` tells Rerun."""
TARGETS = 6
"""Identities from 0 of which numbers are plotted."""
PLOTS = {"Error": "errors", "Effective samples": "diagnostics"}


def main() -> None:
    """Write the layout."""
    import rerun.blueprint as rrb

    plots = [
        rrb.TimeSeriesView(
            name=title,
            origin="/",
            contents=[f"/{source}/{target}" for target in range(TARGETS)],
            overrides={f"/{source}/{target}": _line(target) for target in range(TARGETS)},
        )
        for title, source in PLOTS.items()
    ]
    space = rrb.Spatial3DView(name="In space", origin="/", contents="/**")
    log = rrb.TextLogView(name="Log", origin="/log")
    # Images stand before their cameras in space: the layout does not know what cameras are called
    layout = rrb.Blueprint(
        rrb.Horizontal(space, rrb.Vertical(*plots, log), column_shares=[2, 1]),
        rrb.TimePanel(timeline="message_log_time", state="collapsed"),
        collapse_panels=True,
    )
    layout.save(APPLICATION, str(OUT))


def _line(target: int) -> object:
    """The line of a target: its main number."""
    import rerun as rr
    from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

    mapping = VisualizerComponentMapping(
        target="Scalars:scalars",
        source_kind=ComponentSourceKind.SourceComponent,
        source_component="Scalars:scalars",
    )
    return rr.SeriesLines(names=f"target {target}").visualizer(mappings=[mapping])


if __name__ == "__main__":
    main()
