"""Remedies that messages name: commands and options in texts of the code are those that there are.

All texts of the package are read, docstrings and declarations of options apart.  Three kinds of mentions are compared
with the commands: a command with its options (`occlog ingest BAG --video CAM=FILE`, `ingest --fps`), an option alone,
and a name in `option(...)` or `{option[...]}`, which each surface spells.
"""

from __future__ import annotations

import ast
import re
import shlex
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import click
from command_lines import refusal
from places import ROOT

from occlog.cli.main import cli
from occlog.cli.setting_options import CHOSEN, VariantCommand
from occlog.records.messages import VERDICT

PACKAGE = ROOT / "occlog"
OPTION = r"--[a-z](?:[a-z0-9-]*[a-z0-9])?"
DECLARED = re.compile(rf"(-\w/)?({OPTION}|/--no-)([/ ]{OPTION})*|--\{{\}}/--no-\{{\}}")
"""A text that declares an option."""
EXAMPLE = re.compile(r"^ *(occlog [a-z-]+ [^\n|&#]*?)(?:$|  | [|&#>])", re.MULTILINE)
"""A command on a line of its own, as in help."""
BARE = re.compile(r"(?<![\w`.'\"\[{$/-])([a-z]+(?:_[a-z]+)+)(?![\w`(=.'\"/}])")
"""A name with underscores that is not quoted and not part of a path, a call or a template."""
ROOMS: dict[str, tuple[str, ...]] = {
    "ingest": ("ingest",),
    "simulate": ("simulate",),
    "plan": ("plan",),
    "report": ("report", "run"),
    "evaluate": ("evaluate",),
    "evaluate/compare": ("compare",),
    "track": ("track",),
    "track/methods/map/fit_motion": ("fit-motion",),
    "track/methods/readers/fit": ("fit-readers",),
    "track/methods/images/ground": ("ground",),
    "track/methods/images/run": ("track", "evaluate"),
    "calibrate": ("calibrate", "ingest", "track"),
    "measure/detect": ("detect",),
    "measure/networks": ("detect",),
    "measure/associate": ("label",),
    "measure/fuse": ("fuse", "detect"),
    "measure/doa": ("listen",),
    "measure/epipolar": ("epipolar",),
    "measure/priors": ("priors *",),
    "measure/appearance": ("appearance *",),
    "examine/diff": ("diff",),
    "examine/export": ("export",),
    "examine/doctor": ("doctor",),
    "examine/viewers": ("view",),
    "pipeline/start": ("start",),
    "pipeline/run": ("run", "evaluate"),
    "pipeline/batch": ("batch",),
    "pipeline/sweep": ("sweep",),
    "pipeline/executors": ("batch", "sweep"),
    "pipeline/verify": ("verify",),
    "pipeline/pack": ("pack", "verify"),
    "papers": ("reproduce", "navigate", "traffic"),
    "conformance": ("plugin *",),
}
"""Commands of which the messages of a folder are."""
ELSEWHERE = {
    ("cli/common.py", "--reader"): "every command that reads",
    ("cli/main.py", "--strict"): "help of the program",
    ("cli/main.py", "--fail-if"): "help of the program",
    ("cli/main.py", "--overwrite"): "commands with outputs",
    ("cli/options.py", "--set"): "commands with settings",
    ("cli/request_command.py", "--fail-if"): "commands that have it",
    ("cli/setting_options.py", "--set"): "commands with settings",
    ("errors.py", "--set"): "commands with settings",
    ("examine/info.py", "--topic"): "goes on the command that is printed before",
    ("examine/recover.py", "--video"): "recover",
    ("io/formats/calibration/readers/colmap.py", "--output"): "of colmap",
    ("io/recording/salvage/recover.py", "--scene"): "of later stages",
    ("papers/page_provenance.py", "--exclude"): "of git",
    ("papers/page_provenance.py", "--abbrev"): "of git",
    ("records/declared/world.py", "--paths"): "help of plan and simulate",
    ("records/messages.py", "--input-units"): "commands that read tables",
    ("scans/config.py", "--path-loss"): "help of track",
}
"""Options in texts that all commands share, and to which they belong."""


class Text(NamedTuple):
    """A text of the code, with `{}` for its values."""

    file: str
    line: int
    text: str


