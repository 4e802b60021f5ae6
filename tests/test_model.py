"""TeXModel: evidence, network, refinement and texture together, on cubes of Eq. 1.

The network is untrained: what it adds to the evidence is small, or random where said. Cubes
are of the k-object model; they test that the parts fit, never accuracy.
"""

from dataclasses import replace

import numpy as np
import pytest
import torch
from test_evidence import World, arrays_of, dense, scene, sky_pixels
from test_network import network, predict
from test_refinement import cost
from torch.fx.experimental import _config
from traced import one_thread, traced  # noqa: F401

import texnet.model
from physics import Environment, HeatCube, InputError, MaterialLibrary
from physics.estimate import estimate_environment
from physics.known import known_arrays
from physics.planck import planck
from physics.refinement import GUESS_PRECISION, STEPS, TYPICAL_K
from texnet.learned import torch_model
from texnet.model import CLOSE_NATS, TeXModel
from texnet.uncertainty import NET_OTHER_K

SHAPE = (12, 15)


def blocks_of(materials, shape=SHAPE):
    y, x = np.indices(shape)
    return np.array(materials)[(y // 4 * 5 + x // 3).ravel() % len(materials)]


def world_of(seed=0, shape=SHAPE, **more):
    """Regions of materials well apart, in a library with the sky second."""
    more = {"depth": (0.3, 0.6), "material": blocks_of([0, 2, 3, 4, 5], shape), **more}
    return World(seed=seed, shape=shape, **more)


def sky_is_likelier(world, rows=3):
    """The same cube with a clear sky in its first rows; and which pixels are sky."""
    s, n = world.spectra.copy(), rows * world.shape[1]
    s[:n] = sky_pixels(world, n, np.random.default_rng(9))
    sky = np.zeros(world.shape, bool)
    sky[:rows] = True
    return world.cube_of(s), sky


def answer(known, cube, net=None, steps=STEPS):
    model = TeXModel(network() if net is None else net, steps)
    return model(scene(known), torch.from_numpy(cube.radiance.copy()))


def assert_sound(tex, materials, k, bands, shape):
    assert tex.material_probability.shape == (materials, *shape)
    assert tex.thermal_lighting.shape == (k, *shape) and tex.texture.shape == (bands, *shape)
    for name, x in zip(tex._fields, tex, strict=True):
        assert torch.isfinite(x).all(), name
        assert x.shape[-2:] == shape, name
    torch.testing.assert_close(
        tex.material_probability.sum(0), torch.ones(shape), atol=1e-5, rtol=0
    )
    assert (tex.material_probability >= 0).all() and (tex.thermal_lighting >= 0).all()
    total = tex.thermal_lighting.sum(0)  # nothing lights a clear sky
    torch.testing.assert_close(total, (total > 0.5).float(), atol=1e-5, rtol=0)
    assert (tex.temperature_sigma_k > 0).all() and (tex.residual >= 0).all()
    assert tex.unknown.dtype == torch.bool and tex.material.dtype == torch.int64


@pytest.mark.parametrize("steps", [0, STEPS])
def test_ground_is_lit_by_the_objects_and_sky_by_nothing(steps):
    world = world_of()
    cube, sky = sky_is_likelier(world)
    tex = answer(world.known(), cube, steps=steps)
    assert_sound(tex, 6, 3, world.bands, SHAPE)
    assert (tex.material.numpy()[sky] == world.library.sky_index).all()
    assert (tex.material.numpy().ravel() == world.material)[~sky.ravel()].mean() > 0.95
    lit = tex.thermal_lighting.sum(0).numpy()
    np.testing.assert_allclose(lit[~sky], 1, atol=1e-5)
    clear = lit < 0.5
    assert clear[sky].mean() > 0.9 and not clear[~sky].any()
    assert (tex.texture.numpy()[:, clear] == 0).all()
    assert (tex.sky_texture.numpy()[clear] == 0).all()
    # the air is as warm as its opaque bands look, 285 K
    assert np.abs(tex.temperature_k.numpy()[clear] - 285).max() < 10


@pytest.mark.parametrize("rich", [False, True])
@pytest.mark.parametrize("k", [2, 4])
def test_the_answer_renders_the_cube(k, rich):
    """On cubes of Eq. 1 the residual is the noise, and T within sigma as often as it should."""
    ground = np.setdiff1d(np.arange(6), [1] if rich else [])
    world = world_of(k=k, rich=rich, sky=rich, seed=k, shape=(20, 24), bands=40,
                     material=blocks_of(ground, (20, 24)))  # fmt: skip
    tex = answer(world.known(), world.cube, network(strength=1.0))
    right = (tex.material.numpy().ravel() == world.material) & ~tex.unknown.numpy().ravel()
    assert right.mean() > 0.95
    chi2 = (tex.residual.numpy().ravel() ** 2)[right]
    n = len(chi2)
    # 40 bands less T and V's k - 1, at most; deviations take some more
    free = k + (4 if rich else 0)
    assert 1 - free / 40 - 5 * np.sqrt(2 / 40 / n) < chi2.mean() < 1 + 5 * np.sqrt(2 / 40 / n)
    t, sigma = tex.temperature_k.numpy().ravel(), tex.temperature_sigma_k.numpy().ravel()
    z = (t - world.temperature) / sigma
    # sigma may be more than the error, where V's prior helps, and is never less
    within = (np.abs(z[right]) < 1).mean()
    assert within > 0.683 - 4 * np.sqrt(0.22 / n)
    # Eq. 1 itself, in another hand, from the maps alone
    v = tex.thermal_lighting.numpy().reshape(k, -1).T.astype(float)
    x = tex.texture.numpy().reshape(40, -1).T.astype(float)
    s, flat = world.render(tex.material.numpy().ravel(), t.astype(float), v)
    if not rich:  # nor partly sky
        np.testing.assert_allclose(x, flat, rtol=1e-5)
        ours = (((s - world.spectra) / world.sigma) ** 2).mean(axis=1) ** 0.5
        np.testing.assert_allclose(tex.residual.numpy().ravel(), ours, rtol=2e-3)


def test_texture_holds_the_deviation_of_the_surroundings():
    """A foil under surroundings that deviate by 1.5 of their sigma: X has it, V S has not."""
    w = np.array([7.0, 15.0])
    foil = MaterialLibrary(["foil", "paint", "sky"], w, [[0.3, 0.35], [0.9, 0.95], [0.2, 0.2]])
    n = SHAPE[0] * SHAPE[1]
    world = world_of(library=foil, material=blocks_of([0, 0]), netd=0.02, k=1)
    c = 1.5 * np.sign(world.rng.normal(size=(n, 1)))
    off = c * world.environment.spread[:1]
    s, x = world.render(world.material, world.temperature, world.lighting, off)
    s = s + world.sigma * world.rng.normal(size=s.shape)
    tex = answer(world.known(), world.cube_of(s), network(strength=1.0))
    assert (tex.material == 0).float().mean() > 0.95
    ours = tex.texture.numpy().reshape(world.bands, -1).T
    flat = tex.thermal_lighting.numpy().reshape(1, -1).T @ world.environment.radiance
    rms = lambda a: np.sqrt((a**2).mean())
    assert rms(ours - x) < 0.5 * rms(flat - x)


def test_sigma_is_as_many_times_as_large_as_noise_is_more_than_stated():
    """By Birge's ratio: T is as often within it as of a camera whose noise is known."""
    world = world_of(seed=6, rich=False, shape=(24, 30), netd=0.02)
    noisy = world.spectra + 3 * world.sigma * world.rng.normal(size=world.spectra.shape)
    tex = answer(world.known(), world.cube_of(noisy))
    right = tex.material.numpy().ravel() == world.material
    off = np.abs(tex.temperature_k.numpy().ravel() - world.temperature)
    within = (off < tex.temperature_sigma_k.numpy().ravel())[right].mean()
    assert right.mean() > 0.9 and within > 0.683 - 4 * np.sqrt(0.22 / right.sum())


def test_who_is_sure_of_the_material_is_as_sure_of_t_as_the_bands_are():
    """And who is not by as much less as T may be off with another."""
    world = world_of(seed=7, rich=False, netd=0.02)
    known = world.known()
    twin = known._replace(emissivity=known.emissivity.clone())
    twin.emissivity[2] = twin.emissivity[3]
    alone, doubtful = (answer(k, world.cube) for k in (known, twin))
    p, q = (a.material_probability.amax(0) for a in (alone, doubtful))
    sure, torn = p > 0.9999, (q < 0.6) & (p > 0.9999)
    assert sure.sum() > 100 and torn.sum() > 20
    assert alone.temperature_sigma_k[sure].median() < 0.3
    more = doubtful.temperature_sigma_k[torn] ** 2 - NET_OTHER_K**2 * (1 - q[torn])
    assert (more > 0).all() and more.sqrt().median() < 0.3


def test_sigma_holds_the_t_of_every_material_that_is_as_likely():
    """Grey bodies in two bands, of which one looks like another that is many kelvin colder."""
    grey = MaterialLibrary(["black", "grey"], [7.0, 15.0], [[0.98, 0.98], [0.6, 0.6]])
    of = np.arange(SHAPE[0] * SHAPE[1]) % 2
    world = world_of(8, library=grey, material=of, sky=False, rich=False, k=1, bands=2, netd=1.0)
    tex = answer(world.known(), world.cube, network(strength=1.0))
    off = np.abs(tex.temperature_k.numpy().ravel() - world.temperature)
    torn = tex.material_probability.numpy().max(axis=0).ravel() < 0.9
    within = off < 2 * tex.temperature_sigma_k.numpy().ravel()
    assert (torn & (off > 5)).sum() > 20 and within[torn].mean() > 0.9


def test_what_sees_no_sky_has_no_texture_of_it_however_the_sky_deviates():
    world = world_of(seed=9, shape=(20, 24), lighting=np.tile([0.0, 0.3, 0.7], (480, 1)))
    tex = answer(world.known(), world.cube)
    blind = tex.thermal_lighting[0] == 0
    assert blind.sum() > 20 and (tex.sky_texture[blind] == 0).all()
    assert (tex.sky_texture[tex.thermal_lighting[0] > 0.05] != 0).all()


def test_a_sky_that_deviates_as_skies_in_view_do_leaves_noise_alone():
    world = world_of(seed=10, shape=(24, 30))
    cube, sky = sky_is_likelier(world, rows=8)
    tex = answer(world.known(), cube)
    chi2 = tex.residual.numpy()[sky & (tex.thermal_lighting.sum(0).numpy() < 0.5)] ** 2
    assert chi2.size > 100 and chi2.mean() < 1 + 5 * np.sqrt(2 / world.bands / chi2.size)


def test_refinement_lowers_the_cost_of_what_the_network_proposes():
    """Eq. 6 by bands, priors included, at the network's T and V and at the refined ones."""
    world = world_of(seed=3, k=4, sky=False, material=blocks_of(range(6)))
    known, net = world.known(), network(3)
    guess = predict(net, known, world.cube).log_lighting.exp().flatten(1).T.double().numpy()
    before, after = (answer(known, world.cube, net, steps) for steps in (0, STEPS))
    mean, deviation = known.prior_k.double().tolist()
    of = [cost(one, s, g, GUESS_PRECISION, TYPICAL_K / deviation) for one, s, g in zip(
        np.array(dense(known))[after.material.numpy().ravel()], world.scaled(known).numpy(), guess,
        strict=True)]  # fmt: skip

    def costs(tex):
        t = (tex.temperature_k.double() - known.prior_k[0].double()) / known.prior_k[1].double()
        v = tex.thermal_lighting.double().flatten(1).T.numpy()
        return np.array([f(np.r_[x, y]) for f, x, y in zip(of, t.flatten(), v, strict=True)])

    start, end = costs(before), costs(after)
    assert (end < start + 0.01).all() and np.median(end) < 0.5 * np.median(start)
    # chi^2 / 2 of 30 bands and priors of some nats
    assert np.median(end) < 25
    error = [np.abs(a.temperature_k.numpy().ravel() - world.temperature) for a in (before, after)]
    assert np.median(error[1]) < 0.5 * np.median(error[0])


def test_nothing_is_likelier_than_certain():
    """Not what is so far hotter than usual that the series of Planck's law means nothing there."""
    cube, _ = traced("forest", 24)
    s, warm = cube.radiance.copy(), np.linspace(250, 349, 40)
    s[:, -1, :40] = 0.96 * planck(cube.wavelength_um[:, None], warm) + 0.04 * s[:, -1, :40]
    cube = replace(cube, radiance=s)
    library = MaterialLibrary.starter()
    known = known_arrays(cube, library, estimate_environment(cube, library))
    maps = torch_model()(cube.radiance, known)
    assert np.isfinite(maps["log_evidence"]).all() and (maps["log_evidence"] <= 0).all()


def test_permuting_library_and_environment_permutes_the_answer():
    world = world_of(seed=4, k=4)
    cube, _ = sky_is_likelier(world)
    known, net = world.known(), network(4)
    m, j = [3, 0, 5, 1, 4, 2], [2, 0, 3, 1]
    other = known._replace(
        emissivity=known.emissivity[m], is_sky=known.is_sky[m],
        environment=known.environment[j], light=known.light[j], sky_object=known.sky_object[j],
        usual_lighting=known.usual_lighting[j],
    )  # fmt: skip
    a, b = answer(known, cube, net), answer(other, cube, net)
    # where rounding may turn the choice between two materials all may change
    firm = (a.material_probability.amax(0) > 0.6) & (a.material == torch.tensor(m)[b.material])
    assert firm.float().mean() > 0.95
    at = firm.numpy()
    np.testing.assert_allclose(
        a.material_probability[m].numpy()[:, at], b.material_probability.numpy()[:, at], atol=0.02
    )
    sigma = a.temperature_sigma_k.numpy()[at]
    assert ((a.temperature_k - b.temperature_k).abs().numpy()[at] < 0.05 * sigma + 1e-3).all()
    np.testing.assert_allclose(
        a.thermal_lighting[j].numpy()[:, at], b.thermal_lighting.numpy()[:, at], atol=0.02
    )
    np.testing.assert_allclose(a.texture.numpy()[:, at], b.texture.numpy()[:, at], rtol=5e-3)
    np.testing.assert_array_equal(a.unknown.numpy()[at], b.unknown.numpy()[at])


# --- hard inputs ---------------------------------------------------------------------------------


def test_one_object_of_600_k():
    """It is answered, and does not spoil the others."""
    world = world_of(seed=5)
    s = world.spectra.copy()
    s[40] = world.render(np.array([2]), np.array([600.0]), np.full((1, 3), 1 / 3))[0][0]
    cube = world.cube_of(s)
    known = world.known(cube)
    tex = answer(known, cube, network(strength=1.0))
    assert_sound(tex, 6, 3, world.bands, SHAPE)
    others = np.arange(len(s)) != 40
    assert (tex.material.numpy().ravel() == world.material)[others].mean() > 0.9
    error = np.abs(tex.temperature_k.numpy().ravel() - world.temperature)[others]
    assert np.median(error) < 0.5
    assert 500 < tex.temperature_k.numpy().ravel()[40] < 700 or tex.unknown.numpy().ravel()[40]


def test_an_isothermal_enclosure_shows_one_temperature_and_no_texture():
    """Everything at 290 K: S = X = B(290 K) whatever the material. T is that, X is that."""
    world = world_of(rich=False, sky=False, material=blocks_of([0, 1, 2, 3, 4, 5]))
    w = world.wavelength
    inside = Environment(planck(w, np.array([[289.9], [290.0], [290.1]])), w)
    clean = np.tile(planck(world.nodes, 290.0).mean(axis=-1), (len(world.material), 1))
    s = clean + world.sigma * np.random.default_rng(0).normal(size=clean.shape)
    cube = world.cube_of(s)
    tex = answer(world.known(cube, environment=inside), cube)
    assert_sound(tex, 6, 3, world.bands, SHAPE)
    error = np.abs(tex.temperature_k.numpy() - 290)
    assert (error < 4 * tex.temperature_sigma_k.numpy() + 0.02).all() and error.max() < 1
    # X is between the enclosure's coldest and warmest
    np.testing.assert_allclose(
        tex.texture.reshape(len(w), -1).T,
        clean,
        atol=0.11 * (planck(8.0, 291.0) - planck(8.0, 290.0)) + 0.02,
    )
    assert (tex.residual < 1.6).all()


def test_nothing_is_called_sky_where_none_is_in_view():
    """Not a cold pixel, nor a hot one, nor one that nothing in the library explains."""
    world = world_of(seed=6, netd=0.01)
    blind = Environment(world.environment.radiance, world.wavelength)
    s = world.spectra.copy()
    s[:30] = sky_pixels(world, 30, np.random.default_rng(1))
    s[30:60] *= 0.6
    s[60] *= 8
    s[61:70] *= world.rng.uniform(0.5, 1.5, (9, world.bands))
    cube = world.cube_of(s)
    for strength in (1.0, 10.0):
        tex = answer(world.known(cube, environment=blind), cube, network(strength=strength))
        assert_sound(tex, 6, 3, world.bands, SHAPE)
        assert (tex.material != world.library.sky_index).all()


@pytest.mark.parametrize("steps", [0, STEPS])
@pytest.mark.parametrize(
    "case",
    ["constant", "one pixel", "two materials", "few bands", "no sky", "coarse"],
)
def test_hard_inputs_are_answered_in_numbers(case, steps):
    shape = (1, 1) if case == "one pixel" else (4, 5)
    more = {
        "two materials": dict(materials=2, sky=False), "few bands": dict(bands=4, k=8),
        "no sky": dict(sky=False), "coarse": dict(netd=3.0),
    }.get(case, {})  # fmt: skip
    world = World(shape=shape, seed=8, **more)
    cube = world.cube
    if case == "constant":
        cube = HeatCube(np.full((world.bands, 4, 5), 7.0), world.wavelength, world.width, 0.05)
    tex = answer(world.known(cube), cube, steps=steps)
    assert_sound(tex, len(world.library), world.k, world.bands, shape)
    if case == "few bands" and steps:  # 4 numbers cannot tell T and 8 factors: sigma says so
        error = np.abs(tex.temperature_k.numpy().ravel() - world.temperature)
        assert (error < 3 * tex.temperature_sigma_k.numpy().ravel() + 0.1).mean() > 0.8


@pytest.mark.parametrize("inner", [(0, 0, 12, 15), (3, 4, 5, 6), (11, 14, 1, 1), (0, 7, 12, 1)])
def test_a_part_is_answered_as_it_is_in_the_whole(inner):
    """What is only looked at is looked at nonetheless."""
    world = world_of()
    cube, _ = sky_is_likelier(world)
    model, image = TeXModel(network()), torch.from_numpy(cube.radiance.copy())
    whole = model(scene(world.known()), image)
    part = model(scene(world.known()), image, inner=torch.tensor(inner))
    top, left, height, width = inner
    for name, a, b in zip(whole._fields, whole, part, strict=True):
        a = a[..., top : top + height, left : left + width]
        torch.testing.assert_close(b, a, rtol=1e-4, atol=1e-4, msg=name)


def untrained(known, image, expected=None):
    """By a network that passes on the evidence and what is expected, without messages."""
    return TeXModel(network(strength=0.0, messages=0))(scene(known), image, expected)


def test_what_is_expected_counts_among_materials_that_look_alike():
    """Of twins, by Bayes's rule; one as likely as the other where nothing is expected."""
    world = world_of()
    cube, _ = sky_is_likelier(world)
    twin = world.known()
    twin = twin._replace(emissivity=twin.emissivity.clone())
    twin.emissivity[2] = twin.emissivity[3]
    image = torch.from_numpy(cube.radiance.copy())
    a, b = untrained(twin, image).material_probability[2:4]
    ours = a > 0.1
    assert ours.sum() > 20
    torch.testing.assert_close(a, b, rtol=0, atol=0.01)  # of hypotheses only three are refined
    expected = torch.full((len(world.library), *SHAPE), -1.0)
    expected[3] += 0.7
    p = untrained(twin, image, expected).material_probability
    odds = (p[3] / p[2])[ours]
    torch.testing.assert_close(odds, torch.full_like(odds, np.exp(0.7)), rtol=0.02, atol=0)


def test_what_is_named_against_what_the_pixel_says_itself_is_unknown():
    """Though it fits as well as noise lets it, and is likely by what is expected."""
    world = world_of(seed=11, rich=False, depth=(0.05, 0.15), bands=12, netd=0.1)
    image = torch.from_numpy(world.cube.radiance.copy())
    expected = torch.zeros(len(world.library), *SHAPE)
    expected[3] = 20.0
    tex, plain = untrained(world.known(), image, expected), untrained(world.known(), image)
    named = (tex.material == 3) & (tex.material_probability[3] > 0.5) & (tex.residual < 1.9)
    against = named & (plain.material_probability[3] < 1e-3)
    assert against.sum() > 20 and tex.unknown[against].all()
    agreed = named & (plain.material_probability[3] > 0.1)
    assert agreed.sum() > 20 and not tex.unknown[agreed].any()


def test_to_expect_all_alike_is_to_expect_nothing():
    world = world_of()
    cube, _ = sky_is_likelier(world)
    image = torch.from_numpy(cube.radiance.copy())
    plain = untrained(world.known(), image)
    alike = untrained(world.known(), image, torch.full((len(world.library), *SHAPE), -1.5))
    for name, a, b in zip(plain._fields, plain, alike, strict=True):
        torch.testing.assert_close(b, a, rtol=1e-4, atol=1e-4, msg=name)


def test_pixels_answered_in_chunks_are_answered_as_at_once(monkeypatch):
    world = world_of()
    cube, _ = sky_is_likelier(world)
    model, image = TeXModel(network()), torch.from_numpy(cube.radiance.copy())
    whole = model(scene(world.known()), image)
    monkeypatch.setattr("texnet.model.SEEN", 50)
    monkeypatch.setattr("texnet.model.SOLVED", 70)
    for name, a, b in zip(whole._fields, whole, model(scene(world.known()), image), strict=True):
        torch.testing.assert_close(b, a, rtol=1e-4, atol=1e-4, msg=name)


def test_hypotheses_that_are_not_refined_could_not_have_caught_up(monkeypatch):
    """Materials so alike, and pixels so mixed with sky, that many are in doubt."""
    world = world_of(depth=(0.05, 0.15), bands=8)
    cube, sky = sky_is_likelier(world)
    s = cube.radiance.copy()
    s[:, 4:6] = 0.3 * s[:, 4:6] + 0.7 * s[:, :2]  # sky before and behind
    cube = HeatCube(s, cube.wavelength_um, cube.fwhm_um, cube.netd_k)
    known = world.known()
    some = answer(known, cube)

    def every(*args):
        *others, is_sky, steps = args
        return refined(*others, torch.zeros_like(is_sky), steps)

    refined = texnet.model._refined
    monkeypatch.setattr("texnet.model._refined", every)
    monkeypatch.setattr("texnet.model.CLOSE_NATS", 1e9)
    whole = answer(known, cube)
    off = (whole.material_probability - some.material_probability).abs().max()
    assert 1e-4 < off < 2 * np.exp(-CLOSE_NATS)  # some were left out, else this says nothing
    assert (whole.material == some.material).all()
    torch.testing.assert_close(some.temperature_k, whole.temperature_k, rtol=0, atol=1e-3)
    torch.testing.assert_close(some.thermal_lighting, whole.thermal_lighting, rtol=0, atol=1e-4)


@pytest.mark.parametrize("steps", [0, STEPS])
def test_it_is_computed_where_its_inputs_are(steps):
    """On torch's device without numbers, which but for indices refuses to mix with the CPU."""
    world = world_of()
    there = {name: a.to("meta") for name, a in scene(world.known()).items()}
    radiance_there = torch.from_numpy(world.cube.radiance.copy()).to("meta")
    with _config.patch(meta_nonzero_assume_all_nonzero=True):
        tex = TeXModel(network().to("meta"), steps)(there, radiance_there)
    assert {x.device.type for x in tex} == {"meta"}
    assert tex.texture.shape == (world.bands, *SHAPE)


@pytest.mark.parametrize("there", [False, True])
def test_a_gpu_that_is_not_there_or_not_fit_is_refused(monkeypatch, there):
    def too_old(*_, **__):
        raise RuntimeError("no kernel image is available\nfor this device")

    monkeypatch.setattr(torch.cuda, "is_available", lambda: there)
    monkeypatch.setattr(torch, "eye", too_old)
    why = "cannot use the GPU .no kernel image is available." if there else "finds no CUDA GPU"
    with pytest.raises(InputError, match=f"{why}.*take --device cpu"):
        torch_model(device="cuda")


def test_a_cpu_s_answer_leaves_gpus_alone(monkeypatch):
    def busy():
        raise RuntimeError("all of the GPU's memory is taken")

    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "current_device", busy)
    world = world_of()
    maps = torch_model()(world.cube.radiance, arrays_of(world.known()))
    assert np.isfinite(maps["temperature_k"]).all()


def test_precision_is_ours():
    """Lightning advises lower precisions for the whole process; they would change materials."""
    world = world_of()
    known = arrays_of(world.known())
    run = torch_model()
    right = run(world.cube.radiance, known)
    torch.set_float32_matmul_precision("medium")
    try:
        again = run(world.cube.radiance, known)
        assert torch.get_float32_matmul_precision() == "medium"
    finally:
        torch.set_float32_matmul_precision("highest")
    for name, a in right.items():
        np.testing.assert_array_equal(again[name], a, name)
