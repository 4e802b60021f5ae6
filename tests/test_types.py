"""HeatCube, MaterialLibrary and Environment: checked once on construction, then immutable."""

import copy
import dataclasses
import json
import re

import made_up
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from physics import Environment, HeatCube, InputError, MaterialLibrary
from physics.bands import quadrature
from physics.cube.heat_cube import sampling_step
from physics.planck import brightness_temperature, noise_sigma, planck

W = np.linspace(8.0, 14.0, 5)
EVERY, MOST = slice(None), slice(4)  # of the bands
S = np.broadcast_to(planck(W, 290.0)[:, None, None], (5, 3, 4))
E = np.array([np.full(5, 0.9), np.linspace(0.2, 0.8, 5), np.full(5, 0.5)])
NAMES = ("grass", "glass", "sky")


def changed(array, index, value):
    array = np.array(array)
    array[index] = value
    return array


def sentence(make, *args, **fields):
    """The one sentence of the InputError that make(...) raises."""
    with pytest.raises(InputError) as error:
        make(*args, **fields)
    text = str(error.value)
    assert "\n" not in text and text.endswith(".") and ". " not in text.replace("e.g. ", "")
    return text


# --- wavelengths, which all three have ------------------------------------------------------

MAKE = {
    "cube": lambda w: HeatCube(S, w),
    "library": lambda w: MaterialLibrary(NAMES, w, E),
    "environment": lambda w: Environment(S[:, :2, 0].T, w),
}
WRONG_WAVELENGTHS = {
    "descending": (W[::-1], "ascend"),
    "repeated": (changed(W, 2, W[1]), "repeats"),
    "nanometres": (1000 * W, "nm"),
    "wavenumbers": (1e4 / W[::-1], "cm-1"),
    "NaN": (changed(W, 2, np.nan), "finite"),
    "infinite": (changed(W, 4, np.inf), "finite"),
    "negative": (W - 9, "positive"),
    "zero": (W - 8, "positive"),
    "two lists": (np.stack([W, W]), "one list"),
    "empty": ([], "one list"),
    "complex": (W + 0j, "real"),
    "text": ([str(w) for w in W], "real"),
    "ragged": ([8.0, [9.0], 10.0], "real"),
}


@pytest.mark.parametrize("make", MAKE)
@pytest.mark.parametrize("mistake", WRONG_WAVELENGTHS)
def test_wrong_wavelengths(make, mistake):
    w, word = WRONG_WAVELENGTHS[mistake]
    text = sentence(MAKE[make], w)
    assert word in text and text.startswith(make)


@pytest.mark.parametrize("make", MAKE)
def test_as_many_wavelengths_as_values(make):
    assert "4" in sentence(MAKE[make], W[:4])


# --- everything else ------------------------------------------------------------------------


@pytest.mark.parametrize(
    "change, word",
    [
        *((dict(radiance=S.astype(kind)), "real") for kind in (complex, str, bool)),
        (dict(radiance=S[:, 0]), "(5, 4)"),
        (dict(radiance=S[:, :0]), "(5, 0, 4)"),
        (dict(radiance=S.transpose(1, 2, 0)), "bands first"),
        (dict(radiance=changed(S, (MOST, 2, 3), np.nan)), "the first at 8 um, row 2, column 3"),
        (dict(radiance=changed(S, (MOST, 2, 3), np.inf)), "(inf)"),
        (dict(radiance=changed(S, (MOST, 2), 0)), "33% of its pixels are dead"),
        (dict(radiance=0 * S), "all of its pixels are zero"),
        (dict(radiance=changed(S, (EVERY, 2, 3), -1)), "(-1)"),
        (dict(fwhm_um=[0.1] * 4), "fwhm_um"),
        (dict(fwhm_um=0.1), "fwhm_um"),
        (dict(fwhm_um=[0.1, 0.1, -0.1, 0.1, 0.1]), "fwhm_um"),
        (dict(fwhm_um=[0.1, 0.1, np.nan, 0.1, 0.1]), "fwhm_um"),
        (dict(netd_k=0), "NETD"),
        (dict(netd_k=-0.05), "NETD"),
        (dict(netd_k=np.nan), "NETD"),
        (dict(netd_k=np.inf), "NETD"),
        (dict(netd_k=50), "not in mK"),
        *((dict(netd_k=netd), "NETD") for netd in ("0.05", True, [0.05])),
        (dict(fwhm_um=[100.0] * 5), "reaches 100"),
        (dict(fwhm_um=[0.1j] * 5), "real"),
    ],
)
def test_wrong_cubes(change, word):
    text = sentence(HeatCube, **{**dict(radiance=S, wavelength_um=W), **change})
    assert word in text and text.startswith("cube: ")


