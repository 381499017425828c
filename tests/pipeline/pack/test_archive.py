"""Unpacking trusts nothing: names, kinds, sizes and digests of what an archive holds."""

from __future__ import annotations

import hashlib
import io
import json
import stat
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from occlog.errors import InputError
from occlog.pipeline.pack import archive
from occlog.pipeline.pack.archive import LOCK, MANIFEST, read_manifest, unpack

CONFIG = b"occlog_run: 1\n"
VERSIONS = b"# Python ?\nocclog==0.1.0\nnumpy==2.0.0\n"
Members = dict[str, bytes]


def report_of(path: str, data: bytes) -> dict[str, object]:
    return {"path": path, "sha256": hashlib.sha256(data).hexdigest(), "bytes": len(data), "included": True}


def manifest(**changed: object) -> bytes:
    values = {
        "occlog_pack": 1,
        "version": "0.1.0",
        "versions": {"numpy": "2.0.0"},
        "config": "run.yaml",
        "folder": "out",
        "inputs": [report_of("run.yaml", CONFIG)],
        "outputs": [report_of("metrics.json", b"{}")],
        "stages": {"evaluate": 0},
        **changed,
    }
    return json.dumps(values).encode()


def members(**changed: object) -> Members:
    return {MANIFEST: manifest(**changed), LOCK: VERSIONS, "inputs/run.yaml": CONFIG, "run/metrics.json": b"{}"}


def write(path: Path, found: Members, change: Callable[[zipfile.ZipInfo], object] = lambda info: None) -> Path:
    with zipfile.ZipFile(path, "w") as file:
        for name, data in found.items():
            info = zipfile.ZipInfo(name)
            info.external_attr = (stat.S_IFREG | 0o644) << 16
            change(info)
            file.writestr(info, data)
    return path


def refused(tmp_path: Path, words: str) -> None:
    """Nothing outside the folder, and one line."""
    inner = tmp_path / "inner"
    inner.mkdir()
    with pytest.raises(InputError, match=words) as caught:
        unpack(tmp_path / "x.zip", inner)
    assert "\n" not in str(caught.value)
    assert {path.name for path in tmp_path.iterdir()} == {"x.zip", "inner"}


def test_a_good_archive_is_unpacked(tmp_path: Path) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    found = unpack(write(tmp_path / "x.zip", members()), inner)
    assert found.config == "run.yaml"
    files = {str(path.relative_to(inner)) for path in inner.rglob("*") if path.is_file()}
    assert files == {"inputs/run.yaml", "run/metrics.json"}


@pytest.mark.parametrize(
    "name", ["../x", "/etc/x", "inputs/../../x", "inputs//x", "C:\\x", "inputs/\x1b[2J", "a" * 2000, "./x", "inputs/"]
)
def test_names_that_lead_out_are_refused(tmp_path: Path, name: str) -> None:
    write(tmp_path / "x.zip", {**members(), name: b"x"})
    refused(tmp_path, "no name of a file inside the archive")


@pytest.mark.parametrize("name", ["../x", "/etc/passwd", ""])
def test_names_in_the_manifest_that_lead_out_are_refused(tmp_path: Path, name: str) -> None:
    inputs = [report_of("run.yaml", CONFIG), {**report_of(name, b""), "included": False}]
    write(tmp_path / "x.zip", members(inputs=inputs))
    refused(tmp_path, "no name of a file inside the archive")


@pytest.mark.parametrize(
    ("kind", "words"),
    [(stat.S_IFLNK, "a link or a device"), (stat.S_IFIFO, "a link or a device"), (stat.S_IFDIR, "link")],
)
def test_links_and_devices_are_refused(tmp_path: Path, kind: int, words: str) -> None:
    def change(info: zipfile.ZipInfo) -> None:
        if info.filename == "inputs/run.yaml":
            info.external_attr = (kind | 0o777) << 16

    write(tmp_path / "x.zip", members(), change)
    refused(tmp_path, words)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"run/metrics.json": b"[]"}, "is not what pack.json states"),
        ({"run/metrics.json": b"{} "}, "is not what pack.json states"),
        ({LOCK: VERSIONS + b"--index-url http://evil\n"}, "lock.txt has other versions than pack.json"),
        ({"run/more.json": b"{}"}, "run/more.json is not in pack.json"),
        ({MANIFEST: b"{"}, "not a manifest"),
        ({MANIFEST: b"[" * 100_000}, "not a manifest"),
        ({MANIFEST: manifest(occlog_pack=2)}, "not a manifest"),
        ({MANIFEST: manifest(folder="../out")}, "no name of a file inside"),
        ({MANIFEST: manifest(folder="run.yaml")}, "has inputs in its run folder"),
        ({MANIFEST: manifest(config="other.yaml")}, "is not among its inputs"),
        ({MANIFEST: manifest(outputs=[report_of("metrics.json", b"{}")] * 2)}, "names a file twice"),
        ({MANIFEST: manifest(outputs=[{**report_of("metrics.json", b"{}"), "sha256": "00"}])}, "not a manifest"),
        ({MANIFEST: manifest(outputs=[report_of("tracks.parquet", b"")])}, "run/metrics.json is not in pack.json"),
    ],
)
def test_what_the_manifest_does_not_say_is_refused(tmp_path: Path, changed: Members, words: str) -> None:
    write(tmp_path / "x.zip", {**members(), **changed})
    refused(tmp_path, words)


