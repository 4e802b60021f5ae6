"""The difficulties of the atlas are those that it names."""

from dataclasses import replace
from functools import lru_cache
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import difficulties, rows, stability
from benchmarks.difficulties import AXES, Case, View
from benchmarks.peers import brightness
from benchmarks.peers.band_planck import BandPlanck
from benchmarks.peers.surroundings import surroundings
from benchmarks.reproduce import common
from benchmarks.stability import amplification, brightness_k, missing_rows, row_of
from physics import InputError, MaterialLibrary
from physics.estimate import estimate_environment
from physics.planck import brightness_temperature, planck
from texnet.learned import torch_model
from texnet.methods import METHODS, NETS
from texnet.metrics import non_sky
from texnet.pipeline import decompose


@pytest.fixture(scope="module", autouse=True)
def small():
    patch = pytest.MonkeyPatch()
    patch.setattr(difficulties, "SIZE", (24, 32))
    patch.setattr(difficulties, "SPP", 16)
    patch.setattr(difficulties, "shaded", lru_cache(difficulties.shaded))
    difficulties._traced.cache_clear()
    yield
    patch.undo()
    difficulties._traced.cache_clear()


@pytest.fixture(scope="module")
def library():
    return MaterialLibrary.starter()


FOREST = View("forest", 7)


def case(axis, level, library, view=FOREST) -> Case:
    return AXES[axis].case(view, library, level)


@pytest.mark.parametrize("axis", AXES)
def test_every_case_is_a_cube_with_its_truth(axis, library):
    for level in (AXES[axis].levels[0], AXES[axis].levels[-1]):
        c = case(axis, level, library, AXES[axis].views[-1])
        assert c.truth.material.shape == c.cube.shape
        assert c.truth.texture.shape == c.cube.radiance.shape
        c.truth.check_cube(c.cube)  # of the same wavelengths: what is answered can be compared


@pytest.mark.parametrize(
    ("methods", "axis", "level"),
    [(stability.ALIKE[0], "noise", 0.05), (stability.ALIKE[1], "gain off", 3)],
)
def test_what_is_found_once_is_what_each_method_finds(methods, axis, level, library):
    library = common.scene_library(difficulties.shaded(FOREST, library)[1])
    c, model = case(axis, level, library), torch_model()
    for method, d in stability.answers(c, methods, model).items():
        of_net = method in NETS
        own = decompose(c.cube, library, method=method, k=c.k, model=model if of_net else None)
        assert d.gain == own.gain and (d.gain != 1) == (axis == "gain off")
        for name in ("temperature_k", "temperature_sigma_k", "material"):
            np.testing.assert_array_equal(getattr(d, name), getattr(own, name))


def test_first_levels_are_harmless(library):
    """What an axis starts from is the plain cube."""
    plain = case("noise", 0.05, library).cube.radiance
    for axis in ("dead bands", "noisy bands", "stripes", "saturation", "gain off", "offset",
                 "sky out of view", "mirror-like surfaces", "emissivity to 1"):  # fmt: skip
        np.testing.assert_allclose(case(axis, AXES[axis].levels[0], library).cube.radiance, plain)


def test_what_several_axes_start_from_is_answered_once_and_nothing_else_is(library, monkeypatch):
    asked = []

    def rows(c, again, view, model):
        asked.append((view, c.fingerprint))
        yield {"method": "net", "draws": c.fingerprint != again.fingerprint}

    monkeypatch.setattr(stability, "_rows", rows)
    known, other = {}, replace(FOREST, seed=8)
    one = {"gain off": 0, "offset": 0, "saturation": 0, "offset, as stated": 0}
    others = {"gain off": 3, "offset": 3, "offset, as stated": 3, "wrong curves": 1, "bands": 6}
    for view in (FOREST, other):
        for axis, level in [*one.items(), *others.items()]:
            (row,) = stability.measured(axis, level, view, library, None, known)
            assert row["axis"] == axis and row["level"] == level and row["draws"]
            assert row["scene"] == f"forest {view.seed}"
    assert len(asked) == len(set(asked)) == 2 * (1 + len(others))


