"""What is said of an answer: the lines that `texnet decompose` prints, and the numbers in them."""

import math

import numpy as np

from physics.cube.heat_cube import LEAST_NETD_K, HeatCube
from physics.cube.unusual import USUAL_K, uneven_k
from physics.errors import InputError
from physics.library import SKY
from physics.prior import SampledSpectra

from .decomposition import Decomposition, check_decomposition
from .metrics import non_sky

MANY_BANDS = 10  # fewer tell materials badly apart
# of so many bands or more, what share of the pixels gets a wrong material, unknown or not: in the
# 24 and 12 test scenes of docs/accuracy.md, and in the four of docs/atlas.md
WRONG = {
    2: "more than half",
    3: "a third to two fifths",
    4: "a sixth to a third",
    6: "a tenth to a quarter",
}
SUSPICIOUS_K, SUSPICIOUS = 1.0, 10.0  # of noise, also times what is stated


def summary(decomposition: Decomposition, cube: HeatCube) -> str:
    """What `texnet decompose` prints of an answer, a line each: noise, what was corrected and left
    out, what was found, and what looks suspicious.

    Raises InputError where the Decomposition is not of this cube, by its size or bands.
    """
    check_decomposition(decomposition)
    bands = np.isin(decomposition.wavelength_um, cube.wavelength_um)
    if decomposition.material.shape != cube.shape or not bands.all():
        raise InputError("summary: the decomposition is not of this cube, by size or bands.")
    return "\n".join(lines(numbers_of(decomposition, cube)))


def lines(r):
    """What to say of numbers_of an answer."""
    shares = list(r["materials"].items())
    shown = [(name, share) for name, share in shares if share >= 0.005][:6] or shares[:1]
    return [
        f"Cube         {r['size'][0]} x {r['size'][1]} pixels, "
        f"{r['bands']} band{'s' * (r['bands'] > 1)}"
        f"{' (taken as narrow: no widths are stated)' * r['bands_narrow']}, {_netd(r)}",
        *_corrections(r),
        *_of_objects(r["k"], r["k_chosen"], r["environment"], r["bands"]),
        *_of_sky(r),
        *_of_temperature(r),
        "Materials    " + ", ".join(f"{name} {100 * s:.0f} %" for name, s in shown),
        f"Not sure     {100 * r['unknown']:.1f} % of the {'measured ' if r['dead'] else ''}pixels "
        "are marked unknown" + (": do not use the materials" if r["unknown"] > 0.5 else ""),
        *_of_pixels(r["saturated"], r["dead"], r["hot"]),
        f"Time         {sum(r['seconds'].values()):.1f} s",
    ]


