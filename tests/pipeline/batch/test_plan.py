"""Names of run folders: one each, whatever the recordings are called and wherever they lie."""

from __future__ import annotations

import shutil
import unicodedata
from pathlib import Path

import pytest

from occlog.errors import InputError
from occlog.pipeline.batch import plan as batch_plan
from occlog.pipeline.batch.plan import in_text, sources_of


def touch(folder: Path, *names: str) -> None:
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"x")


def test_recordings_of_one_name_have_folders_of_their_own(tmp_path: Path) -> None:
    touch(tmp_path, "a/hall.mcap", "b/hall.mcap", "b/HALL.mcap", "b/yard.mcap", "caf\u00e9.mcap", "cafe\u0301.mcap")
    found = sources_of([str(tmp_path / "**/*.mcap")])
    names = [source.name for source in found]
    assert names == sorted(names)
    assert len({unicodedata.normalize("NFC", name.casefold()) for name in names}) == 6
    assert "yard" in names
    assert sum(name.startswith("hall-") for name in names) == 2
    shown = {source.shown for source in found if source.shown.isascii()}
    assert shown == {"a/hall.mcap", "b/hall.mcap", "b/HALL.mcap", "b/yard.mcap"}


def test_a_name_that_looks_like_one_with_a_hash_is_kept_apart(tmp_path: Path) -> None:
    touch(tmp_path, "a/hall.mcap", "b/hall.mcap")
    first = sources_of([str(tmp_path / "*/*.mcap")])[0].name
    touch(tmp_path, f"a/{first}.mcap")
    names = [source.name for source in sources_of([str(tmp_path / "*/*.mcap")])]
    assert len(set(names)) == 3
    assert first in names


def test_names_do_not_depend_on_where_everything_lies(tmp_path: Path) -> None:
    touch(tmp_path, "one/a/hall.mcap", "one/b/hall.mcap")
    shutil.copytree(tmp_path / "one", tmp_path / "two")
    one, two = (sources_of([str(tmp_path / name / "*" / "*.mcap")]) for name in ("one", "two"))
    assert [source[:2] for source in one] == [source[:2] for source in two]
    assert str(tmp_path) not in "".join(source.shown for source in one)


def test_a_recording_that_is_named_twice_counts_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    touch(tmp_path, "hall.mcap", "odd[1].mcap")
    monkeypatch.chdir(tmp_path)
    found = sources_of(["hall.mcap", "*.mcap", "./hall.mcap", "odd[1].mcap"])
    assert [(source.name, source.shown) for source in found] == [("hall", "hall.mcap"), ("odd[1]", "odd[1].mcap")]


def test_results_are_no_recordings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The second command took the tables of the first for recordings that failed."""
    touch(tmp_path, "hall.mcap", "out/runs.parquet", "out/runs/hall/tracks.parquet", "outer.mcap")
    monkeypatch.chdir(tmp_path)
    for results in ("out", "./out/", str(tmp_path / "out")):
        assert [source.shown for source in sources_of(["**/*"], results)] == ["hall.mcap", "outer.mcap"]
    assert [source.name for source in sources_of(["out/runs.parquet"], "out")] == ["runs"]
    with pytest.raises(InputError, match="finds no file"):
        sources_of(["out/*"], "out")
    memory = pytest.importorskip("fsspec").filesystem("memory")
    for name in ("hall.mcap", "out/batch.json", "outer.mcap"):
        memory.pipe_file(f"/its/{name}", b"x")
    assert [source.name for source in sources_of(["memory://its/**"], "memory://its/out")] == ["hall", "outer"]
    memory.rm("/its", recursive=True)


def test_a_recording_that_links_lead_to_counts_once(tmp_path: Path) -> None:
    touch(tmp_path, "all/b/hall.mcap", "all/b/yard.mcap", "elsewhere/lot.mcap")
    for name in ("all/a", "all/latest"):
        (tmp_path / name).symlink_to("b")
    (tmp_path / "all" / "loop").symlink_to(".")
    (tmp_path / "all" / "b" / "again.mcap").symlink_to("hall.mcap")
    for name in ("all/far", "all/away"):
        (tmp_path / name).symlink_to(tmp_path / "elsewhere")
    found = sources_of([str(tmp_path / "all/**/*.mcap")])
    assert [source[:2] for source in found] == [
        ("hall", "b/hall.mcap"),
        ("lot", "away/lot.mcap"),
        ("yard", "b/yard.mcap"),
    ]


def test_links_that_lead_back_are_followed_to_a_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two of them in one folder make 2 to the power of 40 paths."""
    monkeypatch.setattr(batch_plan, "MAX_PATHS", 1_000)
    (tmp_path / "h.mcap").write_bytes(b"")
    (tmp_path / "one").symlink_to(".")
    assert [source.name for source in sources_of([str(tmp_path / "**" / "*.mcap")])] == ["h"]
    (tmp_path / "two").symlink_to(".")
    with pytest.raises(InputError, match="more than 1,000 paths; where links lead back into their own folder"):
        sources_of([str(tmp_path / "**" / "*.mcap")])


def test_a_folder_above_a_linked_one_is_the_one_that_the_system_means(tmp_path: Path) -> None:
    touch(tmp_path, "one/deep/hall.mcap", "one/yard.mcap", "yard.mcap")
    (tmp_path / "link").symlink_to("one/deep")
    (found,) = sources_of([str(tmp_path / "link/../yard.mcap")])
    assert found.location == str(tmp_path.resolve() / "one" / "yard.mcap")


def test_names_of_points_are_no_folders_above(tmp_path: Path) -> None:
    touch(tmp_path, "..mcap", "...mcap", "_.mcap", ".mcap")
    names = [source.name for source in sources_of([str(path) for path in tmp_path.iterdir()])]
    assert len(set(names)) == 4
    assert {(tmp_path / "runs" / name).resolve().parent for name in names} == {tmp_path.resolve() / "runs"}


def test_names_with_a_hash_are_no_longer_than_file_systems_take(tmp_path: Path) -> None:
    stem = 125 * "\u00e9"
    touch(tmp_path, f"a/{stem}.mcap", f"b/{stem}.mcap", f"b/x{stem[1:]}.mcap")
    names = [source.name for source in sources_of([str(tmp_path / "*/*.mcap")])]
    assert len(set(names)) == 3
    assert f"x{stem[1:]}" in names
    for name in names:
        (tmp_path / name).mkdir()


def test_names_of_bytes_become_text() -> None:
    assert in_text("hall \u00e9 \udce9\udcff \ud800") == "hall \u00e9 \\xe9\\xff \\ud800"


@pytest.mark.parametrize(
    ("pattern", "words"),
    [
        ("none.mcap", "none.mcap: no such file"),
        ("*.bag", "finds no file; check the pattern"),
        (".", "is a folder; name the recordings in it"),
    ],
)
def test_what_is_not_there_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pattern: str, words: str
) -> None:
    touch(tmp_path, "hall.mcap")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=words.replace("*", r"\*")):
        sources_of(["hall.mcap", pattern])
