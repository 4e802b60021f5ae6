"""The paper's figures made of pictures show what they claim, on tiny scenes."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import matplotlib.image
import numpy as np
import pytest
from scipy.optimize import least_squares
from traced import one_thread, traced  # noqa: F401

import texnet.cli
from benchmarks.reproduce import (
    bands,
    bayer,
    common,
    curves,
    distill,
    environment_count,
    environment_method,
    errors,
    ghosting,
    sgd_flow,
    temperature,
    tex_vision,
)
from benchmarks.reproduce import reproduce as make
from physics import MaterialLibrary
from physics.estimate import estimate_environment
from physics.planck import noise_sigma, planck
from physics.simulator import Camera, Scene, SceneObject, geometry
from physics.sky import Atmosphere
from texnet.metrics import non_sky
from texnet.pipeline import decompose

SIZE = (32, 48)


# --- ghosting ----------------------------------------------------------------------------


def sheet_scene(height, material="snow"):
    """A sheet of one temperature under a clear sky, seen from above; height(xy) in m."""
    at = np.linspace(-2, 2, 161)
    sheet = SceneObject(geometry.sheet(at, at, height), material, 275.0)
    return Scene([sheet], Camera((0, -2.0, 3), (0, 0, 0), 12), Atmosphere(276.0, 0.8))


def exposures(scene):
    return [ghosting.expose(scene, SIZE, 32, seed) for seed in (1, 2)]


def contrasts(scene):
    a, b = exposures(scene)
    return (
        ghosting.rms_contrast(a.visible, b.visible), ghosting.rms_contrast(a.thermal, b.thermal),
    )  # fmt: skip


@pytest.mark.parametrize("material", ["snow", "sand"])
def test_a_flat_surface_of_one_temperature_has_no_texture(material):
    a, b = exposures(sheet_scene(lambda xy: 0 * xy[:, 0], material))
    for seen in ("visible", "thermal"):
        first, second = getattr(a, seen), getattr(b, seen)
        noise = [p.std() / p.mean() for p in (first, second)]
        assert min(noise) > 0.9 * a.noise / a.thermal.mean()  # the sensor's is in it
        # the covariance of two independent noises is zero to a few of its standard deviations
        limit = 4 * noise[0] * noise[1] / np.sqrt(first.size)
        assert ghosting.rms_contrast(first, second) ** 2 < limit


def test_relief_shows_by_day_and_hardly_in_the_thermal_picture():
    waves = lambda xy: 0.03 * np.sin(2 * np.pi * xy[:, 0] / 0.25)
    visible, thermal = contrasts(sheet_scene(waves))
    assert visible > 0.1
    assert visible > 50 * thermal
    # where less is emitted and more scattered there is more texture
    assert contrasts(sheet_scene(waves, "sand"))[1] > 3 * thermal


def test_contrast_is_that_of_the_picture_whatever_the_noise_and_the_gain(rng):
    x = np.linspace(0, 8 * np.pi, 400, endpoint=False)
    wave = np.broadcast_to(1 + 0.03 * np.sin(x), (400, 400))
    seen = [wave + 0.05 * rng.standard_normal(wave.shape) for _ in range(2)]
    assert ghosting.rms_contrast(*seen) == pytest.approx(0.03 / np.sqrt(2), rel=0.03)
    assert ghosting.rms_contrast(7 * seen[0], 7 * seen[1]) == pytest.approx(
        ghosting.rms_contrast(*seen)
    )


def test_an_object_as_hot_as_the_sun_outshines_its_light_by_the_dilution_of_distance():
    dilution = (ghosting.SUN_DISTANCE_M / ghosting.SUN_RADIUS_M) ** 2
    assert ghosting.visible_ratio(ghosting.SUN_K, 0.5, 1.0) == pytest.approx(dilution)
    assert ghosting.visible_ratio(300.0, 0.5, 1.0) < 1e-20


# --- TeX-SGD's workflow ------------------------------------------------------------------


@pytest.fixture(scope="module")
def forest():
    return traced("forest", bands=48)  # narrow, so that Eq. 1 holds with e at their centres


def test_the_sky_fits_a_sky_pixel_best_and_no_fit_by_other_means_is_better(forest):
    cube, truth = forest
    library = common.scene_library(truth)
    pixels = {name: sgd_flow.inmost(truth, name) for name in ("sky", "water")}
    rows = sgd_flow.residuals(cube, library, pixels)
    assert min(rows[: len(library)], key=lambda r: r["residual"])["material"] == "sky"
    environment = estimate_environment(cube, library, sgd_flow.K).radiance
    w = cube.wavelength_um
    for row in rows:
        r, c = pixels[row["pixel"]]
        e = library.at(w)[library.index(row["material"])]

        def misfit(x, e=e, seen=cube.radiance[:, r, c]):
            light = x[1] * environment[0] + (1 - x[1]) * environment[1]
            return (e * planck(w, x[0]) + (1 - e) * light - seen) / cube.sigma

        fits = [
            least_squares(misfit, (285.0, v), bounds=((100, 0), (400, 1)), x_scale=(1, 0.1))
            for v in (0.05, 0.5, 0.95)
        ]
        best = np.sqrt(2 * min(f.cost for f in fits) / len(w))
        # the solver's weak priors on T and V cost it a little
        assert best <= row["residual"] * 1.001
        assert row["residual"] < np.sqrt(best**2 + 2 * 6.0 / len(w))


def test_the_marked_pixel_is_of_its_material_and_so_are_its_neighbours(forest):
    _, truth = forest
    for name in ("water", "bark", "sky"):
        r, c = sgd_flow.inmost(truth, name)
        around = truth.material[max(r - 1, 0) : r + 2, max(c - 1, 0) : c + 2]
        assert (around == truth.material_names.index(name)).all()


# --- distillation ------------------------------------------------------------------------


def test_light_is_split_without_loss_and_the_true_answer_leaves_little(forest):
    cube, truth = forest
    library = MaterialLibrary.starter()
    answer = decompose(cube, library, method="local")
    pictures = distill.steps(cube, truth, answer, library)
    lit = non_sky(answer) & non_sky(truth)
    for side in (0, 1):
        x, ground, sky = (pictures[name][side][lit] for name in ("X~", "ground", "sky"))
        assert np.allclose(x, ground + sky, rtol=1e-4)
    # of no pixel less than its noise; where nothing is mixed, in the pond, not much more
    true = pictures["delta"][1]
    assert np.median(true[lit]) > 0.7
    assert np.median(true[truth.material == library.index("water")]) < 2


# --- Eq. 7 -------------------------------------------------------------------------------


def rippled(step, parts=("t", "e", "x"), size=(12, 14), bands=5):
    """A Truth's fields for Eq. 7: smooth maps that vary by step about a mean."""
    y, x = np.mgrid[: size[0], : size[1]]
    w = np.linspace(8.5, 13.5, bands)
    wave = {p: step * np.sin(0.4 * y + 0.3 * x + i) * (p in parts) for i, p in enumerate("tex")}
    of_band = np.linspace(0.8, 1.2, bands)[:, None, None]
    return SimpleNamespace(
        temperature_k=290 + 10 * wave["t"], emissivity=0.8 + 0.1 * of_band * wave["e"],
        texture=5 + 2 * of_band * wave["x"], material=np.zeros(size, int), wavelength_um=w,
    )  # fmt: skip


