"""Work of `occlog report A B`: open two runs, lay them beside each other, write the page."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

from occlog.array_types import NS
from occlog.console.details import begin_work
from occlog.console.text import as_bytes
from occlog.evaluate.compare.run import compare_runs
from occlog.io.files.atomic import Together, check_outputs, open_output
from occlog.io.files.inputs import hash_inputs
from occlog.io.files.provenance import Provenance
from occlog.records.tables import Truth
from occlog.report.inputs import Paths

from .comparison.frames import common_times, laid
from .comparison.identities import by_each_other
from .comparison.pairs import pairs_of
from .comparison.partings import partings_of
from .config import BesideConfig
from .inputs import Run, check_scenes, files_of, names_of, open_run, truth_of
from .markdown import build_markdown
from .model import AgainstTruth, Beside, Side, lengths_of
from .page import build_page
from .stage import (
    followed_by_truth,
    notes_on_recordings,
    notes_on_scenes,
    notes_on_time,
    notes_on_truth,
    recordings_of,
    same_rows,
)


@dataclass(frozen=True)
class Asked:
    """What is asked for; None where not given."""

    tracks: Path
    other: Path
    output: Path
    scene: Path | None = None
    truth: Path | None = None
    markdown: Path | None = None
    title: str = "Two runs side by side"
    seed: int = 0
    overwrite: bool = False
    config: BesideConfig = field(default_factory=BesideConfig)


def run_beside(asked: Asked) -> Beside:
    """Read both runs, lay them beside each other, write the page and its words.

    Raises:
        UsageError: lengths have a unit without defaults, or an output is an input.
        InputError: a run is missing, damaged, too long, or of another scene, truth or time than the other.
    """
    common = Paths(asked.output, scene=asked.scene, truth=asked.truth, markdown=asked.markdown)
    files = [files_of(run, common) for run in (asked.tracks, asked.other)]
    inputs = tuple(dict.fromkeys(path for each in files for path in each.inputs))
    check_outputs(inputs, common.outputs, asked.overwrite)
    runs = [open_run(n, each) for n, each in zip(names_of(asked.tracks, asked.other), files, strict=True)]
    check_scenes(*runs)
    near, tolerance = lengths_of(asked.config, runs[0].data.unit)
    truth = truth_of(files, runs[0].data.unit)
    begin_work()
    found = lay(runs[0], runs[1], truth, replace(asked.config, match_distance=near, tolerance=tolerance), asked.seed)
    provenance = _provenance(asked, found, inputs)
    found = replace(found, title=asked.title, provenance=provenance)
    made = {asked.output: build_page(found)}
    if asked.markdown is not None:
        made[asked.markdown] = build_markdown(found)
    with Together() as together:
        for path, content in made.items():
            with open_output(path, asked.overwrite, together) as file:
                file.write(as_bytes(content))
    return found


def lay(a: Run, b: Run, truth: tuple[Path, Truth] | None, config: BesideConfig, seed: int) -> Beside:
    """Lay two runs beside each other.

    Args:
        a: run A.
        b: run B.
        truth: of both, and its file; None: it is not known.
        config: with lengths.
        seed: of the draws of the comparison.
    """
    near, tolerance, lasting = config.match_distance, config.tolerance, round(config.lasting_s * NS)
    assert near is not None
    assert tolerance is not None
    times = common_times(a.tracks, b.tracks)
    sides = [Side(run.name, run.data, run.tracks, laid(run.tracks, times)) for run in (a, b)]
    places = sides[0].laid, sides[1].laid
    pairs = pairs_of(*places, near)
    against = None
    if truth is not None:
        path, table = truth
        comparison = compare_runs((a.file, b.file), path, (), (), near, seed)
        of_a, of_b, switches, errors = followed_by_truth(a.tracks, b.tracks, table, near, a.data.unit, lasting)
        against = AgainstTruth(comparison, of_a, of_b, switches, errors)
        sides = [replace(side, data=replace(side.data, truth=table)) for side in sides]
    in_b, in_a = by_each_other(*places, pairs, times, lasting)
    return Beside(
        title="",
        a=sides[0],
        b=sides[1],
        near=near,
        tolerance=tolerance,
        lasting_s=config.lasting_s,
        times=times,
        pairs=pairs,
        partings=partings_of(*places, pairs, times, tolerance, (in_b, in_a)),
        in_b=in_b,
        in_a=in_a,
        against_truth=against,
        same=same_rows(a.tracks, b.tracks),
        notes=(
            *notes_on_time(a.tracks, b.tracks, truth=truth is not None),
            *notes_on_recordings(*(recordings_of(_made(run)) for run in (a, b))),
            *notes_on_scenes(a.data.scene, b.data.scene),
            *(() if against is None else notes_on_truth(against.over_time, near, a.data.unit)),
        ),
    )


def _made(run: Run) -> dict[str, object]:
    """How each table of a run was made."""
    made = run.data.provenance.get("made", {})
    return made if isinstance(made, dict) else {}


def _provenance(asked: Asked, found: Beside, inputs: tuple[Path, ...]) -> dict[str, object]:
    """How this page and everything in both runs was made."""
    settings = {**asdict(asked.config), "match_distance": found.near, "tolerance": found.tolerance}
    own = Provenance("report", {"title": asked.title, **settings}, asked.seed, hash_inputs(inputs))
    made = {f"{letter}: {side.name}": side.data.provenance.get("made", {}) for letter, side in found.sides}
    return {name: value for name, value in own.as_dict().items() if name != "losses"} | {"made": made}
