"""A cube as stored in someone's file, and its conversion to a HeatCube.

With n the file's numbers, per band

    L = (gain n + offset) u J,    J = 1 where L is per um, 1e4 / lambda^2 where it is per cm-1

where u converts the file's unit to W m-2 sr-1 and J = |d nu / d lambda| follows from
nu = 1e4 / lambda (cm-1, um); or L = B(gain n + offset) if n are brightness temperatures in K. A
width d nu becomes d nu / J. Bands that the file calls bad are dropped, the others sorted by
wavelength. A wrong unit shows in the scene's brightness temperature; and since in most pixels the
bands hardly differ in it, a wrong order of axes shows, too.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from physics.bands import BOX
from physics.cube.dead_pixels import lit
from physics.cube.heat_cube import TYPICAL_K, HeatCube, sampling_step
from physics.cube.unusual import USUAL_K, uneven_k
from physics.errors import InputError
from physics.machinery import scratch
from physics.planck import brightness_temperature, planck

from .units import KELVIN, UNITS
from .wavelengths import PER_UM, ascending, in_um

OUR_UNIT = "W/m2/sr/um"
THERMAL_UM = (1.0, 100.0)  # outside it the centres are in another unit
ALIKE = 0.03  # largest relative deviation from the median in half of brightness temperatures
# ratios of band width to spacing beyond which the unit of widths is wrong
THIN, WIDE = 0.05, 5.0
PART = 1 << 23  # numbers converted at once
SAMPLES = 10_000  # pixels whose brightness temperature is checked
CELSIUS = "add 273.15 if these are degrees Celsius, else give the --unit of the radiance"
# common fill values; the least number of bands that must agree on one, and of pixels that have it,
# as a number and as a share of all
FILLS, LEAST_ALIKE, FEWEST, FEW = (0, -999, -9999, -32767, -32768), 6, 20, 0.001
# a float larger than in any scene may have few digits in a header
UNREAL, AS_TEXT = 1e6, 1e-5


class RawCube(NamedTuple):
    """The content of a file; bands in the file's order.

    what     the file in a few words
    numbers  () -> (bands, height, width) real numbers; each call maps the file anew, so that what
             was read does not stay in memory
    centre   (bands,) in axis, or None if the file does not say; fwhm likewise
    response  of the bands, one of `bands.RESPONSES`
    axis     "um", "nm" or "cm-1", of centre and fwhm
    unit     one of `units.UNIT_NAMES`, or None if the file does not say
    gain, offset  (bands,) or one number for all
    good     (bands,) bool; None: all
    netd_k   noise at 300 K, K, or None if the file does not say
    wanted   (bands,) bool, by the caller; None: all
    ignore   the number that stands for no measurement, or None
    hint     advice if centre is missing
    unit_said  what the file calls its unit
    words    more to tell the user
    doubt    a warning on how the file was read, or ""
    """

    what: str
    numbers: Callable
    centre: np.ndarray | None = None
    fwhm: np.ndarray | None = None
    axis: str = "um"
    unit: str | None = None
    gain: np.ndarray | float = 1.0
    offset: np.ndarray | float = 0.0
    good: np.ndarray | None = None
    netd_k: float | None = None
    wanted: np.ndarray | None = None
    ignore: float | None = None
    hint: str = ""
    unit_said: str = ""
    words: tuple = ()
    doubt: str = ""
    response: str = BOX


def part_of(raw, rows=None, columns=None, range_um=None):
    """The RawCube of some rows, columns (slices) and bands (lowest and highest centre, um); None:
    all. It must have a centre. Raises InputError if nothing is left."""
    _, *shape = raw.numbers().shape
    words = []
    for what, part, n in (("rows", rows, shape[0]), ("columns", columns, shape[1])):
        if part is not None:
            at = range(n)[part]
            if not at:
                raise InputError(
                    f"cube: no {what} lie in {_said(part)}; it has 0:{n}, and FROM must be less "
                    "than TO."
                )
            every = f" in steps of {at.step}" * (at.step != 1)
            words.append(f"{what} {at[0]} to {at[-1]}{every} of 0 to {n - 1}")
    if rows is not None or columns is not None:
        of_file, cut = raw.numbers, (slice(None), rows or slice(None), columns or slice(None))
        raw = raw._replace(numbers=lambda: of_file()[cut])
    if range_um is not None:
        good = np.ones(len(raw.centre), bool) if raw.good is None else raw.good
        with np.errstate(divide="ignore"):  # a bad band's centre may be anything
            w = in_um(raw.centre, raw.axis)
        wanted = (w >= range_um[0]) & (w <= range_um[1])
        if good.any() and not (wanted & good).any():
            raise InputError(
                f"cube: no good band lies within {range_um[0]:g}-{range_um[1]:g} um; they lie at "
                f"{w[good].min():.4g}-{w[good].max():.4g} um."
            )
        n = int(np.count_nonzero(wanted))
        words.append(f"{n} band{'s' * (n > 1)} within {range_um[0]:g}-{range_um[1]:g} um")
        raw = raw._replace(wanted=wanted)
    return raw._replace(words=(*raw.words, *words))


def _said(part):
    return f"{part.start or 0}:{'' if part.stop is None else part.stop}"


def heat_cube(raw, netd_k=None, progress=None):
    """The HeatCube of a RawCube that has centre and unit, and one sentence on what was converted,
    followed by a line of warning if the scene's temperature is unusual.

    Raises InputError if the numbers cannot be radiance in that unit.
    """
    bands, height, width = shape = raw.numbers().shape
    if 0 in shape:
        raise InputError(f"cube: it holds no numbers ({bands} x {height} x {width}).")
    kept, w, said_of_bands = _kept_bands(raw, bands)
    fwhm = None
    if raw.fwhm is None:
        said_of_bands.append("taken as narrow, since band widths are not stated (--fwhm)")
    else:
        if raw.response != BOX:
            said_of_bands.append(f"with response {raw.response}")
        fwhm = raw.fwhm[kept] / (1e4 / w**2 if raw.axis == "cm-1" else PER_UM[raw.axis])
    radiance, empty = _radiance(raw, kept, w, progress)
    words = [
        raw.what,
        f"{bands} bands of {height} x {width} pixels",
        *raw.words,
        raw.unit + (" kept" if raw.unit == OUR_UNIT else " became W m-2 sr-1 um-1"),
        *said_of_bands,
        *empty,
    ]
    half, warning = _typical_k(radiance, w, raw.unit)
    warning += _odd_widths(fwhm, w) + (raw.doubt and f"\nWarning: {raw.doubt}")
    netd_k = raw.netd_k if netd_k is None else netd_k
    cube = HeatCube(radiance, w, fwhm, netd_k, response=raw.response)
    if dead := int(np.count_nonzero(cube.dead)):
        share = f" ({dead / cube.dead.size:.0%})" if dead > 0.01 * cube.dead.size else ""
        words.append(f"{dead} pixel{'s' * (dead > 1)}{share} without a measurement, marked unknown")
    return cube, "; ".join([*words, f"half of it is warmer than {half}"]) + "." + warning


def _odd_widths(fwhm, w):
    """A warning if bands are far narrower or wider than their spacing; else ""."""
    if fwhm is None or len(w) < 2:
        return ""
    width, apart = np.median(fwhm), np.median(np.diff(w))
    if not width or THIN * apart <= width <= WIDE * apart:
        return ""
    return (
        f"\nWarning: bands are {width:.2g} um wide and {apart:.2g} um apart; are their widths in "
        "the unit of the wavelengths?"
    )


def _kept_bands(raw, bands):
    """Indices of the good bands by wavelength, their wavelengths in um, and words on that."""
    wanted = np.ones(bands, bool) if raw.wanted is None else raw.wanted
    good = wanted if raw.good is None else wanted & raw.good
    if not good.any():
        raise InputError("cube: the file calls all of its bands bad; correct its list of them.")
    centre = raw.centre[good]
    if not np.isfinite(centre).all() or (centre <= 0).any():
        raise InputError(f"cube: band centres must be finite and positive, in {raw.axis}.")
    ends = f"{centre[0]:.6g}-{centre[-1]:.6g} {raw.axis}"
    w = in_um(centre, raw.axis)
    low, high = THERMAL_UM
    if w.min() < low or w.max() > high:
        raise InputError(
            f"cube: bands at {ends} are outside {low:g}-{high:g} um; they must be in another unit "
            "(10 um is 10000 nm or 1000 cm-1)."
        )
    order, w, moved = ascending(centre, raw.axis, "cube")
    alike = raw.axis == "um" and not moved
    words = [ends + ("" if alike else f" became {w[0]:.4g}-{w[-1]:.4g} um{moved}")]
    if bad := int(np.count_nonzero(wanted & ~good)):
        words.append(f"{bad} band{'s' * (bad > 1)} left out that the file calls bad")
    return np.flatnonzero(good)[order], w, words


def _in_our_unit(numbers, unit, w):
    """Radiance from numbers in one of `units.UNIT_NAMES` at wavelengths in um."""
    if unit == KELVIN:
        return planck(w, np.maximum(numbers, 1.0))  # no emission, as at 0 K
    factor, per_wavenumber = UNITS[unit]
    return numbers * (factor * (1e4 / w**2 if per_wavenumber else 1.0))


def _in_unit(radiance, unit, w):
    """The inverse of _in_our_unit, for radiance above 0."""
    if unit == KELVIN:
        return brightness_temperature(w, radiance)
    return radiance / _in_our_unit(1.0, unit, w)


def _radiance(raw, kept, w, progress):
    """Radiance (kept, height, width) float32 of the kept bands at wavelengths w, um; and words on
    fill values that no header states.

    Read part by part along the file's slowest axis, so that each byte is read once.
    """
    numbers = raw.numbers()
    shape, strides = numbers.shape, numbers.strides
    del numbers
    slowest = int(np.argmax(np.where(np.array(shape) > 1, strides, 0)))
    step = max(1, PART * shape[slowest] // int(np.prod(shape, dtype=np.int64)))
    gain, offset = (np.broadcast_to(x, shape[0])[kept] for x in (raw.gain, raw.offset))
    radiance = scratch.zeros((len(kept), *shape[1:]), np.float32)
    # with band offsets, the same number in all bands is a spectrum, but no camera's
    alike = len(kept) >= LEAST_ALIKE and raw.ignore is None and np.any(offset)
    filled = {number: np.ones(shape[1:], bool) for number in FILLS if alike}
    for start in range(0, radiance.shape[slowest], step):
        at = [slice(None)] * 3
        at[slowest] = slice(start, start + step)
        bands = at[0]
        mapped = raw.numbers()
        found = mapped[kept[bands], at[1], at[2]]
        scratch.release(mapped)
        for number, pixels in filled.items():
            pixels[tuple(at[1:])] &= (found == number).all(axis=0)
        with np.errstate(over="ignore", invalid="ignore"):  # HeatCube reports what is not finite
            part = found.astype(np.float64)
            part *= gain[bands, None, None]
            part += offset[bands, None, None]
            part[is_ignored(found, raw.ignore)] = np.nan
            radiance[tuple(at)] = _in_our_unit(part, raw.unit, w[bands, None, None])
        scratch.release(radiance)
        if progress is not None:
            progress(min(start + step, radiance.shape[slowest]), radiance.shape[slowest], "import")
    words = []
    for number, pixels in filled.items():
        if np.count_nonzero(pixels) >= max(FEWEST, FEW * pixels.size):
            for band in radiance:
                band[pixels] = np.nan
                scratch.release(radiance)
            words.append(f"{number} in every band treated as no measurement")
    radiance.setflags(write=False)
    return radiance, words


def is_ignored(numbers, ignore):
    """Which numbers equal the one that stands for no measurement; none if that is None."""
    if ignore is None:
        return np.zeros(numbers.shape, bool)
    if numbers.dtype.kind != "f":
        return numbers == ignore
    with np.errstate(over="ignore"):
        if abs(ignore) < UNREAL:
            return numbers == numbers.dtype.type(ignore)
        return np.abs(numbers / ignore - 1) <= AS_TEXT


def _typical_k(radiance, w, unit):
    """The brightness temperature that half of the scene exceeds, in words, and a warning or "".

    Raises InputError if it is outside TYPICAL_K, or outside USUAL_K and the numbers are like
    brightness temperatures.
    """
    step = sampling_step(radiance.shape[1:], SAMPLES)
    bands = scratch.parts(radiance)
    s = np.stack([band.reshape(-1)[::step].astype(np.float64) for band in bands])
    uneven, dark = _uneven(s, w), bool((s == 0).any())
    band, pixel = np.nonzero(lit(s))
    s, w = s[band, pixel], w[band]
    if not s.size:
        if unit == KELVIN and dark:
            raise InputError(f"cube: in K nothing of it would be warm enough to glow; {CELSIUS}.")
        return "nothing", ""  # HeatCube says what is wrong
    numbers = _in_unit(s, unit, w)

    def typical_k(other):
        return float(np.median(brightness_temperature(w, _in_our_unit(numbers, other, w))))

    here = typical_k(unit)
    kelvin = unit != KELVIN and _like_kelvin(numbers)
    if USUAL_K[0] <= here <= USUAL_K[1]:
        return f"{here:.0f} K", (kelvin and f"\nWarning: {kelvin}") or uneven
    if kelvin:
        raise InputError(f"cube: in {unit} half of it would be warmer than {here:,.0f} K; {kelvin}")
    names = {}
    for u, factor in UNITS.items():
        names.setdefault(factor, u)  # the first of two names of a unit
    fit = {u: t for u in names.values() if USUAL_K[0] <= (t := typical_k(u)) <= USUAL_K[1]}
    fit = " or ".join(f"{t:.0f} K in {u}" for u, t in fit.items()) or "no known unit fits"
    cold = unit == KELVIN and here < TYPICAL_K[0]
    fit = f"{CELSIUS if cold else 'give the right --unit'} ({fit})."
    if TYPICAL_K[0] <= here <= TYPICAL_K[1]:
        doubt = f"{here:.0f} K is unusual for a scene; if {unit} is not its unit, {fit}"
        return f"{here:.0f} K", f"\nWarning: {doubt}{uneven}"
    raise InputError(f"cube: in {unit} half of it would be warmer than {here:,.0f} K; {fit}")


def _uneven(s, w):
    """A warning if spectra s (bands, n) are unlike those of any scene; else ""."""
    differ = uneven_k(w, s)
    if not differ:
        return ""
    return (
        f"\nWarning: even in the pixels where they differ least, bands differ by {differ:.0f} K in "
        "brightness temperature, as in pictures of only metal or sky; check the order of axes and "
        "bands (for .npy: bands first), interleave, byte order and unit."
    )


def _like_kelvin(numbers):
    """Words on a file's numbers if they are like brightness temperatures; else ""."""
    half = np.median(numbers)
    if not USUAL_K[0] <= half <= USUAL_K[1] or np.median(np.abs(numbers / half - 1)) > ALIKE:
        return ""
    return (
        f"are its numbers, of about {half:.0f} and similar in all bands, brightness temperatures "
        "in K? Then give --unit K."
    )