def size_of(terms):
    return {name: np.sqrt((term**2).sum(axis=0).mean()) for name, term in terms.items()}


def test_first_order_is_all_there_is_of_tiny_steps():
    width = np.full(5, 1.2)
    large, small = (
        size_of(temperature.contributions(rippled(step), width)) for step in (0.1, 0.01)
    )
    for name in ("temperature", "material", "texture"):
        assert large[name] == pytest.approx(10 * small[name], rel=0.05)
    assert large["higher orders"] == pytest.approx(100 * small["higher orders"], rel=0.1)
    assert small["higher orders"] < 0.01 * small["texture"]


@pytest.mark.parametrize("part, name", [("t", "temperature"), ("e", "material"), ("x", "texture")])
def test_what_alone_varies_makes_all_of_the_contrast(part, name):
    truth, width = rippled(1.0, part), np.full(5, 1.2)
    terms = temperature.contributions(truth, width)
    size = size_of(terms)
    assert size[name] > 0.1
    assert all(s == 0 for n, s in size.items() if n not in (name, "higher orders"))
    # exactly linear in e and in X; the four maps together are always the contrast of S
    if part != "t":
        assert size["higher orders"] < 1e-12
    w = truth.wavelength_um[:, None, None]
    s = truth.emissivity * planck(w, truth.temperature_k) + (1 - truth.emissivity) * truth.texture
    whole = np.stack(np.gradient((1.2 * s).sum(axis=0)))
    assert np.allclose(sum(terms.values()), whole, atol=1e-12)


def test_measured_contrast_is_free_of_what_differs_between_exposures(rng):
    true = np.broadcast_to([[[3.0]], [[4.0]]], (2, 200, 200))
    noisy = [{"texture": true + 2 * rng.standard_normal(true.shape)} for _ in range(2)]
    material = np.repeat([0, 1], 100)[None].repeat(200, axis=0)
    seen = np.ones((200, 200), bool)
    (row,) = temperature.measure_contrast(*noisy, material, seen)
    assert row["rms"] == pytest.approx(5.0, rel=0.02)
    edge = true * (np.abs(np.arange(200) - 99.5) < 1)  # contrast at the border alone
    (row,) = temperature.measure_contrast({"t": edge}, {"t": edge}, material, seen)
    assert row["rms"] == pytest.approx(0.5) and row["rms_within_one_material"] == 0