@cache
def commands() -> dict[str, frozenset[str]]:
    """Options of every command, of all its kinds, by its name."""
    found: dict[str, frozenset[str]] = {}

    def add(name: str, command: click.Command) -> None:
        flags: set[str] = set()
        for variant in [None, *(command.variants if isinstance(command, VariantCommand) else ())]:
            context = click.Context(command, info_name=name)
            if variant is not None:
                context.meta[CHOSEN] = variant
            flags |= {flag for p in command.get_params(context) for flag in (*p.opts, *p.secondary_opts)}
        found[name] = frozenset(flags)

    root = click.Context(cli)
    for name in cli.list_commands(root):
        command = cli.get_command(root, name)
        assert command is not None
        add(name, command)
        if isinstance(command, click.Group):
            for inner in command.list_commands(root):
                each = command.get_command(root, inner)
                assert each is not None
                add(f"{name} {inner}", each)
    return found


def of_folder(file: str) -> tuple[str, ...]:
    """Commands of which the messages of a file are; none: of all."""
    folders = [folder for folder in ROOMS if file.startswith(f"{folder}/")]
    names = ROOMS[max(folders, key=len)] if folders else ()
    return tuple(each for name in names for each in commands() if each == name or name == f"{each.partition(' ')[0]} *")


@cache
def texts() -> tuple[Text, ...]:
    """All texts of the package but docstrings and declarations of options."""
    return tuple(text for path in sorted(PACKAGE.rglob("*.py")) for text in _texts(path))


def _texts(path: Path) -> Iterator[Text]:
    tree, inner = ast.parse(path.read_text(encoding="utf-8")), set[int]()
    file = path.relative_to(PACKAGE).as_posix()
    for node in _nodes(tree):
        if isinstance(node, ast.Expr):
            inner.add(id(node.value))
        elif isinstance(node, ast.JoinedStr):
            inner |= {id(each) for value in node.values for each in _nodes(value)}
            text = "".join(str(v.value) if isinstance(v, ast.Constant) else "{}" for v in node.values)
            yield from () if DECLARED.fullmatch(text) else (Text(file, node.lineno, text),)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in inner:
            yield from () if DECLARED.fullmatch(node.value) else (Text(file, node.lineno, node.value),)


