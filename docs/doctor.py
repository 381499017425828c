"""The page of what `occlog doctor` finds: words, and the table of all kinds of findings from the code."""

from __future__ import annotations

from occlog.examine.doctor.clock import APART_NS, MIN_INTERVALS, REGULAR_FROM, REGULAR_SHARE, REGULAR_TO
from occlog.examine.doctor.findings import MAX_LISTED_FINDINGS
from occlog.examine.doctor.run import MAX_FILES
from occlog.records.messages import DOCTOR, GAP_INTERVALS

NS = 10**9
TEXT = f"""# What is wrong with these files?

`occlog doctor` lists everything that is wrong in recordings, bags, tables, scenes, calibrations, videos and
images, and in the clocks of sensors. A command stops at the first thing that it cannot use; the doctor goes on,
and one damaged file does not stop the others. Nothing is changed.

```sh
occlog doctor hall.mcap
occlog doctor recordings/ run/ --json | jq '.findings[] | select(.severity == "error")'
```

Each finding is a line on standard output: how bad it is, the file, the place in it, what is there, what may be
there, what to do.

    error: mot.txt: line 6: an invalid row: 9 cells, but the first line has 10; correct this line
    warning: times.csv: camera 2: after 2023-11-14T22:13:20.900Z: no data: for 1.1 s, where 0.1 s are usual; ...

What differs in place and numbers alone is counted (`and 41 more like it`), and so is what comes after the first
{MAX_LISTED_FINDINGS} of one kind. Of a folder the files of its own folders are looked at too, {MAX_FILES} at most;
files that occlog does not know are counted on standard error. With `--json` all of it is one object, of which `occlog
schema doctor` prints the schema.

| severity | what a command does that reads the file | exit code |
|---|---|---|
| error | it stops, and says so | 4 |
| warning | it goes on: something is lost, or its result may be wrong | 3 |
| note | it takes the file as it is | 0 |

The exit code is that of the worst finding.

## Clocks

The times of each camera, array, reader and topic are looked at, and of text tables with a column `camera` or
`sensor`; of a file of boxes of one camera those of its frames.

* **Gaps** are told of a regular sensor: one with at least {MIN_INTERVALS} intervals, of which {REGULAR_SHARE:.0%}
  are between {REGULAR_FROM:g} and {REGULAR_TO:g} times their median. What is longer than {GAP_INTERVALS:g} times the
  median is a gap; one lost frame is none. Where the frames are numbered on through it, no frame is lost: the
  clock has jumped. Reads of tags, directions of sound, tracks and files of boxes of one camera have no gaps: there no
  row says that nothing was there.
* **Epochs.** Times since 1970 lie between 2000 and 2100. Those that do so only when taken for seconds,
  milliseconds or microseconds were written in that unit. Times that count from the beginning of a recording are
  left in peace, those of microseconds up to eleven days.
* **Beside the others.** A sensor is apart if its times are farther from those of the others than the recording is
  long, and than {APART_NS // NS} s. It is late if it has as many times as the others of its rate (one more or
  less), and begins and ends later by the same time, more than {GAP_INTERVALS:g} intervals. A sensor that was switched
  on late ends with the others, and has fewer. An offset that is shorter shows in no clock, but in the
  [residuals](../explanation/believe.md) of tracks.
* **Truth.** True positions and boxes of a recording that are of none of the times of its sensors can be compared
  with nothing, most often since they count from another origin.

## Findings

"""
END = """
## What is not found

* Of a scene, a calibration, JSON, XML, TOML and YAML the first fault alone is told: what comes after it has no
  meaning without it.
* Flipped bits where a format has no check sums: text, videos (as far as decoders bear them), and the statistics
  in Parquet.
* Copies of boxes beyond the first 8 million rows of a text, and copies of rows in tables of others that are in no
  order of time.
* Files of sound are read for their length and for numbers, logs of directions of other programs not at all.
"""


def doctor_page() -> str:
    """The page."""
    rows = ["| kind | severity | what | limit | what to do |", "|---|---|---|---|---|"]
    for name, kind in DOCTOR.items():
        remedy = kind.remedy.format(file="FILE")
        rows.append(f"| `{name}` | {kind.severity} | {kind.text} | {kind.limit} | {remedy} |")
    return TEXT + "\n".join(rows) + "\n" + END
