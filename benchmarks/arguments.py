"""The arguments of a benchmark that is a command."""

import argparse
from pathlib import Path


def arguments(doc, **numbers):
    """Parsed arguments for a module with docstring doc: out, a folder, created if missing, and for
    each of numbers a whole number or, if its default is a tuple, several."""
    parser = argparse.ArgumentParser(description=doc.split("\n")[0])
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    for name, usual in numbers.items():
        several = "+" if isinstance(usual, tuple) else None
        parser.add_argument(f"--{name}", type=int, nargs=several, default=usual, metavar="N")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    return args
