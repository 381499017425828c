"""Changes a module, or one of a folder, in one place, then runs their tests: `python -m tests.mutate MODULES TESTS`.

    python -m tests.mutate occlog/core/metrics/errors.py tests/core/metrics/test_errors.py --count 20 --seed 1
    python -m tests.mutate occlog/track/methods/jipda/kernels tests/track/jipda/kernels --count 50

A change is one of: `<` to `<=` and the like, `==` to `!=`, `+` to `-`, `*` to `/`, `and` to `or`, `min` to `max`,
`any` to `all`, a sign or `not` left out, a truth value, a whole number plus 1, another number times 1.5.  Changes are
drawn with the seed, from all places in all modules.  The work goes on in a copy of the repository's files; kernels run
as plain Python (`NUMBA_DISABLE_JIT=1`), unless --jit is given.  Each change that no test notices is printed with its
line: either it makes no difference, or a test at that boundary is missing.
"""

from __future__ import annotations

import argparse
import ast
import copy
import os
import random
import re
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Collection, Iterator, Sequence
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
COMPARISONS = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq}
OPERATORS = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}
LIBRARIES = ("matplotlib.figure", "numba", "pyarrow", "scipy.optimize", "scipy.stats")
"""Loaded before the work begins, after the JIT is switched off."""
NAMES = {"min": "max", "minimum": "maximum", "argmin": "argmax", "any": "all"}
NAMES |= {other: name for name, other in NAMES.items()}


def changed(node: ast.AST) -> Iterator[ast.AST]:
    """The node with one thing changed, for each change that there is."""
    if isinstance(node, ast.Compare):
        for i, op in enumerate(node.ops):
            if type(op) in COMPARISONS:
                other = copy.deepcopy(node)
                other.ops[i] = COMPARISONS[type(op)]()
                yield other
    elif isinstance(node, ast.BinOp | ast.AugAssign) and type(node.op) in OPERATORS:
        other = copy.deepcopy(node)
        other.op = OPERATORS[type(node.op)]()
        yield other
    elif isinstance(node, ast.BoolOp):
        other = copy.deepcopy(node)
        other.op = ast.And() if isinstance(node.op, ast.Or) else ast.Or()
        yield other
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
        yield node.operand
    elif isinstance(node, ast.Constant) and type(node.value) in (bool, int, float):
        value = node.value
        rest = value + 1 if type(value) is int else 1.5 * value or 1.0
        yield ast.copy_location(ast.Constant(not value if type(value) is bool else rest), node)
    elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load) and node.id in NAMES:
        yield ast.copy_location(ast.Name(NAMES[node.id], node.ctx), node)
    elif isinstance(node, ast.Attribute) and node.attr in NAMES:
        yield ast.copy_location(ast.Attribute(node.value, NAMES[node.attr], node.ctx), node)


def untouched(tree: ast.AST) -> set[int]:
    """Nodes whose change no test can notice: annotations, decorators, messages of errors, `strict` of zip."""
    out: set[int] = set()
    for node in ast.walk(tree):
        parts = [getattr(node, name, None) for name in ("annotation", "returns")]
        parts += getattr(node, "decorator_list", [])
        parts += [node] if isinstance(node, ast.Raise) or getattr(node, "arg", None) == "strict" else []
        out |= {id(inner) for part in parts if part is not None for inner in ast.walk(part)}
    return out


def changes(tree: ast.AST) -> Iterator[tuple[ast.AST, ast.AST]]:
    """Make each change in the tree, yield the node that stood there and the one that now does, and undo it."""
    skip = untouched(tree)
    for parent in list(ast.walk(tree)):
        for name, value in list(ast.iter_fields(parent)):
            for i, node in enumerate(value if isinstance(value, list) else [value]):
                if not isinstance(node, ast.AST) or id(node) in skip:
                    continue
                for other in changed(node):
                    _put(parent, name, i, other)
                    yield node, other
                    _put(parent, name, i, node)


def mutants(source: str, chosen: Collection[int] | None = None) -> Iterator[tuple[int, str, str, str]]:
    """Line, what stands there, what stands there instead, and the changed source, of the chosen changes or all."""
    tree = ast.parse(source)
    for n, (node, other) in enumerate(changes(tree)):
        if chosen is None or n in chosen:
            yield getattr(node, "lineno", 0), ast.unparse(node), ast.unparse(other), ast.unparse(tree)


