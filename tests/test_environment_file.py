"""Measured environments on disk: spectra in, band means out; wrong files, one sentence."""

import json

import numpy as np
import pytest
from scipy.integrate import quad

import texnet.budget
from physics import Environment, HeatCube, InputError, MaterialLibrary
from physics.bands import equidistant_bands, means_of_samples, quadrature
from physics.eq1 import render
from physics.planck import noise_sigma, planck
from physics.sky import Atmosphere, sky_radiance
from texnet.cli import main
from texnet.files.cube_io import write_cube
from texnet.files.environment_file import read_environment

LIBRARY = MaterialLibrary.starter().subset(["sky", "water", "granite", "soil", "sandstone"])
CENTRE, WIDTH = equidistant_bands(54)
FINE = np.arange(7.9, 14.1, 0.01)


def shine(w):
    """(2, n) of a dry sky and of the ground around, W m-2 sr-1 um-1."""
    return np.stack([sky_radiance(w, [0.6], Atmosphere(280.0, 0.8))[0], planck(w, 290.0)])


def flat_cube(shape=(40, 30)):
    """A cube by Eq. 1 of a scene from above, and what made it: T and materials (height, width)."""
    rng, n = np.random.default_rng(0), shape[0] * shape[1]
    material, t = rng.integers(1, 5, n), rng.uniform(280.0, 300.0, n)
    sky_view = rng.uniform(0.3, 1.0, n)
    nodes = quadrature(CENTRE, WIDTH)
    e = LIBRARY.at(nodes).mean(axis=-1)[material]
    lit = np.stack([sky_view, 1 - sky_view], axis=1)
    s, _ = render(t, e, lit, means_of_samples(FINE, shine(FINE), CENTRE, WIDTH), CENTRE)
    s = s + rng.normal(size=s.shape) * noise_sigma(CENTRE, 0.05)
    cube = HeatCube(s.T.reshape(-1, *shape), CENTRE, WIDTH, 0.05)
    return cube, t.reshape(shape), material.reshape(shape)