def test_the_last_level_of_the_crossover_is_a_black_enclosure(library):
    """As warm as all that surrounds it, an object shows its T and nothing else."""
    c = case("thermal crossover", 0, library, View("room", 7))
    t = c.truth.temperature_k
    assert np.ptp(t) < 1e-2
    black = planck(c.cube.wavelength_um, float(t.mean()))[:, None, None]
    off = (c.cube.radiance - black) / c.cube.sigma[:, None, None]
    assert off.std() == pytest.approx(1, abs=0.02) and abs(off.mean()) < 0.02


def test_black_bodies_show_their_temperature(library):
    c = case("emissivity to 1", 0.02, library, View("room", 7))
    ground = non_sky(c.truth)
    t = brightness_temperature(c.cube.wavelength_um[:, None], c.cube.radiance[:, ground])
    assert np.median(np.abs(t.mean(axis=0) - c.truth.temperature_k[ground])) < 0.1


def test_sky_goes_out_of_view(library):
    view = View("patterned", 7)
    assert not non_sky(case("sky out of view", 0, library, view).truth).all()
    assert non_sky(case("sky out of view", 1, library, view).truth).all()


def test_mixing_keeps_the_mean(library):
    one, four = case("mixed pixels", 1, library), case("mixed pixels", 4, library)
    assert four.cube.shape == (6, 8)
    np.testing.assert_allclose(
        four.cube.radiance.mean(axis=(1, 2)), one.cube.radiance.mean(axis=(1, 2)), rtol=2e-3
    )


def test_draws_differ_by_their_noise_alone(library):
    a, b = (case("noise", 0.5, library, View("forest", 7, draw=i)).cube for i in (0, 1))
    off = (a.radiance - b.radiance) / a.sigma[:, None, None]
    assert off.std() == pytest.approx(np.sqrt(2), rel=0.02)


def test_amplification_of_the_exact_solver_is_near_one(library):
    """By half more than the bound: the solver allows for what k objects leave out, noise does too.
    On the model's own pixels it meets the bound, see test_local."""
    cases = [case("noise", 0.05, library, View("patterned", 7, draw=i)) for i in (0, 1)]
    a, b = (decompose(c.cube, library, method="local") for c in cases)
    assert 1 < amplification(cases[0], a, b) < 2


@pytest.mark.parametrize("scene", ["forest", "street"])
@pytest.mark.parametrize(("axis", "level"), [("noise", 0.05), ("overcast", 4)])
def test_the_brightness_temperature_knows_the_sky(library, scene, axis, level):
    """Told that, be it a cloud or clear, it errs less than told nothing of what is reflected."""
    view = View(scene, 7)
    c = case(axis, level, library, view)
    bands, ground = (c.cube.wavelength_um, c.cube.fwhm_um), non_sky(c.truth)
    off = lambda t: np.abs(t - c.truth.temperature_k[ground]).mean()

    def told(x):
        s = c.cube.radiance[:, ground].T.astype(float)
        return off(brightness.separate(s, BandPlanck(*bands), x)[0])

    ours = off(brightness_k(c, view))
    assert ours < 0.95 * told(np.zeros(c.cube.bands))
    if axis == "overcast":  # nor is the clear sky that its View has as good
        assert ours < 0.95 * told(surroundings(view.traced, c.truth, *bands))


def test_a_right_environment_can_be_given_too(library):
    c = case("wrong environment", 0, library)
    assert c.fingerprint != case("noise", 0.05, library).fingerprint
    (d,) = stability.answers(c, ["local"], None).values()
    given = estimate_environment(c.cube, library, c.k).radiance
    np.testing.assert_allclose(d.environment, given, rtol=1e-6)
    assert d.environment_error_k == 0


