"""The clear sky: its limits, its monotonicity, LOWTRAN 7, and what observers report."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.other_skies import lowtran7, nearest_sky
from physics.errors import InputError
from physics.planck import brightness_temperature, planck
from physics.sky import (
    RADIUS_KM,
    Atmosphere,
    _temperature_k,
    air_mass,
    level_transmittance,
    sky_along,
    sky_radiance,
    slant,
    usual_atmosphere,
    zenith_optical_depth,
)

W = np.linspace(7.5, 14.5, 141)
GRID = np.linspace(0, 90, 9001)  # degrees
WINDOW = (W > 10.2) & (W < 12.2)
COSINES = np.linspace(0, 1, 21)
EMPTY = Atmosphere(water_cm=0.0, ozone_du=0.0, co2_ppm=0.0)
CLIMATES = [
    Atmosphere(262.0, 0.3),
    Atmosphere(),
    Atmosphere(300.0, 4.0, 280.0),
    Atmosphere(310.0, 1.0, 450.0, 800.0),
]


def zenith_brightness(atmosphere):
    return brightness_temperature(W, sky_radiance(W, [1.0], atmosphere)[0])


@pytest.mark.parametrize("atmosphere", CLIMATES)
def test_no_direction_is_brighter_than_the_air(atmosphere):
    sky = sky_radiance(W, COSINES, atmosphere)
    assert sky.shape == (COSINES.size, W.size)
    assert (sky > 0).all()
    assert (sky < planck(W, atmosphere.air_temperature_k)).all()


@pytest.mark.parametrize("atmosphere", CLIMATES)
def test_the_sky_brightens_towards_the_horizon(atmosphere):
    assert (np.diff(sky_radiance(W, COSINES, atmosphere), axis=0) < 0).all()


def test_the_horizon_is_a_blackbody_at_about_air_temperature():
    humid = Atmosphere(295.0, 2.5)
    horizon = brightness_temperature(W, sky_radiance(W, [0.0], humid)[0])
    assert (horizon < 295.0).all()
    assert (horizon > 292.0).all()


def test_below_the_horizon_is_the_horizon():
    down, horizon = sky_radiance(W, [-0.7, 0.0], Atmosphere())
    assert np.array_equal(down, horizon)


# Of LOWTRAN 7's standard atmospheres: air near the ground (K), water (cm), ozone (DU). Their
# profiles are not ours: layers of 1 km, and in subarctic winter an inversion that ours has not.
STANDARD = {
    "tropical": (299.7, 4.12, 277.0),
    "midlatitude summer": (294.2, 2.93, 332.0),
    "midlatitude winter": (272.2, 0.86, 376.0),
    "subarctic summer": (287.2, 2.10, 345.0),
    "subarctic winter": (257.2, 0.42, 376.0),
    "US standard 1976": (288.2, 1.44, 344.0),
}

VAPOUR_G_M3 = dict(zip(STANDARD, (19.0, 14.0, 3.48, 9.13, 1.2, 5.9), strict=True))  # at the ground


@pytest.fixture(scope="module")
def lowtran():
    return lowtran7()


@pytest.mark.parametrize("angle", ["0", "60", "80", "88"])
@pytest.mark.parametrize("climate", STANDARD)
def test_the_sky_is_that_of_lowtran_7(lowtran, climate, angle):
    w, skies = lowtran
    air_k, water_cm, ozone_du = STANDARD[climate]
    ours = sky_radiance(
        w, [np.cos(np.radians(float(angle)))], Atmosphere(air_k, water_cm, ozone_du, co2_ppm=330.0)
    )
    off = brightness_temperature(w, ours[0]) - skies[climate][angle]
    rms, between_bands = np.sqrt((off**2).mean()), off.std()
    # of the US standard vapour lies higher than ours, which counts most near the horizon
    most = 2.5 if angle == "88" or (angle, climate) == ("80", "US standard 1976") else 2.0
    assert rms < (4.5 if climate == "subarctic winter" else most)
    assert between_bands < (1.6 if angle == "88" else 1.5)


@pytest.mark.parametrize("air_k", [262.0, 288.0, 303.0])
def test_another_sky_is_as_warm_as_the_air_at_the_horizon_and_clears_up(air_k):
    t = brightness_temperature(W, nearest_sky(air_k)(W, COSINES))
    assert abs(t[0].max() - air_k) < 0.5
    assert (np.diff(t, axis=0) < 0.5).all()  # one has an inversion
    assert t[-1].min() < air_k - 40


@pytest.mark.parametrize("climate", STANDARD)
def test_a_kilometre_of_air_is_that_of_lowtran_7(lowtran, climate):
    w, columns = lowtran
    air_k, vapour_g_m3 = STANDARD[climate][0], VAPOUR_G_M3[climate]
    # our vapour has a scale height of 2 km, so 2000 m of the ground's density are in the column
    air = Atmosphere(air_k, vapour_g_m3 * 2000 / 1e4, co2_ppm=330.0)
    ours = level_transmittance(w, 1000.0, air)
    off = np.abs(ours - columns[climate]["1 km"])
    ozone = np.abs(w - 9.6) < 0.5  # of which there is less near the ground in our profile
    assert off[~ozone].max() < 0.01
    assert off[ozone].max() < 0.025


@pytest.mark.parametrize("angle", [0.0, 60.0, 85.0, 89.0, 90.0])
def test_a_layer_is_met_on_as_long_a_path_as_a_ray_has_from_shell_to_shell(angle):
    """By the law of cosines, shell after shell."""
    edge, c = np.array([0.0, 0.03, 1.0, 12.0, 50.0]), np.cos(np.radians(angle))
    r = RADIUS_KM + edge
    start, lengths = np.zeros(2), []  # the ray leaves the ground towards (sin, cos)
    towards = np.array([np.sin(np.radians(angle)), c])
    for low, high in zip(r[:-1], r[1:], strict=True):
        at = start + [0.0, RADIUS_KM]
        b = at @ towards
        step = -b + np.sqrt(b * b + high**2 - at @ at)
        assert np.hypot(*at) == pytest.approx(low)
        lengths.append(step)
        start = start + step * towards
    np.testing.assert_allclose(slant(np.array([c]), edge)[0], lengths / np.diff(edge), rtol=1e-4)


def test_the_well_mixed_air_is_met_as_kasten_and_young_have_it():
    """Layers weighted by their pressure; theirs is refracted by each."""
    edge = np.linspace(0, 80, 2001)
    air = -np.diff(np.exp(-edge / 8.0))
    for angle, within in ((0, 1e-9), (60, 0.002), (80, 0.01), (85, 0.02), (88, 0.03), (90, 0.1)):
        c = np.cos(np.radians([angle]))
        assert slant(c, edge)[0] @ air / air.sum() == pytest.approx(air_mass(c)[0], rel=within)


def test_along_an_air_mass_is_towards_where_it_is():
    mass = np.array([1.0, 1.3, 5.0, 20.0, 37.0])
    angles = [np.interp(m, air_mass(np.cos(np.radians(GRID))), GRID) for m in mass]
    wanted = sky_radiance(W, np.cos(np.radians(angles)), Atmosphere())
    np.testing.assert_allclose(sky_along(W, mass, Atmosphere()), wanted, rtol=1e-4)


def test_air_mass_is_kasten_and_young():
    assert air_mass(1.0) == pytest.approx(1.0, abs=1e-9)
    assert air_mass(0.5) == pytest.approx(1.994, abs=0.002)  # their table, 30 deg elevation
    assert air_mass(0.0) == pytest.approx(37.9, abs=0.2)


def test_the_profile_is_that_of_the_us_standard_atmosphere_of_1976():
    km = np.array([0.0, 11.0, 20.0, 30.0, 32.0])
    standard_k = [288.15, 216.65, 216.65, 226.65, 228.65]
    np.testing.assert_allclose(_temperature_k(km, Atmosphere(288.15)), standard_k)


@pytest.mark.parametrize(("celsius", "g_m3"), [(0, 4.85), (10, 9.4), (20, 17.3), (30, 30.4)])
def test_usual_air_holds_half_of_the_vapour_that_it_can(celsius, g_m3):
    """Handbooks' density of saturated vapour; of a scale height of 2 km."""
    usual = usual_atmosphere(celsius + 273.15)
    assert usual.water_cm == pytest.approx(0.5 * g_m3 * 2000 / 1e4, rel=0.01)


