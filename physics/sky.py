"""The spectrum of a clear sky, 7.5-14.5 um: layers of gas whose absorption has a closed form.

The atmosphere is 28 plane-parallel layers, thin at the ground. Seen along air mass m
(Kasten and Young 1989) it has the transmittance t_i(m) from the ground to the top of
layer i and the downwelling radiance

    L = sum_i B(T_i) (t_{i-1} - t_i),        t_i = exp(-tau_i(m)),

which is the sum of B_i (1 - exp(-m tau_i)) exp(-m sum_{j<i} tau_j) wherever tau is
proportional to m. It is not where spectral lines saturate, so that a band's tau is taken
over the whole path (Curtis-Godson) and not layer by layer. tau adds up:

* water-vapour continuum: Roberts, Selby and Biberman 1976, Appl. Opt. 15, 2085, as in
  LOWTRAN: C(nu) w [e exp(1800 (1/T - 1/296)) + 0.002 (p - e)] with
  C = 4.18 + 5578 exp(-7.87e-3 nu) cm2 g-1 atm-1;
* H2O 6.3 um and rotational bands, CO2 15, 10.4 and 9.4 um bands: exponential wide-band
  model, Edwards 1976, Adv. Heat Transfer 12, 115; parameters and notation as in Modest,
  Radiative Heat Transfer, 3rd ed. 2013, section 11.10 (rotational band: Modak 1979);
* O3 9.6 um (nu_3): measured band strength (HITRAN, 1.4e-17 cm per molecule) spread over the
  P, Q and R envelope of a rigid rotor (Herzberg 1945), with the same line-overlap law.

Profiles: 6.5 K/km up to 216.65 K, isothermal to 20 km, then +1 K/km (U.S. Standard
Atmosphere 1976); water with a 2 km scale height; well-mixed CO2; ozone after Green (Lacis
and Hansen 1974, J. Atmos. Sci. 31, 118: u(z) falls as a logistic at 20 km, 5 km wide).

Approximate, and on purpose: band models give the mean over some 10 cm-1, no single lines;
their far wings, which fill the 8-9 and 12-13.5 um flanks of the window, are extrapolated and
good to some 30 %; the mean line spacing of ozone (0.1 cm-1) is a round value; no CH4 and N2O
(7.6-8 um), no aerosol, no cloud, no refraction beyond the air mass, no inversion at night.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .cube.heat_cube import check_wavelength
from .errors import InputError
from .planck import C2, planck

HC_K = C2 / 1e4  # h c / k_B, cm K
TROPOPAUSE_K = 216.65
LAPSE_K_KM = 6.5
WATER_SCALE_KM = 2.0
VAPOUR_J_G_K = 0.4615  # gas constant of water vapour
HUMIDITY = 0.5  # of usual air, over what it can hold
MOST_WATER_CM = 8.0
TOP_KM = 50.0
LAYERS = 28
AIR_MASSES = np.geomspace(0.1, 40, 60)  # that a sky may be seen through


@dataclass(frozen=True)
class Atmosphere:
    """A clear atmosphere over the scene.

    air_temperature_k  near the ground, in K, 220-330
    water_cm           precipitable water, in cm (g cm-2), 0-8
    ozone_du           ozone column, in Dobson units, 0-1000
    co2_ppm            carbon dioxide, in parts per million by volume, 0-10000

    Raises InputError outside these ranges.
    """

    air_temperature_k: float = 288.0
    water_cm: float = 1.4
    ozone_du: float = 320.0
    co2_ppm: float = 420.0

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


def zenith_optical_depth(wavelength_um, atmosphere):
    """(n,) optical depth of the whole atmosphere towards the zenith, at wavelengths in um."""
    w = check_wavelength(wavelength_um, "sky")
    return _optical_depth(w, np.ones(1), _profile(atmosphere))[0, -1]


def sky_radiance(wavelength_um, cos_zenith, atmosphere):
    """(directions, n) downwelling radiance of the clear sky, W m-2 sr-1 um-1.

    wavelength_um (n,) in um, ascending; cos_zenith (directions,) in -1..1, where
    everything at or below the horizon (<= 0) takes the horizon's value.
    """
    w = check_wavelength(wavelength_um, "sky")
    c = np.asarray(cos_zenith, dtype=np.float64)
    if c.ndim != 1 or not (np.abs(c) <= 1).all():
        raise InputError("sky: cos_zenith must be one list of numbers in -1..1.")
    profile = _profile(atmosphere)
    transmittance = np.exp(-_optical_depth(w, air_mass(c), profile))
    above = np.concatenate([np.ones_like(transmittance[:, :1]), transmittance[:, :-1]], axis=1)
    glow = planck(w, profile.temperature_k[:, None])
    return np.einsum("dln,ln->dn", above - transmittance, glow)


def level_transmittance(wavelength_um, metres, atmosphere):
    """(n,) transmittance of so many metres of the air near the ground, at wavelengths in um."""
    w = check_wavelength(wavelength_um, "air")
    lowest_m = 1e3 * _edges_km()[1]
    through = np.array([metres / lowest_m])  # the lowest layer, along a slant that long
    return np.exp(-_optical_depth(w, through, _profile(atmosphere))[0, 0])


def usual_atmosphere(air_temperature_k, humidity=HUMIDITY):
    """Atmosphere of so many K near the ground, and of vapour over what its air can hold (Magnus's
    formula, WMO 2008)."""
    t = float(np.clip(air_temperature_k, 220, 330))
    celsius = t - 273.15
    saturated_pa = 611.2 * math.exp(17.62 * celsius / (243.12 + celsius))
    column_cm = saturated_pa / (1e3 * VAPOUR_J_G_K * t) * WATER_SCALE_KM * 100
    return Atmosphere(t, min(humidity * column_cm, MOST_WATER_CM))


def continuum(wavelength_um):
    """How strongly the water-vapour continuum absorbs, cm2 g-1 atm-1 at 296 K (Roberts et al.)."""
    return 4.18 + 5578 * np.exp(-7.87e-3 * 1e4 / wavelength_um)


def air_mass(cos_zenith):
    """Relative air mass: 1 at the zenith, 37.9 at (and below) the horizon.

    Kasten and Young 1989, Appl. Opt. 28, 4735, scaled to 1 at the zenith (by 3e-4).
    """
    c = np.clip(cos_zenith, 0.0, 1.0)
    mass = 1 / (c + 0.50572 * (96.07995 - np.degrees(np.arccos(c))) ** -1.6364)
    return mass * (1 + 0.50572 * 96.07995**-1.6364)


class _Profile(NamedTuple):
    """Per layer, bottom first: T (K), p and e (atm), columns in g m-2."""

    temperature_k: np.ndarray
    pressure: np.ndarray
    vapour: np.ndarray
    water: np.ndarray
    co2: np.ndarray
    ozone: np.ndarray
    co2_fraction: float


def _edges_km():
    # Exponential spacing: 30 m at the ground, where an opaque band is seen, 8 km at the top.
    return TOP_KM * np.expm1(6 * np.arange(LAYERS + 1) / LAYERS) / np.expm1(6)


def _profile(atmosphere):
    edge = _edges_km()
    middle = 0.5 * (edge[1:] + edge[:-1])
    troposphere = np.maximum(atmosphere.air_temperature_k - LAPSE_K_KM * middle, TROPOPAUSE_K)
    t = troposphere + np.maximum(middle - 20.0, 0.0)
    # Hydrostatic: d ln p = -(g M / R) dz / T, with g M / R = 34.163 K/km.
    log_p = -np.concatenate([[0.0], np.cumsum(34.163 * np.diff(edge) / t)])
    p = np.exp(0.5 * (log_p[1:] + log_p[:-1]))
    air = 1.0332e7 * -np.diff(np.exp(log_p))  # g m-2
    share = -np.diff(np.exp(-edge / WATER_SCALE_KM))
    water = 1e4 * atmosphere.water_cm * share / share.sum()
    share = -np.diff(1 / (1 + np.exp((edge - 20.0) / 5.0)))
    ozone = 2.1415e-2 * atmosphere.ozone_du * share / share.sum()  # 1 DU = 21.4 mg m-2
    fraction = 1e-6 * atmosphere.co2_ppm
    density = water / (1e3 * np.diff(edge))  # g m-3
    vapour = density * VAPOUR_J_G_K * t / 101325
    return _Profile(t, p, vapour, water, air * fraction * 44.01 / 28.96, ozone, fraction)


def _optical_depth(wavelength_um, mass, profile):
    """(directions, layers, n) optical depth from the ground to the top of each layer."""
    nu = 1e4 / wavelength_um
    t, p, e = profile.temperature_k, profile.pressure, profile.vapour
    dry = np.maximum(p - e, 0.0)
    broadened = e * np.exp(1800 * (1 / t - 1 / 296)) + 0.002 * dry
    along = np.cumsum(1e-4 * profile.water * broadened)[:, None]
    depth = mass[:, None, None] * (along * continuum(wavelength_um))
    for band in BANDS:
        column = profile.water if band.gas is WATER else profile.co2
        fraction = e / p if band.gas is WATER else np.full_like(p, profile.co2_fraction)
        density, overlap = _wide_band(nu, t, p, fraction, band)
        depth += _line_depth(column[:, None] * density, overlap, mass)
    density, overlap = _ozone_band(nu, t, p)
    depth += _line_depth(profile.ozone[:, None] * density, overlap, mass)
    return depth


def _line_depth(weak, overlap, mass):
    """(directions, layers, n) mean depth of lines, tau = m u / sqrt(1 + m u / eta).

    weak (layers, n) is each layer's depth in the limit of overlapping lines, overlap
    (layers,) its line width over spacing eta. u is the sum of weak along the path and
    eta its mean weighted by weak: the Curtis-Godson approximation.
    """
    u = np.cumsum(weak, axis=0)
    u_eta = np.cumsum(weak * overlap[:, None], axis=0)
    inverse_eta = np.divide(u, u_eta, out=np.zeros_like(u), where=u_eta > 0)
    path = mass[:, None, None] * u
    return path / np.sqrt(1 + path * inverse_eta)


class _Gas(NamedTuple):
    """Vibrational modes of a molecule: wavenumbers (cm-1) and degeneracies."""

    mode: tuple
    degeneracy: tuple


class _Band(NamedTuple):
    """One row of Edwards's table (Modest 2013, table 11.3)."""

    gas: _Gas
    centre: float  # nu_c, cm-1
    jump: tuple  # delta_k, change of each mode's quantum number
    exponent: float  # n of the effective pressure
    alpha: float  # alpha_0, cm-1 / (g m-2), at 100 K
    beta: float  # beta_0
    omega: float  # omega_0, cm-1


