"""A camera that sees the ground alone: is it lit by a sky, and as right as if that were in view?"""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from traced import names_of, one_thread, right, said, traced  # noqa: F401

from physics import Environment, HeatCube, InputError, MaterialLibrary
from physics.bands import band_means, equidistant_bands, quadrature
from physics.estimate import Sample, estimate_environment
from physics.planck import noise_sigma, planck
from physics.sky import Atmosphere, sky_radiance, usual_atmosphere
from texnet.camera import missing_sky
from texnet.files.cube_io import write_cube
from texnet.pipeline import decompose

LIBRARY = MaterialLibrary.starter()


def below_the_sky(name, bands):
    """(HeatCube, names, T, texture) of the rows below all sky."""
    cube, truth = traced(name, bands)
    names = names_of(truth)
    top = int(np.flatnonzero((names == "sky").any(axis=1)).max()) + 1
    part = type(cube)(cube.radiance[:, top:], cube.wavelength_um, cube.fwhm_um, cube.netd_k)
    return part, names[top:], truth.temperature_k[top:], truth.texture[:, top:]


@pytest.mark.parametrize(
    ("name", "bands", "method"),
    [*product(("forest", "street"), (54, 9), ("net+sgd", "local")),
     ("forest", 54, "net"), ("forest", 54, "sgd")],
)  # fmt: skip
def test_ground_alone_is_explained_by_a_usual_sky(name, bands, method):
    cube, names, t, _ = below_the_sky(name, bands)
    d = decompose(cube, method=method)
    assert d.sky_assumed and len(d.sky) == 1
    assert (names_of(d) == names).mean() > 0.6  # without, hardly any
    assert np.abs(d.temperature_k - t).mean() < 0.8  # and 1.5 K and more
    assert (np.abs(d.temperature_k - t) < 2 * d.temperature_sigma_k).mean() > 0.9


@pytest.mark.parametrize("method", ["net+sgd", "local"])
@pytest.mark.parametrize("size", [1, 2, 6])
def test_a_few_pixels_are_enough(size, method):
    """Or one: what it is shows in the sky that it mirrors."""
    found = []
    for name in ("forest", "street"):
        cube, names, t, _ = below_the_sky(name, 54)
        rng = np.random.default_rng(0)
        for row, column in rng.integers([n - size + 1 for n in cube.shape], size=(8, 2)):
            part = slice(row, row + size), slice(column, column + size)
            small = HeatCube(cube.radiance[:, *part], cube.wavelength_um, cube.fwhm_um, 0.05)
            d = decompose(small, method=method)
            is_right = names_of(d) == names[part]
            off = np.abs(d.temperature_k - t[part]).mean()
            found.append((d.sky_assumed, is_right.mean(), (~is_right & ~d.unknown).mean(), off))
    assumed, is_right, wrong, _ = np.mean(found, axis=0)
    assert assumed > 0.8 and is_right > 0.6 and wrong < 0.2
    assert np.median([off for *_, off in found]) < 0.5  # without a sky, 1.2 K and more


def pixel(cube, i):
    spectrum = cube.radiance.reshape(cube.bands, -1)[:, i, None, None]
    return HeatCube(spectrum, cube.wavelength_um, cube.fwhm_um, 0.05)


@pytest.mark.parametrize("method", ["net+sgd", "local"])
def test_a_single_pixel_of_a_room_is_not_taken_for_something_else(method):
    (cube, truth), assumed = traced("room", 54), []
    for i in np.random.default_rng(0).integers(truth.material.size, size=12):
        d = decompose(pixel(cube, i), method=method)
        assert d.unknown.all() or names_of(d).item() == names_of(truth).flat[i]
        assumed.append(d.sky_assumed)
    assert np.mean(assumed) < 0.3


def test_a_single_pixel_may_be_sky_or_of_a_library_without_one():
    cube, truth = traced("forest", 54)
    i = np.flatnonzero(names_of(truth) == "sky")[0]
    d = decompose(pixel(cube, i))
    assert names_of(d).item() == "sky" and not d.unknown.any()
    ground = pixel(cube, np.flatnonzero(names_of(truth) == "grass")[0])
    none = LIBRARY.subset([n for n in LIBRARY.names if n != "sky"])
    assert not decompose(ground, none).sky_assumed
    assert len(decompose(ground, k=2).environment) == 2  # one of them being the sky
    with pytest.raises(InputError, match="k = 2 objects need at least 2 pixels, got 1"):
        decompose(ground, none, k=2)
    with pytest.raises(InputError, match="k = 3 .* a sky among them, need at least 2 pixels"):
        decompose(ground, k=3)


