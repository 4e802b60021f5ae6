"""Wavelengths as files state them, in um and in ascending order."""

import numpy as np

from physics.errors import InputError

PER_UM = {"um": 1.0, "nm": 1e3}  # in one um; wavenumbers have no such factor
WAVENUMBERS_CM1 = (100.0, 10_000.0)  # 100 to 1 um; other numbers are not wavenumbers in cm-1


def in_um(x, unit):
    """Wavelengths in um from x in um, nm or cm-1."""
    return 1e4 / x if unit == "cm-1" else x / PER_UM[unit]


def ascending(x, unit, what):
    """The order (n,) in which x (n,), in um, nm or cm-1, ascends as wavelengths; these in um in
    that order; and words on the conversion.

    Raises InputError, which starts with what, if a value occurs twice or cannot be in cm-1.
    """
    low, high = WAVENUMBERS_CM1
    if unit == "cm-1" and (x.min() < low or x.max() > high):
        raise InputError(
            f"{what}: wavenumbers {x.min():g}-{x.max():g} are outside {low:g}-{high:g} cm-1; "
            "give them in cm-1 (10 um is 1000 cm-1)."
        )
    w = in_um(x, unit)
    order = np.argsort(w)
    step, w = np.diff(order), w[order]
    twice = w[1:] == w[:-1]
    if twice.any():
        raise InputError(
            f"{what}: the wavelength {w[1:][twice][0]:g} um is there twice; give each once."
        )
    moved = "" if (step == 1).all() else ", order reversed" if (step == -1).all() else ", sorted"
    return order, w, moved