def test_with_methane_and_nitrous_oxide_alone_the_sky_is_dark_but_for_their_bands():
    elsewhere = (W > 9.6) & (W < 10.0) | (W > 11.8) & (W < 12.6)
    assert not zenith_optical_depth(W, EMPTY)[elsewhere].any()
    assert not sky_radiance(W, COSINES, EMPTY)[:, elsewhere].any()
    assert W[np.argmax(zenith_optical_depth(W, EMPTY))] < 8


def test_an_isothermal_slab_glows_with_one_minus_transmittance():
    # Water within 2 km of the ground at nearly the air's temperature, seen at 11 um where the
    # continuum rules: L = (1 - exp(-m tau)) B(T), with T between the air's and 10 K less.
    slab, w = Atmosphere(290.0, 3.0, 0.0, 0.0), np.array([11.0])
    tau = zenith_optical_depth(w, slab)
    for cosine in (1.0, 0.7, 0.5):
        emissivity = -np.expm1(-tau / cosine)
        sky = sky_radiance(w, [cosine], slab)[0]
        assert (sky < emissivity * planck(w, 290.0)).all()
        assert (sky > emissivity * planck(w, 280.0)).all()


@pytest.mark.parametrize(
    ("field", "low", "high"),
    [("water_cm", 0.5, 2.5), ("ozone_du", 200.0, 400.0), ("co2_ppm", 300.0, 600.0)],
)
def test_more_gas_makes_the_sky_more_opaque(field, low, high):
    thin, thick = (zenith_optical_depth(W, Atmosphere(**{field: v})) for v in (low, high))
    assert (thick >= thin).all()
    assert (thick - thin).max() > 0.05