@pytest.mark.parametrize(
    ("material", "bands", "method"),
    [*product(("sand",), (54, 18), ("net+sgd", "local")),
     ("sandstone", 54, "net+sgd"), ("granite", 18, "net+sgd"), ("granite", 54, "local")],
)  # fmt: skip
def test_a_field_of_one_material_is_no_mirror_of_itself(material, bands, method):
    """All objects that are found have the material's own spectrum, which a mirror would show."""
    rng, air = np.random.default_rng(0), usual_atmosphere(288.0)
    w, width = equidistant_bands(bands)
    t, v = rng.normal(290, 2, (40, 50)), rng.uniform(0.6, 1.0, (40, 50))

    def radiance(fine_um):
        e = LIBRARY.at(fine_um)[LIBRARY.index(material)]
        own, sky = planck(fine_um, t[..., None]), sky_radiance(fine_um, [0.6], air)[0]
        return e * own + (1 - e) * (v[..., None] * sky + (1 - v[..., None]) * own)

    s = np.moveaxis(band_means(radiance, quadrature(w, width)), -1, 0)
    s += noise_sigma(w, 0.05)[:, None, None] * rng.standard_normal(s.shape)
    d = decompose(HeatCube(s, w, width, 0.05), method=method)
    assert d.sky_assumed
    if method == "net+sgd" or bands == 54:
        assert np.abs(d.temperature_k - t).mean() < 0.5
        assert (names_of(d) == material).mean() > 0.8


def from_above(materials, air, warmer_k, metal=0):
    """(HeatCube, names, T) of 8 x 12 fields, warmer than the Atmosphere over them, their first row
    with so many pixels of steel."""
    rng = np.random.default_rng(0)
    fields = lambda values: values.repeat(6, axis=0).repeat(6, axis=1)
    names = fields(np.array(materials)[rng.integers(len(materials), size=(8, 12))])
    names = names.astype(object)
    t = air.air_temperature_k + warmer_k + fields(rng.normal(0, 1.5, (8, 12)))
    t += rng.normal(0, 0.5, t.shape)
    v = rng.uniform(0.6, 1, t.shape)
    names[0, 5 : 5 + metal], v[0, 5 : 5 + metal] = "steel", 0.8
    material = np.vectorize(LIBRARY.index)(names)
    w, width = equidistant_bands(54)

    def radiance(fine_um):
        e, sky = LIBRARY.at(fine_um)[material], sky_radiance(fine_um, [0.6], air)[0]
        around = v[..., None] * sky + (1 - v[..., None]) * planck(fine_um, t.mean())
        return e * planck(fine_um, t[..., None]) + (1 - e) * around

    s = np.moveaxis(band_means(radiance, quadrature(w, width)), -1, 0)
    s += noise_sigma(w, 0.05)[:, None, None] * rng.standard_normal(s.shape)
    return HeatCube(s, w, width, 0.05), names, t


DESERT = ("sand", "sandstone", "granite", "clay"), Atmosphere(311, 1.3), 11.0
FIELDS = ("soil", "grass", "asphalt", "concrete"), Atmosphere(290, 2.2), -8.0


@pytest.mark.parametrize(
    ("scene", "gain", "spread", "method"),
    [*product((DESERT, FIELDS), (1, 1.03), (0,), ("net+sgd", "local")),
     (DESERT, 0.9, 0, "net+sgd"), (DESERT, 0.9, 0, "local"), (FIELDS, 0.9, 0, "local"),
     (DESERT, 1, 0.003, "net+sgd"), (DESERT, 1, 0.003, "local"), (FIELDS, 1, 0.003, "local")],
)  # fmt: skip
def test_reflections_tell_of_which_air_the_sky_is(scene, gain, spread, method):
    """Usual air is as warm as the scene and half saturated: over the desert 10 K and 6 cm off."""
    cube, names, t = from_above(*scene)
    gains = gain * np.exp(np.random.default_rng(0).normal(0, spread, cube.bands))
    d = decompose(replace(cube, radiance=gains[:, None, None] * cube.radiance), method=method)
    off = np.abs(d.temperature_k - t)
    assert d.sky_assumed and off.mean() < 0.4  # 1.3 K and more by usual air, or by none
    assert (off < 2 * d.temperature_sigma_k).mean() > 0.9
    assert (~d.unknown & (names_of(d) != names)).mean() < 0.02
    if not spread:
        assert (names_of(d) == names).mean() > 0.95 and (d.band_gains == 1).all()
        assert d.gain == pytest.approx(gain, abs=0.003)


@pytest.mark.parametrize("method", ["net+sgd", "local"])
@pytest.mark.parametrize("metal", [4, 12])
def test_a_little_metal_is_no_sky(metal, method):
    cube, names, t = from_above(("sand", "sandstone"), Atmosphere(283, 0.75), -2.0, metal)
    d = decompose(cube, method=method)
    assert d.sky_assumed and np.abs(d.temperature_k - t)[1:].mean() < 0.3  # 6 K by that sky
    assert (names_of(d) == names)[1:].mean() > 0.95


