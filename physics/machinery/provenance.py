"""What made a result kept on disk, so that it is never taken for the result of something else."""

import hashlib
import json
from pathlib import Path

import numpy as np


def provenance(settings, sources):
    """16 hexadecimal digits of settings (plain values) and of sources: files, and folders whose
    .py files count, their subfolders' too."""
    digest = hashlib.sha256(json.dumps(settings).encode())
    for source in map(Path, sources):
        files = sorted(source.rglob("*.py")) if source.is_dir() else [source]
        for file in files:
            text = file.read_bytes()
            name = file.relative_to(source.parent).as_posix()
            digest.update(f"\n{name} {len(text)}\n".encode() + text)
    return digest.hexdigest()[:16]


def fingerprint(*arrays):
    """What tells arrays of numbers apart, shapes and types included, as a string."""
    digest = hashlib.sha256()
    for a in map(np.ascontiguousarray, arrays):
        digest.update(f"{a.shape} {a.dtype.str} ".encode())
        digest.update(a)
    return digest.hexdigest()
