"""The folder that `texnet decompose` writes, checked before the work is done."""

import os
from pathlib import Path

from physics.errors import InputError
from physics.machinery.whole_file import check_writable

from .exr_file import check_exr_name

FILES = ("decomposition.npz", "tex_vision.png", "maps.png", "comparison.png", "maps.exr")


def check_directory(directory, *inputs, names=FILES):
    """Raise InputError, before the work, if no folder could be created or written there.

    inputs  paths that are read, or None: the files must not overwrite any of them
    names   of the files
    """
    directory = Path(directory)
    check_exr_name(os.path.abspath(directory))
    if os.path.lexists(directory) and not directory.is_dir():
        raise InputError(f"cannot write into {directory}: it is a file or a dead link, no folder.")
    if directory.is_dir():
        if not os.access(directory, os.W_OK):
            raise InputError(f"cannot write into {directory}; check its permissions.")
        for name in names:
            check_writable(directory / name, *inputs)
    else:
        check_writable(directory)
