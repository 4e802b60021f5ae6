"""A file is written whole or not at all: into a neighbour first, then renamed over it."""

import os
import secrets
from contextlib import contextmanager
from pathlib import Path

from ..errors import InputError

SHOWN = 40  # letters of a file's name in its neighbour's, which may not be too long, either


def check_writable(path, *inputs, suffix=()):
    """Raise InputError, before hours of work, if a file could not be written at path.

    inputs  what is read, paths or None: none of them may be written over
    suffix  that its name has to have, or several, of which one; any if there is none
    """
    path = Path(path)
    target = _target(path)
    if path.is_dir():
        raise InputError(f"{path} is a folder; give the name of a file.")
    if os.path.lexists(target) and not target.is_file():
        raise InputError(f"cannot write {path}: it is no regular file; give the name of one.")
    if not target.parent.is_dir():
        raise InputError(f"cannot write {path}: there is no folder {target.parent}.")
    if not os.access(target.parent, os.W_OK):
        raise InputError(f"cannot write {path}: the folder {target.parent} is read-only.")
    for other in inputs:
        if other is not None and _same_file(target, other):
            raise InputError(f"cannot write {path}: the command reads it; give another name.")
    suffixes = (suffix,) if isinstance(suffix, str) else tuple(suffix)
    if suffixes and path.suffix.lower() not in suffixes:
        raise InputError(f"cannot write {path}: its name must end in {' or '.join(suffixes)}.")


@contextmanager
def whole_file(path):
    """Yield a path to write to; it becomes `path` if the block ends well, else it goes. An OSError
    of it, as of a full disk, has `path` for a filename.

    The neighbour keeps the suffix, because numpy and matplotlib choose by it. A link stays one:
    what it leads to is written.
    """
    path = Path(path)
    check_writable(path)
    target = _target(path)
    part = target.with_name(f".{path.stem[:SHOWN]}.{secrets.token_hex(4)}{path.suffix}")
    try:
        yield part
        os.replace(part, target)
    except OSError as e:
        if e.errno is not None and str(e.filename) in ("None", str(part)):
            e.filename = str(path)
        raise
    finally:
        part.unlink(missing_ok=True)


def _target(path):
    """What a link leads to, in the end; any other path as it is."""
    return Path(os.path.realpath(path)) if path.is_symlink() else path


def _same_file(a, b):
    return os.path.exists(a) and os.path.exists(b) and os.path.samefile(a, b)
