"""Files that the commands of both sides read, made once: `make_inputs(folder, checkout)`."""

from __future__ import annotations

import json
import shutil
import sys
import wave
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent / "reference" / name) for name in ("", "forms", "scenes", "video", "peers")]

import ros_bags  # noqa: E402
from small_networks import constant_network  # noqa: E402

from tests.fuzz import seeds  # noqa: E402

TEXTS = {
    "boxes.csv": seeds.BOXES,
    "marked.csv": seeds.MARKED,
    "mot.txt": seeds.MOT,
    "mot_truth.txt": "1,1,10,20,12,30,1,1,1\n2,1,11,20,12,30,1,1,1\n2,2,2,2,3,4,1,1,1\n",
    "kitti.txt": seeds.KITTI,
    "vatic.txt": seeds.VATIC,
    "coco.json": seeds.COCO,
    "given.json": seeds.GIVEN,
    "detections.json": seeds.DETECTIONS,
    "yolo/000002.txt": seeds.YOLO,
    "truth.csv": seeds.TRUTH,
    "doa.csv": seeds.DOA,
    "odas.json": seeds.ODAS,
    "telemetr.dat": seeds.TELEMETR,
    "frida.csv": seeds.FRIDA,
    "readers.csv": seeds.READERS,
    "reads.csv": seeds.READS,
    "tsai.xml": seeds.TSAI,
    "c.toml": seeds.TOML,
    "camchain.yaml": seeds.KALIBR,
    "ros.yaml": seeds.ROS,
    "colmap/cameras.txt": seeds.COLMAP_CAMERAS,
    "colmap/images.txt": seeds.COLMAP_IMAGES,
    "cam1_P.txt": seeds.PROJECTION,
    "matches.csv": seeds.MATCHES,
    "mine.csv": seeds.TRACKS,
    "mine_truth.csv": "time,id,x_m,y_m\n0,7,2,3.1\n0.1,7,2.2,3.1\n0.1,8,5,5.2\n",
    "azimuths.csv": "time,sensor,id,azimuth_deg\n"
    + "".join(f"{1577836800 + k / 10},wall,0,{k / 2}\n" for k in range(100)),
    "broken.csv": "time,id,x,y\n0,1,2,3\n0.1,1,nothing,3\n",
    "broken_run.yaml": "occlog_run: 1\nseed: 1\ntrack: {partciles: 5}\n",
    "unknown_setting.yaml": "occlog_run: 1\nsimulate: {scene: people, frames: 5}\n"
    "track: {method: jipda, set: {nix: 1}}\n",
    "people.yaml": "occlog_run: 1\nseed: 1\nsimulate: {scene: people, people: 3, views: 2, frames: 25, fps: 10, "
    "size: 320x240, store: ffv1}\ndetect: {}\ntrack: {method: jipda}\nevaluate: {}\nreport: {title: People}\n",
    "sweep.yaml": "occlog_sweep: 1\nscene: examples/room100.yaml\nseed: 1\nruns: 2\n"
    "simulate: {steps: 60, occluders: 10}\ntrack: {particles: 200}\norder: [cam1, cam7, cam5, cam3]\n"
    "cases:\n- {name: known, priors.kind: known}\n- {name: none, priors.kind: none}\nvary: {cameras: [2, 4]}\n",
}
MICROPHONES = np.array([[0.1, 0, 1], [-0.1, 0, 1], [0, 0.1, 1], [0, -0.1, 1.1]])


def make_inputs(folder: Path, checkout: Path) -> None:
    """Write them, with the examples and the sample data of a checkout."""
    for name in ("examples", "sample_data"):
        shutil.copytree(checkout / name, folder / name)
    for name, text in TEXTS.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    (folder / "c.npz").write_bytes(seeds.arrays("npz")()[2])
    ros_bags.write_mcap(folder / "bag.mcap", ros_bags.two_cameras(6))
    ros_bags.write_db3(folder / "bag.db3", ros_bags.two_cameras(4))
    recording = (checkout / "sample_data" / "room" / "recording.mcap").read_bytes()
    (folder / "cut.mcap").write_bytes(recording[: len(recording) // 2])
    (folder / "cut.parquet").write_bytes(b"PAR1" + bytes(100))
    boxes = np.zeros((1, 5, 8), np.float32)
    boxes[0, :, :2] = np.array([[30, 20], [32, 40], [10, 12], [24, 20], [0.9, 0.8]])
    constant_network(folder / "network.onnx", {"output0": boxes}, metadata={"names": "{0: 'owl'}"})
    talk(folder / "talk.wav")
    np.savetxt(folder / "microphones.csv", MICROPHONES, "%g", ",", header="x,y,z", comments="")
    shutil.copy(HERE / "api.py", folder / "api.py")
    (folder / "made.json").write_text(json.dumps(sorted(TEXTS)), encoding="utf-8")


def talk(path: Path, rate: int = 16_000, seconds: float = 2.0) -> None:
    """Noise from 40 degrees at four microphones, with a pause, as 16-bit sound."""
    noise = np.random.default_rng(1)
    n = int(rate * seconds)
    source = noise.normal(size=n) * (np.arange(n) % rate < 0.7 * rate)
    direction = np.array([np.cos(np.radians(40)), np.sin(np.radians(40)), 0])
    turns = np.exp(2j * np.pi * np.fft.rfftfreq(n, 1 / rate)[:, None] * (MICROPHONES @ direction / 343))
    heard = np.fft.irfft(np.fft.rfft(source)[:, None] * turns, n, axis=0) + 0.01 * noise.normal(size=(n, 4))
    with wave.open(str(path), "wb") as sound:
        sound.setnchannels(4)
        sound.setsampwidth(2)
        sound.setframerate(rate)
        sound.writeframes((heard / np.abs(heard).max() * 30_000).astype("<i2").tobytes())