def numbers_of(d, cube, objects=()):
    """What --json gives of a Decomposition of a HeatCube; all but `dead` of what was measured.

    objects  names of those of an environment that was given, where they have names
    """
    if cube.bands > len(d.wavelength_um):
        cube = cube.only(np.isin(cube.wavelength_um, d.wavelength_um))
    seen = ~d.dead
    ground = non_sky(d) & seen
    span, sigma_k = [math.nan] * 3, math.nan
    if ground.any():
        span = np.percentile(d.temperature_k[ground], [2, 50, 98])
        sigma_k = np.median(d.temperature_sigma_k[ground])
    share = np.bincount(d.material[seen], minlength=len(d.material_names)) / np.count_nonzero(seen)
    materials = {d.material_names[i]: share[i] for i in np.argsort(-share) if share[i] > 0}
    looks, k = SampledSpectra.of(cube), d.made_by.get("k")
    # no object stands for it where there is one alone
    sky_in_view = bool(d.sky) and not d.sky_assumed or len(d.environment) == 1 and SKY in materials
    chosen, environment = k == "auto" or k is None and not sky_in_view, None
    if d.made_by.get("environment"):
        chosen, sky_in_view = False, None  # not what it was taken from
        environment = {"objects": objects, "error_k": d.environment_error_k}
    return {
        "method": d.made_by.get("method"), "k": len(d.environment), "k_chosen": chosen,
        "environment": environment,
        "bands": cube.bands, "bands_narrow": not cube.fwhm_um.any(), "size": cube.shape,
        "brightness_k": np.median(looks.brightness_k),
        "uneven_k": uneven_k(cube.wavelength_um, looks.spectra.T),
        "netd_stated_k": cube.netd_k, "camera_netd_k": d.camera_netd_k, "netd_k": d.netd_k,
        "noise_raised": d.noise_raised,
        "left_out": [{"wavelength_um": w, "why": why} for w, why in d.left_out.items()],
        "spectral_shift_um": d.spectral_shift_um, "gain": d.gain,
        "band_gains": d.band_gains, "offset_k": d.offset_k, "air_m": d.air_m, "air_k": d.air_k,
        "air_error": d.air_error, "air_error_k": d.air_error_k, "curve_error": d.curve_error,
        "calibration_error_k": d.calibration_error_k, "suspected_error_k": d.suspected_error_k,
        "temperature_k": dict(zip(("p2", "median", "p98"), span, strict=True)),
        "temperature_sigma_k": sigma_k,
        "materials": materials, "sky_in_library": SKY in d.material_names,
        "sky_in_view": sky_in_view, "sky_assumed": d.sky_assumed, "sky_objects": len(d.sky),
        "unknown": d.unknown[seen].mean(), "saturated": d.saturated[seen].mean(),
        "dead": d.dead.mean(), "hot": d.hot[seen].mean(),
        "residual": np.median(d.residual[seen]), "seconds": d.seconds,
    }  # fmt: skip


def _of_pixels(saturated, dead, hot):
    if saturated:
        yield f"Saturated    {_percent(saturated)} of the pixels: unknown, T is a lower bound"
    if dead:
        yield f"Dead         {_percent(dead)} of the pixels were not measured: unknown"
    if hot:
        yield f"Hot          {_percent(hot)} of the pixels, far hotter than the rest: solved apart"


def _percent(share):
    return f"{100 * share:.2g} %" if share < 0.1 else f"{100 * share:.1f} %"


def _netd(r):
    said, own = r["netd_stated_k"], r["camera_netd_k"]
    source = "estimated" if said is None else "as stated"
    if said and not math.isclose(own, said, rel_tol=1e-3):
        source = f"estimated, {1e3 * said:.0f} mK stated"
    netd = f"NETD {1e3 * own:.0f} mK ({source})"
    if r["noise_raised"] <= 1:
        return netd
    taken = own * r["noise_raised"]
    if round(1e3 * taken) == round(1e3 * own):
        return netd
    maybe = "library, calibration, environment?" if r["environment"] else "library, calibration?"
    why = f"with less noise no material fits ({maybe})"
    if taken < 1.001 * LEAST_NETD_K:
        why = "the model of the surroundings is no more accurate"
    return f"{netd}, taken for {1e3 * taken:.0f} mK: {why}"


def _of_objects(k, chosen, given, bands):
    if given:
        named, found = given["objects"], k - len(given["objects"])
        names = ": " + ", ".join(named) + (f", and {found} found" if found else "") if named else ""
        yield f"Objects      k = {k}, as given{names}"
        if given["error_k"]:
            yield (
                f"Environment  likely about {given['error_k']:.0f} K off, or lacking objects, "
                "judging by the fit: T and its sigma take that into account"
            )
        return
    yield f"Objects      k = {k}{', chosen' if chosen else ''}"
    if 1 < bands < MANY_BANDS:
        wrong = WRONG[max(n for n in WRONG if n <= bands)]
        apart = ""
        if k >= bands:
            apart = f"; nor can they tell {k} objects apart: V relies on the prior"
        yield (
            f"Few bands    with {bands} bands, {wrong} of the pixels got a wrong material in "
            f"simulated scenes, and up to two thirds of these were not marked unknown{apart}"
        )