@pytest.mark.parametrize(
    "change, word",
    [
        (dict(names=("grass", "sky", "sky")), "two materials 'sky'"),
        (dict(names=("grass", "", "sky")), "empty"),
        (dict(names=(), emissivity=np.zeros((0, 5))), "no material"),
        (dict(names=("grass", "sky")), "(2, 5)"),
        (dict(emissivity=E.T), "(5, 3)"),
        (dict(emissivity=E[0]), "(5,)"),
        (dict(emissivity=changed(E, (1, 2), 1.01)), "glass"),
        (dict(emissivity=changed(E, (1, 2), -0.01)), "glass"),
        (dict(emissivity=changed(E, (2, 0), np.nan)), "sky"),
        (dict(emissivity=100 * E), "grass"),
        (dict(hue_deg=[0, 120]), "hue"),
        (dict(hue_deg=[0, 120, np.nan]), "hue"),
        (dict(albedo_rgb=np.full((2, 3), 0.5)), "albedo"),
        (dict(albedo_rgb=np.full((3, 3), 255)), "albedo"),
        (dict(albedo_rgb=changed(np.full((3, 3), 0.5), (0, 0), np.nan)), "albedo"),
        (dict(descriptions=("grass", "glass")), "descriptions"),
    ],
)
def test_wrong_libraries(change, word):
    fields = dict(names=NAMES, wavelength_um=W, emissivity=E)
    text = sentence(MaterialLibrary, **{**fields, **change})
    assert word in text and text.startswith("library: ")


@pytest.mark.parametrize(
    "change, word",
    [
        (dict(radiance=S[:, 0, 0]), "(5,)"),
        (dict(radiance=S[:, :, 0]), "(5, 3)"),
        (dict(radiance=np.zeros((0, 5))), "(0, 5)"),
        (dict(radiance=changed(S[:, :2, 0].T, (1, 2), 0)), "positive"),
        (dict(radiance=changed(S[:, :2, 0].T, (1, 2), -1)), "positive"),
        (dict(radiance=changed(S[:, :2, 0].T, (1, 2), np.nan)), "finite"),
        (dict(radiance=changed(S[:, :2, 0].T, (1, 2), np.inf)), "finite"),
        (dict(sky=(2,)), "sky"),
        (dict(sky=(-1,)), "sky"),
        *((dict(sky=sky), "sky") for sky in ((True,), (1.0,), ("0",), (0, 0), [[0], [1]])),
        (dict(radiance=1e9 * S[:, :2, 0].T), "hotter than 10000 K"),
        (dict(radiance=1j * S[:, :2, 0].T), "real"),
        (dict(spread=np.zeros((1, 4))), "spread"),
        (dict(spread=np.zeros(5)), "spread"),
        (dict(spread=np.full((1, 5), np.nan)), "spread"),
        (dict(curve_spread=np.zeros((1, 4))), "curve_spread"),
        (dict(sky_spread=np.zeros((1, 4))), "sky_spread"),
        (dict(sky_spread=np.zeros((1, 1, 5))), "sky_spread"),
        (dict(sky_mean=np.ones(4)), "sky_mean"),
        (dict(sky_mean=np.ones((1, 5))), "sky_mean"),
        (dict(sky_mean=changed(np.ones(5), 0, np.inf)), "sky_mean"),
        (dict(error_k=-0.1), "error_k"),
        (dict(error_k=np.nan), "error_k"),
        (dict(error_k=200.0), "error_k"),
        (dict(error_k=[0.1, 0.2]), "error_k"),
        (dict(error_k="x"), "error_k"),
        (dict(sky_mean=np.zeros(5)), "sky_mean must be positive"),
        (dict(within=np.ones((1, 5, 3))), "within must be (0 of the sky, 5 bands, n)"),
        (dict(sky=(0,), within=np.ones((1, 4, 3))), "within must be (1 of the sky, 5 bands, n)"),
        (dict(sky=(0,), within=np.ones((1, 5))), "within must be"),
        (dict(sky=(0,), within=np.zeros((1, 5, 3))), "within must be finite and positive"),
        (dict(sky=(0,), within=np.full((1, 5, 3), np.nan)), "within must be finite and positive"),
    ],
)
def test_wrong_environments(change, word):
    fields = dict(radiance=S[:, :2, 0].T, wavelength_um=W)
    text = sentence(Environment, **{**fields, **change})
    assert word in text and text.startswith("environment: ")


