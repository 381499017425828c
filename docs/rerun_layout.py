"""Makes the layout that Rerun opens files of `occlog export --to rerun` with, which only its SDK can write.

    pip install rerun-sdk==0.41.0
    python -m docs.rerun_layout

It is package data: nobody who looks at a file needs the SDK.  Numbers of protobuf messages are plotted where a layout
names their fields, so the layout names those of the first identities.
"""

from __future__ import annotations

from pathlib import Path

OUT = Path(__file__).parents[1] / "occlog" / "examine" / "viewers" / "rerun.rbl"
APPLICATION = "occlog"
"""Application of the recordings that the layout is for, as `occlog view` tells Rerun."""
TARGETS = 6
"""Identities from 0 of which numbers are plotted."""
PLOTS = {"Error": ("errors", "Errors", ("error",)), "Effective samples": ("diagnostics", "Diagnostics", ("ess",))}


def main() -> None:
    """Write the layout."""
    import rerun.blueprint as rrb

    plots = [
        rrb.TimeSeriesView(
            name=title,
            origin="/",
            contents=[f"/{source}/{target}" for target in range(TARGETS)],
            overrides={f"/{source}/{target}": [_line(message, field) for field in fields] for target in range(TARGETS)},
        )
        for title, (source, message, fields) in PLOTS.items()
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


def _line(message: str, field: str) -> object:
    """A line of one field of a message of protobuf."""
    import rerun as rr
    from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

    mapping = VisualizerComponentMapping(
        target="Scalars:scalars",
        source_kind=ComponentSourceKind.SourceComponent,
        source_component=f"occlog.{message}:message",
        selector=f".{field}",
    )
    return rr.SeriesLines(names=field).visualizer(mappings=[mapping])


if __name__ == "__main__":
    main()