@pytest.mark.parametrize("method", ["net+sgd", "local"])
@pytest.mark.parametrize("bands", [54, 9])
def test_no_sky_shines_into_a_closed_room(bands, method):
    d = right("room", bands, method)
    assert not d.sky_assumed and d.sky == ()


def test_where_a_sky_is_plain_no_camera_would_do_without(monkeypatch):
    cube = from_above(*FIELDS)[0]
    short = decompose(cube)
    monkeypatch.setattr(missing_sky, "PLAIN", np.inf)
    whole = decompose(cube)
    assert short.sky_assumed and whole.sky_assumed
    np.testing.assert_array_equal(short.environment, whole.environment)
    np.testing.assert_array_equal(short.temperature_k, whole.temperature_k)
    np.testing.assert_array_equal(short.temperature_sigma_k, whole.temperature_sigma_k)


@pytest.mark.parametrize("name, k", [("forest", 5), ("street", 2), ("patches", 3)])
def test_one_object_is_the_sky_and_the_others_are_the_ground(name, k):
    cube, *_, texture = below_the_sky(name, 54)
    e = estimate_environment(cube, LIBRARY, k, assume_sky=Sample(cube, LIBRARY).usual_air())
    assert len(e) == k and e.sky == (0,)
    rest = estimate_environment(cube, LIBRARY, k - 1).radiance
    np.testing.assert_allclose(np.sort(e.radiance[1:], axis=0), np.sort(rest, axis=0), rtol=1e-6)
    assert (e.radiance[0] < texture.max(axis=(1, 2))).all()


def test_none_is_assumed_where_it_is_unknown_or_has_no_place():
    ground = below_the_sky("forest", 54)[0]
    none = LIBRARY.subset([n for n in LIBRARY.names if n != "sky"])
    for library, k in ((none, 5), (LIBRARY, 1)):
        a, b = (
            estimate_environment(ground, library, k, assume_sky=s) for s in (None, Atmosphere())
        )
        assert a.sky == b.sky
        np.testing.assert_array_equal(a.radiance, b.radiance)


def test_an_environment_that_is_given_is_believed():
    cube, *_ = below_the_sky("forest", 54)
    given = Environment(estimate_environment(cube, LIBRARY, 3).radiance, cube.wavelength_um)
    d = decompose(cube, environment=given, method="local")
    assert not d.sky_assumed and d.sky == ()


def test_it_is_said(tmp_path, capsys):
    write_cube(below_the_sky("forest", 54)[0], tmp_path / "ground.npz")
    text, result, arrays = said(capsys, tmp_path / "ground.npz", tmp_path / "out")
    assert result["sky_assumed"] and not result["sky_in_view"]
    assert "none in view: a usual clear one is assumed" in text
    assert result["k_chosen"] and f"k = {result['k']}, chosen" in text
    assert arrays["sky"].tolist() == [0]


@pytest.mark.parametrize("method", ["net+sgd", "local"])
def test_what_few_bands_show_of_another_sky_is_no_gain(method):
    """Downwelling of line by line another model in seven bands, of which ours knows nothing."""
    w, width = np.array([8.2, 8.7, 9.1, 9.6, 10.6, 11.3, 12.1]), np.full(7, 0.4)
    sky = np.array([2.352, 1.470, 1.761, 2.562, 2.167, 2.255, 2.810])
    rng = np.random.default_rng(0)
    fields = lambda values: values.repeat(6, axis=0).repeat(6, axis=1)
    seen = [LIBRARY.index(n) for n in ("grass", "soil", "asphalt", "concrete", "water", "foliage")]
    material = fields(np.array(seen)[rng.integers(6, size=(8, 12))])
    t = 292 + fields(rng.normal(0, 2, (8, 12)))
    t += rng.normal(0, 0.5, t.shape)
    v = rng.uniform(0.6, 1, t.shape)[..., None]
    fine_um = quadrature(w, width)
    e = LIBRARY.at(fine_um)[material]
    glow = (e * planck(fine_um, t[..., None, None])).mean(axis=-1)
    s = glow + (1 - e.mean(axis=-1)) * (v * sky + (1 - v) * planck(w, t.mean()))
    s += noise_sigma(w, 0.05) * rng.standard_normal(s.shape)
    d = decompose(HeatCube(np.moveaxis(s, -1, 0), w, width, 0.05), method=method)
    off = np.abs(d.temperature_k - t)
    assert d.sky_assumed and d.gain == 1
    assert off.mean() < 1 and (off < 2 * d.temperature_sigma_k).mean() > 0.9
    assert np.median(d.temperature_sigma_k) < 2  # 6 K, where a gain was suspected