# --- immutable --------------------------------------------------------------------------------


def arguments():
    """A fresh, writeable set of arguments for each type."""
    rng = np.random.default_rng(0)
    return [
        (HeatCube, dict(radiance=np.array(S, np.float32), wavelength_um=np.array(W),
                        fwhm_um=np.full(5, 0.1), netd_k=0.05)),
        (MaterialLibrary, dict(names=list(NAMES), wavelength_um=np.array(W),
                               emissivity=np.array(E), hue_deg=np.array([0.0, 120, 240]),
                               albedo_rgb=rng.uniform(size=(3, 3)), descriptions=list("abc"))),
        (Environment, dict(radiance=np.array(S[:, :2, 0].T), wavelength_um=np.array(W),
                           sky=(0,), spread=rng.normal(size=(2, 5)), error_k=0.1,
                           sky_mean=rng.uniform(1, 2, 5), sky_spread=rng.normal(size=(1, 5)),
                           within=rng.uniform(1, 2, (1, 5, 3)))),
    ]  # fmt: skip


@pytest.mark.parametrize("which", range(3), ids=["cube", "library", "environment"])
def test_immutable_and_not_an_alias(which):
    """No array can be written through the object, nor through what the caller passed in."""
    make, fields = arguments()[which]
    made = make(**fields)
    before = {k: np.array(getattr(made, k)) for k in fields}
    for name, given_ in fields.items():
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(made, name, given_)
        held = getattr(made, name)
        if isinstance(given_, np.ndarray):
            np.testing.assert_allclose(held, given_, rtol=1e-6)
            assert not held.flags.writeable
            with pytest.raises(ValueError):
                held[...] = 0
            given_[...] = 1.0
        elif isinstance(given_, list):
            assert isinstance(held, tuple)
            given_[0] = 1 if name == "sky" else "changed"
    for name, value in before.items():
        np.testing.assert_array_equal(getattr(made, name), value)


@pytest.mark.parametrize("which", range(3), ids=["cube", "library", "environment"])
def test_a_copy_is_immutable_too(which):
    """As one that goes to another process is."""
    make, fields = arguments()[which]
    made = make(**fields)
    again = copy.deepcopy(made)
    for field in dataclasses.fields(made):
        held, was = getattr(again, field.name), getattr(made, field.name)
        np.testing.assert_array_equal(held, was)
        if isinstance(held, np.ndarray):
            assert not held.flags.writeable and held is not was


def test_defaults_cannot_be_written_either():
    for made in (HeatCube(S, W), MaterialLibrary(NAMES, W, E), Environment(S[:, :2, 0].T, W, (0,))):
        for field in dataclasses.fields(made):
            value = getattr(made, field.name)
            assert not isinstance(value, np.ndarray) or not value.flags.writeable, field.name


# --- HeatCube ---------------------------------------------------------------------------------


@given(st.integers(1, 900), st.integers(1, 900), st.integers(1, 3000))
def test_a_subsample_sees_every_column_alike(height, width, most):
    step = sampling_step((height, width), most)
    seen = np.bincount(np.arange(0, height * width, step) % width, minlength=width)
    assert seen.sum() >= min(most, height * width)
    assert np.ptp(seen) <= 1