def _corrections(r):
    """What the cube was corrected by, or should have been before it came here."""
    taken, stated = r["camera_netd_k"] * r["noise_raised"], r["netd_stated_k"]
    if taken > SUSPICIOUS_K and taken > SUSPICIOUS * (stated or 0):
        yield "Suspicious   so much noise: check unit, interleave, byte order and library"
    half = r["brightness_k"]
    if not USUAL_K[0] <= half <= USUAL_K[1]:
        looks = "colder" if half < USUAL_K[0] else "warmer"
        yield f"Suspicious   half of the cube looks {looks} than {half:.0f} K: check the unit"
    if r["uneven_k"]:
        yield (
            f"Uneven       bands differ by {r['uneven_k']:.0f} K in brightness temperature even "
            "where they differ least, as in pictures of only metal or sky: check unit, interleave, "
            "byte order"
        )
    for band in r["left_out"]:
        yield f"Left out     {band['wavelength_um']:.4g} um: {band['why']}"
    if shift := r["spectral_shift_um"]:
        yield (
            f"Wavelengths  {abs(shift):.3g} um {'less' if shift > 0 else 'more'} than stated, "
            "judging by the sky's ozone and the fit"
        )
    without = "judging by the fit: all results are corrected for it"
    if off := r["gain"] - 1 or r["offset_k"]:
        much = f"{abs(off):.1%}" if r["gain"] != 1 else f"{abs(off):.1f} K at 300 K"
        yield f"Calibration  radiance {much} too {'high' if off > 0 else 'low'}, {without}"
    if off := np.std(r["band_gains"]):
        yield f"Bands        gains differ among bands by {off:.2%}, {without}"
    if error := r["curve_error"]:
        unless = ", unless the environment is off," if r["environment"] else ","
        yield (
            f"Library      likely off by {error:.2g} in emissivity or more{unless} judging by the "
            "fit: T, its sigma and the materials allow for that"
        )
    if error := r["calibration_error_k"]:
        yield f"Calibration  uncertain by {error:g} K at 300 K, as stated: sigma includes that"
    if error := r["suspected_error_k"]:
        yield (
            f"Suspected    a gain, an offset or air in front of the camera, too uncertain to "
            f"correct: T may be off by {error:.2g} K, which sigma includes"
        )
    if metres := r["air_m"]:
        yield (
            f"Air          {metres:.0f} m of {r['air_k']:.0f} K in front of the camera, "
            "judging by the fit, and in front of each pixel as much as distance_m says: all "
            "results are corrected for it; absorption in any band may differ by "
            f"{r['air_error']:.0%} from that of usual air, so that T may be off by "
            f"{r['air_error_k']:.2g} K, which sigma includes"
        )


def _of_temperature(r):
    t, without = r["temperature_k"], ", without sky" if r["sky_in_library"] else ""
    if not math.isnan(t["median"]):  # not all of it is sky
        yield (
            f"Temperature  median {t['median']:.1f} K, 2nd to 98th percentile {t['p2']:.1f} to "
            f"{t['p98']:.1f} K{without}"
        )
        sigma = f"{r['temperature_sigma_k']:.2g} K"
        yield f"             its sigma is {sigma} or less in half of the pixels"


def _of_sky(r):
    """Why texture is not what the sky lights, or which sky that is, unless it was found."""
    instead = "texture is what no material explains"
    if r["environment"]:
        if not r["sky_objects"]:
            yield (
                "Sky          no object's name begins with sky, downwelling, ldown or dwr: "
                f"{instead}"
            )
    elif not r["sky_in_library"]:
        yield (
            f"Sky          the library has none: sky pixels get other names, and {instead}; import "
            "it with --add-sky, or add a material named sky"
        )
    elif r["sky_assumed"]:
        yield (
            "Sky          none in view: a usual clear one is assumed, which makes the pixels "
            "likelier (for views from above that is right, once the air below is removed; "
            "otherwise check that the top of the picture shows clear sky)"
        )
    elif not r["sky_in_view"]:
        yield (
            f"Sky          none in view: {instead}. Outdoors that is wrong: check that the picture "
            "is not upside down, its unit is right, and it shows sky that low cloud does not cover"
        )
    elif not r["sky_objects"]:
        yield f"Sky          with k = 1 no object stands for it: {instead}"
