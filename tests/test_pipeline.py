"""Cube in, decomposition out, on path-traced cubes: every field, every k, few bands, texture."""

import functools
from dataclasses import replace

import numba
import numpy as np
import pytest
from scipy.ndimage import maximum_filter, minimum_filter
from traced import averaged, names_of, one_thread, scene_of, traced  # noqa: F401

import texnet.circumstances
import texnet.solver
from benchmarks import ONNX
from physics import Environment, HeatCube, InputError, MaterialLibrary
from physics.bands import equidistant_bands, quadrature
from physics.cube.heat_cube import LEAST_NETD_K
from physics.eq1 import render
from physics.estimate import estimate_environment
from physics.known import known_arrays
from physics.planck import brightness_temperature, noise_sigma, planck
from physics.simulator import simulate
from texnet.baselines import baseline_pictures
from texnet.learned import torch_model
from texnet.methods import METHODS
from texnet.metrics import texture_scores
from texnet.pipeline import decompose
from texnet.progress import COMPILING, compiling
from texnet.runtime import Runtime

LIBRARY = MaterialLibrary.starter()
SMALL = dict(size=(20, 30), spp=8)


@functools.cache
def answer(method="sgd", k=5, bands=54, every=1):
    """A Decomposition of a small `patterned` cube, or one of every so many pixels, and the cube."""
    cube = traced("patterned", 54, **SMALL)[0]
    s = cube.radiance[:, ::every, ::every]
    cube = HeatCube(s, cube.wavelength_um, cube.fwhm_um, cube.netd_k)
    cube = cube if bands == 54 else averaged(cube, bands)
    return decompose(cube, LIBRARY, method=method, k=k), cube


def check_fields(d, cube, k):
    """Every field as `Decomposition` documents it."""
    shape, bands = cube.shape, cube.bands
    f32, maps = np.float32, lambda *lead: (*lead, *shape)
    for name, kind, size in [
        ("temperature_k", f32, maps()), ("material", np.int16, maps()),
        ("thermal_lighting", f32, maps(k)), ("environment", float, (k, bands)),
        ("texture", f32, maps(bands)), ("sky_texture", f32, maps()), ("residual", f32, maps()),
        ("temperature_sigma_k", f32, maps()),
        ("material_probability", f32, maps(len(LIBRARY))), ("unknown", bool, maps()),
        ("wavelength_um", float, (bands,)), ("hue_deg", float, (len(LIBRARY),)),
    ]:  # fmt: skip
        value = getattr(d, name)
        assert value.dtype == kind and value.shape == size, name
        assert np.isfinite(value).all(), name
    assert d.material_names == LIBRARY.names
    assert (d.material >= 0).all() and (d.material < len(LIBRARY)).all()
    sky = names_of(d) == "sky"
    assert (d.thermal_lighting >= 0).all()
    total = d.thermal_lighting.sum(axis=0)
    np.testing.assert_allclose(total[~sky], 1, atol=1e-5)
    empty = total < 0.5  # nothing stands before the sky
    assert (sky | ~empty).all()
    np.testing.assert_allclose(total[empty], 0, atol=1e-5)
    assert (d.material_probability >= 0).all()
    np.testing.assert_allclose(d.material_probability.sum(axis=0), 1, atol=1e-5)
    assert (d.temperature_sigma_k > 0).all() and (d.residual >= 0).all()
    assert (d.texture[:, empty] == 0).all() and (d.sky_texture[empty] == 0).all() | (not d.sky)
    t_b = brightness_temperature(cube.wavelength_um, cube.spectra).mean(axis=1)
    assert d.temperature_k.min() > t_b.min() - 60 and d.temperature_k.max() < t_b.max() + 90


@pytest.mark.parametrize("method", METHODS)
def test_every_field(method):
    d, cube = answer(method)
    check_fields(d, cube, 5)
    assert d.netd_k == max(cube.netd_k, LEAST_NETD_K)
    solving = {"net": "network", "net+sgd": "network"}.get(method, "local")
    assert {"bands", "environment", "calibration", solving} <= set(d.seconds)
    assert (d.objective != ()) == (method == "sgd")
    if d.objective:
        assert (np.diff(d.objective) <= 1e-6 * abs(d.objective[0])).all()


