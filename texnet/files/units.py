"""Units of spectral radiance, however they are written.

A unit is a product of powers: W m-2 sr-1 um-1, uW/(cm^2*sr*nm) and W/m^2/sr/cm^-1 are read factor
by factor, in any order, and mean the unit of UNITS of the same size and dimension: W m-2 sr-1 per
length is radiance per um, W m-2 sr-1 times length is radiance per cm-1.
"""

import math
import re

UNITS = {  # W m-2 sr-1 in one of it, and whether it is per cm-1
    "W/m2/sr/um": (1.0, False),
    "mW/m2/sr/um": (1e-3, False),
    "microflick": (1e-2, False),
    "uW/cm2/sr/um": (1e-2, False),
    "W/cm2/sr/um": (1e4, False),
    "mW/cm2/sr/um": (10.0, False),
    "uW/cm2/sr/nm": (10.0, False),  # usual of ENVI and FLAASH
    "nW/cm2/sr/nm": (1e-2, False),
    "mW/m2/sr/nm": (1.0, False),
    "W/m2/sr/cm-1": (1.0, True),
    "mW/m2/sr/cm-1": (1e-3, True),
    "W/cm2/sr/cm-1": (1e4, True),
}
KELVIN = "K"  # brightness temperature
UNIT_NAMES = *UNITS, KELVIN
PREFIXES = {"": 1.0, "n": 1e-9, "u": 1e-6, "m": 1e-3}
LENGTHS = {"m": 1.0, "cm": 1e-2, "um": 1e-6, "nm": 1e-9}  # in m
WRITTEN = str.maketrans("\u00b5\u03bc\u207b\u00b9\u00b2\u00b7\u22c5", "uu-12**")  # two kinds of mu
WORDS = {
    r"micro-?(m(et(er|re)s?)?|ns?)\b": "um", r"nanomet(er|re)s?": "nm", r"steradians?": "sr",
    r"watts?": "w", r"kelvins?": "k", r"\*\*": "^", r"micro-?(?=flick)": "u", r"flicks\b": "flick",
}  # fmt: skip
PART = re.compile(r"(/?)\s*(?:\(([^()]*)\)\s*(\^?-1\b)?|([^/()]+))")
FACTOR = re.compile(r"([a-z]+)\^?([+-]?\d+)?")


def unit_of(said):
    """Which of UNIT_NAMES a word means, such as uW/(cm^2*sr*nm); None if none."""
    plain = said.lower().strip("{} ").translate(WRITTEN)
    for word, short in WORDS.items():
        plain = re.sub(word, short, plain)
    if plain == "k":
        return KELVIN
    found, letters = _product(plain), lambda text: set(re.findall("[a-z]+", text.lower()))
    same = [u for u, (size, per_cm1) in UNITS.items() if found == (_rounded(size), per_cm1)]
    # of names of the same unit the one that is most like it
    return max(same, key=lambda u: letters(u) == letters(plain), default=None)


def _product(plain):
    """Size in W m-2 sr-1 per um or cm-1, and whether it is per cm-1, of what is a product of powers
    of watts, steradians and lengths; None if it is no radiance."""
    size, powers = 1.0, {"w": 0, "sr": 0, "m": 0}
    for below, part in _parts(plain):
        for name, power in part:
            power = -power if below else power
            if name.endswith("flick"):  # W cm-2 sr-1 um-1
                factors = (("w", 1, 1.0), ("sr", -1, 1.0), ("m", -2, 1e-2), ("m", -1, 1e-6))
                size *= PREFIXES.get(name[: -len("flick")], math.nan) ** power
            elif name in LENGTHS:
                factors = (("m", 1, LENGTHS[name]),)
            elif name == "sr":
                factors = (("sr", 1, 1.0),)
            elif name.endswith("w") and name[:-1] in PREFIXES:
                factors = (("w", 1, PREFIXES[name[:-1]]),)
            else:
                return None
            for dimension, times, in_si in factors:
                powers[dimension] += times * power
                size *= in_si ** (times * power)
    if (powers["w"], powers["sr"]) != (1, -1) or powers["m"] not in (-3, -1):
        return None
    per_cm1 = powers["m"] == -1
    return _rounded(size * (1e2 if per_cm1 else 1e-6)), per_cm1


def _parts(plain):
    """(below, [(name, power), ...]) of a quotient: of what follows a slash one factor is below, or
    all that is in parentheses; or nothing that could be read, as a factor without a name."""
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
