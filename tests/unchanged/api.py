"""The functions of Python on tables in memory and on files; what they give is written into the current folder."""

import json
from pathlib import Path

import numpy as np
import pandas as pd

import occlog

INPUTS = Path(__file__).parent
stations = pd.DataFrame({"name": ["north", "east", "west"], "x": [0, 45, -40], "y": [40, -5, 0]})
time = np.arange(0, 20, 0.5)
x, y = -10 + 0.5 * time, 5 + 0.1 * time
noise = np.random.default_rng(1)
bearings = pd.concat(
    pd.DataFrame(
        {
            "time": time,
            "station": name,
            "id": 7,
            "bearing_deg": np.degrees(np.arctan2(y - at_y, x - at_x)) + noise.normal(0, 1, len(time)),
            "sigma_deg": 1.0,
        }
    )
    for name, at_x, at_y in stations.itertuples(index=False)
)
truth = pd.DataFrame({"time": time, "id": 7, "x": x, "y": y})
for method in ("apf", "fix", "ekf", "map"):
    result = occlog.track(bearings, stations, method=method)
    result.tracks.to_pandas().to_csv(f"{method}.csv", index=False)
    figures = occlog.evaluate(result, truth, bearings=bearings, scene=stations)
    Path(f"{method}.json").write_text(json.dumps(figures.metrics), encoding="utf-8")
walk = occlog.simulate(INPUTS / "examples" / "room.yaml", steps=60, seed=7)
walk["truth"].to_pandas().to_csv("truth.csv", index=False)
occlog.track(walk, method="ukf", seed=7).tracks.save("ukf.parquet")
found = occlog.detect(INPUTS / "sample_data" / "room" / "recording.mcap")
found.bearings.save("bearings.parquet")
three = occlog.ingest(
    boxes={name: INPUTS / "sample_data" / "boxes" / f"{name}.csv" for name in ("left", "right")},
    calibration=[INPUTS / "sample_data" / "boxes" / f"{name}.yaml" for name in ("left", "right")],
    truth=INPUTS / "sample_data" / "boxes" / "truth.csv",
    fps=10,
)
people = occlog.track(three, method="jipda")
Path("people.json").write_text(json.dumps(occlog.evaluate(people, three).metrics), encoding="utf-8")
people.tracks.save("people.csv")
occlog.report(people, truth=three, output="people.html")
