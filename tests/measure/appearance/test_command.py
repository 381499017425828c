"""`occlog appearance learn` and `occlog label --gallery` on files: outputs, provenance, one-line errors."""

from __future__ import annotations

import json

import numpy as np
import pytest
import two_coloured as people

from occlog.cli.main import run
from occlog.core.image import colour_counts
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import read_provenance, read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.records.tables import AppearanceMatches, Gallery, PeopleTracks, Tracks, Views


def tracks(steps, numbers=(0, 1), names=None):
    """True places as tracks, without velocities."""
    truth = people.truth(steps, numbers)
    names = dict(zip(numbers, numbers if names is None else names, strict=True))
    one, none = np.ones(len(truth)), np.full(len(truth), np.nan)
    return Tracks.of(
        t_ns=truth.t_ns,
        target_id=np.array([names[i] for i in truth.target_id.tolist()]),
        x=truth.x,
        y=truth.y,
        vx=none,
        vy=none,
        cov_xx=one,
        cov_xy=0 * one,
        cov_yy=one,
    )


@pytest.fixture
def folder(tmp_path):
    people.write(tmp_path / "true.mcap")
    people.write(tmp_path / "boxes.mcap", true=False, identity=(-1, -1))
    write_table(tmp_path / "tracks.parquet", tracks(40, names=(11, 12)), Provenance("track"))
    return tmp_path


def learn(folder, *args, source="true.mcap", out="gallery.parquet"):
    return run(["appearance", "learn", str(folder / source), "-o", str(folder / out), "-q", *args])


def label(folder, *args, source="true.mcap", out="matches.parquet", gallery="gallery.parquet"):
    files = [str(folder / source), "--gallery", str(folder / gallery), "-o", str(folder / out)]
    return run(["label", *files, "-q", *args])


def test_people_are_distinguished_by_the_side_that_is_seen(folder, capsys):
    assert learn(folder, "--json") == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    assert summary["sides"] == {"0": "1 7", "1": "1 7"}
    assert (summary["positions"], summary["boxes"], summary["targets"]) == ("truth", 80, 2)
    table = read_table(folder / "gallery.parquet", Gallery)
    assert table.bins.tolist() == [72] * 4
    made = read_provenance(folder / "gallery.parquet")
    assert (made.command, made.parameters["angle_step"]) == ("appearance learn", 30.0)
    assert label(folder, "--json") == ExitCode.DONE
    found = read_table(folder / "matches.parquet", AppearanceMatches)
    same = found.decision == "same"
    assert json.loads(capsys.readouterr().out)["labelled"] == same.sum() > 70
    assert (found.target_id[same] == found.track_id[same]).all()
    assert set(found.reason[found.decision == "suspended"].tolist()) <= {"heading"}


def test_all_sides_together_they_look_the_same(folder):
    assert learn(folder, "--angle-step", "360") == ExitCode.DONE
    assert label(folder) == ExitCode.DONE
    found = read_table(folder / "matches.parquet", AppearanceMatches)
    right = found.target_id == found.track_id
    assert abs(np.median(found.rho[right]) - np.median(found.rho[~right])) < 0.05


def test_boxes_without_identity_are_of_the_tracks_where_they_lie(folder):
    boxes = ["--tracks", str(folder / "tracks.parquet")]
    assert learn(folder, *boxes, source="boxes.mcap") == ExitCode.DONE
    assert set(read_table(folder / "gallery.parquet", Gallery).target_id.tolist()) == {11, 12}
    assert learn(folder, out="true.parquet") == ExitCode.DONE
    write_table(folder / "later.parquet", tracks(40, names=(0, 5)), Provenance("track"))
    later = ["--tracks", str(folder / "later.parquet"), "--reidentified", str(folder / "named.parquet")]
    assert label(folder, *later, source="boxes.mcap", gallery="gallery.parquet") == ExitCode.DONE
    named = read_table(folder / "named.parquet", PeopleTracks)
    want = tracks(40, names=(11, 12))
    assert (named.target_id == want.target_id).all()
    assert named.x == pytest.approx(want.x)