@pytest.mark.parametrize("k", range(1, 11))
def test_every_number_of_objects(k):
    d, cube = answer("sgd", k, 9, every=2)
    check_fields(d, cube, k)
    assert d.netd_k == max(cube.netd_k, LEAST_NETD_K)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("bands", [1, 2, 3, 4, 9])
def test_every_number_of_bands(method, bands):
    d, cube = answer(method, 5, bands)
    check_fields(d, cube, 5)
    assert d.netd_k == max(cube.netd_k, LEAST_NETD_K)


def test_doubt_grows_as_bands_get_fewer():
    """The same light in fewer, wider bands: less is known of T, and sigma says so."""
    true = traced("patterned", 54, **SMALL)[1].material
    inner = minimum_filter(true, 5) == maximum_filter(true, 5)  # edges have a doubt of their own
    ground = inner & (names_of(traced("patterned", 54, **SMALL)[1]) != "sky")
    sigma = [
        np.median(answer("sgd", 5, bands)[0].temperature_sigma_k[ground]) for bands in (54, 9, 4)
    ]
    assert (np.diff(sigma) > 0).all(), sigma
    few = [np.median(answer("sgd", 5, bands)[0].temperature_sigma_k[ground]) for bands in (3, 2, 1)]
    assert min(few) > 1.5 * sigma[0], few


@pytest.mark.parametrize("bands", [54, 9, 4, 3])
@pytest.mark.parametrize("method", ["local", "net+sgd"])
def test_the_answer_rendered_by_eq1_is_the_measurement(method, bands):
    """T, m and X of pure ground pixels, put into Eq. 1 with the light of the environment's objects
    within each band, miss S by about the residual reported."""
    d, cube = answer(method, bands=bands)
    nodes = quadrature(cube.wavelength_um, cube.fwhm_um)
    curves = LIBRARY.at(nodes.ravel()).reshape(-1, *nodes.shape)
    np.testing.assert_allclose(d.emissivity, curves.mean(axis=-1))
    ground = (names_of(d) != "sky") & (d.residual < 1.5)
    assert ground.mean() > 0.5
    t, e = d.temperature_k[ground].astype(float), curves[d.material[ground]]
    v, x = d.thermal_lighting[:, ground].T.astype(float), d.texture[:, ground].T
    environment = estimate_environment(cube.with_netd(), LIBRARY, 5)
    np.testing.assert_allclose(environment.radiance, d.environment, rtol=1e-4)
    within = np.tensordot(v, environment.at_nodes(nodes), 1)
    within += (x - v @ d.environment)[..., None]
    s = (e * planck(nodes, t[:, None, None]) + (1 - e) * within).mean(axis=-1)
    r = (cube.radiance[:, ground].T - s) / noise_sigma(cube.wavelength_um, d.netd_k)
    rms = np.sqrt((r**2).mean(axis=1))
    assert np.median(np.abs(rms - d.residual[ground])) < 0.02
    assert np.median(rms) < 1.5
    # and without the surroundings' deviation, X is V S
    _, texture = render(t, e, v, d.environment, nodes)
    assert np.corrcoef(texture.ravel(), x.ravel())[0, 1] > 0.95


def test_texture_is_nearer_the_truth_than_any_picture_people_look_at_today():
    """Sky-lit texture of a scene whose temperature pattern hides it from a thermal camera."""
    cube, truth = traced("patterned", 24, (48, 72), 32)
    d = decompose(cube, LIBRARY)
    score = lambda picture: texture_scores(picture, truth)["correlation"]
    pictures = [p for of in baseline_pictures(cube).values() for p in of]
    # a picture's sign is the viewer's to choose
    theirs = [abs(score(p)) for p in pictures]
    ours = score(d.sky_texture)
    assert ours > 0.5
    assert ours > max(theirs) + 0.05, (ours, theirs)
    gradient = lambda picture: texture_scores(picture, truth)["gradient_correlation"]
    assert gradient(d.sky_texture) > max(abs(gradient(p)) for p in pictures)