WATER = _Gas((3652.0, 1595.0, 3756.0), (1, 1, 1))
CO2 = _Gas((1351.0, 666.0, 2396.0), (1, 2, 1))
BANDS = (
    _Band(WATER, 140.0, (0, 0, 0), 1.0, 44205.0, 0.14311, 69.3),  # rotational
    _Band(WATER, 1600.0, (0, 1, 0), 1.0, 41.2, 0.09427, 56.4),  # 6.3 um
    _Band(CO2, 667.0, (0, 1, 0), 0.7, 19.0, 0.06157, 12.7),  # 15 um
    _Band(CO2, 960.0, (-1, 0, 1), 0.8, 2.47e-9, 0.04017, 13.4),  # 10.4 um
    _Band(CO2, 1060.0, (0, -2, 1), 0.8, 2.48e-9, 0.11888, 10.1),  # 9.4 um
)


def _wide_band(nu, t, p, fraction, band):
    """Edwards's band: (layers, n) line strength per spacing in m2 g-1, (layers,) overlap.

    S/d = (alpha / omega) exp(-2 |nu - nu_c| / omega), eta = beta P_e, with
    omega = omega_0 sqrt(T/100), P_e = [p (1 + (b - 1) x)]^n.
    """
    hot = 100.0 / t
    if not any(band.jump):
        alpha = band.alpha * np.exp(-9 * np.sqrt(hot))
        beta = band.beta * np.sqrt(hot)
    else:
        cold = np.full(1, 100.0)
        alpha = band.alpha * _psi(t, band) / _psi(cold, band)
        beta = band.beta * np.sqrt(hot) * _phi(t, band) / _phi(cold, band)
    b = 8.6 * np.sqrt(hot) + 0.5 if band.gas is WATER else 1.3
    omega = (band.omega / np.sqrt(hot))[:, None]
    density = alpha[:, None] / omega * np.exp(-2 * np.abs(nu - band.centre) / omega)
    return density, beta * (p * (1 + (b - 1) * fraction)) ** band.exponent


