"""The spectrum of the sky, 7.5-14.5 um: layers of gas, which absorb as LOWTRAN 7 has it.

The atmosphere is 28 spherical layers, thin at the ground. Layer j is met on a path m_j times as
long as towards the zenith. From the ground to the top of layer i the transmittance is t_i, and
the downwelling radiance is

    L = sum_i B(T_i) (t_{i-1} - t_i),        t_i = exp(-tau_i).

An overcast sky ends at its cloud, which is black and as warm as the air at its base: of that at
transmittance t comes t B(T) instead of all that lies above.

tau_i adds up, over gases of column u_j in layer j, the band model of Pierluissi and Maragoudakis
(1986, AFGL-TR-86-0272), in which lines saturate over the whole path,

    (C(nu) sum_{j<=i} m_j u_j p_j^n (273.15 / T_j)^q)^a,        p in atm,

and the continuum of water vapour of Clough et al. (1980), proportional to m_j: that which vapour
broadens itself, linear in T between 260 and 296 K, and that which air broadens. C, every 5 cm-1,
and the continua are LOWTRAN 7's (Kneizys et al. 1988, AFGL-TR-88-0177), copied by
`benchmarks.lowtran7`: H2O, CO2, O3, N2O and CH4.

Profiles: 6.5 K/km up to 216.65 K, isothermal to 20 km, then +1 K/km (U.S. Standard
Atmosphere 1976); water with a 2 km scale height; well-mixed CO2, N2O and CH4; ozone after Green
(Lacis and Hansen 1974, J. Atmos. Sci. 31, 118: u(z) falls as a logistic at 20 km, 5 km wide).

Approximate, and on purpose: bands are means over 20 cm-1, no single lines; no trace gases but
those, no aerosol, no thin or broken cloud, no inversion at night; the ground at sea level;
refraction by one effective radius of Earth for all layers.
"""

import math
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import NamedTuple

import numpy as np

from .cube.heat_cube import check_wavelength
from .errors import InputError
from .planck import C2, planck

HC_K = C2 / 1e4  # h c / k_B, cm K
LOSCHMIDT = 2.6868e19  # molecules cm-3 at 1 atm and ICE_K
ICE_K = 273.15
AVOGADRO = 6.02214076e23
TROPOPAUSE_K = 216.65
LAPSE_K_KM = 6.5
WATER_SCALE_KM = 2.0
VAPOUR_J_G_K = 0.4615  # gas constant of water vapour
HUMIDITY = 0.5  # of usual air, over what it can hold
MOST_WATER_CM, HIGHEST_CLOUD_KM = 8.0, 20.0
TOP_KM = 50.0
LAYERS = 28
RADIUS_KM = 7 / 6 * 6371  # of an Earth above which rays that air bends would be straight
CH4_PPM, N2O_PPM = 1.9, 0.33  # of dry air, by volume
BEYOND_CM = 20.0  # the width of its bands: so far beyond its end a coefficient is that of the end


