"""Metrics and baselines: perfect answers score perfectly, known errors score what they are."""

from dataclasses import replace

import made_up
import numpy as np
import pytest

from physics.cube.heat_cube import HeatCube
from physics.errors import InputError
from texnet.baselines import clahe, panchromatic, principal_components
from texnet.metrics import correlation, evaluate, non_sky, texture_scores

TEXTURE_SCORES = ("texture_correlation", "texture_gradient_correlation", "texture_ssim")


@pytest.fixture
def truth():
    return made_up.truth()


def test_a_perfect_answer_scores_perfectly(truth):
    assert evaluate(made_up.perfect(truth), truth) == pytest.approx(
        dict(
            temperature_rmse_k=0, temperature_mae_k=0, material_accuracy=1, mean_iou=1,
            cross_entropy=0, texture_mse_per_band=0, texture_correlation=1,
            texture_gradient_correlation=1, texture_ssim=1, within_1_sigma=1, within_2_sigma=1,
            abstention=0, accuracy_answered=1,
        ),
        abs=1e-6,
    )  # fmt: skip


def test_known_shifts(truth):
    d = made_up.perfect(truth)
    sign = np.where(np.arange(truth.material.size) % 2, 1, -1).reshape(truth.material.shape)
    d.temperature_k = truth.temperature_k + 0.15 * sign  # sigma is 0.1
    d.texture = truth.texture + 0.5
    d.sky_texture = 3 - 2 * truth.sky_texture
    m = evaluate(d, truth)
    assert m["temperature_rmse_k"] == pytest.approx(0.15, rel=1e-3)
    assert m["temperature_mae_k"] == pytest.approx(0.15, rel=1e-3)
    assert (m["within_1_sigma"], m["within_2_sigma"]) == (0, 1)
    assert m["texture_mse_per_band"] == pytest.approx(0.25, rel=1e-5)
    assert m["texture_correlation"] == pytest.approx(-1)
    assert m["texture_gradient_correlation"] == pytest.approx(-1)
    assert m["texture_ssim"] < 0


@pytest.mark.parametrize("sigmas, within", [(0.95, (1, 1)), (1.05, (0, 1)), (2.05, (0, 0))])
def test_errors_count_by_their_own_sigma(truth, sigmas, within):
    d = made_up.perfect(truth)
    d.temperature_sigma_k = np.random.default_rng(0).uniform(0.1, 2, truth.material.shape)
    d.temperature_k = truth.temperature_k - sigmas * d.temperature_sigma_k
    m = evaluate(d, truth)
    assert (m["within_1_sigma"], m["within_2_sigma"]) == within


