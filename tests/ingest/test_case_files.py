"""Files of public bug reports that `ingest` reads, or refuses with what to do."""

from __future__ import annotations

from pathlib import Path
from time import process_time

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.recording.reader import open_recording
from occlog.records.tables import Truth


def test_coco_of_images_of_another_size_scales_the_calibration(
    shared_cases: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case, out = shared_cases / "v01-coco-other-size", tmp_path / "w.mcap"
    words = [w for name in ("left", "right") for w in ("--boxes", f"{case / name}.json")]
    words += [w for name in ("left", "right") for w in ("--calibration", f"{case / name}.yaml")]
    assert run(["ingest", "-o", str(out), *words, "--fps", "10"]) == ExitCode.DONE
    assert "frames of 640 x 360 px, calibrated for 1280 x 720: assumed to be scaled by 0.5" in capsys.readouterr().err
    scene = open_recording(out).scene
    assert scene is not None
    assert [camera.image_size for camera in scene.cameras] == [(640, 360)] * 2


def test_stamps_that_fall_back_to_1980_are_left_out_and_listed(shared_cases: Path, tmp_path: Path) -> None:
    out = tmp_path / "x.mcap"
    assert run(["ingest", str(shared_cases / "c07_gps_1980" / "b_1980"), "-o", str(out)]) == ExitCode.LOSSY
    (loss,) = open_recording(out).losses
    assert (loss.count, "time stamps go back" in loss.what) == (5, True)


def test_images_stated_to_be_video_are_refused_with_what_to_do(
    shared_cases: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = shared_cases / "c13_compressed_video" / "fox_video.mcap"
    assert run(["ingest", str(bag), "-o", str(tmp_path / "x.mcap")]) == ExitCode.BAD_INPUT
    stderr = capsys.readouterr().err
    assert "topic /left/image: video is stated to be h264, and its data are JPEG; record it as jpeg" in stderr


START = 1_714_564_800


@pytest.mark.parametrize("kind", ["mm", "cm", "parquet", "stamps", "utf-16"])
def test_true_positions_of_other_programs_go_into_recordings(tmp_path: Path, kind: str) -> None:
    """Units in names of columns, Parquet with times of any kind: these were read by evaluate alone."""
    time, x = np.array([START, START + 0.5]), np.array([1.0, 1.25])
    scale = {"mm": 1000.0, "cm": 100.0}.get(kind, 1.0)
    path, out = tmp_path / f"truth.{'csv' if scale > 1.0 or kind == 'utf-16' else 'parquet'}", tmp_path / "out.mcap"
    if path.suffix == ".parquet":
        stamps = pa.array((time * 1e6).astype(np.int64), pa.int64()).cast(pa.timestamp("us", "UTC"))
        pq.write_table(pa.table({"time": stamps if kind == "stamps" else time, "id": [7, 7], "x": x, "y": x}), path)
    else:
        names = f"time,id,x_{kind},y_{kind}" if scale > 1.0 else "time,id,x,y"
        rows = "".join(f"{t:.1f},7,{v},{v}\n" for t, v in zip(time, scale * x, strict=True))
        path.write_text(f"{names}\n{rows}", encoding="utf-16" if kind == "utf-16" else "utf-8")
    assert run(["ingest", "--truth", str(path), "-o", str(out)]) == ExitCode.DONE
    truth = open_recording(out).read(Truth)
    assert truth.t_ns.tolist() == [START * 10**9, START * 10**9 + 500_000_000]
    assert (truth.x.tolist(), truth.target_id.tolist()) == ([1.0, 1.25], [7, 7])


def test_a_truth_with_a_clock_that_was_set_back_is_a_warning(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    times = [START + 0.1 * k - 30.0 * (k >= 20) for k in range(40)]
    (tmp_path / "truth.csv").write_text("time,id,x,y\n" + "".join(f"{t:.1f},1,{k},0\n" for k, t in enumerate(times)))
    assert run(["ingest", "--truth", str(tmp_path / "truth.csv"), "-o", str(tmp_path / "x.mcap")]) == ExitCode.DONE
    assert "warning:" in (stderr := capsys.readouterr().err)
    assert "line 22: time goes back by 29.9 s" in stderr


def test_many_identities_are_ingested_in_linear_time(tmp_path: Path) -> None:
    """Finding R22: rows of each identity were sought in all rows; 40,000 took minutes."""
    rows = "".join(f"{n // 100},{n},{n % 100},{n // 100 % 50}\n" for n in range(40_000))
    (tmp_path / "truth.csv").write_text("time,id,x,y\n" + rows)
    begin = process_time()
    assert run(["ingest", "--truth", str(tmp_path / "truth.csv"), "-o", str(tmp_path / "x.mcap")]) == ExitCode.DONE
    assert process_time() - begin < 10.0


def test_frames_that_true_boxes_in_xml_do_not_list_are_noted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    person = '<objectlist><object id="4"><box h="60" w="20" xc="50" yc="70"/></object></objectlist>'
    frame = f'<frame number="{{}}">{person}</frame>'
    for name, frames in (("whole", range(9)), ("parts", (0, 1, 8))):
        (tmp_path / f"{name}.xml").write_text(f"<dataset>{''.join(map(frame.format, frames))}</dataset>")
        (tmp_path / "b.csv").write_text("frame,left,top,width,height\n0,40,40,20,60\n8,40,40,20,60\n")
        words = ["--boxes", f"a={tmp_path / 'b.csv'}", "--truth", f"a={tmp_path / name}.xml", "--fps", "10"]
        out = str(tmp_path / f"{name}.mcap")
        assert run(["ingest", "-o", out, *words, "--allow-uncalibrated"]) == ExitCode.DONE
        noted = "true boxes of camera a: 6 of 9 frames are not in the file" in capsys.readouterr().err
        assert noted == (name == "parts")


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("b.csv", b"PK\x03\x04\x14\x00\x06\x00", "a ZIP archive, as of Excel"),
        (
            "b.json",
            b'{"annotations": [{"image_id": 1, "category_id": 1, "bbox": [1, 2, 3, 4]}]}',
            "COCO without images",
        ),
        ("b.json", b'{"annotations": [{"result": []}], "id": 1}', "JSON of Label Studio"),
    ],
)
def test_other_content_than_boxes_is_refused_with_its_cause(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, content: bytes, words: str
) -> None:
    (tmp_path / name).write_bytes(content)
    given = ["--boxes", f"a={tmp_path / name}", "--fps", "10", "--allow-uncalibrated"]
    assert run(["ingest", "-o", str(tmp_path / "o.mcap"), *given]) == ExitCode.BAD_INPUT
    assert words in capsys.readouterr().err


def test_calibrated_cameras_without_boxes_are_noted(
    shared_cases: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = shared_cases / "v02-one-camera-inverted"
    words = ["--boxes", f"left={case / 'left.csv'}", "--boxes", f"right={case / 'right.csv'}", "--fps", "10"]
    words += [w for name in ("left", "right", "back") for w in ("--calibration", f"{case / name}.yaml")]
    assert run(["ingest", "-o", str(tmp_path / "w.mcap"), *words]) == ExitCode.DONE
    assert "calibration: no boxes or images of back, which" in capsys.readouterr().err
