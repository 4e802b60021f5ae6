"""The arguments of a benchmark that is a command by itself."""

import argparse
from pathlib import Path


def arguments(doc, **numbers):
    """Those of a module of this docstring: out, a folder, which is made if it is not there, and of
    each of numbers a whole number or, if it is a tuple, some, these if none is said."""
    parser = argparse.ArgumentParser(description=doc.split("\n")[0])
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    for name, usual in numbers.items():
        several = "+" if isinstance(usual, tuple) else None
        parser.add_argument(f"--{name}", type=int, nargs=several, default=usual, metavar="N")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    return args