def table(path, axis="wavelength_um", x=FINE, values=None, names=("sky", "ground"), mark=","):
    values = shine(x) if values is None else values
    rows = [axis, *names], *np.column_stack([x, *values]).tolist()
    path.write_text("\n".join(mark.join(map(str, row)) for row in rows) + "\n", encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def scene():
    return flat_cube()


@pytest.fixture(scope="module")
def files(tmp_path_factory, scene):
    folder = tmp_path_factory.mktemp("environment")
    write_cube(scene[0], folder / "cube.npz")
    LIBRARY.save(folder / "library.json")
    return folder


def decompose(capfd, files, *words):
    """(what --json says, decomposition.npz) of the scene by a command that must succeed."""
    common = ["decompose", files / "cube.npz", "--library", files / "library.json", "--json"]
    code = main([str(w) for w in (*common, "--out", files / "out", *words)])
    out, err = capfd.readouterr()
    assert code == 0, err
    with np.load(files / "out" / "decomposition.npz") as arrays:
        return out, json.loads(out.splitlines()[-1]), dict(arrays)


# --- what comes out ----------------------------------------------------------------------


@pytest.mark.parametrize("method", ["local", "net+sgd"])
def test_a_scene_under_a_measured_environment(capfd, files, scene, method):
    _, t, material = scene
    file = table(files / "fine.csv")
    out, said, d = decompose(capfd, files, "--environment", file, "--method", method)
    error = d["temperature_k"] - t
    assert np.abs(error[d["material"] == material]).max() < 1.0 and np.median(np.abs(error)) < 0.1
    assert (np.abs(error) < 2 * d["temperature_sigma_k"]).mean() > 0.95
    assert (d["material"] == material).mean() > 0.98
    assert said["k"] == 2 and not said["k_chosen"] and said["sky_in_view"] is None
    given = said["environment"]
    assert given == {"file": str(file), "objects": ["sky", "ground"], "error_k": 0.0}
    assert "k = 2, as given: sky, ground" in out and "Sky  " not in out
    assert d["sky"].tolist() == [0] and "Environment" not in out


@pytest.mark.parametrize("method", ["local", "net+sgd"])
def test_beside_a_measured_sky_the_cube_shows_the_rest(capfd, files, scene, method):
    _, t, material = scene
    file = table(files / "sky.csv", values=shine(FINE)[:1], names=("downwelling",))
    out, said, d = decompose(capfd, files, "--environment", file, "--method", method)
    assert "k = 5, as given: downwelling, and 4 found" in out and d["sky"].tolist() == [0]
    np.testing.assert_allclose(
        d["environment"][0], means_of_samples(FINE, shine(FINE)[:1], CENTRE, WIDTH)[0]
    )
    assert np.median(np.abs(d["temperature_k"] - t)) < 0.08  # 0.4 K, were the sky all there is
    assert (d["material"] == material).mean() > 0.97


def test_several_measured_skies_have_others_beside_them_too(capfd, files, scene):
    _, t, _ = scene
    cosines = 1.0, 0.8, 0.6, 0.4, 0.2
    skies = np.stack([sky_radiance(FINE, [c], Atmosphere(280.0, 0.8))[0] for c in cosines])
    names = [f"sky{i}" for i in range(5)]
    file = table(files / "skies.csv", values=skies, names=names)
    out, said, d = decompose(capfd, files, "--environment", file, "--method", "local")
    assert said["k"] == 7 and "and 2 found" in out and d["sky"].tolist() == [0, 1, 2, 3, 4]
    assert np.median(np.abs(d["temperature_k"] - t)) < 0.15


def test_the_order_of_columns_is_that_of_the_objects(capfd, files):
    table(files / "a.csv")
    table(files / "b.csv", values=shine(FINE)[::-1], names=("ground", "Sky_zenith"))
    (*_, a), (*_, b) = (
        decompose(capfd, files, "--method", "local", "--environment", files / name)
        for name in ("a.csv", "b.csv")
    )
    np.testing.assert_array_equal(a["environment"], b["environment"][::-1])
    assert a["sky"].tolist() == [0] and b["sky"].tolist() == [1]
    np.testing.assert_allclose(a["thermal_lighting"], b["thermal_lighting"][::-1], atol=1e-3)
    np.testing.assert_allclose(a["temperature_k"], b["temperature_k"], atol=1e-3)


def test_an_environment_that_is_wrong_is_said_to_be(capfd, files):
    cold = np.stack([shine(FINE)[0], planck(FINE, 250.0)])
    file = table(files / "cold.csv", values=cold)
    out, said, _ = decompose(capfd, files, "--method", "local", "--environment", file)
    error_k = said["environment"]["error_k"]
    assert error_k >= 10 and f"Environment  likely about {error_k:.0f} K off" in out


def test_without_a_sky_it_is_said(capfd, files):
    file = table(files / "ground.csv", values=shine(FINE)[1:], names=["ground"])
    out, *_ = decompose(capfd, files, "--method", "local", "--environment", file)
    assert "no object's name begins with sky, downwelling, ldown or dwr" in out


def test_a_budget_is_of_as_many_objects(capfd, files, monkeypatch):
    def choose(cube, library, k, *_):
        assert k == 2
        return "local", 7.0

    monkeypatch.setattr(texnet.budget, "choose", choose)
    words = "--environment", table(files / "fine.csv"), "--budget", 9
    _, said, d = decompose(capfd, files, *words)
    assert said["method"] == "local" and said["k"] == 2 and d["sky"].tolist() == [0]


# --- bands -------------------------------------------------------------------------------


@pytest.mark.parametrize("width", [0.3, 0.111, 0.004])
def test_means_over_bands(width):
    """Of lines narrower than the band, against adaptive quadrature."""
    spectrum = lambda x: 5 + np.sin(40 * x) + 0.1 * x
    w = np.arange(8.0, 9.5, 0.0005)
    centre = np.array([8.2, 8.7171, 9.25])
    means = means_of_samples(w, [spectrum(w), 3 * spectrum(w)], centre, np.full(3, width))
    right = [quad(spectrum, c - width / 2, c + width / 2)[0] / width for c in centre]
    np.testing.assert_allclose(means, [right, np.multiply(3, right)], rtol=1e-5)


def test_means_of_a_straight_line_and_at_a_point_are_exact():
    w = np.array([8.0, 8.37, 9.0, 12.0])
    means = means_of_samples(w, [2 * w - 1], np.array([8.3, 10.0]), np.array([0.4, 0.0]))
    np.testing.assert_allclose(means, [[15.6, 19.0]], rtol=1e-9)


def test_each_band_is_averaged(tmp_path, scene):
    environment, names = read_environment(table(tmp_path / "fine.csv"), scene[0])
    dense = (np.arange(500) + 0.5) / 500 - 0.5
    right = shine((CENTRE[:, None] + dense * WIDTH[:, None]).ravel()).reshape(2, 54, -1)
    np.testing.assert_allclose(environment.radiance, right.mean(axis=-1), rtol=2e-3)
    assert names == ["sky", "ground"] and environment.sky == (0,)
    assert np.abs(shine(CENTRE) / environment.radiance - 1).max() > 0.01, "it is no matter here"


@pytest.mark.parametrize("axis", ["wavelength_nm", "wavenumber_cm1"])
def test_the_same_spectra_in_other_words(tmp_path, scene, axis):
    um = read_environment(table(tmp_path / "a.csv"), scene[0])[0].radiance
    x = 1e3 * FINE if axis == "wavelength_nm" else 1e4 / FINE
    other = table(tmp_path / "b.csv", axis, x, shine(FINE))
    np.testing.assert_allclose(read_environment(other, scene[0])[0].radiance, um, rtol=1e-9)


@pytest.mark.parametrize("mark", [",", ";", "\t", "  ", " , "])
def test_marks_and_comments(tmp_path, scene, mark):
    path = tmp_path / "a.txt"
    x = FINE[::-1]
    text = table(path, x=x, values=shine(FINE)[:, ::-1], mark=mark).read_text(encoding="utf-8")
    path.write_text(f"\ufeff# taken at noon, tripod\n\n{text}\n# end\n", encoding="utf-8")
    environment, names = read_environment(path, scene[0])
    right = means_of_samples(FINE, shine(FINE), CENTRE, WIDTH)
    np.testing.assert_allclose(environment.radiance, right, rtol=1e-9)
    assert names == ["sky", "ground"]


def test_the_table_that_numpy_writes(tmp_path, scene):
    values = np.column_stack([FINE, *shine(FINE)])
    np.savetxt(tmp_path / "a.txt", values, header="wavelength_um downwelling other")
    environment, names = read_environment(tmp_path / "a.txt", scene[0])
    assert names == ["downwelling", "other"] and environment.sky == (0,)


def test_rows_at_the_bands_of_a_camera_are_taken_as_they_are(tmp_path, scene):
    """Of this cube, or of one that it was a part of: they were averaged before."""
    rough = np.random.default_rng(1).uniform(5, 8, (1, 54))
    path = table(tmp_path / "own.csv", x=CENTRE.round(2), values=rough, names=["a"])
    part = scene[0].only(np.arange(54) > 20)
    for cube, right in ((scene[0], rough), (part, rough[:, 21:])):
        np.testing.assert_array_equal(read_environment(path, cube)[0].radiance, right)


def test_a_single_band(tmp_path, scene):
    cube = HeatCube(scene[0].radiance[16:17], [9.83], [1.5], 0.05)
    read = lambda path: read_environment(path, cube)[0].radiance
    right = means_of_samples(FINE, shine(FINE), cube.wavelength_um, cube.fwhm_um)
    np.testing.assert_allclose(read(table(tmp_path / "fine.csv")), right, rtol=1e-9)
    own = table(tmp_path / "own.csv", x=np.array([9.83]), values=[[3.0], [8.0]])
    np.testing.assert_array_equal(read(own), [[3.0], [8.0]])


def test_a_single_band_is_averaged_though_one_row_lies_at_its_centre(tmp_path):
    cube = HeatCube(np.full((1, 3, 3), 9.0), [9.83], [1.5], 0.05)
    x = 9.83 + 0.1 * np.arange(-10, 11)
    spectra = np.stack([5 + np.sin(9 * x), 8 + np.cos(7 * x)])
    found = read_environment(table(tmp_path / "rows.csv", x=x, values=spectra), cube)[0]
    right = means_of_samples(x, spectra, cube.wavelength_um, cube.fwhm_um)
    np.testing.assert_allclose(found.radiance, right, rtol=0.02)
    assert (np.abs(right[:, 0] - spectra[:, 10]) > 0.3).all()


def test_narrow_bands_are_points(tmp_path, scene):
    cube = HeatCube(scene[0].radiance, CENTRE, netd_k=0.05)
    environment, _ = read_environment(table(tmp_path / "fine.csv"), cube)
    right = [np.interp(CENTRE, FINE, s) for s in shine(FINE)]
    np.testing.assert_allclose(environment.radiance, right, rtol=1e-4)


def test_half_a_step_beyond_the_rows(tmp_path, scene):
    read_environment(table(tmp_path / "a.csv", x=np.linspace(8.1, 13.9, 30)), scene[0])
    with pytest.raises(InputError, match="lacks 8-8.051 um; the bands need 8-14 um"):
        read_environment(table(tmp_path / "b.csv", x=np.linspace(8.15, 13.9, 30)), scene[0])


# --- wrong files -------------------------------------------------------------------------

HEAD = "wavelength_um,sky\n"


@pytest.mark.parametrize(
    "text, sentence",
    [
        ("", "must be headed wavelength_um or wavelength_nm or wavenumber_cm1"),
        ("8,5\n14,5\n", "its header starts with '8'"),
        ("wavelength,sky\n8,5\n", "its header starts with 'wavelength'"),
        ("wavelength_um\n8\n", "a column per object"),
        (HEAD, "a row per wavelength"),
        (HEAD + "8,5\n9,cold\n", "line 3"),
        (HEAD + "8,5\n\n9\n", "line 4"),
        (HEAD + "8,5\n9,nan\n", "line 3"),
        (HEAD + "8,5\n9,\n", "has no number for sky; every column must have one"),
        ("wavelength_um;sky\n8,5;5\n", "with a decimal point"),
        ("wavelength_um,sky,\n8,5,\n", "has no name in its header; name it, or, if it is empty"),
        (HEAD + "8,5\n8,6\n14,7\n", "8 um is there twice"),
        (HEAD + "8000,5\n14000,5\n", "looks like nm or cm-1"),
        ("wavenumber_cm1,sky\n8,5\n14,5\n", "10 um is 1000 cm-1"),
        (HEAD + "-8,5\n14,5\n", "positive"),
        (HEAD + "9,5\n9.5,5\n14,5\n", "lacks 8-8.75 um"),
        (HEAD + "8,5\n8.5,5\n12,5\n13,5\n14,5\n", "lacks 8.5-12 um"),
        (HEAD + "8,5\n8.5,5\n9,5\n", "lacks 9.25-14 um"),
        (HEAD + "1,5\n2,5\n", "lacks 8-14 um"),
        (HEAD + "10,5\n", "lacks 8-10 um"),
    ],
)
def test_wrong_texts(capfd, files, text, sentence):
    (files / "wrong.csv").write_text(text, encoding="utf-8")
    assert sentence in refused(capfd, files, "--environment", files / "wrong.csv")


@pytest.mark.parametrize(
    "change, sentence",
    [
        (lambda s: -s, "sky of"),
        (lambda s: s * (FINE < 11), "is 0 at 11.17 um"),
        (lambda s: 100 * s, "all of it looks like 937 K and hotter"),
        (lambda s: s * FINE**2 / 10, "its sky looks like"),  # mW m-2 sr-1 per cm-1
        (lambda s: s * FINE**2 / 1e4, "if it is per cm-1"),
        (lambda s: s / 1e4, "and colder"),
        (lambda s: np.pi * s, "not as irradiance"),
    ],
)
def test_wrong_units(capfd, files, change, sentence):
    file = table(files / "wrong.csv", values=change(shine(FINE)))
    assert sentence in refused(capfd, files, "--environment", file)


def test_a_dry_sky_alone_may_be_far_colder_than_the_scene():
    """Where no band is opaque, it is."""
    w = np.linspace(10.0, 12.5, 6)
    cube = HeatCube(np.broadcast_to(planck(w, 315.0)[:, None, None], (6, 8, 9)), w, netd_k=0.05)
    cold = planck(w, np.array([[200.0]]))
    Environment(cold, w, sky=(0,)).check(cube)
    for sky in ((0,), ()):
        with pytest.raises(InputError, match="and colder"):
            Environment(cold / 1000, w, sky=sky).check(cube)


def test_a_plate_may_be_heated_far_above_what_lights_it():
    w = np.linspace(8, 13, 12)
    plate = planck(w[:, None, None], np.full((8, 8), 430.0))
    Environment([planck(w, 230.0), planck(w, 286.0)], w, sky=(0,)).check(HeatCube(plate, w))


def test_a_sky_per_cm_may_be_far_colder_than_the_scene_too():
    w = np.linspace(8.0, 13.0, 36)
    cube = HeatCube(np.broadcast_to(planck(w, 292.0)[:, None, None], (36, 8, 9)), w, netd_k=0.05)
    sky = planck(w, np.array([[245.0]]))
    Environment(sky, w, sky=(0,)).check(cube)
    with pytest.raises(InputError, match="if it is per cm-1"):
        Environment(sky * w**2 / 1e4, w, sky=(0,)).check(cube)


def test_wrong_places_and_options(capfd, files):
    fine = table(files / "fine.csv")
    assert "cannot read" in refused(capfd, files, "--environment", files / "gone.csv")
    assert "cannot read" in refused(capfd, files, "--environment", files)
    assert "no table in UTF-8" in refused(capfd, files, "--environment", files / "cube.npz")
    assert "leave out --k" in refused(capfd, files, "--environment", fine, "--k", "auto")
    assert "leave out --k" in refused(capfd, files, "--environment", fine, "--k", 3)
    many = [planck(FINE, t) for t in np.linspace(250, 300, 14)]
    many = table(files / "many.csv", values=many, names=[f"o{i}" for i in range(14)])
    assert "it holds 14 objects; give at most 10" in refused(capfd, files, "--environment", many)


def refused(capfd, files, *words):
    """The one sentence that the command refuses with."""
    common = "decompose", files / "cube.npz", "--library", files / "library.json"
    common += "--method", "local"  # which loads no network
    code = main([str(w) for w in (*common, "--out", files / "none", *words)])
    out, err = capfd.readouterr()
    assert code == 2 and out == "" and not (files / "none").exists()
    assert err.startswith("texnet: error: ") and err.count("\n") == 1 and "Traceback" not in err
    return err


def test_within_wide_bands_a_measured_sky_is_what_was_measured(tmp_path):
    """Its mean over a band is not all that counts where materials vary in it, too."""
    centre, width = equidistant_bands(4)
    cube = HeatCube(np.full((4, 5, 6), 8.0), centre, width, 0.05)
    environment, _ = read_environment(table(tmp_path / "a.csv"), cube)
    nodes = quadrature(centre, width)
    around = nodes[..., None] + (np.arange(50) - 24.5) / 50 * 0.125  # each node's part of a band
    measured = np.interp(around, FINE, shine(FINE)[0]).mean(axis=-1)
    light = environment.at_nodes(nodes)
    assert environment.sky == (0,)
    np.testing.assert_allclose(light[0], measured, rtol=2e-3)
    assert np.ptp(light[0], axis=-1).min() > 0.5  # which is not even
    np.testing.assert_allclose(light.mean(axis=-1), environment.radiance)
