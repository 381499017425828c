"""Files of other programs that are not read: named with what to write, and no others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode, InputError
from occlog.io.files.programs import describe_program, refuse_unread
from occlog.io.formats.calibration.reader import read_calibration
from occlog.io.open import open_input

NOT_READ = {
    "web page": "<!DOCTYPE html>\n<html><body>404</body></html>",
    "Git LFS": "version https://git-lfs.github.com/spec/v1\noid sha256:1\nsize 12\n",
    "UA-DETRAC": '<sequence name="a"><frame density="1" num="1"><target_list><target id="1">',
    "Pascal VOC": "<annotation>\n<filename>1.jpg</filename><size><width>5</width></size><object>",
    "LabelMe": '{"version": "5.4.1", "flags": {}, "shapes": [{"label": "person", "shape_type": "rectangle"}]}',
    "Roboflow": '[{"image": {"width": 9}, "predictions": [{"x": 1, "y": 2, "width": 3}]}]',
    "keypoints": '[{"image_id": "0.jpg", "keypoints": [1, 2, 3], "box": [1, 2, 3, 4], "idx": 1}]',
    "VisDrone": "1,4,484,97,20,109,1,1,0,2\n2,4,484,97,20,109,1,1,0,0\n",
    "AI City": "1 4 0 484 97 20 109 1.25 -3.50\n",
    "KITTI's detection": "person 0.0 0 0.0 1.00 2.00 30.00 40.00 0.0 0.0 0.0 0.0 0.0 0.0 0.0 0.9\n",
    "AVA": "cam1,902.1,0.077,0.151,0.283,0.811,80,1\n",
    "DarkLabel": "0,2,1,10,20,30,40,person,2,15,20,30,40,person\n",
    "EasyMocap": '%YAML:1.0\n---\nnames:\n   - "1"\nK_1: !!opencv-matrix\n',
    "Panoptic": '{"cameras": [{"name": "a", "K": [], "distCoef": [], "R": [], "t": []}]}',
    "Meshroom": '{"views": [{"viewId": "1", "intrinsicId": "2"}]}',
    "Open3D": '{"class_name": "PinholeCameraTrajectory"}',
    "Nerfstudio": '{"fl_x": 800, "frames": [{"transform_matrix": [[1, 0]]}]}',
    "MMPTRACK": '{"Cameras": [{"ExtrinsicParameters": {"Rotation": []}}]}',
    "stereo pair": "%YAML:1.0\n---\nM1: !!opencv-matrix\n   rows: 3\nM2: !!opencv-matrix\n",
    "ORB-SLAM": "%YAML:1.0\nCamera.fx: 800.0\nCamera.fy: 800.0\n",
    "Bouguet": "%-- Focal length:\nfc = [ 800.0 ; 800.0 ];\n",
    "OptiTrack": "Format Version,1.23,Take Name,Take 1\n",
    "Vicon": "Trajectories\n100\n,,p0,,\n",
    "Qualisys": "NO_OF_FRAMES\t200\nNO_OF_CAMERAS\t8\n",
    "TrajNet": '{"track": {"f": 0, "p": 1, "x": 1.0, "y": 2.0}}\n',
    "Acoular": '<?xml version="1.0"?><MicArray name="a"><pos Name="1" x="0" y="0" z="0"/></MicArray>',
    "C3D": "\x02P\x00\x00",
    "Gemini": '[{"frame": 0, "box_2d": [50, 100, 150, 140], "label": "person"}]',
    "Qwen": '[{"frame": 0, "bbox_2d": [100, 50, 140, 150]}]',
    "Detectron2": '[{"image_id": 0, "bbox": [100, 50, 140, 150], "bbox_mode": 0}]',
    "JSON with matrices": '{"mtx": [[800.0, 0.0, 640.0], [0.0, 800.0, 360.0], [0.0, 0.0, 1.0]], "dist": [[0.1]]}',
    "YAML with matrices": "camera_matrix:\n- - 800.0\n  - 0.0\ndist_coeff:\n- - 0.1\n",
    "pickle": "\x80\x04\x95\x00",
    "OCamCalib": "#polynomial coefficients for the DIRECT mapping function (ocam_model.ss in MATLAB).\n",
    "RealSense": '{"width": 1280, "fx": 800, "ppx": 640, "ppy": 360, "coeffs": [0, 0, 0, 0, 0]}',
    "Pix4D": "fileName imageWidth imageHeight \ncamera matrix K [3x3]\n",
}
READ = (
    "frame,left,top,width,height,confidence\n0,1,2,3,4,0.5\n",
    "1,-1,912,484,97,109,0.9,-1,-1,-1\n",
    "1,1,912,484,97,109,1,1,1.0\n",
    "1,1,912,484,97,109,1,-1,-1,-1\n",
    '{"images": [{"id": 1, "width": 9}], "annotations": [{"bbox": [1, 2, 3, 4], "keypoints": []}]}',
    '[{"image_id": 1, "category_id": 1, "bbox": [1, 2, 3, 4], "score": 0.5}]',
    "%YAML:1.0\n---\nimage_width: 1280\ncamera_matrix: !!opencv-matrix\n",
    "image_width: 640\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: [1, 0, 3]\n",
    '{"camera_matrix": {"type_id": "opencv-matrix", "rows": 3, "cols": 3}}',
    "<?xml version='1.0'?><annotations><track id='0' label='person'>",
    "0 Pedestrian 0 0 -1.57 1.0 2.0 3.0 4.0 -1 -1 -1 -1000 -1000 -1000 -10 0.9\n",
    "time,id,x,y\n0,1,2,3\n",
)


@pytest.mark.parametrize("name", NOT_READ)
def test_a_file_of_a_program_that_is_not_read_is_named(tmp_path: Path, name: str) -> None:
    path = tmp_path / "file"
    path.write_text(NOT_READ[name], encoding="latin-1")
    for place in (path, tmp_path):  # in a folder with a file for each frame
        with pytest.raises(InputError) as caught:
            refuse_unread(place)
        assert caught.value.id == "unsupported-format"
        assert name in str(caught.value)


@pytest.mark.parametrize("text", READ)
def test_what_is_read_is_of_no_such_program(text: str) -> None:
    assert describe_program(text.encode()) is None


@pytest.mark.parametrize(("name", "option"), [("VisDrone", "--boxes"), ("C3D", "--truth"), ("AVA", "--doa")])
def test_every_kind_of_input_names_the_program(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, option: str
) -> None:
    path = tmp_path / "in.txt"
    path.write_text(NOT_READ[name], encoding="latin-1")
    given = str(path) if option == "--truth" else f"cam={path}"
    assert run(["ingest", "-o", str(tmp_path / "o.mcap"), option, given, "--fps", "10"]) == ExitCode.BAD_INPUT
    assert name in capsys.readouterr().err


def test_folders_with_a_file_for_each_frame_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "cam").mkdir()
    (tmp_path / "cam" / "000001.xml").write_text(NOT_READ["Pascal VOC"])
    for given in (tmp_path, f"cam={tmp_path / 'cam'}"):
        assert (
            run(["ingest", "-o", str(tmp_path / "o.mcap"), "--boxes", str(given), "--fps", "10"]) == ExitCode.BAD_INPUT
        )
        assert "Pascal VOC" in capsys.readouterr().err


def test_a_calibration_of_a_program_that_is_not_read_is_named(tmp_path: Path) -> None:
    (tmp_path / "c.json").write_text(NOT_READ["Panoptic"])
    with pytest.raises(InputError, match="Panoptic") as caught:
        read_calibration([tmp_path])
    assert caught.value.id == "unsupported-format"


def test_poses_of_a_board_in_several_images_are_not_that_of_a_camera(tmp_path: Path) -> None:
    """As `cv2.calibrateCamera` returns them; NumPy's message was that an array cannot be reshaped."""
    rvecs, matrix = np.zeros((7, 3, 1)), np.array([[800.0, 0, 640], [0, 800, 360], [0, 0, 1]])
    np.savez(tmp_path / "c.npz", mtx=matrix, dist=np.zeros((1, 5)), rvecs=rvecs, tvecs=rvecs)
    with pytest.raises(InputError, match="7 images") as caught:
        read_calibration([tmp_path / "c.npz"])
    assert caught.value.id == "invalid-calibration"