def test_four_times_as_many_bands_tell_as_much():
    """Each a quarter as wide, with twice the noise."""
    w, fwhm = equidistant_bands(200, 7.55, 12.0)
    many, truth = simulate(
        scene_of("patches", 12), wavelength_um=w, fwhm_um=fwhm, size=(48, 72), spp=16
    )
    right = [
        (names_of(decompose(cube)) == names_of(truth)).mean() for cube in (many, averaged(many, 50))
    ]
    assert right[0] > right[1] - 0.03


@pytest.mark.parametrize("method", METHODS)
def test_the_same_seed_gives_the_same_answer(method):
    a, cube = answer(method, 5, 9, every=2)
    b = decompose(cube, LIBRARY, method=method, k=5)
    for name in ("temperature_k", "material", "thermal_lighting", "texture", "sky_texture",
                 "temperature_sigma_k", "material_probability", "unknown"):  # fmt: skip
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), name)


def test_a_given_environment_is_used_as_it_is(monkeypatch):
    _, cube = answer("sgd", 5, 9)
    w = cube.wavelength_um
    given = Environment(planck(w, np.array([[230.0], [260.0], [289.0]])), w, (0,))

    def never(*args, **kwargs):
        raise AssertionError("estimated an environment though one was given")

    for name in ("estimate_environment", "Sample"):
        monkeypatch.setattr(texnet.circumstances, name, never)
    d = decompose(cube, LIBRARY, environment=given)
    np.testing.assert_array_equal(d.environment, given.radiance)
    assert d.sky == (0,) and len(d.thermal_lighting) == 3
    with pytest.raises(InputError, match="has its own k"):
        decompose(cube, LIBRARY, environment=given, k=7)
    with pytest.raises(InputError, match="local uses no network"):
        decompose(cube, LIBRARY, method="local", model=never)


@pytest.mark.parametrize(
    "fields, word",
    [
        (dict(method="magic"), "local, sgd"),
        (dict(method=None), "local, sgd"),
        (dict(k=0), "whole number 1..10"),
        (dict(k=11), "whole number 1..10"),
        *((dict(k=k), "whole number 1..10") for k in (2.5, "5", True, float("nan"))),
        *((dict(seed=seed), "seed") for seed in (-1, 2**40, 1.5, None, True)),
        (dict(k=-1), "whole number 1..10"),
    ],
)
def test_wrong_options(fields, word):
    with pytest.raises(InputError, match=word):
        decompose(answer("sgd", 5, 9)[1], LIBRARY, **fields)


@pytest.mark.parametrize("low, high", [(9.0, 14.5), (7.5, 13.0)])
@pytest.mark.parametrize("sky", [True, False])
@pytest.mark.parametrize("given", [True, False])
@pytest.mark.parametrize("method", ["sgd", "net+sgd"])
def test_a_library_that_does_not_reach_is_refused_before_the_work(
    monkeypatch, low, high, sky, given, method
):
    _, cube = answer("sgd", 5, 9)
    w = np.linspace(low, high, 20)
    names = ["grass", "water", "sky" if sky else "soil"]
    short = MaterialLibrary(names, w, LIBRARY.at(w)[:3])
    environment = Environment(planck(cube.wavelength_um, 285.0)[None], cube.wavelength_um)

    def never(*args, **kwargs):
        raise AssertionError("worked first, complained later")

    monkeypatch.setattr(texnet.solver, "solve_local", never)
    with pytest.raises(InputError, match="cover .* um but the bands need"):
        decompose(cube, short, method=method, environment=environment if given else None)


@pytest.mark.parametrize("method", ["sgd", "net+sgd"])
def test_an_environment_of_other_bands_is_refused(method):
    _, cube = answer("sgd", 5, 9)
    w = np.linspace(8.0, 14.0, 7)
    other = Environment(planck(w, np.array([[250.0], [289.0]])), w, (0,))
    try:
        decompose(cube, LIBRARY, method=method, environment=other)
    except InputError as error:
        assert "environment" in str(error)
    else:
        pytest.fail("took an environment of 7 bands for a cube of 9")