def test_more_water_makes_the_window_brighter():
    columns = [zenith_brightness(Atmosphere(water_cm=v))[WINDOW] for v in (0.2, 0.7, 1.4, 3.0, 5.0)]
    assert (np.diff(columns, axis=0) > 0).all()


def test_every_gas_absorbs_where_its_band_is():
    def peak(**gas):
        more = zenith_optical_depth(W, replace(EMPTY, **gas)) - zenith_optical_depth(W, EMPTY)
        return W[np.argmax(more)]

    assert 9.4 < peak(ozone_du=320.0) < 9.8
    assert peak(co2_ppm=420.0) == W[-1]  # towards 15 um
    assert peak(water_cm=0.1) == W[0]  # towards 6.3 um


def test_lines_saturate_but_the_continuum_grows_faster_than_its_water():
    # Band lines: tau ~ sqrt(column); self-broadened continuum: tau ~ column^2.
    co2 = [zenith_optical_depth([14.5], Atmosphere(288, 0, 0, c))[0] for c in (200, 800)]
    assert 1.8 < co2[1] / co2[0] < 2.5
    water = [zenith_optical_depth([11.0], Atmosphere(288, c, 0, 0))[0] for c in (1.0, 4.0)]
    assert 4 < water[1] / water[0] < 16


@pytest.mark.parametrize(
    ("atmosphere", "low", "high"),
    [(Atmosphere(275.0, 0.5), 150, 200), (Atmosphere(), 185, 215), (Atmosphere(300, 4), 235, 265)],
)
def test_window_brightness_is_what_observers_report(atmosphere, low, high):
    assert low < zenith_brightness(atmosphere)[WINDOW].mean() < high


def test_ozone_stands_out_of_the_window_and_co2_hides_the_sky():
    t = zenith_brightness(Atmosphere())
    assert t[(W > 9.4) & (W < 9.8)].mean() > t[(W > 10.2) & (W < 11.2)].mean() + 20
    assert t[W > 14].min() > 288 - 20
    assert t[-1] > 288 - 4


@pytest.mark.parametrize("atmosphere", CLIMATES[1:])
def test_downwelling_flux_is_near_brutsaert(atmosphere):
    # Brutsaert 1975: clear-sky emissivity 1.24 (e / T)^(1/7), e in hPa. Outside 8-14 um the sky
    # is taken as black, so that the window's deficit is that of the whole spectrum; that leaves
    # out the driest climate, in which the sky opens at 17-25 um too.
    t = atmosphere.air_temperature_k
    w, mu = np.linspace(8, 14, 121), (np.arange(40) + 0.5) / 40
    flux = 2 * np.pi * (sky_radiance(w, mu, atmosphere) * mu[:, None]).mean(axis=0)
    emissivity = 1 - np.trapezoid(np.pi * planck(w, t) - flux, w) / (5.670374e-8 * t**4)
    vapour = 4.615e-3 * t * atmosphere.water_cm * 10 / 2.0  # hPa, 2 km scale height
    assert emissivity == pytest.approx(1.24 * (vapour / t) ** (1 / 7), abs=0.08)


@pytest.mark.parametrize(
    "field",
    [
        dict(air_temperature_k=15.0),
        dict(water_cm=-1.0),
        dict(ozone_du=float("nan")),
        dict(cloud_base_km=51.0),
    ],
)
def test_a_wrong_atmosphere_is_an_input_error(field):
    with pytest.raises(InputError, match=next(iter(field))):
        Atmosphere(**field)


@pytest.mark.parametrize("cosines", [[1.5], [[0.5]], [float("nan")]])
def test_wrong_directions_are_an_input_error(cosines):
    with pytest.raises(InputError, match="cos_zenith"):
        sky_radiance(W, cosines, Atmosphere())


@pytest.mark.parametrize("far", [[4.0, 10.0], [10.0, 15.5]])
def test_beyond_its_coefficients_there_is_no_sky(far):
    with pytest.raises(InputError, match="7.4 to 14.6 um"):
        sky_radiance(far, [1.0], Atmosphere())
    with pytest.raises(InputError, match="7.4 to 14.6 um"):
        level_transmittance(far, 100.0, Atmosphere())
