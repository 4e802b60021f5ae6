"""How much the sky lights a scene: against the simulator's truth, Bayes' rule and its limits."""

from dataclasses import replace

import numpy as np
import pytest
from test_evidence import World, arrays_of, hypotheses
from traced import names_of, one_thread, traced  # noqa: F401

from physics import Environment, InputError, MaterialLibrary, lighting
from physics.estimate import estimate_environment
from physics.evidence import evidence
from physics.lighting import LEAST, with_usual_lighting
from texnet.circumstances import circumstances
from texnet.pipeline import decompose, method_of

LIBRARY = MaterialLibrary.starter()


def share(environment):
    """The sky's, of the usual V."""
    return environment.usual[list(environment.sky)].sum()


def even(environment):
    return replace(environment, usual_lighting=None)


def world_of(sky_share, n=1500, **how):
    """Pixels of the k-object model under so much sky, in the mean."""
    rng = np.random.default_rng(5)
    v = rng.dirichlet(6 * np.array([sky_share, *[(1 - sky_share) / 2] * 2]), n)
    return World(lighting=v, shape=(1, n), seed=2, materials=5, rich=False, **how)


# --- of pixels that the model made ---------------------------------------------------------------


@pytest.mark.parametrize("sky_share", [0.05, 0.1, 0.15])
@pytest.mark.parametrize("bands", [6, 24])
def test_the_share_that_made_the_pixels_is_found(sky_share, bands):
    """One of three objects is sky, so a third is what is thought beforehand."""
    world = world_of(sky_share, bands=bands)
    start = even(world.environment)
    found = with_usual_lighting(start, world.cube, world.library)
    assert share(start) == pytest.approx(1 / 3)
    assert share(found) == pytest.approx(sky_share, abs=0.04)
    others = np.delete(found.usual, found.sky)
    np.testing.assert_allclose(others, (1 - share(found)) / 2)
    assert found.usual.sum() == pytest.approx(1)


def test_pixels_are_likelier_with_it():
    world = world_of(0.1, bands=8)
    start = even(world.environment)
    found = with_usual_lighting(start, world.cube, world.library)
    nats = []
    for environment in (start, found):
        known = world.known(environment=environment)
        of_all = evidence(hypotheses(known), world.pixels(known))[0]
        nats.append(of_all.logsumexp(0).mean().item())
    assert nats[1] > nats[0] + 0.05


def test_every_column_counts():
    """Whatever the picture's size: here one column alone sees much sky."""
    rng, column = np.random.default_rng(6), np.arange(10_000) % 10
    mean = np.where((column == 0)[:, None], [0.9, 0.05, 0.05], [0.1, 0.45, 0.45])
    v = np.array([rng.dirichlet(6 * m) for m in mean])
    world = World(lighting=v, shape=(1000, 10), seed=2, materials=5, rich=False, bands=12)
    found = with_usual_lighting(even(world.environment), world.cube, world.library)
    assert share(found) == pytest.approx(v[:, 0].mean(), abs=0.05)


@pytest.mark.parametrize("sky_share", [0.3, 0.8])
def test_more_sky_than_its_share_or_about_as_much_changes_nothing(sky_share):
    world = world_of(sky_share, bands=12)
    start = even(world.environment)
    found = with_usual_lighting(start, world.cube, world.library)
    assert found is start


@pytest.mark.parametrize("bands", [4, 12])
def test_a_little_more_sky_changes_it_little(bands):
    """There is no step where pixels begin to ask for it."""
    worlds = [world_of(s, bands=bands) for s in np.arange(0.15, 0.28, 0.01)]
    found = [share(with_usual_lighting(even(w.environment), w.cube, w.library)) for w in worlds]
    assert found[0] < 0.2 and found[-1] == pytest.approx(1 / 3)
    assert (np.diff(found) > -0.005).all() and np.diff(found).max() < 0.06


def test_what_was_said_to_be_usual_stays():
    world = world_of(0.1, bands=12)
    said = replace(world.environment, usual_lighting=[0.5, 0.3, 0.2])
    assert with_usual_lighting(said, world.cube, world.library) is said


def test_how_much_of_the_picture_is_sky_does_not_matter():
    """Its own pixels say nothing of how much it lights the ground."""
    world = world_of(0.1, bands=12)
    start = even(world.environment)
    of_ground = share(with_usual_lighting(start, world.cube, world.library))
    spectra, n = world.spectra.copy(), len(world.spectra)
    sky = world.environment.sky_mean + world.sigma * world.rng.normal(size=(2 * n, world.bands))
    cube = world.cube_of(np.concatenate([sky, spectra]), (3 * world.shape[0], world.shape[1]))
    assert of_ground < 0.2
    assert share(with_usual_lighting(start, cube, world.library)) == pytest.approx(
        of_ground, abs=0.02
    )