def test_a_subsample_is_there_though_all_that_it_would_see_is_dead():
    """Every fifth pixel is dead, and every fifth would be looked at."""
    dead = (np.arange(100 * 101) % 5 == 0).reshape(100, 101)
    cube = HeatCube(np.full((3, *dead.shape), 9.0), [9.0, 10.0, 11.0], netd_k=0.05, dead=dead)
    at = cube.regular_pixels(1616)
    assert len(at) == 1616 and not dead.ravel()[at].any()


def test_a_few_warm_columns_are_not_the_scene():
    """320 columns and 3000 lines share many factors."""
    t = np.full((3000, 320), 285.0)
    t[:, [0, 160]] = 300.0
    w = np.array([9.0, 10.0, 11.0])
    cube = HeatCube(planck(w[:, None, None], t), w, netd_k=0.05)
    warm = brightness_temperature(w, cube.sample(6000)) > 290
    assert warm.mean() == pytest.approx(2 / 320, rel=0.1)


def test_views_of_a_cube_agree():
    s = planck(W[:, None, None], 280.0 + np.arange(12.0).reshape(3, 4))
    cube = HeatCube(s, W, netd_k=0.1)
    assert cube.bands == 5 and cube.shape == (3, 4) and cube.radiance.dtype == np.float32
    np.testing.assert_array_equal(cube.spectra[1 * 4 + 2], cube.radiance[:, 1, 2])
    np.testing.assert_allclose(cube.sigma, noise_sigma(W, 0.1))


def test_the_noise_of_a_cube_is_a_plain_number():
    """Which goes into JSON, whatever it was read from."""
    assert type(HeatCube(S[:, :2], W, netd_k=np.float32(0.05)).netd_k) is float


def test_noise_of_a_cube_that_does_not_know_it():
    assert "NETD" in sentence(lambda: HeatCube(S, W).sigma)
    assert "NETD" in sentence(HeatCube(S[:, :2], W).with_netd)


def low_dimensional(seed, netd, bands, dimensions, pixels_per_band):
    """A cube whose noiseless spectra span few dimensions, each pixel another mixture."""
    rng = np.random.default_rng(seed)
    w, side = np.linspace(8.0, 14.0, bands), int(np.ceil(np.sqrt(pixels_per_band * bands)))
    t = 285 + 8 * rng.normal(size=(dimensions, 1))
    share = rng.dirichlet(np.ones(dimensions), side * side)
    s = share @ planck(w, t) + rng.normal(size=(side * side, bands)) * noise_sigma(w, netd)
    return HeatCube(s.T.reshape(bands, side, side), w)


@settings(max_examples=20)
@given(
    st.integers(0, 2**31), st.floats(0.01, 1.0), st.integers(12, 80), st.integers(1, 4),
    st.integers(30, 60),
)  # fmt: skip
def test_netd_is_estimated_from_the_pixels(seed, netd, bands, dimensions, pixels_per_band):
    """Spectra that fill few dimensions: what is left is noise, whatever the picture shows."""
    cube = low_dimensional(seed, netd, bands, dimensions, pixels_per_band)
    assert cube.with_netd().netd_k == pytest.approx(netd, rel=0.15)
    np.testing.assert_array_equal(cube.with_netd().radiance, cube.radiance)


@pytest.mark.parametrize("bands", [16, 54])
def test_netd_of_a_small_picture(bands):
    cube = low_dimensional(0, 0.1, bands, 3, 5)
    assert cube.with_netd().netd_k == pytest.approx(0.1, rel=0.15)


@pytest.mark.parametrize("bands", [1, 4, 9])
def test_netd_of_few_bands(bands):
    """A smooth picture in few bands: neighbours differ by noise alone."""
    w = np.linspace(8.5, 13.5, bands)
    t = np.linspace(280.0, 300.0, 60)[:, None] + np.linspace(0, 5, 60)
    s = planck(w[:, None, None], t)
    s = s + np.random.default_rng(0).normal(size=s.shape) * noise_sigma(w, 0.1)[:, None, None]
    assert HeatCube(s, w).with_netd().netd_k == pytest.approx(0.1, rel=0.15)