# --- the pictures ------------------------------------------------------------------------


def test_true_tex_vision_has_the_hues_of_the_true_materials(forest):
    _, truth = forest
    starter = MaterialLibrary.starter()
    shuffled = starter.names[::-1]  # the order of the names must not matter
    other = replace(
        truth, material=(len(shuffled) - 1 - truth.material).astype(np.int16),
        material_names=shuffled,
    )  # fmt: skip
    picture = common.true_vision(truth)
    assert np.array_equal(picture, common.true_vision(other))
    water = picture[truth.material == starter.index("water")]
    assert (water.argmax(axis=1) == 2).all()


def drawn(picture, path, **how):
    """(height, width, 3) 0..255 of a file with nothing but a picture in it."""
    fig, axes = common.panels(1, 1, SIZE)
    common.show(axes[0, 0], picture, "")
    common.save(fig, path, **how)
    return np.rint(255 * matplotlib.image.imread(path)[..., :3])


def test_a_saved_figure_keeps_its_colours_or_every_grey(tmp_path):
    colours = np.array([[[200, 40, 90]], [[17, 250, 128]]], np.uint8)
    seen = drawn(colours, tmp_path / "colours.png")
    for colour in colours[:, 0]:
        assert (np.abs(seen - colour).max(axis=-1) <= 4).mean() > 0.1
    ramp = np.repeat(np.arange(256, dtype=np.uint8)[None, :, None], 3, axis=2)
    seen = drawn(ramp, tmp_path / "greys.png", greys=True)
    assert set(np.unique(seen)) == set(range(256))


@pytest.fixture
def tiny(monkeypatch):
    """Every figure at a size that takes a second or two."""
    small = partial(common.night, size=SIZE, bands=12, spp=8)
    monkeypatch.setattr(common, "night", small)
    monkeypatch.setattr(ghosting, "SIZE", SIZE)
    monkeypatch.setattr(ghosting, "SPP", 4)
    monkeypatch.setattr(ghosting, "FINENESS", 1)
    monkeypatch.setattr(tex_vision, "SCENES", ("forest",))
    for module in (bayer, environment_method, curves):
        small = lambda name, seed, *_: errors.traced(name, seed, SIZE, 4)
        monkeypatch.setattr(module, "traced", small)
        monkeypatch.setattr(module, "random_seeds", lambda n: [])
    monkeypatch.setattr(curves, "sizes", lambda full: (SIZE, 4, 2, 0))
    monkeypatch.setattr(bands, "BANDS", (4, 20))
    monkeypatch.setattr(environment_count, "COUNTS", (1, 3))
    monkeypatch.setattr(environment_count, "BANDS", 12)
    monkeypatch.setattr(environment_method, "BANDS", 12)


@pytest.mark.parametrize("figure", texnet.cli.FIGURES)
def test_a_figure_is_a_table_and_a_picture(figure, tiny, tmp_path):
    said = []
    text, result = make(figure, tmp_path, progress=lambda *report: said.append(report))
    assert text and result and said
    names = [figure] + ["temperature-contributions"] * (figure == "temperature")
    for name in names:
        assert matplotlib.image.imread(tmp_path / f"{name}.png").ndim == 3
        lines = (tmp_path / f"{name}.csv").read_text().splitlines()
        assert len(lines) > 2 and all(len(x.split(",")) >= 3 for x in lines)
    assert {p.stem for p in tmp_path.iterdir()} == set(names)


def test_the_same_seed_gives_the_same_table(monkeypatch, forest, tmp_path):
    # that it gives the same cube is the simulator's test
    monkeypatch.setattr(common, "night", lambda *_, **__: forest)
    for figure in ("sgd-flow", "distill"):
        for run in "ab":
            make(figure, tmp_path / run)
        a, b = (tmp_path / run / f"{figure}.csv" for run in "ab")
        assert a.read_bytes() == b.read_bytes()
    scene = sheet_scene(lambda xy: 0 * xy[:, 0])
    a, b = (ghosting.expose(scene, SIZE, 8, 3) for _ in range(2))
    assert np.array_equal(a.thermal, b.thermal) and np.array_equal(a.visible, b.visible)


def test_another_exposure_is_the_same_scene_with_other_noise():
    of = lambda n: common.night("patterned", size=SIZE, bands=4, spp=16, exposure=n)
    (a, truth), (b, again) = of(0), of(1)
    assert (truth.material == again.material).mean() > 0.95
    inside = truth.material == again.material
    difference = (a.radiance - b.radiance)[:, inside & non_sky(truth)]
    assert np.median(np.abs(difference)) > 0.5 * noise_sigma(a.wavelength_um, 0.05).min()
    assert np.median(np.abs(difference)) < 0.02 * a.radiance.mean()


@pytest.fixture
def rng():
    return np.random.default_rng(5)
