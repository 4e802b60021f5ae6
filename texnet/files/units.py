"""Units of spectral radiance in all spellings.

A unit is a product of powers: W m-2 sr-1 um-1, uW/(cm^2*sr*nm) and W/m^2/sr/cm^-1 are read factor
by factor, in any order: exactly watts, an area, a steradian, and um, nm or cm-1. The result is the
unit of the same size in UNITS.
"""

import math
import re

UNITS = {  # its size in W m-2 sr-1, and whether it is per cm-1
    "W/m2/sr/um": (1.0, False),
    "mW/m2/sr/um": (1e-3, False),
    "microflick": (1e-2, False),
    "uW/cm2/sr/um": (1e-2, False),
    "W/cm2/sr/um": (1e4, False),
    "mW/cm2/sr/um": (10.0, False),
    "uW/cm2/sr/nm": (10.0, False),  # common with ENVI and FLAASH
    "nW/cm2/sr/nm": (1e-2, False),
    "mW/m2/sr/nm": (1.0, False),
    "W/m2/sr/nm": (1e3, False),
    "W/m2/sr/cm-1": (1.0, True),
    "mW/m2/sr/cm-1": (1e-3, True),
    "W/cm2/sr/cm-1": (1e4, True),
}
KELVIN = "K"  # brightness temperature
UNIT_NAMES = *UNITS, KELVIN
PREFIXES = {"": 1.0, "n": 1e-9, "u": 1e-6, "m": 1e-3}
PER_M2 = {"m": 1.0, "cm": 1e4}
# of a factor: size, whether per cm-1. Not per cm, which is probably a miswritten cm-1
DENSITIES = {("um", -1): (1.0, False), ("nm", -1): (1e3, False), ("cm", 1): (1.0, True)}
WRITTEN = str.maketrans("\u00b5\u03bc\u207b\u00b9\u00b2\u00b7\u22c5", "uu-12**")  # two kinds of mu
WORDS = {
    r"micro-?(m(et(er|re)s?)?|ns?)\b": "um", r"nanomet(er|re)s?": "nm", r"steradians?": "sr",
    r"watts?": "w", r"kelvins?": "k", r"\*\*": "^", r"micro-?(?=flick)": "u", r"flicks\b": "flick",
}  # fmt: skip
PART = re.compile(r"(/?)\s*(?:\(([^()]*)\)\s*(\^?-1\b)?|([^/()]+))")
FACTOR = re.compile(r"([a-z]+)\^?([+-]?\d+)?")


def unit_of(said):
    """The one of UNIT_NAMES that a text such as uW/(cm^2*sr*nm) means; None if none."""
    plain = said.lower().strip("{} ").translate(WRITTEN)
    plain = re.sub(r"\^\(([+-]?\d)\)", r"\1", plain)
    plain = re.sub(r"^\(([^()]*)\)$", r"\1", plain)
    for word, short in WORDS.items():
        plain = re.sub(word, short, plain)
    if plain == "k":
        return KELVIN
    found, letters = _product(plain), lambda text: set(re.findall("[a-z]+", text.lower()))
    same = [u for u, (size, per_cm1) in UNITS.items() if found == (_rounded(size), per_cm1)]
    # of several names of the same unit the most similar
    return max(same, key=lambda u: letters(u) == letters(plain), default=None)


def _product(plain):
    """Size in W m-2 sr-1 per um or cm-1, and whether it is per cm-1, of a product of powers; None
    if these are not watts per area, steradian and um, nm or cm-1."""
    factors = sorted((n, -p if below else p) for below, part in _parts(plain) for n, p in part)
    if len(factors) == 1 and factors[0][0].endswith("flick") and factors[0][1] == 1:
        return _rounded(1e4 * PREFIXES.get(factors[0][0][: -len("flick")], math.nan)), False
    watts = [f for f in factors if f[0].endswith("w") and f[0][:-1] in PREFIXES and f[1] == 1]
    area = [f for f in factors if f[0] in PER_M2 and f[1] == -2]
    density = [f for f in factors if f in DENSITIES]
    if not (len(watts) == len(area) == len(density) == factors.count(("sr", -1)) == 1):
        return None
    if len(factors) != 4:
        return None
    size, per_cm1 = DENSITIES[density[0]]
    return _rounded(size * PREFIXES[watts[0][0][:-1]] * PER_M2[area[0][0]]), per_cm1


def _parts(plain):
    """(below, [(name, power), ...]) of a quotient: a slash applies to one factor, or to all in
    parentheses; unreadable text is a factor without a name."""
    for slash, inside, inverse, alone in PART.findall(plain):
        text = inside or alone
        factors = [(n, int(p or 1)) for n, p in FACTOR.findall(text)]
        if re.sub(r"[\s*.^]", "", FACTOR.sub("", text)) or not factors:
            factors = [("", 1)]
        if slash and not inside:
            yield True, factors[:1]
            yield False, factors[1:]
        else:
            yield bool(slash) != bool(inverse), factors


def _rounded(size):
    return float(f"{size:.6g}")