def test_worse_than_the_brightness_temperature_is_what_its_sigma_does_not_cover(library):
    """Of four pixels one errs by three of its sigmas where brightness is right."""
    c = case("noise", 0.05, library)
    d = decompose(c.cube, library, method="local")
    ground, t = non_sky(c.truth), c.truth.temperature_k.astype(np.float64)
    off = np.resize([0.0, 0.5, 1.5, 3.0], t.shape)
    d = replace(d, temperature_k=t + off, temperature_sigma_k=np.ones_like(t))
    said = row_of(c, d, t[ground])
    assert said["worse_than_brightness"] == (off[ground] > 2).mean()
    assert said["brightness_mae_k"] == 0 and not said["failure"]
    assert row_of(c, d, t[ground] + 5)["worse_than_brightness"] == 0


def test_what_is_said_of_a_missing_material(library, monkeypatch):
    """Every pixel unknown covers all, at the cost of every right pixel elsewhere; none unknown and
    no sigma covers nothing, at no cost."""

    def said(unknown, sigma):
        def answers(case, methods, model):
            t = case.truth
            names = np.array(t.material_names)
            right = np.array([case.library.names.index(n) if n in case.library.names else 0
                              for n in names])[t.material]  # fmt: skip
            one = SimpleNamespace(
                material=right, material_names=case.library.names,
                temperature_k=t.temperature_k + 1,
                temperature_sigma_k=np.full(right.shape, sigma),
                unknown=np.full(right.shape, unknown),
            )  # fmt: skip
            return dict.fromkeys(methods, one)

        monkeypatch.setattr(stability, "answers", answers)
        cube, truth = difficulties.shaded(FOREST, library)
        return list(missing_rows("forest", cube, truth, library, None))

    rows = said(True, 0.1)
    assert len(rows) == len(METHODS) * len({r["missing"] for r in rows}) > 0
    for r in rows:
        assert r["covered"] == r["unknown"] == r["false_alarms"] == r["unknown_else"] == 1
    for r in said(False, 0.1):
        assert r["covered"] == r["unknown"] == r["false_alarms"] == r["unknown_else"] == 0
    assert all(r["covered"] == 1 and r["unknown"] == 0 for r in said(False, 0.6))


def test_a_stopped_atlas_goes_on_after_the_last_level(tmp_path, monkeypatch):
    levels = (0, 1, 5)
    axis = replace(AXES["dead bands"], levels=levels, views=(FOREST,))
    monkeypatch.setattr(stability, "AXES", {"dead bands": axis})
    monkeypatch.setattr(stability, "ALIKE", (("local",),))

    class Stop(Exception):
        pass

    def stop(done, total, what):
        if done == 2:
            raise Stop

    with pytest.raises(Stop):
        stability.measure(tmp_path, ["dead bands"], stop)
    first = rows.read_csv(tmp_path / "stability.csv", rows.settings())
    assert {r["level"] for r in first} == {0, 1}
    anew, measured = [], stability.measured

    def counted(axis, level, *more):
        anew.append(level)
        return measured(axis, level, *more)

    monkeypatch.setattr(stability, "measured", counted)
    whole, _, _ = stability.measure(tmp_path, ["dead bands"])
    assert anew == [5] and whole[: len(first)] == first
    assert [r["level"] for r in whole] == list(levels)
    assert (tmp_path / "atlas.md").exists() and (tmp_path / "atlas.png").exists()


def test_rows_of_other_code_do_not_count(tmp_path, monkeypatch):
    table = tmp_path / "stability.csv"
    kept = [{"axis": "x", "level": 0.5, "scene": "s"}]
    rows.write_csv(table, kept)
    assert rows.read_csv(table, rows.settings()) == kept
    monkeypatch.setattr(rows, "CODE", [])
    assert rows.read_csv(table, rows.settings()) == []
    # and are not lost for a few that are measured anew
    before = table.read_bytes()
    with pytest.raises(InputError, match=r"other axes \(x\); take another --out"):
        stability.measure(tmp_path, ["noise"])
    assert table.read_bytes() == before
