"""Bands of finite width: boxes and Gaussians, from quadrature to files."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from traced import scene_of

from physics import HeatCube, InputError, MaterialLibrary
from physics.bands import (
    BOX,
    GAUSSIAN,
    RESPONSES,
    SIGMAS,
    at_nodes,
    band_means,
    equidistant_bands,
    quadrature,
)  # fmt: skip
from physics.planck import noise_sigma, planck, planck_derivative
from physics.simulator import simulate
from physics.simulator.sensor import CUT_SIGMAS, Bands
from physics.sky import Atmosphere, sky_radiance
from texnet.cli import main
from texnet.files.cube_import import import_cube
from texnet.files.cube_io import read_cube, write_cube
from texnet.files.environment_file import read_environment
from texnet.metrics import evaluate
from texnet.pipeline import decompose

LIBRARY = MaterialLibrary.starter()
CENTRE, WIDTH = np.array([8.9, 10.2, 11.5, 12.8]), np.array([0.6, 0.8, 1.0, 0.7])


def responds(wavelength_um, centre, width, response):
    """How strongly a band does, by its definition."""
    off = np.abs(wavelength_um - centre) / width
    return 2.0 ** -((2 * off) ** 2) if response == GAUSSIAN else (off <= 0.5).astype(float)


def mean_over(spectrum, centre, width, response):
    """By ten thousand wavelengths: the slow way."""
    reach = (2.0 if response == GAUSSIAN else 0.5) * width
    w = centre + reach * ((np.arange(10_000) + 0.5) / 5_000 - 1)
    return np.average(spectrum(w), weights=responds(w, centre, width, response))


@given(
    st.lists(st.floats(0, 1.2), min_size=1, max_size=4), st.sampled_from(RESPONSES),
)  # fmt: skip
@settings(max_examples=50)
def test_nodes_have_a_band_s_mean_and_variance(widths, response):
    """And lie in its halves alike."""
    centre, width = np.linspace(8, 13, len(widths)), np.array(widths)
    nodes = quadrature(centre, width, response)
    np.testing.assert_allclose(nodes.mean(axis=1), centre)
    np.testing.assert_allclose(nodes + nodes[:, ::-1], 2 * centre[:, None] + 0 * nodes)
    assert (np.diff(nodes, axis=1) >= 0).all() and nodes.shape[1] <= 16
    n = nodes.shape[1]
    if n > 1:
        whole = width / SIGMAS if response == GAUSSIAN else width * np.sqrt((1 - n**-2) / 12)
        np.testing.assert_allclose(nodes.std(axis=1), whole, atol=1e-9)


@pytest.mark.parametrize("response", RESPONSES)
def test_nodes_average_what_is_seen_as_the_band_does(response):
    """Black bodies exactly, curves of the library and the sky's lines to less than the noise that
    the surroundings make."""
    nodes = quadrature(CENTRE, WIDTH, response)
    bands = list(zip(CENTRE, WIDTH, strict=True))
    of = lambda spectrum: [mean_over(spectrum, *band, response) for band in bands]
    black = lambda w: planck(w, 290.0)
    np.testing.assert_allclose(band_means(black, nodes), of(black), rtol=1e-4)
    e = lambda w: LIBRARY.subset(["granite"]).at(w)[0]
    np.testing.assert_allclose(band_means(e, nodes), of(e), atol=3e-3)
    sky = lambda w: sky_radiance(w, np.array([0.6]), Atmosphere(285.0, 1.0))[0]
    off = (band_means(sky, nodes) - of(sky)) / planck_derivative(CENTRE, 300.0)
    assert np.abs(off).max() < 0.5  # K


@pytest.mark.parametrize("response", RESPONSES)
def test_the_simulator_s_cells_average_as_the_band_does(response):
    """Of a Gaussian what lies within three sigmas, of which a hundredth more or less is outside."""
    bands = Bands.of(CENTRE, WIDTH, response)
    edge = CUT_SIGMAS / SIGMAS if response == GAUSSIAN else 0.5
    assert (bands.fine_um - bands.cell_um / 2).min() == pytest.approx((CENTRE - edge * WIDTH).min())
    for spectrum, atol in ((lambda w: planck(w, 290.0), 2e-3), (lambda w: np.sin(2 * w), 0.02)):
        wanted = [mean_over(spectrum, *b, response) for b in zip(CENTRE, WIDTH, strict=True)]
        seen = bands.average(bands.in_cells(spectrum))
        np.testing.assert_allclose(seen, wanted, atol=atol)
    np.testing.assert_allclose(bands.average(bands.in_cells(np.ones_like)), 1)


@pytest.mark.parametrize("name", ["patterned", "patches"])
def test_a_camera_of_gaussian_filters_is_understood(name):
    """As well as one of boxes, if it says so; else T is another."""
    how = dict(wavelength_um=equidistant_bands(9)[0], fwhm_um=np.full(9, 0.6))
    how |= dict(size=(48, 72), spp=16)
    (box, truth), (gaussian, _) = (simulate(scene_of(name), **how, response=r) for r in RESPONSES)
    assert gaussian.response == GAUSSIAN and box.response == BOX
    mistaken = replace(gaussian, response=BOX)
    as_box, as_gaussian, wrong = (evaluate(decompose(c), truth) for c in (box, gaussian, mistaken))
    off = "temperature_mae_k"
    assert as_gaussian[off] < 1.15 * as_box[off]
    assert as_gaussian["material_accuracy"] > as_box["material_accuracy"] - 0.02
    assert wrong[off] > 1.2 * as_gaussian[off]


def gaussian_cube():
    s = np.stack([planck(w, np.full((5, 6), 290.0)) for w in CENTRE])
    return HeatCube(s, CENTRE, WIDTH, 0.05, response=GAUSSIAN)


@pytest.mark.parametrize("suffix", [".npz", ".exr"])
def test_files_keep_the_response(tmp_path, suffix):
    for response in RESPONSES:
        path = tmp_path / f"{response}{suffix}"
        write_cube(replace(gaussian_cube(), response=response), path)
        assert read_cube(path).response == response
        assert import_cube(path, rows=slice(0, 3))[0].response == response
    assert import_cube(path, response=BOX)[0].response == BOX
    said = import_cube(path)[1]
    assert "response gaussian" in said


def test_an_npz_in_another_order_keeps_it_and_a_wrong_one_is_refused(tmp_path):
    cube, path = gaussian_cube(), tmp_path / "cube.npz"
    arrays = dict(radiance=cube.radiance[::-1], wavelength_um=CENTRE[::-1], fwhm_um=WIDTH[::-1])
    np.savez(path, **arrays, response=GAUSSIAN)
    turned, _ = import_cube(path)
    assert turned.response == GAUSSIAN
    np.testing.assert_array_equal(turned.nodes_um, cube.nodes_um)
    arrays = dict(radiance=cube.radiance, wavelength_um=CENTRE, fwhm_um=WIDTH)
    for wrong in ("triangle", 3, ["box", "gaussian"]):
        np.savez(path, **arrays, response=wrong)
        for read in (read_cube, import_cube):
            with pytest.raises(InputError, match="response must be box or gaussian"):
                read(path)
    with pytest.raises(InputError, match="response must be box or gaussian, got None"):
        replace(cube, response=None)


def test_a_measured_sky_is_averaged_as_the_camera_does(tmp_path):
    fine = np.arange(7.4, 14.6, 0.01)
    sky = lambda w: sky_radiance(w, np.array([0.6]), Atmosphere(285.0, 1.0))[0]
    file = tmp_path / "sky.csv"
    file.write_text(
        "wavelength_um,sky\n" + "".join(f"{w},{s}\n" for w, s in zip(fine, sky(fine), strict=True))
    )
    environment, _ = read_environment(file, gaussian_cube())
    wanted = [
        mean_over(lambda w: np.interp(w, fine, sky(fine)), *b, GAUSSIAN)
        for b in zip(CENTRE, WIDTH, strict=True)
    ]
    off = (environment.radiance[0] - wanted) / planck_derivative(CENTRE, 300.0)
    assert np.abs(off).max() < 0.3  # K
    light = environment.at_nodes(gaussian_cube().nodes_um)[0]
    modelled = at_nodes(sky, gaussian_cube().nodes_um)
    assert np.abs(light - modelled).max() / noise_sigma(10.0, 1.0) < 3


def test_simulate_and_import_take_it_from_the_command_line(tmp_path, capsys):
    file, cube = tmp_path / "bands.json", tmp_path / "night.npz"
    how = ["simulate", "patches", "--bands", str(file), "--size", "8x9", "--spp", "2"]
    bands = {"wavelength_um": CENTRE.tolist(), "fwhm_um": (WIDTH / 2).tolist()}
    file.write_text(json.dumps(bands | {"response": GAUSSIAN}))
    assert main([*how, "--out", str(cube)]) == 0
    assert read_cube(cube).response == GAUSSIAN
    boxes = tmp_path / "boxes.exr"
    assert main(["import", str(cube), "--response", "box", "--out", str(boxes)]) == 0
    assert read_cube(boxes).response == BOX
    capsys.readouterr()
    file.write_text(json.dumps(bands | {"response": "bell"}))
    assert main([*how, "--out", str(cube)]) == 2
    assert "response must be box or gaussian" in capsys.readouterr().err
