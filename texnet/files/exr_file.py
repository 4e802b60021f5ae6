"""Writing OpenEXR files: any failure is an OSError, or known beforehand."""

import os

from physics.errors import InputError


def check_exr_name(path):
    """Raise InputError if OpenEXR could not open a path."""
    try:
        os.fspath(path).encode()
    except UnicodeEncodeError as e:
        raise InputError(f"OpenEXR takes only UTF-8 names; rename {os.fspath(path)!a}.") from e


def write_exr(header, channels, path):
    """Write channels, {name: (height, width) contiguous array}, and further header entries. Raises
    OSError, as for a full disk, in OpenEXR's words; InputError as check_exr_name."""
    import OpenEXR

    check_exr_name(path)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage} | header
    try:
        with OpenEXR.File(header, channels) as file:
            file.write(str(path))
    except RuntimeError as e:
        raise OSError(str(e).rpartition('". ')[2]) from e