def test_noise_that_is_not_known_is_estimated():
    _, cube = answer("sgd", 5, 54)
    blind = HeatCube(cube.radiance, cube.wavelength_um, cube.fwhm_um)
    assert decompose(blind, LIBRARY, method="local").netd_k == pytest.approx(0.05, rel=0.3)


def test_progress_is_reported_to_the_end():
    _, cube = answer("sgd", 5, 4)
    seen = []
    decompose(cube, LIBRARY, method="sgd", progress=lambda *a: seen.append(a))
    seen = [a for a in seen if a[2] != COMPILING]
    assert {what for *_, what in seen} == {"local", "smooth"}
    assert max(done / total for done, total, what in seen if what == "local") == 1
    assert all(0 < done <= total for done, total, _ in seen)
    seen.clear()
    decompose(cube, LIBRARY, method="net+sgd", progress=lambda *a: seen.append(a))
    assert seen[-1][0] == seen[-1][1] and {what for *_, what in seen} == {"network"}


def test_compiling_is_announced_where_it_happens():
    """Not where it has been done, or its result lies on disk."""
    seen, double = [], numba.njit(lambda x: 2 * x)
    for _ in range(2):
        with compiling(lambda *a: seen.append(a)):
            double(1)
    assert seen == [(0, 1, COMPILING)]
    with compiling(None):
        double(1.0)


def test_few_bands_make_it_doubt_its_materials():
    """Neighbours cannot know what no pixel knows: one band tells hardly any material."""
    doubt = [answer("sgd", 5, bands)[0].unknown.mean() for bands in (54, 4, 1)]
    assert doubt[0] < doubt[1] < doubt[2]
    assert doubt[2] > 0.7


@pytest.mark.parametrize("method", METHODS)
def test_what_is_all_of_one_temperature_is_unknown(method):
    """Thermal crossover: where all is as warm as its surroundings, S = B(T), whatever e is."""
    w = np.linspace(8, 14, 20)
    noise = noise_sigma(w, 0.05)[:, None, None] * np.random.default_rng(0).normal(size=(20, 24, 32))
    d = decompose(HeatCube(planck(w, 290.0)[:, None, None] + noise, w, None, 0.05), method=method)
    assert d.unknown.mean() > 0.95
    assert np.abs(d.temperature_k - 290).max() < 1


@pytest.mark.parametrize("method", ["local", "net+sgd"])
@pytest.mark.parametrize("name", ["room", "forest"])
def test_less_noise_than_the_model_is_good_to_makes_no_answer_worse(method, name):
    """What all materials fit better than noise would let them is not evidence of black ones."""
    w, fwhm = equidistant_bands(36)
    right, surely_wrong, off = [], [], []
    for netd_k in (LEAST_NETD_K, 0.003):
        cube, truth = simulate(
            scene_of(name), wavelength_um=w, fwhm_um=fwhm, size=(48, 72), spp=16, netd_k=netd_k
        )
        d = decompose(cube, method=method)
        assert d.netd_k == LEAST_NETD_K
        same = names_of(d) == names_of(truth)
        right.append(same.mean())
        surely_wrong.append((~same & ~d.unknown).mean())
        off.append(np.abs(d.temperature_k - truth.temperature_k).mean())
    assert right[1] > right[0] - 0.02 and off[1] < 1.05 * off[0], (right, off)
    assert surely_wrong[1] < surely_wrong[0] + 0.02


@pytest.mark.parametrize("wrong", [np.ones((5, 54)), "sky", 3])
def test_an_environment_of_another_type_gets_a_sentence(wrong):
    with pytest.raises(InputError, match="environment must be an Environment"):
        decompose(answer("local", 2, 9)[1], environment=wrong)


@pytest.mark.parametrize("hot_k", [900.0, 1500.0])
def test_a_fire_does_not_blur_all_else(hot_k):
    """A pixel far hotter than all others leaves their answers nearly as they are: what it may light
    is little."""
    d, cube = answer("net+sgd", 5, 24)
    s = cube.radiance.copy()
    s[:, 3, 3] = planck(cube.wavelength_um, hot_k)
    burning = HeatCube(s, cube.wavelength_um, cube.fwhm_um, cube.netd_k)
    burning = decompose(burning, LIBRARY, k=5)
    same = burning.material == d.material
    assert same.mean() > 0.97
    assert abs(burning.unknown.mean() - d.unknown.mean()) < 0.02
    off = np.abs(burning.temperature_k - d.temperature_k)[same]
    assert np.median(off / d.temperature_sigma_k[same]) < 0.15


