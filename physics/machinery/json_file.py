"""JSON files that people write."""

import json
from pathlib import Path

from ..errors import InputError


def read_json(path, what, instead=""):
    """What a JSON file holds; InputError, which starts with what, where that cannot be read, with
    what to do instead at the end."""
    try:
        return json.loads(Path(path).read_text(encoding="utf-8-sig"))
    except OSError as e:
        raise InputError(f"{what}: cannot read {path}: {e.strerror}.") from e
    except (ValueError, RecursionError) as e:
        raise InputError(f"{what}: {path} is not a JSON file ({e}){instead}.") from e
