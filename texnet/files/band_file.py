"""Bands on disk, as JSON: {"wavelength_um": [centres], "fwhm_um": [widths]}, both in um, and, if
they are not boxes, "response": "gaussian"."""

import json

import numpy as np

from physics.bands import BOX
from physics.cube.heat_cube import check_response, numbers
from physics.errors import InputError
from physics.machinery.json_file import read_json
from physics.machinery.whole_file import whole_file


def read_bands(path):
    """Centres and widths, each (bands,) um, and their response. InputError says what is wrong with
    the file."""
    wanted = "must be JSON with lists wavelength_um and fwhm_um, in um"
    data = read_json(path, "bands", f"; it {wanted}")
    try:
        columns = [numbers(data[key], key) for key in ("wavelength_um", "fwhm_um")]
        response = data.get("response", BOX)
    except (KeyError, TypeError, AttributeError, InputError) as e:
        raise InputError(f"bands: {path} {wanted}.") from e
    if unknown := data.keys() - {"wavelength_um", "fwhm_um", "response"}:
        raise InputError(f"bands: {path} has an unknown key {min(unknown)!r}.")
    if not all(column.ndim == 1 and np.isfinite(column).all() for column in columns):
        raise InputError(f"bands: {path} {wanted}.")
    if columns[0].shape != columns[1].shape:
        raise InputError(f"bands: {path} must hold one width, fwhm_um, for each wavelength_um.")
    check_response(response, f"bands: {path}")
    return *(column.astype(np.float64) for column in columns), response


def write_bands(path, wavelength_um, fwhm_um):
    """Write centres and widths (bands,) of boxes, um, to 1e-4 um, whole or not at all."""
    columns = {"wavelength_um": wavelength_um, "fwhm_um": fwhm_um}
    data = {name: [round(float(w), 4) for w in column] for name, column in columns.items()}
    with whole_file(path) as part:
        part.write_text(json.dumps(data) + "\n", encoding="utf-8")