@pytest.mark.parametrize("size", [(8, 8), (40, 40)])
def test_what_is_far_hotter_is_solved_apart_and_leaves_the_rest(size, make_pixels):
    """A twentieth of the picture at 1200 K, far beyond the network's series of B(T)."""
    scene = make_pixels(bands=24, shape=size)
    s = scene.cube.radiance.copy()
    hot = np.random.default_rng(0).permutation(size[0] * size[1])[: size[0] * size[1] // 20]
    s.reshape(24, -1)[:, hot] = planck(scene.wavelength, 1200.0)[:, None]
    cube = HeatCube(s, scene.wavelength, netd_k=0.05)
    d = decompose(cube, scene.library, environment=scene.environment)
    burns = np.isin(np.arange(size[0] * size[1]), hot).reshape(size)
    off = np.abs(d.temperature_k - scene.temperature.reshape(size))
    assert np.array_equal(d.hot, burns) and np.median(off[~burns]) < 1.0
    assert np.abs(d.temperature_k[burns] - 1200).max() < 60


def test_what_is_no_cube_or_library_is_refused(make_pixels):
    cube = make_pixels(bands=9, shape=(6, 8)).cube
    for wrong in ("night.exr", cube.radiance):
        with pytest.raises(InputError, match="cube must be a HeatCube, as texnet.read_cub"):
            decompose(wrong)
    with pytest.raises(InputError, match="library must be a MaterialLibrary"):
        decompose(cube, "lib.json")
    with pytest.raises(InputError, match="net needs one that takes refined=False"):
        decompose(cube, method="net", model=Runtime(ONNX).run)
    with pytest.raises(InputError, match="model must be a function, .* got str"):
        decompose(cube, model="texnet.onnx")
    with pytest.raises(InputError, match="names must be a list"):
        MaterialLibrary.starter().subset("water")


@pytest.mark.parametrize(
    "model", [torch_model(), functools.partial(torch_model(), refined=False), Runtime(ONNX).run]
)
def test_what_is_no_number_is_never_trusted(make_pixels, model):
    """What looks around, sees it; noise of a billionth of a kelvin makes all of it so."""
    scene = make_pixels(bands=9, shape=(6, 8))
    known = known_arrays(scene.cube, scene.library, scene.environment)
    radiance = scene.cube.radiance.copy()
    radiance[:, 2, 3] = np.nan
    maps = model(radiance, known)
    number = np.isfinite(maps["temperature_k"])
    assert not number[2, 3] and maps["unknown"][~number].all()
    cube = HeatCube(scene.cube.radiance, scene.wavelength, netd_k=1e-9)
    with pytest.raises(InputError, match="sigma is too small"):
        model(cube.radiance, known_arrays(cube, scene.library, scene.environment))


@pytest.mark.parametrize("method", METHODS)
def test_less_noise_than_k_objects_leave_out_is_taken_for_as_much(make_pixels, method):
    """Not even a billionth of a kelvin, which would overflow what is divided by it."""
    scene = make_pixels(bands=9, shape=(6, 8))
    exact = replace(scene.environment, error_k=0.0)  # else the noise decides what scatters
    of = {
        netd_k: decompose(
            HeatCube(scene.cube.radiance, scene.wavelength, netd_k=netd_k), scene.library,
            environment=exact, method=method,
        )
        for netd_k in (1e-9, 0.01, 0.02)
    }  # fmt: skip
    apart_k = 0.1 if method == "net" else 1e-3  # its T is a mean over materials
    for netd_k, d in of.items():
        np.testing.assert_allclose(d.temperature_k, of[0.02].temperature_k, atol=apart_k)
        assert np.isfinite(d.temperature_k).all() and d.netd_k >= 0.02
        assert d.noise_raised == pytest.approx(d.netd_k / netd_k)