def _levels(t, band):
    """Per mode, (levels, layers) weights of its transitions and of its population."""
    for nu, g, jump in zip(band.gas.mode, band.gas.degeneracy, band.jump, strict=True):
        v = range(-jump if jump < 0 else 0, 12)
        up = [math.factorial(i + g + abs(jump) - 1) / math.factorial(i) for i in v]
        all_levels = [math.factorial(i + g - 1) / math.factorial(i) for i in range(12)]
        boltzmann = np.exp(-HC_K * nu / t)
        yield (
            np.array(up)[:, None] * boltzmann ** np.array(v)[:, None],
            np.array(all_levels)[:, None] * boltzmann ** np.arange(12)[:, None],
        )


def _psi(t, band):
    """Band strength's dependence on T (Psi in Modest, up to its value at 100 K)."""
    energy = sum(nu * jump for nu, jump in zip(band.gas.mode, band.jump, strict=True))
    value = -np.expm1(-HC_K * energy / t)
    for up, population in _levels(t, band):
        value = value * up.sum(axis=0) / population.sum(axis=0)
    return value


def _phi(t, band):
    """Line overlap's dependence on T (Phi in Modest, up to its value at 100 K)."""
    value = np.ones_like(t)
    for up, _ in _levels(t, band):
        value = value * np.sqrt(up).sum(axis=0) ** 2 / up.sum(axis=0)
    return value


def _ozone_band(nu, t, p):
    """Ozone nu_3: (layers, n) line strength per spacing in m2 g-1, (layers,) overlap.

    P and R branches of a rotor, |x| exp(-x^2) with x = (nu - 1042) / sqrt(4 B k T / h c), hold
    4/5 of the strength, and a Gaussian between them the rest: 1/9 for the Q branches of the K
    structure at 220 K, and as much for the hot bands. B = 0.42 cm-1 is the mean of ozone's two
    small rotational constants.
    """
    width = np.sqrt(4 * 0.42 * t / HC_K)[:, None]
    x = (nu - 1042.0) / width
    shape = (0.8 * np.abs(x) + 0.2 / math.sqrt(math.pi)) * np.exp(-(x**2)) / width
    strength = 1.4e-17 * 6.02214076e23 / 47.998 * 1e-4  # cm-1 / (g m-2)
    # pi gamma p / d with half-width gamma 0.075 cm-1 atm-1 and spacing d 0.1 cm-1.
    return strength * shape, math.pi * 0.075 / 0.1 * p