@pytest.mark.parametrize("content", ["0 1 2.5 3.5\n1 1 2.5 3.5\n", "# id\tframe\tx\n1\t0\t2.5\n"])
def test_positions_without_a_header_are_no_damaged_parquet(tmp_path: Path, content: str) -> None:
    path = tmp_path / "walk.txt"
    path.write_text(content)
    with pytest.raises(InputError) as caught:
        open_input(path)
    assert caught.value.id == "unknown-format"


@pytest.mark.parametrize(
    ("inside", "words"),
    [("_delta_log/0.json", "Delta Lake"), ("part-0.csv", "one file"), ("day=1/part-0.csv", "join its parts: duckdb")],
)
def test_folders_of_tables_state_what_to_write(tmp_path: Path, inside: str, words: str) -> None:
    (tmp_path / inside).parent.mkdir(exist_ok=True)
    (tmp_path / inside).write_text("{}")
    with pytest.raises(InputError, match=words) as caught:
        open_input(tmp_path)
    assert caught.value.id == "not-a-file"


@pytest.mark.parametrize("words", [["--truth"], ["--positions"], ["--allow-uncalibrated", "--boxes"]])
def test_csv_in_parts_of_hive_is_refused_by_ingest_with_a_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    (tmp_path / "hive" / "day=1").mkdir(parents=True)
    (tmp_path / "hive" / "day=1" / "part-0.csv").write_text("frame,id,x,y\n0,1,2,3\n")
    given = [*words, str(tmp_path / "hive"), "--fps", "10"]
    assert run(["ingest", "-o", str(tmp_path / "x.mcap"), *given]) == ExitCode.BAD_INPUT
    assert "join its parts: duckdb" in capsys.readouterr().err


def test_columns_for_each_target_are_named(tmp_path: Path) -> None:
    (tmp_path / "wide.csv").write_text("time,x1,y1,x2,y2,x3,y3\n0,1,2,3,4,5,6\n")
    with pytest.raises(InputError, match="has separate columns for each target") as caught:
        open_input(tmp_path / "wide.csv")
    assert caught.value.id == "unknown-format"