def _nodes(tree: ast.AST) -> Iterator[ast.AST]:
    """All nodes, each before its own, as `ast.walk` in a third of its time."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        yield node
        for value in vars(node).values():
            if isinstance(value, ast.AST):
                waiting.append(value)
            elif isinstance(value, list):
                waiting += [each for each in value if isinstance(each, ast.AST)]


def mentioned_commands(text: str) -> Iterator[tuple[str, str, list[str]]]:
    """Each command of a text with its options: all of the mention, the name, and the options."""
    if "--" not in text:
        return
    names = "|".join(re.escape(name) for name in sorted(commands(), key=len, reverse=True))
    word = r"(?:[A-Za-z0-9_./{}:=*'\[\],-]*[A-Za-z0-9_/{}:=*'\]])"
    for found in re.finditer(rf"(?:occlog )?\b({names})\b((?:[ ]+(?:{OPTION}\b|{word}))*)", text):
        yield found[0], found[1], re.findall(rf"(?<![\w-]){OPTION}", found[2])


def test_commands_in_code_are_there() -> None:
    """A word after `occlog` in quotes (`occlog ingest ...`)."""
    verbs = {name.partition(" ")[0] for name in commands()}
    named = [(t, verb) for t in texts() for verb in re.findall(r"`occlog ([a-z][a-z-]*)", t.text)]
    assert len(named) > 60
    assert [(t.file, t.line, verb) for t, verb in named if verb not in verbs] == []


def test_whole_commands_in_code_are_valid() -> None:
    """Quoted commands, with the types and limits of their values; `{}` and words in capitals stand for any value."""
    lines = [(t.file, t.line, line) for t in texts() for line in re.findall(r"`(occlog [^`]*)`", t.text)]
    lines += [(t.file, t.line, found[1]) for t in texts() for found in EXAMPLE.finditer(t.text)]
    assert len(lines) > 100
    wrong = [(*each, why) for each in lines if (why := refusal(shlex.split(each[2])))]
    assert wrong == []


def test_options_of_commands_that_texts_name_are_there() -> None:
    """`ingest --fps`, `occlog recover FILE -o OUT.mcap`: the command has the option."""
    prose = {"compare --doa", "ground --truth"}  # verbs and places in the help of evaluate
    wrong, seen = [], 0
    for text in texts():
        for _, name, options in mentioned_commands(text.text):
            seen += len(options)
            wrong += [
                (text.file, text.line, name, each)
                for each in options
                if each not in commands()[name] and f"{name} {each}" not in prose
            ]
    assert seen > 50
    assert wrong == []


def test_options_alone_are_those_of_the_commands_that_print_them() -> None:
    wrong, known = [], set(ELSEWHERE)
    for text in texts():
        rest = text.text
        for mention, *_ in mentioned_commands(text.text):
            rest = rest.replace(mention, " ")
        for each in re.findall(rf"(?<![\w-]){OPTION}", rest):
            own = of_folder(text.file)
            if each == "--help" or any(each in commands()[name] for name in own):
                continue
            if (text.file, each) in ELSEWHERE:
                known.discard((text.file, each))
                continue
            wrong.append((text.file, text.line, each, text.text[:60]))
    assert wrong == []
    assert known == set()


def test_options_of_findings_are_there() -> None:
    """A finding of a verdict spells `{option[NAME]}` as `--name`, which some command has."""
    flags = {flag for own in commands().values() for flag in own}
    named = [(id, name) for id, m in VERDICT.items() for name in re.findall(r"\{option\[(\w+)\]\}", m.text + m.remedy)]
    assert len(named) > 10
    assert [each for each in named if f"--{each[1].replace('_', '-')}" not in flags] == []


def test_names_of_options_in_code_are_options_of_their_commands() -> None:
    """`option("fps")` is spelled `--fps`, which a command of the folder has."""
    wrong, seen = [], 0
    for path in sorted(PACKAGE.rglob("*.py")):
        file = path.relative_to(PACKAGE).as_posix()
        for name in re.findall(r"\boption\(['\"](\w+)['\"]\)", path.read_text(encoding="utf-8")):
            seen += 1
            flag = f"--{name.replace('_', '-')}"
            own = of_folder(file) or tuple(commands())
            if not any(flag in commands()[each] for each in own):
                wrong.append((file, name))
    assert seen > 100
    assert wrong == []


def test_placeholders_of_messages_are_in_formatted_strings() -> None:
    """No error is raised with a text such as "{path}: ..." that lacks the prefix f."""
    wrong, seen = [], 0
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Raise) and node.exc is not None:
                parts = [each for each in ast.walk(node.exc) if isinstance(each, ast.Constant)]
                wrong += [(path.name, each.lineno) for each in parts if re.search(r"\{[a-z_]\w*\W", str(each.value))]
                seen += len(parts)
    assert seen > 1000
    assert wrong == []


def test_remedies_spell_options_as_the_surface_does() -> None:
    """A name with an underscore that is an option of a command of the folder is written `option("name")`."""
    columns = {"sigma_px", "detection_probability", "false_alarm_probability"}
    wrong = []
    for text in texts():
        own = of_folder(text.file) or tuple(commands())
        for name in BARE.findall(text.text) if " " in text.text.strip() else ():
            if any(f"--{name.replace('_', '-')}" in commands()[each] for each in own) and name not in columns:
                wrong.append((text.file, text.line, name))
    assert wrong == []


def test_packages_that_messages_name_can_be_installed() -> None:
    """A13: occlog is on no package index, so that `pip install occlog[EXTRA]` fails; packages of its extras are."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    known = {re.split(r"[>=<]", each)[0] for own in extras.values() for each in own}
    known |= {"polars", "rerun-sdk"}
    named = [(t, found) for t in texts() for found in re.findall(r"pip install ([^;,`)\n]+)", t.text)]
    assert len(named) > 6
    for text, found in named:
        packages = [each.strip("'\"") for each in found.split() if each not in ("or", "{}")]
        assert set(packages) <= known, (text.file, text.line, found)
    assert [(t.file, t.line) for t in texts() if re.search(r"occlog\[[a-z0-9]+\]", t.text)] == []