def test_pixels_that_were_not_measured_count_nowhere(truth):
    """As beyond the edge of an orthorectified strip, where all maps are a guess."""
    d = made_up.perfect(truth)
    d.dead[:, : d.dead.shape[1] // 3] = True
    wrong = {
        "temperature_k": 400.0, "material": (d.material + 1) % 4, "texture": 99.0, "unknown": True,
        "sky_texture": -truth.sky_texture, "material_probability": 0.0,
    }  # fmt: skip
    for name, value in wrong.items():
        setattr(d, name, np.where(d.dead, value, getattr(d, name)))
    m = evaluate(d, truth)
    for name in ("temperature_rmse_k", "cross_entropy", "texture_mse_per_band", "abstention"):
        assert m[name] == pytest.approx(0, abs=1e-6)
    for name in ("material_accuracy", "mean_iou", "accuracy_answered", *TEXTURE_SCORES):
        assert m[name] == pytest.approx(1, abs=1e-6)


def test_sky_pixels_do_not_count_for_temperature_and_texture(truth):
    d = made_up.perfect(truth)
    sky = ~non_sky(truth)
    assert sky.any()
    before = evaluate(d, truth)
    d.temperature_k = np.where(sky, 1000, d.temperature_k)
    d.texture = np.where(sky, 99, d.texture)
    d.sky_texture = np.where(sky, 99, d.sky_texture)
    assert evaluate(d, truth) == before


def test_confusing_two_materials(truth):
    """All bark is taken for grass, at probability 0.75, and half of that is marked unknown."""
    d = made_up.perfect(truth)
    grass, bark = (made_up.NAMES.index(n) for n in ("grass", "bark"))
    was_bark, was_grass = truth.material == bark, truth.material == grass
    d.material = np.where(was_bark, grass, d.material)
    p = d.material_probability.copy()
    p[:, was_bark] = 0
    p[grass, was_bark], p[bark, was_bark] = 0.75, 0.25
    d.material_probability = p
    d.unknown = was_bark & (np.cumsum(was_bark).reshape(was_bark.shape) % 2 == 0)
    m = evaluate(d, truth)
    share, n_bark, n_grass = was_bark.mean(), was_bark.sum(), was_grass.sum()
    answered = d.material.size - d.unknown.sum()
    assert m["material_accuracy"] == pytest.approx(1 - share)
    assert m["cross_entropy"] == pytest.approx(share * np.log(4))
    assert m["mean_iou"] == pytest.approx((2 + n_grass / (n_grass + n_bark)) / 4)
    assert m["abstention"] == pytest.approx(d.unknown.mean()) and m["abstention"] > 0
    assert m["accuracy_answered"] == pytest.approx((d.material.size - n_bark) / answered)


def test_the_order_of_the_library_does_not_matter(truth):
    d, other = (made_up.perfect(truth, n) for n in (made_up.NAMES, made_up.NAMES[::-1]))
    assert not np.array_equal(d.material, other.material)
    wrong = np.random.default_rng(1).random(truth.material.shape) < 0.3
    for answer in (d, other):
        grass = answer.material_names.index("grass")
        answer.material = np.where(wrong, grass, answer.material)
        answer.material_probability = 0.5 * answer.material_probability + 0.125
    assert evaluate(d, truth) == evaluate(other, truth)
    assert evaluate(d, truth)["material_accuracy"] < 0.9


def test_a_material_that_the_library_lacks_counts_as_wrong(truth):
    d = made_up.perfect(truth)
    bark = made_up.NAMES.index("bark")
    is_bark = truth.material == bark
    d.material_names = ("grass", "water", "sky")
    d.hue_deg = d.hue_deg[:3]
    d.material = np.where(is_bark, 0, d.material)
    d.material_probability = d.material_probability[:3]
    d.material_probability[0, is_bark] = 1  # of what it is taken for
    m = evaluate(d, truth)
    assert m["material_accuracy"] == pytest.approx(1 - is_bark.mean())
    assert m["cross_entropy"] == pytest.approx(-is_bark.mean() * np.log(1e-6))
    assert m["mean_iou"] < 0.75


def test_no_pixel_to_average_is_nan(truth):
    d = made_up.perfect(truth)
    d.unknown = np.ones_like(d.unknown)
    m = evaluate(d, truth)
    assert m["abstention"] == 1 and np.isnan(m["accuracy_answered"])


def test_a_room_has_no_sky_lit_texture_to_be_found(truth):
    room = replace(truth, sky_texture=np.zeros_like(truth.sky_texture))
    m = evaluate(made_up.perfect(truth), room)
    assert np.isnan([v for name, v in m.items() if name in TEXTURE_SCORES]).all()
    assert np.isfinite([v for name, v in m.items() if name not in TEXTURE_SCORES]).all()


def test_another_scene_s_truth_is_refused(truth):
    with pytest.raises(InputError, match="its truth"):
        evaluate(made_up.perfect(made_up.truth(8, 9)), truth)
    shifted = replace(truth, wavelength_um=truth.wavelength_um + 0.1)
    with pytest.raises(InputError, match="its truth"):
        evaluate(made_up.perfect(truth), shifted)


def test_correlation_is_that_of_numpy_and_blind_to_scale():
    rng = np.random.default_rng(0)
    a, b = rng.standard_normal((2, 20, 30))
    b += a
    mask = rng.random((20, 30)) < 0.5
    r = correlation(a, b, mask)
    assert r == pytest.approx(np.corrcoef(a[mask], b[mask])[0, 1])
    assert correlation(5 * a + 3, -2 * b, mask) == pytest.approx(-r)
    assert correlation(np.ones_like(a), b, mask) == 0


def test_gradients_are_never_taken_across_the_sky_s_edge(truth):
    """A step at the sky's edge, and anything inside it, changes no texture score's gradient."""
    noisy = truth.sky_texture + np.random.default_rng(0).normal(0, 0.3, truth.material.shape)
    edge = np.where(non_sky(truth), noisy, 1e6)
    a, b = (texture_scores(p, truth)["gradient_correlation"] for p in (noisy, edge))
    assert a == b and 0 < a < 1


# --- baselines ---------------------------------------------------------------------------


def test_panchromatic_integrates_over_wavelength():
    w = np.array([8.0, 9.0, 11.0])
    s = np.broadcast_to((2 * w)[:, None, None], (3, 2, 2))  # S = 2 w, whose integral is w^2
    np.testing.assert_allclose(panchromatic(HeatCube(s, w)), 11**2 - 8**2, rtol=1e-6)
    np.testing.assert_allclose(panchromatic(HeatCube(s[:1], w[:1])), 16)


def test_principal_components_are_those_of_all_bands_at_once():
    rng = np.random.default_rng(0)
    s = 8 + rng.normal(size=(5, 2)) @ rng.normal(size=(2, 6 * 7)) * 0.1
    cube = HeatCube(s.reshape(5, 6, 7), np.linspace(8, 14, 5))
    x = cube.spectra - cube.spectra.mean(axis=0)
    variance, axes = np.linalg.eigh(x.T.astype(float) @ x)
    found = principal_components(cube).reshape(3, -1)
    for i in range(2):
        axis = axes[:, -1 - i]
        np.testing.assert_allclose(found[i], x @ axis * np.sign(axis.sum()), atol=1e-5)
    assert np.abs(found[2]).max() < 1e-5 and found[0] @ cube.spectra.sum(axis=1) > 0


def test_clahe_brings_out_local_contrast():
    ramp = np.linspace(0, 1, 128)[:, None] + 0.01 * (np.arange(128) % 2)
    out = clahe(ramp)
    assert out.shape == ramp.shape and out.min() >= 0 and out.max() <= 1
    local = lambda p: np.abs(np.diff(p, axis=1)).mean()
    assert local(out) > 1.2 * local(ramp / np.ptp(ramp))
    assert clahe(np.ones((5, 7))).shape == (5, 7)


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (1, 300), (2, 2)])
def test_clahe_of_a_single_row_or_column(shape):
    picture = np.random.default_rng(0).uniform(1, 2, shape)
    out = clahe(picture)
    assert out.shape == shape and out.min() >= 0 and out.max() <= 1
    if out.size < 10:  # one tile, in which brighter stays brighter
        assert (np.diff(out.ravel()[np.argsort(picture.ravel())]) >= 0).all()


def test_principal_components_find_the_sources_in_order():
    rng = np.random.default_rng(0)
    maps = rng.standard_normal((3, 20 * 30)) * np.array([[1.0], [0.3], [0.1]])
    axes = np.linalg.qr(rng.standard_normal((8, 3)))[0]
    s = 10 + (axes @ maps).reshape(8, 20, 30)
    cube = HeatCube(s, np.linspace(8, 14, 8))
    pcs = principal_components(cube)
    everywhere = np.ones((20, 30), bool)
    for found, source in zip(pcs, maps.reshape(3, 20, 30), strict=True):
        assert abs(correlation(found, source, everywhere)) > 0.95
    np.testing.assert_array_equal(pcs, principal_components(cube))
    two_bands = principal_components(HeatCube(s[:2], [8.0, 9.0]))
    assert two_bands.shape == (3, 20, 30) and not two_bands[2].any() and two_bands[1].any()


@pytest.mark.parametrize("shape", [(1, 1), (5, 7)])
def test_a_cube_of_equal_pixels_has_no_component(shape):
    cube = HeatCube(np.full((8, *shape), 7.0), np.linspace(8, 14, 8))
    np.testing.assert_allclose(principal_components(cube), 0, atol=1e-6)