def test_no_light_from_the_sky_leaves_it_the_least():
    world = world_of(1e-3, bands=24)
    found = with_usual_lighting(even(world.environment), world.cube, world.library)
    assert LEAST <= share(found) < 0.06


def test_the_order_of_materials_does_not_matter():
    world = world_of(0.1, bands=8)
    turned = world.library.subset(world.library.names[::-1])
    a, b = (
        with_usual_lighting(even(world.environment), world.cube, library)
        for library in (world.library, turned)
    )
    assert a.usual_lighting is not None
    np.testing.assert_allclose(a.usual_lighting, b.usual_lighting, atol=1e-5)


def test_the_order_of_objects_turns_it():
    world = world_of(0.1, bands=8)
    e, order = even(world.environment), [1, 2, 0]
    turned = replace(e, radiance=e.radiance[order], sky=(2,), usual_lighting=None)
    a, b = (with_usual_lighting(x, world.cube, world.library) for x in (e, turned))
    np.testing.assert_allclose(a.usual_lighting[order], b.usual_lighting, atol=1e-5)


def test_without_sky_or_with_sky_alone_it_stays():
    world = world_of(0.1, bands=8)
    none = even(replace(world.environment, sky=(), sky_mean=None))
    alone = even(replace(world.environment, sky=(0, 1, 2)))
    for start in (none, alone):
        found = with_usual_lighting(start, world.cube, world.library)
        assert found is start


# --- of path-traced scenes -----------------------------------------------------------------------


def lit(cube, environment):
    return with_usual_lighting(environment, cube, LIBRARY)


@pytest.mark.parametrize("name", ["forest", "street"])
@pytest.mark.parametrize("bands", [4, 9, 54])
def test_in_a_wood_or_a_street_it_is_about_the_true_sky_view(name, bands):
    """Three of five objects are sky's; the simulator knows how much of the hemisphere is."""
    cube, truth = traced(name, bands)
    true = truth.sky_view[names_of(truth) != "sky"].mean()
    before = estimate_environment(cube, LIBRARY)
    found = lit(cube, before)
    assert share(found) == pytest.approx(true, abs=0.15)
    assert abs(share(found) - true) < abs(share(before) - true)


def test_in_a_room_nothing_changes():
    cube = traced("room")[0]
    found = lit(cube, estimate_environment(cube, LIBRARY))
    assert not found.sky
    assert found.usual_lighting is None


@pytest.mark.parametrize("name", ["forest", "street"])
@pytest.mark.parametrize("method", ["local", "net+sgd"])
def test_few_bands_then_name_more_right(monkeypatch, name, method):
    cube, truth = traced(name, 6)
    right = lambda: (names_of(decompose(cube, method=method)) == names_of(truth)).mean()
    found = right()
    monkeypatch.setattr(lighting, "with_usual_lighting", lambda environment, *_: environment)
    assert found > right() + 0.02


def test_it_is_found_of_pixels_that_were_measured():
    """Half of the picture dead, left out: as of the other half."""
    cube, _ = traced("forest", 9)
    environment, half = estimate_environment(cube, LIBRARY), np.zeros(cube.shape, bool)
    half[:, ::2] = True
    radiance = np.where(half, np.float32(1e-3), cube.radiance)
    broken = replace(cube, radiance=radiance)
    found = with_usual_lighting(environment, broken, LIBRARY, half)
    assert share(found) == pytest.approx(share(lit(cube, environment)), abs=0.03)
    nothing = with_usual_lighting(environment, cube, LIBRARY, np.ones(cube.shape, bool))
    assert nothing is environment


def test_an_environment_that_was_given_is_lit_too():
    cube, _ = traced("forest", 9)
    given = estimate_environment(cube, LIBRARY)
    looks = method_of("net+sgd", LIBRARY).looks
    of = circumstances(cube, LIBRARY, looks, environment=given)
    assert share(given) == pytest.approx(0.6) and share(of.environment) < 0.5
    # of five objects, four of which are found, one is sky: no less than there is
    sky = Environment(given.radiance[:1], given.wavelength_um, (0,))
    of = circumstances(cube, LIBRARY, looks, environment=sky)
    np.testing.assert_allclose(of.environment.usual, 0.2)


# --- where the data say nothing ------------------------------------------------------------------


@pytest.mark.parametrize(
    "usual", [[0.5, 0.5, 0.5], [0.5, 0.5], [1.5, -0.5, 0.0], [np.nan, 0.5, 0.5]]
)
def test_shares_that_are_none_are_refused(usual):
    e = World().environment
    with pytest.raises(InputError, match="usual_lighting must be 3 shares|finite|number"):
        replace(e, usual_lighting=usual)


def test_known_holds_it():
    world = World()
    known = arrays_of(world.known())
    np.testing.assert_allclose(known["usual_lighting"], world.environment.usual_lighting, rtol=1e-6)
