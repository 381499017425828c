"""Ids of errors: what each kind of error means, and what to do.

The message of an error is written where the error is found, since it names the file, the position in it, the value and
the limit.  Its id says of which kind it is, for scripts (`--json`, `OcclogError.id`) and for
docs/reference/errors.md.
"""

from typing import NamedTuple


class ErrorKind(NamedTuple):
    """A kind of error.

    Attributes:
        meaning: what is wrong.
        remedy: what to do, if the message does not say it more exactly.
    """

    meaning: str
    remedy: str


ERRORS: dict[str, ErrorKind] = {
    # Files
    "file-not-found": ErrorKind("There is no such file or folder.", "Check the path and the working folder."),
    "not-a-file": ErrorKind(
        "A folder, a device or a terminal is given where a file is expected, or a file instead of a folder.",
        "Name a path of the expected kind.",
    ),
    "unreadable-file": ErrorKind(
        "The operating system refuses to read a file.", "Check permissions, the disk and the network share."
    ),
    "empty-input": ErrorKind(
        "An input has no rows, images or samples, or none for the chosen cameras, frames or classes.",
        "Check the program that wrote it, and the selection.",
    ),
    "damaged-file": ErrorKind(
        "A file is cut off or corrupt: a wrong check sum, or content that cannot be decoded.",
        "Copy or make it again; `occlog recover` salvages recordings.",
    ),
    "file-changed": ErrorKind(
        "A file is not the one that was recorded under this name: its size or SHA-256 differs.",
        "Restore it, or repeat the step that refers to it.",
    ),
    "unknown-format": ErrorKind(
        "The content fits none of the formats that are accepted here.",
        "See the formats in the how-to page of the input, and export the file in one of them.",
    ),
    "invalid-syntax": ErrorKind("A text is not valid JSON, YAML, TOML, XML or CSV.", "Correct the line that is named."),
    "wrong-encoding": ErrorKind("A text is not encoded in UTF-8.", "Save it as UTF-8."),
    "unsupported-format": ErrorKind(
        "The format, or the variant of it, is known but cannot be read or used.",
        "Convert the file as the message states.",
    ),
    "unsupported-network": ErrorKind(
        "Inputs or outputs of a neural network are not those of a supported detector or embedding.",
        "Export the network again, or state its head or runtime.",
    ),
    "wrong-content": ErrorKind(
        "A file is valid but holds something else than the command needs: a recording instead of tracks, another "
        "table, no images.",
        "Give the file that the message names; `occlog info` shows what a file holds.",
    ),
    "version-mismatch": ErrorKind(
        "A file or a worker belongs to another version of occlog.", "Update occlog, or make the file again."
    ),
    "input-too-large": ErrorKind(
        "An input is larger than the limit for its kind, or would be when it is unpacked.",
        "Split or correct it; limits are in the reference page on security.",
    ),
    # Tables
    "missing-column": ErrorKind("A table lacks a required column.", "Add the column; `occlog schema` lists all."),
    "unknown-column": ErrorKind(
        "A table has no column of the stated name, or has a column that occlog does not know.",
        "Correct its name, or ignore extra columns.",
    ),
    "duplicate-row": ErrorKind(
        "Two rows are about the same thing: one target in two positions at a time, a repeated box.",
        "Keep one of them.",
    ),
    "unsorted-times": ErrorKind("Times go back or repeat where they must increase.", "Sort the rows by time."),
    "time-out-of-range": ErrorKind(
        "A time cannot be represented (int64 nanoseconds since 1970), or is before the first one allowed.",
        "Check its unit and its origin.",
    ),
    "missing-times": ErrorKind(
        "Frames are counted, and nothing states their times.", "Give the frame rate or a file of time stamps."
    ),
    "missing-unit": ErrorKind(
        "A quantity has no unit, and none can be derived.",
        "Name the column after its unit (x_mm, t_ms), or state the unit by an option.",
    ),
    "unit-mismatch": ErrorKind("Two inputs have different units.", "Convert one, or correct the unit that is stated."),
    "missing-labels": ErrorKind(
        "Detections have no identities, which the command needs.",
        "Label them (`occlog label`, `occlog track --method sort`), or use a method without labels.",
    ),
    # Values and names
    "invalid-value": ErrorKind(
        "A value in an input is of the wrong type, outside its range, or inconsistent with others.",
        "Correct the value at the position that the message names.",
    ),
    "missing-value": ErrorKind("A required value, key or element is missing in an input.", "Add it."),
    "conflicting-values": ErrorKind("An input states one quantity twice, in different ways.", "Keep one of them."),
    "duplicate-name": ErrorKind("Two things have one name where names must differ.", "Rename or remove one."),
    "unknown-key": ErrorKind(
        "A configuration or a request has a key or setting that does not exist.",
        "Correct its name; messages propose similar and renamed ones.",
    ),
    "unknown-name": ErrorKind(
        "There is no method, metric, table, format, command, option or value of this name.",
        "Choose one of those that the message lists.",
    ),
    "unknown-sensor": ErrorKind(
        "The scene or the input has no camera, array, reader or station of this name.",
        "Use the names of the scene; `occlog info` lists them.",
    ),
    # Scenes and calibrations
    "missing-scene": ErrorKind(
        "No scene is given, or the file holds none.", "Name a scene file, or a recording that holds one."
    ),
    "missing-pose": ErrorKind(
        "The position or orientation (extrinsics) of a sensor is unknown.",
        "Add it to the scene, or leave the sensor out.",
    ),
    "missing-image-size": ErrorKind("The image size of a camera is unknown.", "State it, as WIDTHxHEIGHT."),
    "image-size-mismatch": ErrorKind(
        "Images, boxes or a calibration of one camera are of different image sizes.",
        "Give the calibration of these images.",
    ),
    "invalid-calibration": ErrorKind(
        "Intrinsics or extrinsics are impossible: not a rotation, a focal length out of range, coefficients of "
        "another lens model.",
        "Correct or repeat the calibration.",
    ),
    "camera-not-named": ErrorKind(
        "A file has the data of a single camera or microphone array, and does not state its name.",
        "Give it as NAME=FILE.",
    ),
    "too-few-sensors": ErrorKind(
        "The scene or the selection has fewer usable sensors than the command needs.", "Add sensors, or omit fewer."
    ),
    # Inputs together
    "disjoint-inputs": ErrorKind(
        "Inputs have no time, frame, camera or target in common, or belong to different recordings.",
        "Give inputs of one recording; check clocks and names.",
    ),
    "incompatible-inputs": ErrorKind(
        "Inputs cannot be used together: they differ in kind, layout or parameters.", "Give inputs of one kind."
    ),
    "ambiguous-input": ErrorKind(
        "An input allows several interpretations, or holds several things of which one is needed.",
        "State which one.",
    ),
    "insufficient-data": ErrorKind(
        "Inputs are valid and hold too few observations for an estimate.", "Give a longer or better recording."
    ),
    "problem-too-large": ErrorKind(
        "The computation would need too much memory or time.",
        "Use fewer targets, cells, combinations or a shorter part.",
    ),
    "no-room": ErrorKind(
        "A simulation cannot place its targets and obstacles.", "Use fewer or smaller ones, or a larger room."
    ),
    # Requests
    "invalid-option": ErrorKind("An option has a value that it cannot have.", "See the help of the command."),
    "invalid-setting": ErrorKind(
        "A setting is outside its range or of the wrong type.", "See the reference page on settings."
    ),
    "missing-option": ErrorKind(
        "The request lacks an input, an output or an option that another option requires.", "Give what is named."
    ),
    "conflicting-options": ErrorKind("Two options exclude each other or state the same thing.", "Keep one of them."),
    "not-applicable": ErrorKind(
        "An option has no effect with this method, format or input.",
        "Leave it out, or choose another method or format.",
    ),
    # Outputs
    "output-exists": ErrorKind("The output exists.", "Give another name, or allow it to be replaced."),
    "output-unwritable": ErrorKind(
        "An output cannot be written, or a program that shows it fails.",
        "Check disk space, permissions and the folder.",
    ),
    "output-busy": ErrorKind("Another occlog works with the same output.", "Wait, or name another output."),
    # The system
    "missing-package": ErrorKind("A program or Python package is not installed.", "Install it as the message states."),
    "plugin-failed": ErrorKind(
        "A plug-in cannot be loaded, fails, or returns something invalid.",
        "Report it to its author; remove the plug-in.",
    ),
    "scheduler-failed": ErrorKind("A scheduler of jobs or its workers do not answer.", "Start it again."),
    "transfer-failed": ErrorKind("A download is incomplete.", "Try again."),
    "out-of-memory": ErrorKind("Memory is exhausted.", "Use fewer particles, a shorter lag or smaller images."),
    "too-many-open-files": ErrorKind("The limit of open files is reached.", "Raise it with `ulimit -n`."),
    "interrupted": ErrorKind("The command was interrupted from the keyboard (SIGINT).", "Start it again."),
    "terminated": ErrorKind("The command was terminated by the system or a job queue (SIGTERM).", "Start it again."),
    "bug": ErrorKind("An unexpected error inside occlog.", "Report the message and the command."),
}
"""Kinds of errors by id; an id never changes its meaning."""