@pytest.mark.parametrize("bands", [4, 9])
def test_netd_of_few_bands_of_a_picture_half_of_which_is_leaves(bands):
    """What is calm tells the noise."""
    w, rng = np.linspace(8.5, 13.5, bands), np.random.default_rng(1)
    t = np.full((60, 60), 290.0)
    t[:30] += rng.uniform(-10, 10, (30, 60))
    s = planck(w[:, None, None], t)
    s = s + rng.normal(size=s.shape) * noise_sigma(w, 0.1)[:, None, None]
    assert 0.09 < HeatCube(s, w).with_netd().netd_k < 0.2


@pytest.mark.parametrize("bands", [4, 20])
def test_netd_of_a_cube_without_noise_is_the_least(bands):
    w = np.linspace(8, 14, bands)
    cube = HeatCube(np.broadcast_to(planck(w, 300.0)[:, None, None], (bands, 20, 20)), w)
    assert cube.with_netd().netd_k == pytest.approx(1e-3)


def test_known_netd_is_kept():
    cube = HeatCube(S, W, netd_k=0.123)
    assert cube.with_netd() is cube


# --- MaterialLibrary --------------------------------------------------------------------------


def test_names_and_sky():
    library = MaterialLibrary(NAMES, W, E)
    assert len(library) == 3 and library.sky_index == 2 and library.index("glass") == 1
    assert library.subset(["glass", "grass"]).sky_index is None
    text = sentence(library.index, "glas")
    assert "glas" in text and "grass, glass, sky" in text


@given(st.integers(0, 2**31), st.integers(2, 30))
def test_interpolation_is_linear_and_bounded(seed, n):
    """Exact at the given wavelengths, the mean half way between, never beyond its neighbours."""
    rng = np.random.default_rng(seed)
    w = np.sort(rng.uniform(7, 15, n))
    assume(np.diff(w).min() > 1e-6)
    library = MaterialLibrary(["a", "b"], w, rng.uniform(size=(2, n)))
    np.testing.assert_allclose(library.at(w), library.emissivity, atol=1e-12)
    middle = 0.5 * (w[1:] + w[:-1])
    mean = 0.5 * (library.emissivity[:, 1:] + library.emissivity[:, :-1])
    np.testing.assert_allclose(library.at(middle), mean, atol=1e-9)


def test_no_curve_is_made_up_where_there_is_none():
    library = MaterialLibrary(NAMES, W, E)
    for w in ([7.9, 10.0], [10.0, 14.1]):
        assert "cover 8-14 um" in sentence(library.at, w)


def test_subset_keeps_order_and_all_that_belongs_to_a_material():
    _, fields = arguments()[1]
    library = MaterialLibrary(**fields)
    part = library.subset(["sky", "grass"])
    assert part.names == ("sky", "grass") and part.descriptions == ("c", "a")
    for name in ("emissivity", "hue_deg", "albedo_rgb"):
        np.testing.assert_array_equal(getattr(part, name), getattr(library, name)[[2, 0]])
    assert "moss" in sentence(library.subset, ["grass", "moss"])
    assert "two materials" in sentence(library.subset, ["grass", "grass"])


@given(st.permutations(range(30)))
def test_permuting_the_library_there_and_back(order):
    library = MaterialLibrary.starter()
    names = [library.names[i] for i in order if i < len(library)]
    back = library.subset(names).subset(library.names)
    assert back.names == library.names and back.descriptions == library.descriptions
    np.testing.assert_array_equal(back.emissivity, library.emissivity)
    np.testing.assert_array_equal(back.hue_deg, library.hue_deg)
    np.testing.assert_array_equal(back.albedo_rgb, library.albedo_rgb)


ROW = {"name": "grass", "emissivity": [0.9, 0.95]}


@pytest.mark.parametrize(
    "text, word",
    [
        ("", "JSON"),
        ("{", "JSON"),
        ("[]", "must be an object"),
        ("3", "must be an object"),
        ("{}", "materials"),
        ('{"wavelength_um": [8, 14]}', "materials"),
        (json.dumps({"materials": [ROW]}), "wavelength_um"),
        (json.dumps({"wavelength_um": [8, 14], "materials": []}), "no material"),
        (json.dumps({"wavelength_um": [8, 14], "materials": {"grass": [0.9, 0.95]}}), "a list of"),
        (json.dumps({"wavelength_um": [8, 14], "materials": [{"name": "grass"}]}), "emissivity"),
        (json.dumps({"wavelength_um": [14, 8], "materials": [ROW]}), "ascend"),
        (json.dumps({"wavelength_um": [8, 10, 14], "materials": [ROW]}), "3 numbers"),
        (json.dumps({"wavelength_um": [8, 14], "materials": [ROW, ROW]}), "two materials"),
        (json.dumps({"wavelength_um": ["8 um", 14], "materials": [ROW]}), "real numbers"),
    ],
)
def test_wrong_library_files(tmp_path, text, word):
    path = tmp_path / "library.json"
    path.write_text(text)
    with pytest.raises(InputError, match="^library: ") as error:
        MaterialLibrary.load(path)
    assert word in str(error.value) and "\n" not in str(error.value)


