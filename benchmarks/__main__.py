"""Runs every benchmark, or those named: `python -m benchmarks [NAME…] [--soak] [--list]`.

A benchmark is a module of this package with `main()`, which prints its figures and writes its own section of
docs/benchmarks. Names that end in `_soak` run only with --soak. Options that follow a single name are its own.
"""

from __future__ import annotations

import argparse
import importlib
import pkgutil
import sys

import benchmarks


def names(*, soak: bool) -> list[str]:
    found = [module.name for module in pkgutil.iter_modules(benchmarks.__path__) if not module.name.startswith("_")]
    scripts = [name for name in found if hasattr(importlib.import_module(f"benchmarks.{name}"), "main")]
    return [name for name in scripts if name.endswith("_soak") == soak]


def run() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("names", nargs="*", help="benchmarks to run; all by default")
    parser.add_argument("--soak", action="store_true", help="run the soaks instead")
    parser.add_argument("--list", action="store_true", help="list them")
    own = sys.argv[2:] if len(sys.argv) > 2 and not sys.argv[1].startswith("-") and sys.argv[2].startswith("-") else []
    own = [] if set(own) <= {"--soak", "--list"} else own
    options = parser.parse_args(sys.argv[1:2] if own else None)
    there = names(soak=options.soak)
    unknown = sorted(set(options.names) - set(there))
    if unknown:
        parser.error(f"no benchmark {unknown[0]!r}; there are: {', '.join(there)}")
    for name in options.names or there:
        print(name if options.list else f"== {name}", flush=True)
        if not options.list:
            sys.argv = [name, *own]
            importlib.import_module(f"benchmarks.{name}").main()


if __name__ == "__main__":
    run()