def test_tracks_of_others_are_renamed_in_the_unit_of_the_scene(folder):
    assert learn(folder, "--tracks", str(folder / "tracks.parquet"), source="boxes.mcap") == ExitCode.DONE
    later = tracks(40, names=(0, 5))
    rows = zip(later.t_ns, later.target_id, 100 * later.x, 100 * later.y, strict=True)
    text = "".join(f"{t},{k},{float(x)!r},{float(y)!r},,\n" for t, k, x, y in rows)
    (folder / "later.csv").write_text("t_ns,id,x_cm,y_cm,vx_cm_s,vy_cm_s\n" + text)
    named = ["--tracks", str(folder / "later.csv"), "--reidentified", str(folder / "named.parquet")]
    assert label(folder, *named, source="boxes.mcap", gallery="gallery.parquet") == ExitCode.DONE
    assert read_table(folder / "named.parquet", PeopleTracks).x == pytest.approx(tracks(40, names=(11, 12)).x)


def test_boxes_with_identities_need_no_tracks(folder, capsys):
    people.write(folder / "told.mcap", true=False)
    assert learn(folder, "--json", source="told.mcap") == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    assert summary["positions"] == "floor"
    assert summary["sides"] == {"0": "1 7", "1": "1 7"}


def test_a_target_of_a_side_that_is_missing_is_suspended(folder):
    assert learn(folder) == ExitCode.DONE
    table = read_table(folder / "gallery.parquet", Gallery)
    front = table.take(table.angle == 1)
    write_table(folder / "front.parquet", front, Provenance("appearance learn"))
    assert label(folder, gallery="front.parquet") == ExitCode.DONE
    found = read_table(folder / "matches.parquet", AppearanceMatches)
    away = found.angle == 7
    assert away.sum() > 60
    assert set(found.reason[away].tolist()) == {"angle"}


def test_the_same_inputs_give_the_same_bytes(folder):
    for name in ("one.parquet", "two.parquet"):
        assert learn(folder, out=name) == ExitCode.DONE
    assert (folder / "one.parquet").read_bytes() == (folder / "two.parquet").read_bytes()


def refused(capsys, code, message):
    """Whether the last command stated this in one line."""
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    return code


@pytest.mark.parametrize(
    ("args", "code", "message"),
    [
        (["--angle-step", "50"], ExitCode.USAGE, "a divisor of 180 degrees"),
        (["--colour-levels", "16"], ExitCode.USAGE, "--colour-levels"),
        (["--colour-levels", "1"], ExitCode.USAGE, "--colour-levels"),
        (["--min-samples", "1000"], ExitCode.BAD_INPUT, "no person has 1000 boxes of one viewing angle"),
        (["--tracks", "nothing.parquet"], ExitCode.BAD_INPUT, "nothing.parquet"),
    ],
)
def test_options_that_make_no_sense_are_one_line(folder, capsys, args, code, message):
    assert learn(folder, *args) == refused(capsys, code, message)
    assert not (folder / "gallery.parquet").exists()


def test_two_sources_of_boxes_are_one_line(folder, capsys):
    both = [f"--{name}={folder / 'boxes.mcap'}" for name in ("boxes", "views")]
    assert learn(folder, *both) == refused(capsys, ExitCode.USAGE, "two sources of boxes")
    assert not (folder / "gallery.parquet").exists()


def test_inputs_that_do_not_fit_are_one_line(folder, capsys):
    people.write(folder / "blind.mcap", images=False)
    assert learn(folder, source="blind.mcap") == refused(capsys, ExitCode.BAD_INPUT, "holds no images")
    people.write(folder / "told.mcap", true=False, identity=(-1, -1))
    assert learn(folder, source="told.mcap") == refused(capsys, ExitCode.BAD_INPUT, "no box has an identity")
    boxes = people.box_table(people.frames(4)[1], (0, 1))
    write_table(folder / "boxes.parquet", boxes, Provenance("detect"))
    assert learn(folder, source="boxes.parquet") == refused(capsys, ExitCode.USAGE, "holds no scene")
    (folder / "scene.yaml").write_text(scene_to_yaml(people.SCENE))
    scene = ["--scene", str(folder / "scene.yaml")]
    assert learn(folder, *scene, source="boxes.parquet") == refused(capsys, ExitCode.BAD_INPUT, "holds no images")
    (folder / "other.yaml").write_text(scene_to_yaml(people.SCENE).replace("hall", "yard"))
    other = ["--scene", str(folder / "other.yaml")]
    assert learn(folder, *other) == refused(capsys, ExitCode.BAD_INPUT, "no camera 'hall' in the scene")