def test_library_file_that_cannot_be_read(tmp_path):
    assert "gone.json" in sentence(MaterialLibrary.load, tmp_path / "gone.json")
    (tmp_path / "binary.json").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(InputError, match="JSON"):
        MaterialLibrary.load(tmp_path / "binary.json")


def test_library_file(tmp_path):
    path = tmp_path / "library.json"
    rows = [dict(ROW, hue_deg=100, description="lawn"), dict(ROW, name="sky")]
    path.write_text(json.dumps({"wavelength_um": [8, 14], "materials": rows}))
    library = MaterialLibrary.load(path)
    assert library.names == ("grass", "sky") and library.sky_index == 1
    np.testing.assert_array_equal(library.emissivity, [[0.9, 0.95]] * 2)


# --- Environment ------------------------------------------------------------------------------


def test_light_within_bands_has_the_mean_that_is_stated():
    s = S[:, :2, 0].T
    nodes = quadrature(W, np.full(5, 1.0))
    shape = np.random.default_rng(0).uniform(0.5, 1.5, (1, *nodes.shape))
    light = Environment(s, W, (1,), within=shape).at_nodes(nodes)
    np.testing.assert_allclose(light.mean(axis=-1), s)
    np.testing.assert_allclose(light[1] / light[1, :, :1], shape[0] / shape[0, :, :1])
    black = planck(nodes, brightness_temperature(W, s[0])[:, None])
    np.testing.assert_allclose(light[0] / light[0, :, :1], black / black[:, :1])
    # of as many parts of narrower bands, in between
    few = quadrature(W, np.full(5, 0.5))
    light = Environment(s, W, (1,), within=shape).at_nodes(few)
    pairs = shape[0].reshape(*few.shape, 2).mean(axis=-1)
    np.testing.assert_allclose(light[1] / light[1, :, :1], pairs / pairs[:, :1])
    np.testing.assert_array_equal(Environment(s, W).at_nodes(W[:, None])[..., 0], s)
    # a sky of which nothing is told is even
    light = Environment(s, W, (1,)).at_nodes(nodes)
    np.testing.assert_allclose(light[1], np.broadcast_to(s[1][:, None], nodes.shape))


def test_sky_of_an_environment():
    """What lights a scene need not be in view."""
    s = S[:, :2, 0].T * [[0.5], [1.0]]
    for sky in ((), (0,), (0, 1)):
        above = Environment(s, W, sky)
        assert above.sky == sky and above.sky_mean is None
    np.testing.assert_array_equal(Environment(s, W, (0,), sky_mean=2 * s[0]).sky_mean, 2 * s[0])
    none = Environment(s, W)
    assert none.sky == ()
    assert len(none) == 2 and none.spread.shape == none.sky_spread.shape == (0, 5)


def test_radiance_in_microflicks_is_noticed():
    w = np.array([9.0, 10.0, 11.0])
    s = planck(w, 290.0)[:, None, None] * np.ones((3, 2, 2))
    HeatCube(s, w)
    assert "microflick" in sentence(HeatCube, 100 * s, w)


def test_what_one_material_leaves_out_the_others_keep(tmp_path):
    rows = [
        {"name": "a", "emissivity": [0.9, 0.8], "hue_deg": 200, "albedo_rgb": [0.1, 0.2, 0.3]},
        {"name": "b", "emissivity": [0.7, 0.8], "description": "measured"},
    ]
    file = tmp_path / "l.json"
    file.write_text(json.dumps({"wavelength_um": [8, 14], "materials": rows}))
    library = MaterialLibrary.load(file)
    np.testing.assert_array_equal(library.hue_deg, [200, 20])
    np.testing.assert_array_equal(library.albedo_rgb, [[0.1, 0.2, 0.3], [0.4, 0.4, 0.4]])
    assert library.descriptions == ("", "measured")


