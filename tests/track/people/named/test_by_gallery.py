"""`occlog track --method jipda --gallery`: tracks under the identities of a gallery."""

from __future__ import annotations

import json

import numpy as np
import pytest
import two_coloured as people

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import read_provenance, read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.records.tables import Associations, Events, Gallery, PeopleTracks, PeopleViews

pytestmark = pytest.mark.jit
STEPS = 60


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("gallery")
    people.write(out / "true.mcap", STEPS)
    people.write(out / "boxes.mcap", STEPS, true=False, identity=(-1, -1))
    assert run(["appearance", "learn", str(out / "true.mcap"), "-o", str(out / "gallery.parquet"), "-q"]) == 0
    table = read_table(out / "gallery.parquet", Gallery)
    values = {c.name: getattr(table, c.name) for c in Gallery.columns()}
    write_table(out / "g.parquet", Gallery(**values | {"target_id": table.target_id + np.int32(40)}), Provenance("t"))
    return out


def track(folder, *args, source="boxes.mcap", gallery="g.parquet"):
    tables = [f"--{n}={folder / n}.parquet" for n in ("associations", "events", "view-tracks")]
    given = [] if gallery is None else ["--gallery", str(folder / gallery)]
    out = ["-o", str(folder / "t.parquet"), "--overwrite", "--json"]
    return run(["track", str(folder / source), "--method", "jipda", *given, *tables, *out, *args])


def test_all_tables_have_the_names_of_the_gallery(folder, capsys):
    assert track(folder, gallery=None) == ExitCode.DONE
    plain = read_table(folder / "t.parquet", PeopleTracks)
    capsys.readouterr()
    assert track(folder) == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    rows = read_table(folder / "t.parquet", PeopleTracks)
    assert len(rows) == len(plain)
    assert set(rows.target_id.tolist()) == {40, 41}
    assert (summary["gallery"]["people_reidentified"], summary["people"]) == (2, 2)
    # Each is who they resemble
    true = people.truth(STEPS)
    for name in (0, 1):
        own, place = rows.take(rows.target_id == 40 + name), true.take(true.target_id == name)
        at = np.searchsorted(place.t_ns, own.t_ns)
        assert np.median(np.hypot(own.x - place.x[at], own.y - place.y[at])) < 0.5
    for name, table in (("associations", Associations), ("view-tracks", PeopleViews), ("events", Events)):
        assert set(read_table(folder / f"{name}.parquet", table).target_id.tolist()) == {40, 41}
    events = read_table(folder / "events.parquet", Events)
    named = events.take(events.kind == "reidentified")
    assert len(named) == summary["gallery"]["fragments_reidentified"]
    assert (named.probability > 0.9).all()
    made = read_provenance(folder / "t.parquet")
    assert made.parameters["gallery"]["min_similarity"] == 0.8
    assert any("g.parquet" in str(each) for each in made.inputs)


def test_a_gallery_of_no_one_who_is_there_is_stated(folder, capsys):
    table = read_table(folder / "g.parquet", Gallery)
    # No one wears the colour in which no one was seen
    unseen = int(np.argmin(table.density[:, : int(table.bins[0])].sum(axis=0)))
    density = np.zeros_like(table.density)
    density[:, unseen] = 1.0
    values = {c.name: getattr(table, c.name) for c in Gallery.columns()} | {"density": density}
    write_table(folder / "strangers.parquet", Gallery(**values), Provenance("t"), overwrite=True)
    assert track(folder, gallery="strangers.parquet") == ExitCode.DONE
    reported = capsys.readouterr()
    assert "warning: gallery: no track is of a person of the gallery, by " in reported.err
    assert "{" not in reported.err
    assert json.loads(reported.out)["gallery"]["tracks_reidentified"] == 0
    # Their numbers are above those of the gallery
    assert (read_table(folder / "t.parquet", PeopleTracks).target_id > 41).all()


def test_the_same_gallery_gives_the_same_bytes(folder):
    files = []
    for _ in range(2):
        assert track(folder, "-q", "--smooth") == ExitCode.DONE
        files.append([(folder / f"{n}.parquet").read_bytes() for n in ("t", "associations", "events", "view-tracks")])
    assert files[0] == files[1]


@pytest.mark.parametrize(
    ("images", "gallery", "message"),
    [
        (False, "g.parquet", "neither images nor colours"),
        (True, "other.parquet", "holds associations"),
        (True, "nobody.parquet", "gallery: has no rows"),
    ],
)
def test_what_a_gallery_needs_is_asked_for_before_anything_is_tracked(
    folder, tmp_path, capsys, images, gallery, message
):
    people.write(tmp_path / "boxes.mcap", 4, true=False, images=images)
    write_table(tmp_path / "g.parquet", read_table(folder / "g.parquet", Gallery), Provenance("t"))
    write_table(tmp_path / "nobody.parquet", Gallery.empty(), Provenance("t"))
    write_table(tmp_path / "other.parquet", Associations.empty(), Provenance("t"))
    assert track(tmp_path, "-q", gallery=gallery) == ExitCode.BAD_INPUT
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (tmp_path / "t.parquet").exists()
