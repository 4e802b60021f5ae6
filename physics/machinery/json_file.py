"""JSON files that people write."""

import json
from pathlib import Path

from ..errors import InputError


def read_json(path, what, instead=""):
    """What a JSON file holds; InputError, which starts with what, where that cannot be read, with
    what to do instead at the end."""
    try:
        return json.loads(Path(path).read_text(encoding="utf-8-sig"), object_pairs_hook=_once)
    except OSError as e:
        raise InputError(f"{what}: cannot read {path}: {e.strerror}.") from e
    except (ValueError, RecursionError) as e:
        raise InputError(f"{what}: {path} is not a JSON file ({e}){instead}.") from e


def _once(pairs):
    """The dict of an object's pairs; of a key that is there twice JSON would take the last."""
    found = dict(pairs)
    if len(found) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"{twice!r} is there twice")
    return found