def drawn(modules: Path, count: int, seed: int) -> tuple[dict[Path, set[int]], int]:
    """Numbers of the changes to try in each module, and how many changes there are in all."""
    files = [modules] if modules.is_file() else sorted(modules.rglob("*.py"))
    every = [(file, n) for file in files for n, _ in enumerate(changes(ast.parse(file.read_text(encoding="utf-8"))))]
    random.Random(seed).shuffle(every)
    return {file: {n for other, n in every[:count] if other == file} for file in files}, len(every)


def _put(parent: ast.AST, name: str, place: int, node: ast.AST) -> None:
    """Put a node into a field of its parent, or into the list that the field is."""
    value = getattr(parent, name)
    if isinstance(value, list):
        value[place] = node
    else:
        setattr(parent, name, node)


def copied(folder: Path) -> None:
    """Copy the files of the repository."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in listed.splitlines():
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, folder / name)


def passes(folder: Path, tests: Sequence[list[str]], jit: bool, limit_s: float) -> bool:
    """Whether all parts of the tests pass within the processor time, in a copy of this process with its libraries."""
    child = os.fork()
    if child == 0:
        os.chdir(folder)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os.dup2(1, 2)
        resource.setrlimit(resource.RLIMIT_CPU, (int(limit_s) + 1, int(limit_s) + 1))
        marks = "not slow and not statistics" + ("" if jit else " and not jit")
        ends = (pytest.main(["-q", "-x", "-p", "no:cacheprovider", "-m", marks, *part]) for part in tests if part)
        os._exit(any(end not in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED) for end in ends))
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def parts(folder: Path, tests: list[str], module: Path) -> tuple[list[str], list[str]]:
    """The files of the tests in the copy that name the module, and the others."""
    named = re.compile(rf"\b{module.stem}\b")
    given = (folder / test for test in tests)
    files = [file for test in given for file in ([test] if test.is_file() else sorted(test.rglob("test_*.py")))]
    first = [str(file) for file in files if named.search(file.read_text(encoding="utf-8"))]
    return first, [str(file) for file in files if str(file) not in first]


def options_of(arguments: list[str] | None = None) -> argparse.Namespace:
    """What the command line asks for."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutate", description="Do the tests notice errors?")
    parser.add_argument("modules", help="file of a module, or folder of modules, from the root of the repository")
    parser.add_argument("tests", nargs="+", help="their tests: files or folders")
    parser.add_argument("--count", type=int, default=20, help="changes to try; default 20")
    parser.add_argument("--seed", type=int, default=1, help="of the draw; default 1")
    parser.add_argument("--jit", action="store_true", help="compile the kernels")
    parser.add_argument(
        "--limit", type=float, default=180.0, help="processor time [s] beyond which a change is noticed; default 180"
    )
    return parser.parse_args(arguments)


def main() -> None:
    """Try the changes, and print those that no test notices."""
    options = options_of()
    os.chdir(ROOT)
    os.environ |= {"PYTHONDONTWRITEBYTECODE": "", "NUMBA_DISABLE_JIT": str(int(not options.jit))}
    for library in LIBRARIES:
        import_module(library)
    chosen, places = drawn(ROOT / options.modules, options.count, options.seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        copied(folder)
        if not passes(folder, [options.tests], options.jit, options.limit):
            sys.exit(f"the tests do not pass in {options.limit:g} s without a change")
        limit_s = min(3.0 * resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime, options.limit)
        tried = noticed = 0
        for file, numbers in chosen.items():
            module = file.relative_to(ROOT)
            source, tests = file.read_text(encoding="utf-8"), parts(folder, options.tests, module)
            for line, before, after, text in mutants(source, numbers):
                tried += 1
                write(folder / module, text, tried)
                if passes(folder, tests, options.jit, limit_s):
                    print(f"{module}:{line}: not noticed: {before}  ->  {after}", flush=True)
                else:
                    noticed += 1
            write(folder / module, source, tried + 1)
    print(f"{options.modules}: {noticed} of {tried} noticed, {places} places")


def write(file: Path, text: str, n: int) -> None:
    """Write a module, n-th in time: kept bytecode goes by the second and the length."""
    file.write_text(text, encoding="utf-8")
    os.utime(file, (1e9 + 10 * n, 1e9 + 10 * n))


if __name__ == "__main__":
    main()