ALIKE = (("run.yaml", "RUN.yaml"), ("caf\u00e9", "cafe\u0301"), ("stra\u00dfe", "strasse"), ("\u212b", "\u00e5"))
"""Names that some systems take for the same one."""


@pytest.mark.parametrize(("one", "other"), ALIKE)
def test_inputs_are_not_in_the_run_folder_however_it_is_written(tmp_path: Path, one: str, other: str) -> None:
    """The state of a run in it would say that every stage is done."""
    inputs = [report_of("run.yaml", CONFIG), report_of(f"{other}/run.json", b"{}")]
    write(tmp_path / "x.zip", {**members(inputs=inputs, folder=one), f"inputs/{other}/run.json": b"{}"})
    refused(tmp_path, "has inputs in its run folder")


@pytest.mark.parametrize(("one", "other"), ALIKE)
def test_a_file_that_is_there_twice_is_refused(tmp_path: Path, one: str, other: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with zipfile.ZipFile(tmp_path / "x.zip", "w") as file:
            for name in (f"inputs/{one}", f"inputs/{other}"):
                file.writestr(name, CONFIG)
    refused(tmp_path, "there twice")


def test_bombs_are_refused_before_anything_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(archive, "FREE_BYTES", 100_000)
    large = bytes(1_000_000)
    found = {**members(outputs=[report_of("metrics.json", large)]), "run/metrics.json": large}

    def change(info: zipfile.ZipInfo) -> None:
        info.compress_type = zipfile.ZIP_DEFLATED

    write(tmp_path / "x.zip", found, change)
    refused(tmp_path, "unpacks to 100.... bytes; the limit of an archive of its size is 10")


def test_what_is_packed_can_be_unpacked_however_well_it_compresses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(archive, "FREE_BYTES", 100_000)
    text = b"0" * 40_000
    names = [f"{number}.csv" for number in range(20)]
    made = manifest(outputs=[report_of(name, text) for name in names])
    (tmp_path / "text").write_bytes(text)
    with (tmp_path / "x.zip").open("wb") as out:
        packer = archive.Packer(out)
        for name, data in ((MANIFEST, made), (LOCK, VERSIONS), ("inputs/run.yaml", CONFIG)):
            packer.bytes(name, data)
        for each in read_manifest(made, "m").outputs:
            packer.file(f"run/{each.path}", tmp_path / "text", each)
        packer.close()
    (tmp_path / "out").mkdir()
    unpack(tmp_path / "x.zip", tmp_path / "out")
    assert [(tmp_path / "out" / "run" / name).read_bytes() for name in names] == [text] * 20


def test_sizes_that_lie_are_refused(tmp_path: Path) -> None:
    """The index states 2 bytes of a file that unpacks to many."""
    write(tmp_path / "x.zip", {**members(), "run/metrics.json": b"{}" + bytes(500)})
    raw = bytearray((tmp_path / "x.zip").read_bytes())
    at = raw.rindex(b"PK\x01\x02", 0, raw.rindex(b"run/metrics.json"))
    raw[at + 24 : at + 28] = (2).to_bytes(4, "little")
    (tmp_path / "x.zip").write_bytes(raw)
    refused(tmp_path, "damaged, or no archive|is not what pack.json states")


def test_cuts_and_flipped_bytes_are_one_line(tmp_path: Path) -> None:
    path = write(tmp_path / "x.zip", members())
    raw = path.read_bytes()
    for place in range(0, len(raw), 37):
        for data in (raw[:place], raw[:place] + bytes([raw[place] ^ 255]) + raw[place + 1 :]):
            inner = tmp_path / f"{place}-{len(data)}"
            inner.mkdir()
            path.write_bytes(data)
            try:
                unpack(path, inner)
            except InputError as error:
                assert "\n" not in str(error)
            else:
                assert (inner / "inputs" / "run.yaml").read_bytes() == CONFIG
                assert (inner / "run" / "metrics.json").read_bytes() == b"{}"


def test_what_is_no_archive_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.zip").write_bytes(io.BytesIO(b"PAR1").getvalue())
    refused(tmp_path, "no archive of `occlog pack`")
