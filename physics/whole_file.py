"""A file is written whole or not at all: into a neighbour first, then renamed over it."""

import os
import secrets
from contextlib import contextmanager
from pathlib import Path

from .errors import InputError


def check_writable(path):
    """Raise InputError, before hours of work, if a file could not be written at path."""
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path} is a folder; give the name of a file.")
    if not path.parent.is_dir():
        raise InputError(f"cannot write {path}: there is no folder {path.parent}.")
    if not os.access(path.parent, os.W_OK):
        raise InputError(f"cannot write {path}: the folder {path.parent} is read-only.")


@contextmanager
def whole_file(path):
    """Yield a path to write to; it becomes `path` if the block ends well, else it goes.

    The neighbour keeps the suffix, because numpy and matplotlib choose by it.
    """
    path = Path(path)
    check_writable(path)
    part = path.with_name(f".{path.stem}.{secrets.token_hex(4)}{path.suffix}")
    try:
        yield part
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