def test_frames_that_are_missing_are_reported(folder, capsys):
    late = people.box_table(people.frames(60)[1], (0, 1))
    write_table(folder / "late.parquet", late, Provenance("detect"))
    assert learn(folder, "--boxes", str(folder / "late.parquet"), "--labelled") == ExitCode.LOSSY
    assert "hall: boxes: there is no frame of that number (40 lost)" in capsys.readouterr().err


def views(steps):
    """The boxes as views, which bring their colours: red or green all over."""
    pictures, edges = people.frames(steps)
    boxes = people.box_table(edges, (0, 1))
    none, zero = np.full(len(boxes), np.nan), np.zeros(len(boxes))
    colours = []
    for picture, (left, top, right, bottom) in zip(np.repeat(pictures, 2, axis=0), edges.reshape(-1, 4), strict=True):
        middle = picture[round((top + bottom) / 2), round((left + right) / 2)]
        colours.append(colour_counts(middle[None, None], np.ones((1, 1), dtype=np.uint8), 8))
    shared = ("t_ns", "sensor", "frame", "target_id", "left_px", "top_px", "width_px", "height_px", "confidence")
    return Views.of(
        **{name: getattr(boxes, name) for name in shared},
        cluster=boxes.box,
        x_px=zero,
        y_px=zero,
        cov_xx_px=zero + 1,
        cov_xy_px=zero,
        cov_yy_px=zero + 1,
        area_px=boxes.width_px * boxes.height_px,
        bearing=none,
        sigma=none,
        u_px=none,
        sigma_px=none,
        similarity=none,
        appearance=np.array(colours, dtype=np.float32),
    )


def test_views_bring_their_colours_and_need_no_images(folder, capsys):
    write_table(folder / "views.parquet", views(40), Provenance("detect"))
    (folder / "scene.yaml").write_text(scene_to_yaml(people.SCENE))
    scene = ["--scene", str(folder / "scene.yaml"), "--tracks", str(folder / "tracks.parquet")]
    assert learn(folder, *scene, source="views.parquet") == ExitCode.DONE
    assert set(read_table(folder / "gallery.parquet", Gallery).target_id.tolist()) == {11, 12}
    assert label(folder, *scene, source="views.parquet") == ExitCode.DONE
    found = read_table(folder / "matches.parquet", AppearanceMatches)
    same = found.decision == "same"
    assert same.sum() > 70
    assert (found.target_id[same] == found.track_id[same]).all()
    # Their colours are in eight levels
    capsys.readouterr()
    other = ["--colour-levels", "4", "--overwrite"]
    assert learn(folder, *scene, *other, source="views.parquet") == refused(
        capsys, ExitCode.BAD_INPUT, "72 bins (8 levels)"
    )
    assert learn(folder, *other) == ExitCode.DONE
    capsys.readouterr()
    assert label(folder, *scene, "--overwrite", source="views.parquet") == refused(
        capsys, ExitCode.BAD_INPUT, "72 bins"
    )
    assert label(folder, "--overwrite") == ExitCode.DONE
    assert read_table(folder / "gallery.parquet", Gallery).bins[0] == 20


def test_a_file_that_is_no_gallery_is_refused(folder, capsys):
    assert label(folder, gallery="tracks.parquet") == refused(capsys, ExitCode.BAD_INPUT, "expected gallery")
    write_table(folder / "gallery.parquet", Gallery.empty(), Provenance("appearance learn"))
    assert label(folder) == refused(capsys, ExitCode.BAD_INPUT, "gallery: has no rows")
    assert not (folder / "matches.parquet").exists()


def test_options_of_the_two_kinds_are_kept_apart(folder, capsys):
    assert label(folder, "--gate", "3") == refused(capsys, ExitCode.USAGE, "--gate is an option of --tracks FILE")
    assert run(["label", str(folder / "boxes.mcap"), "-o", "x.parquet"]) == ExitCode.USAGE
    assert "--tracks" in capsys.readouterr().err
    named = ["--reidentified", str(folder / "named.parquet")]
    assert learn(folder) == ExitCode.DONE
    assert label(folder, *named) == refused(capsys, ExitCode.USAGE, "give --tracks")