@given(st.permutations(["sky", "water", "material_1", "material_2", "rock", "leaf"]))
def test_known_names_keep_the_starter_s_hue_and_no_other_comes_near(names):
    library = MaterialLibrary(names, [8, 14], np.full((6, 2), 0.9))
    hue, starter = dict(zip(names, library.hue_deg, strict=True)), MaterialLibrary.starter()
    for name in ("sky", "water"):
        assert hue.pop(name) == starter.hue_deg[starter.index(name)]
    near = np.abs((library.hue_deg[:, None] - list(hue.values()) + 180) % 360 - 180)
    assert (np.sort(near, axis=0)[1] > 360 / 6).all()  # the next, itself being the first


def test_hues_that_nobody_knows_are_spread_evenly():
    library = MaterialLibrary(["a", "b", "c"], [8, 14], np.full((3, 2), 0.9))
    np.testing.assert_array_equal(library.hue_deg, [0, 120, 240])


@pytest.mark.parametrize(
    "change, words",
    [
        ({"emissivity": [0.9, 0.8, 0.7]}, "emissivity of b must be 2 numbers, one for each"),
        ({"emissivity": [0.9, "0.8"]}, "emissivity of b must be a list of numbers"),
        ({"emissivity": 0.9}, "emissivity of b must be a list of numbers"),
        ({"hue_deg": "red"}, "hue_deg of b must be a number, got .red"),
        ({"albedo_rgb": [0.1, 0.2]}, "albedo_rgb of b must be three numbers"),
        ({"hue": 3}, "'hue' of b is not known; besides its emissivity it may have hue_deg, albedo"),
        ({"emissivity": [0.9, 80]}, "emissivity of b is 80 at 14 um.*divide by 100 if"),
        (
            {"emissivity": [-0.2, 0.8]},
            r"emissivity of b is -0.2 at 8 um; it must lie within 0..1\.",
        ),
        ({"emissivity": [0.9, float("nan")]}, "emissivity of b is nan at 14 um"),
        ({"name": "a"}, "two materials 'a'"),
        ({"name": ""}, "empty name"),
        ({"name": None}, "the name of a material must be text, got null"),
    ],
)
def test_what_is_wrong_with_a_library_file_is_named(tmp_path, change, words):
    rows = [{"name": "a", "emissivity": [0.9, 0.8]}, {"name": "b", "emissivity": [0.7, 0.8]}]
    rows[1] |= change
    file = tmp_path / "l.json"
    file.write_text(json.dumps({"wavelength_um": [8, 14], "materials": rows}))
    said = sentence(MaterialLibrary.load, file)
    assert said.startswith(f"library: {file}: ") and re.search(words, said)


def test_a_library_that_is_no_json_is_told_how_to_become_one(tmp_path):
    file = tmp_path / "l.csv"
    file.write_text("wavelength_um,water\n8,0.98\n14,0.95\n")
    assert "texnet library import" in sentence(MaterialLibrary.load, file)


def test_a_masked_array_is_refused():
    s = np.ma.masked_array(np.full((2, 3, 4), 8.0))
    assert HeatCube(s, [10.0, 11.0]).bands == 2
    s[0, 1, 1] = np.ma.masked
    with pytest.raises(InputError, match="must not be masked"):
        HeatCube(s, [10.0, 11.0])


def test_what_is_looked_at_in_a_notebook_says_what_it_is():
    e = Environment(np.ones((2, 3)), [8.0, 9.0, 10.0], sky=(0,))
    assert repr(e) == "<Environment of 2 objects, of which sky 0, 3 bands at 8-10 um>"
    truth = made_up.truth(4, 6)
    assert repr(truth).startswith("<Truth of 4 x 6 pixels: ") and "\n" not in repr(truth)
    assert all(
        name in repr(truth) for name in np.unique(np.array(truth.material_names)[truth.material])
    )
