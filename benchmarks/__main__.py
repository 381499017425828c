"""`python -m benchmarks [NAME ...] [--json] [--list]`: print what each case measures."""

from __future__ import annotations

import argparse
import importlib
import json
import pkgutil
from types import ModuleType
from typing import Any

import benchmarks


def cases() -> dict[str, ModuleType]:
    """Benchmark modules by their NAME."""
    names = [m.name for m in pkgutil.walk_packages(benchmarks.__path__, "benchmarks.") if not m.ispkg]
    modules = (importlib.import_module(name) for name in names if not name.rpartition(".")[2].startswith("_"))
    found: dict[str, ModuleType] = {}
    for module in modules:
        if hasattr(module, "NAME") and found.setdefault(module.NAME, module) is not module:
            raise ValueError(f"{module.__name__} and {found[module.NAME].__name__} have one name, {module.NAME!r}")
    return found


def show(name: str, summary: str, result: dict[str, Any]) -> None:
    """One case for a person."""
    limit = f", limit {result['limit']:g}" if result.get("limit") is not None else ""
    print(f"{name}: {summary}\n  ratio {result['ratio']:.3f}{limit}")
    for part, value in result.get("parts", {}).items():
        print(f"  {part:<38} {value:.4g}" if isinstance(value, int | float) else f"  {part:<38} {value}")


def main() -> None:
    """Run the named cases, or all of them."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=benchmarks.__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="cases to run; default: all")
    parser.add_argument("--list", action="store_true", help="name the cases and stop")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.add_argument("--repeats", type=int, default=5, help="repeats of each case (median); default 5")
    options = parser.parse_args()
    known = cases()
    if options.list:
        print("\n".join(f"{name:<12} {module.SUMMARY}" for name, module in known.items()))
        return
    unknown = [n for n in options.names if n not in known]
    if unknown:
        parser.error(f"no benchmark {unknown[0]!r}; there are {', '.join(known)}")
    results = {}
    for name in options.names or known:
        results[name] = known[name].run(options.repeats)
        if not options.json:
            show(name, known[name].SUMMARY, results[name])
    if options.json:
        print(json.dumps(results, sort_keys=True))


if __name__ == "__main__":
    main()
