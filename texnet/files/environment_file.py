"""A measured environment on disk: a text table, one column an object, W m-2 sr-1 um-1.

    wavelength_um,sky,ground
    7.995,5.71,8.13
    8.005,5.42,8.14

`text_table` defines the tables it reads. Columns named sky..., downwelling..., ldown... or dwr...
are sky.

If there is one row for each band between the first and the last band, the rows are from this
camera, or already averaged, and are used as they are. Any other spectrum is interpolated linearly,
and averaged over each band as the camera would: by exact means over the parts of the band that the
nodes of `bands.quadrature` stand for, as these nodes are too far apart for the lines of a sky.
"""

import numpy as np

from physics.bands import means_of_samples
from physics.cube.heat_cube import check_wavelength
from physics.environment import Environment
from physics.errors import InputError

from .text_table import MAX_GAP_UM, read_table

SKIES = ("sky", "downwelling", "ldown", "dwr")
SAME_UM = 0.01  # largest difference at which a row is at a band
ROUNDED_UM = 1e-3  # smaller gaps are ignored


def read_environment(path, cube):
    """The Environment in the text table at path, at the bands of a HeatCube, and the names of its
    objects, in the file's order.

    Raises InputError if it is not such a table, does not cover the bands or is not radiance.
    """
    names, w, spectra, _ = read_table(path, "environment", "object")
    if twice := [name for i, name in enumerate(names) if name in names[:i]]:
        raise InputError(f"environment: {path} has two columns {twice[0]!r}; rename one.")
    w, bands = check_wavelength(w, "environment"), cube.wavelength_um
    # for a single band, all rows within it
    beside = SAME_UM if cube.bands > 1 else max(SAME_UM, cube.fwhm_um[0] / 2)
    between = (w > bands[0] - beside) & (w < bands[-1] + beside)
    if between.sum() == cube.bands and np.allclose(w[between], bands, 0, SAME_UM):
        radiance, within = spectra[:, between], None
    else:
        _check_covers(w, cube, path)
        nodes, parts = cube.nodes_um, _parts(cube)
        within = means_of_samples(w, spectra, nodes.ravel(), parts.ravel())
        within = within.reshape(-1, *nodes.shape)
        radiance = within.mean(axis=-1)
    for i, b in np.argwhere(radiance <= 0)[:1]:
        raise InputError(
            f"environment: {names[i]} of {path} is {radiance[i, b]:.3g} at {bands[b]:.4g} um, but "
            "radiance must be above 0."
        )
    sky = tuple(i for i, name in enumerate(names) if name.lower().startswith(SKIES))
    if within is not None:
        within = within[list(sky)]
        within = within if sky and (within > 0).all() else None
    return Environment(radiance, bands, sky, within=within), names


def _parts(cube):
    """(bands, n) um, widths of the parts of a HeatCube's bands for which its nodes stand."""
    nodes = cube.nodes_um
    return np.gradient(nodes, axis=1) if nodes.shape[1] > 1 else cube.fwhm_um[:, None]


def _check_covers(w, cube, path):
    """Raise InputError if wavelengths w (n,), um, each with half a step to either side, do not
    cover a HeatCube's bands, or leave a gap wider than MAX_GAP_UM in them."""
    nodes, half = cube.nodes_um, _parts(cube) / 2
    low, high = (nodes - half).min(), (nodes + half).max()
    step = np.diff(w) if w.size > 1 else np.zeros(1)
    first, last = w[0] - step[0] / 2, w[-1] + step[-1] / 2
    wide = np.flatnonzero((np.diff(w) > MAX_GAP_UM) & (w[:-1] < high) & (w[1:] > low))
    gaps = [(low, min(first, high)), *((w[i], w[i + 1]) for i in wide), (max(last, low), high)]
    for start, end in gaps:
        if end - start > ROUNDED_UM:
            raise InputError(
                f"environment: {path} lacks {start:.4g}-{end:.4g} um; the bands need "
                f"{low:.4g}-{high:.4g} um, with rows at most {MAX_GAP_UM:g} um apart."
            )
