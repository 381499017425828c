"""The page of what `occlog doctor` finds: words, and the table of all kinds of findings from the code."""

from __future__ import annotations

from occlog.examine.doctor.clock import APART_NS, MIN_INTERVALS, REGULAR_FROM, REGULAR_SHARE, REGULAR_TO
from occlog.examine.doctor.findings import MAX_LISTED_FINDINGS
from occlog.examine.doctor.run import MAX_FILES
from occlog.records.messages import DOCTOR, GAP_INTERVALS

NS = 10**9
TEXT = f"""# What is wrong with these files?

`occlog doctor` lists all faults of recordings, bags, tables, scenes, calibrations, videos and
images, and of the clocks of sensors. Other commands stop at the first fault; the doctor continues,
and one damaged file does not stop the others. It changes nothing.

```sh
occlog doctor hall.mcap
occlog doctor recordings/ run/ --json | jq '.findings[] | select(.severity == "error")'
```

Each finding is a line on standard output: its severity, the file, the position in it, the value found, the
expected value, and the remedy.

    error: mot.txt: line 6: invalid row: 9 cells, but the first line has 10; correct this line
    warning: times.csv: camera 2: after 2023-11-14T22:13:20.900Z: no data: for 1.1 s, where 0.1 s are usual; ...

Findings that differ only in position and numbers are counted (`and 41 more like it`), and so are those after the
first {MAX_LISTED_FINDINGS} of one kind. Folders are searched recursively, up to {MAX_FILES} files;
files of unknown formats are counted on standard error. With `--json` the output is one object; `occlog
schema doctor` prints its schema.

| severity | other commands on this file | exit code |
|---|---|---|
| error | stop with an error | 4 |
| warning | continue: data is lost, or the result may be wrong | 3 |
| note | use the file as it is | 0 |

The exit code is that of the worst finding.

## Clocks

The times of each camera, array, reader and topic are checked, of text tables with a column `camera` or
`sensor`, and of the frames in a file of boxes of one camera.

* **Gaps** are reported for regular sensors: those with at least {MIN_INTERVALS} intervals, of which
  {REGULAR_SHARE:.0%} are between {REGULAR_FROM:g} and {REGULAR_TO:g} times their median. An interval longer than
  {GAP_INTERVALS:g} times the median is a gap; one lost frame is not. If the frame numbers continue through it, no
  frame is lost: the clock has jumped. In bags, jumps and drifts of header stamps against the times of
  recording are reported. Reads of tags, directions of sound, tracks and files of boxes of one camera are
  not checked for gaps, because a missing row there is a missing detection.
* **Epochs.** Times since 1970 lie between 2000 and 2100. Those that do so only when taken for seconds,
  milliseconds or microseconds were written in that unit. Times relative to the start of a recording are
  accepted, those in microseconds up to eleven days.
* **Clock offsets.** The times of a sensor are separate if their distance from those of the others exceeds the length of
  the recording and {APART_NS // NS} s. A sensor is late if it has as many times as the others of its rate (one more or
  less), and starts and ends later by the same time, more than {GAP_INTERVALS:g} intervals. A sensor that was switched
  on late ends with the others, and has fewer. A shorter offset is not visible in the times, but in the
  [residuals](../explanation/believe.md) of tracks.
* **Truth.** True positions and boxes without a time in common with the sensors of the recording cannot be compared;
  most often their times have another origin.

## Findings

"""
END = """
## What is not found

* In a scene, a calibration, JSON, XML, TOML and YAML only the first fault is reported: what follows cannot be
  interpreted without it.
* Flipped bits where a format has no check sums: text, videos (as far as decoders tolerate them), and the statistics
  in Parquet.
* Duplicates of boxes beyond the first 8 million rows of a text, and duplicate rows in external tables that are not
  sorted by time.
* Sound files are checked for their length and for invalid numbers, logs of directions of other programs not at all.
"""


def doctor_page() -> str:
    """The page."""
    rows = ["| kind | severity | what | limit | what to do |", "|---|---|---|---|---|"]
    for name, kind in DOCTOR.items():
        remedy = kind.remedy.format(file="FILE")
        rows.append(f"| `{name}` | {kind.severity} | {kind.text} | {kind.limit} | {remedy} |")
    return TEXT + "\n".join(rows) + "\n" + END