@dataclass(frozen=True)
class Atmosphere:
    """The atmosphere over the scene.

    air_temperature_k  near the ground, in K, 220-330
    water_cm           precipitable water, in cm (g cm-2), 0-8
    ozone_du           ozone column, in Dobson units, 0-1000
    co2_ppm            carbon dioxide, in parts per million by volume, 0-10000
    cloud_base_km      how high the cloud of an overcast sky is, in km, 0-20; infinity if clear

    Raises InputError outside these ranges.
    """

    air_temperature_k: float = 288.0
    water_cm: float = 1.4
    ozone_du: float = 320.0
    co2_ppm: float = 420.0
    cloud_base_km: float = math.inf

    def __post_init__(self):
        for name, unit, low, high in (
            ("air_temperature_k", "K", 220, 330),
            ("water_cm", "cm", 0, MOST_WATER_CM),
            ("ozone_du", "DU", 0, 1000),
            ("co2_ppm", "ppm", 0, 10000),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise InputError(f"atmosphere: {name} must be {low}-{high} {unit}, got {value}.")
        if not 0 <= self.cloud_base_km <= HIGHEST_CLOUD_KM and self.cloud_base_km != math.inf:
            raise InputError(
                f"atmosphere: cloud_base_km must be 0-{HIGHEST_CLOUD_KM:g} km, or infinity for "
                f"none, got {self.cloud_base_km}."
            )


def _checked(wavelength_um):
    """A validated axis (n,) in um, of wavelengths that the coefficients hold for."""
    w = check_wavelength(wavelength_um, "sky")
    first, last = _table()["wavenumber_cm"][[0, -1]]
    if w[0] < 1e4 / (last + BEYOND_CM) or w[-1] > 1e4 / (first - BEYOND_CM):
        raise InputError(
            f"sky: its model holds for {1e4 / last:.1f} to {1e4 / first:.1f} um, but bands reach "
            f"from {w[0]:.4g} to {w[-1]:.4g}; leave out those beyond (texnet import --range), or "
            "give the environment."
        )
    return w


def zenith_optical_depth(wavelength_um, atmosphere):
    """(n,) optical depth of the whole atmosphere towards the zenith, be there a cloud or not, at
    wavelengths in um."""
    w = _checked(wavelength_um)
    return _optical_depth(w, np.ones((1, LAYERS)), _profile(atmosphere))[0, -1]


def sky_radiance(wavelength_um, cos_zenith, atmosphere):
    """(directions, n) downwelling radiance of the sky, W m-2 sr-1 um-1.

    wavelength_um (n,) in um, ascending; cos_zenith (directions,) in -1..1, where
    everything at or below the horizon (<= 0) takes the horizon's value.
    """
    c = np.asarray(cos_zenith, dtype=np.float64)
    if c.ndim != 1 or not (np.abs(c) <= 1).all():
        raise InputError("sky: cos_zenith must be one list of numbers in -1..1.")
    w, profile = _checked(wavelength_um), _profile(atmosphere)
    depth, base_km = _optical_depth(w, slant(c, _edges_km()), profile), atmosphere.cloud_base_km
    overcast = base_km < math.inf
    if overcast:
        depth = _below(base_km, depth)
    transmittance = np.exp(-depth)
    above = np.concatenate([np.ones_like(transmittance[:, :1]), transmittance[:, :-1]], axis=1)
    glow = planck(w, profile.temperature_k[:, None])
    sky = np.einsum("dln,ln->dn", above - transmittance, glow)
    if overcast:
        sky += transmittance[:, -1] * planck(w, _temperature_k(base_km, atmosphere))
    return sky


def _below(base_km, depth):
    """Optical depth (directions, layers, n) without what lies above a base."""
    edge = _edges_km()
    share = np.clip((base_km - edge[:-1]) / np.diff(edge), 0, 1)
    return np.cumsum(np.diff(depth, axis=1, prepend=0.0) * share[:, None], axis=1)


def sky_along(wavelength_um, mass, atmosphere):
    """The same where the air mass is (directions,); the zenith's below 1, the horizon's beyond that
    one's."""
    cos_zenith = np.cos(np.radians(np.linspace(0, 90, 1801)))
    towards = np.interp(mass, air_mass(cos_zenith), cos_zenith)
    return sky_radiance(wavelength_um, towards, atmosphere)


def level_transmittance(wavelength_um, metres, atmosphere):
    """(n,) transmittance of so many metres of the air near the ground, at wavelengths in um."""
    w = _checked(wavelength_um)
    lowest_m = 1e3 * _edges_km()[1]
    through = np.full((1, LAYERS), metres / lowest_m)  # the lowest layer, along a slant that long
    return np.exp(-_optical_depth(w, through, _profile(atmosphere))[0, 0])


def usual_atmosphere(air_temperature_k, humidity=HUMIDITY):
    """Atmosphere of so many K near the ground, and of vapour over what its air can hold (Magnus's
    formula, WMO 2008)."""
    t = float(np.clip(air_temperature_k, 220, 330))
    celsius = t - 273.15
    saturated_pa = 611.2 * math.exp(17.62 * celsius / (243.12 + celsius))
    column_cm = saturated_pa / (1e3 * VAPOUR_J_G_K * t) * WATER_SCALE_KM * 100
    return Atmosphere(t, min(humidity * column_cm, MOST_WATER_CM))


def air_mass(cos_zenith):
    """Relative air mass: 1 at the zenith, 37.9 at (and below) the horizon.

    Kasten and Young 1989, Appl. Opt. 28, 4735, scaled to 1 at the zenith (by 3e-4).
    """
    c = np.clip(cos_zenith, 0.0, 1.0)
    mass = 1 / (c + 0.50572 * (96.07995 - np.degrees(np.arccos(c))) ** -1.6364)
    return mass * (1 + 0.50572 * 96.07995**-1.6364)


def slant(cos_zenith, edge_km):
    """(directions, layers) how many times as long as towards the zenith the path through each layer
    is, between edges (layers + 1,) in km above the ground."""
    c = np.clip(cos_zenith, 0.0, 1.0)[:, None]
    path = np.sqrt((RADIUS_KM * c) ** 2 + (2 * RADIUS_KM + edge_km) * edge_km)
    return np.diff(path) / np.diff(edge_km)


class _Profile(NamedTuple):
    """Per layer, bottom first: T (K), p (atm), and columns: water in g cm-2, the others in atm cm;
    vapour and dry air as densities over that of air at 296 K and 1 atm."""

    temperature_k: np.ndarray
    pressure: np.ndarray
    h2o: np.ndarray
    co2: np.ndarray
    o3: np.ndarray
    n2o: np.ndarray
    ch4: np.ndarray
    vapour: np.ndarray
    dry: np.ndarray


def _edges_km():
    # Exponential spacing: 30 m at the ground, where an opaque band is seen, 10 km at the top.
    return TOP_KM * np.expm1(6 * np.arange(LAYERS + 1) / LAYERS) / np.expm1(6)


def _temperature_k(km, atmosphere):
    troposphere = np.maximum(atmosphere.air_temperature_k - LAPSE_K_KM * km, TROPOPAUSE_K)
    return troposphere + np.maximum(km - 20.0, 0.0)


def _profile(atmosphere):
    edge = _edges_km()
    middle = 0.5 * (edge[1:] + edge[:-1])
    t = _temperature_k(middle, atmosphere)
    # Hydrostatic: d ln p = -(g M / R) dz / T, with g M / R = 34.163 K/km.
    log_p = -np.concatenate([[0.0], np.cumsum(34.163 * np.diff(edge) / t)])
    p = np.exp(0.5 * (log_p[1:] + log_p[:-1]))
    air = -np.diff(np.exp(log_p)) * 1033.2 / 28.96 * AVOGADRO / LOSCHMIDT  # atm cm
    share = -np.diff(np.exp(-edge / WATER_SCALE_KM))
    water = atmosphere.water_cm * share / share.sum()
    share = -np.diff(1 / (1 + np.exp((edge - 20.0) / 5.0)))
    ozone = 1e-3 * atmosphere.ozone_du * share / share.sum()
    vapour_pa = 1e4 * water / (1e3 * np.diff(edge)) * VAPOUR_J_G_K * t
    vapour = vapour_pa / 101325 * 296 / t
    co2, n2o, ch4 = (1e-6 * ppm * air for ppm in (atmosphere.co2_ppm, N2O_PPM, CH4_PPM))
    return _Profile(t, p, water, co2, ozone, n2o, ch4, vapour, np.maximum(p * 296 / t - vapour, 0))


class _Band(NamedTuple):
    """The exponents a, n and q of a gas, between two wavenumbers."""

    gas: str
    low_cm: float
    high_cm: float
    a: float
    n: float
    q: float


BANDS = (
    _Band("h2o", 350, 1002.5, 0.5299, 1.1406, -2.6343),
    _Band("h2o", 1002.5, 1640, 0.5416, 0.9834, -2.5294),
    _Band("co2", 425, 837.5, 0.6176, 0.6705, -2.2560),
    _Band("co2", 837.5, 1440, 0.6810, 0.7038, -5.0768),
    _Band("o3", 515, 1275, 0.7593, 0.4221, 0.7678),
    _Band("n2o", 490, 1385, 0.7201, 0.7203, -0.1836),
    _Band("ch4", 1065, 1775, 0.5844, 0.7139, -0.4185),
)


def _optical_depth(wavelength_um, longer, profile):
    """(directions, layers, n) optical depth from the ground to the top of each layer, along paths
    through each that are longer (directions, layers) times than towards the zenith."""
    nu, t = 1e4 / wavelength_um, profile.temperature_k
    depth = np.cumsum(longer[..., None] * _continua(nu, profile), axis=1)
    for band in BANDS:
        here = (nu > band.low_cm) & (nu <= band.high_cm)
        column = getattr(profile, band.gas) * profile.pressure**band.n * (ICE_K / t) ** band.q
        path = np.cumsum(longer * column, axis=1)
        strength = _coefficients(band.gas, nu[here]) ** band.a
        depth[..., here] += (path**band.a)[..., None] * strength
    return depth


def _continua(nu, profile):
    """(layers, n) optical depth of each layer by the continuum of water vapour."""
    t = profile.temperature_k[:, None]
    molecules = (1e-20 * AVOGADRO / 18.015 * profile.h2o)[:, None]
    # near 1000 cm-1 less was measured than is tabulated, as LOWTRAN corrects
    less = 1 - 0.2333 * 200.0**2 / ((nu - 1050.0) ** 2 + 200.0**2)
    warm, cold = (
        less * _coefficients(f"self_{at}", nu) * _radiation(nu, float(at)) for at in (296, 260)
    )
    of_self = warm + np.clip((296.0 - t) / 36.0, 0, 1) * (cold - warm)
    # far wings of the lines that broaden in air, as LOWTRAN adds them
    wings = 1 / (np.exp(2.75e-4 * nu) / 3.238e-8 + np.exp(1.3e-3 * nu) / 8.97e-6)
    of_air = (_coefficients("foreign", nu) + wings) * _radiation(nu, 296.0)
    return molecules * (profile.vapour[:, None] * of_self + profile.dry[:, None] * of_air)


def _radiation(nu, temperature_k):
    """The radiation field that a continuum's coefficients are to be multiplied with, cm-1."""
    return nu * np.tanh(HC_K * nu / (2 * temperature_k))


def _coefficients(name, nu):
    """A column of LOWTRAN's coefficients at wavenumbers, cm-1; its ends' beyond them."""
    table = _table()
    return np.interp(nu, table["wavenumber_cm"], table[name])


@cache
def _table():
    text = files("physics").joinpath("data/lowtran7.csv").read_text(encoding="utf-8")
    names, *rows = (line.split(",") for line in text.splitlines())
    return dict(zip(names, np.array(rows, float).T, strict=True))
