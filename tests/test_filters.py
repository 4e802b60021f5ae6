"""Filter design: closed forms, a dense solution of the same criterion, and what must not matter."""

import numpy as np
import pytest

from physics import InputError, MaterialLibrary
from physics.bands import equidistant_bands
from physics.filters import (
    FINE_UM,
    HIGH_UM,
    LOW_UM,
    NETD_K,
    TOLERANCE_K,
    WIDTHS_UM,
    Scenes,
    design_filters,
    draw_scenes,
    filter_range,
    rate_filters,
)
from physics.planck import noise_sigma, planck, planck_derivative
from physics.prior import MIN_TEMPERATURE_SPREAD_K

W = np.linspace(7.5, 14.5, 141)
FEW = Scenes(*(a[:4] for a in draw_scenes()))


def dip(centre, width=0.15, depth=0.15):
    return 0.95 - depth * np.exp(-0.5 * ((W - centre) / width) ** 2)


def library(*curves):
    return MaterialLibrary([f"m{i}" for i in range(len(curves))], W, np.array(curves))


THREE = library(dip(9.2, 0.5), dip(11.0, 0.3), dip(12.5))


@pytest.mark.parametrize("centre", [8.7, 10.4, 12.3])
def test_two_materials_that_differ_in_one_place_get_a_filter_there(centre):
    best = design_filters(library(dip(centre), np.full(W.size, 0.95)), 4, FEW)
    off = np.abs(best.wavelength_um - centre) / best.fwhm_um
    assert off.min() < 0.5
    # two unlike materials are told apart by what differs, not by the last filter at 14 um
    away = [c for c in np.linspace(8.5, 13.5, 11) if abs(c - centre) > 0.7][:3]
    blind = rate_filters(library(dip(centre), np.full(W.size, 0.95)), away, 0.5, FEW)
    assert best.material_loss < 0.5 * blind.material_loss
    assert blind.material_loss == pytest.approx(np.log(2), abs=1e-3)


def test_the_order_of_the_library_and_its_sky_change_nothing():
    curves, names = THREE.emissivity, THREE.names
    sky = np.linspace(0.2, 0.9, W.size)
    turned = MaterialLibrary(["sky", *names[::-1]], W, np.concatenate([sky[None], curves[::-1]]))
    a, b = design_filters(THREE, 4, FEW), design_filters(turned, 4, FEW)
    np.testing.assert_array_equal(a.wavelength_um, b.wavelength_um)
    np.testing.assert_array_equal(a.fwhm_um, b.fwhm_um)
    assert a.loss == pytest.approx(b.loss, rel=1e-9)


def test_more_filters_are_never_worse_and_no_design_is_worse_than_filters_side_by_side():
    designs = {n: design_filters(THREE, n, FEW) for n in (3, 4, 5)}
    losses = [d.loss for d in designs.values()]
    assert losses == sorted(losses, reverse=True) and losses[-1] < losses[0]
    for n, d in designs.items():
        centres, width = equidistant_bands(n, LOW_UM, HIGH_UM)
        assert d.loss <= rate_filters(THREE, centres, float(width[0]), FEW).loss
        assert len(set(d.wavelength_um)) == n and (np.diff(d.wavelength_um) > 0).all()
        assert (d.wavelength_um - d.fwhm_um / 2 >= LOW_UM - 1e-9).all()
        assert (d.wavelength_um + d.fwhm_um / 2).max() == pytest.approx(HIGH_UM)
        assert d.netd_k == pytest.approx(NETD_K / d.fwhm_um[0])


def test_no_filter_moved_and_no_other_width_is_better_than_a_design():
    best = design_filters(THREE, 4, FEW)
    centres, width = list(best.wavelength_um), float(best.fwhm_um[0])
    for i in range(3):
        others = centres[:i] + centres[i + 1 :]
        for place in np.arange(LOW_UM + width / 2, HIGH_UM - width / 2 - 0.05, 0.1):
            assert rate_filters(THREE, [*others, place], width, FEW).loss > best.loss - 1e-9
    for other in WIDTHS_UM:
        moved = [min(max(c, LOW_UM + other / 2), HIGH_UM - other / 2) for c in centres[:3]]
        rated = rate_filters(THREE, [*moved, HIGH_UM - other / 2], other, FEW)
        assert rated.loss > best.loss - 1e-9


def test_as_many_filters_as_stand_side_by_side():
    keep = (W >= 9) & (W <= 12)
    black = MaterialLibrary(["black", "grey"], W[keep], np.outer([1.0, 0.95], np.ones(keep.sum())))
    few = Scenes(*(a[:1] for a in FEW))
    assert len(set(design_filters(black, 16, few).wavelength_um)) == 16
    with pytest.raises(InputError, match="only 30 filters fit .*, got 31"):
        design_filters(black, 31, few)


def test_black_bodies_are_all_alike_and_their_temperature_is_as_known_as_the_noise_lets_it():
    one = Scenes(np.array([290.0]), planck(FINE_UM, 280.0)[None, None], np.ones((1, 1)))
    centres = [9.0, 11.0, 13.0]
    found = rate_filters(library(*np.ones((4, W.size))), centres, 0.4, one)
    assert found.material_loss == pytest.approx(np.log(4), rel=1e-12)
    noise = noise_sigma(np.array(centres), NETD_K / 0.4)
    slope = [planck_derivative(c + np.linspace(-0.2, 0.2, 401), 290.0).mean() for c in centres]
    information = ((slope / noise) ** 2).sum() + MIN_TEMPERATURE_SPREAD_K**-2
    assert found.temperature_k == pytest.approx(information**-0.5, rel=1e-4)
    assert found.loss - found.material_loss == pytest.approx(
        np.log1p(1 / information / TOLERANCE_K**2) / 2, rel=1e-4
    )


def test_where_all_is_as_warm_as_its_only_surroundings_nothing_tells_materials_apart():
    one = Scenes(np.array([290.0]), planck(FINE_UM, 290.0)[None, None], np.ones((1, 1)))
    found = rate_filters(THREE, *_side_by_side(6), one)
    assert found.material_loss == pytest.approx(np.log(3), rel=1e-9)


def test_grey_bodies_of_one_temperature_differ_by_what_the_temperature_cannot_mend():
    """d^2 = r' (I + J P J')^-1 r by dense algebra, one scene, all surroundings one black body."""
    e, t, around = (0.95, 0.9), 300.0, 260.0
    one = Scenes(np.array([t]), planck(FINE_UM, around)[None, None], np.ones((1, 1)))
    centres, width = np.array([8.5, 10.0, 11.0, 13.5]), 1.0
    found = rate_filters(library(*(np.full(W.size, x) for x in e)), centres, width, one)
    noise = noise_sigma(centres, NETD_K / width)
    fine = centres[:, None] - 0.45 + 0.1 * np.arange(10)
    signal = [(x * planck(fine, t) + (1 - x) * planck(fine, around)).mean(1) for x in e]
    r = (signal[0] - signal[1]) / noise
    apart = np.zeros((2, 2))
    for other, x in enumerate(e):
        hats = np.maximum(0, 1 - np.abs(fine[..., None] - np.arange(8, 14.5)))
        error = (1 - x) * (hats * noise_sigma(fine, 0.3)[..., None]).mean(1)
        j = np.column_stack([x * planck_derivative(fine, t).mean(1) * 15.0, error])
        j = j / noise[:, None]
        apart[1 - other, other] = r @ np.linalg.solve(np.eye(4) + j @ j.T, r)
    assert found.material_loss == pytest.approx(
        np.log(np.exp(-apart / 8).sum(axis=1)).mean(), rel=1e-6
    )


def test_what_is_refused():
    for n in (2, 3.5):
        with pytest.raises(InputError, match=f"whole number, at least 3, got {n}"):
            design_filters(THREE, n)
    for centres, width in (([9.0, 10.0, 11.0], 0.0), ([9.0, 10.0, 11.0], -1.0), ([], 1.0)):
        with pytest.raises(InputError, match="width above 0"):
            rate_filters(THREE, centres, width)
    with pytest.raises(InputError, match="only the sky"):
        design_filters(MaterialLibrary(["sky"], W, np.full((1, W.size), 0.5)), 4)
    with pytest.raises(InputError, match="cover"):
        design_filters(MaterialLibrary(["a", "b"], [9, 10], [[0.9, 0.8], [0.8, 0.9]]), 4)
    with pytest.raises(InputError, match="within 8-14 um"):
        rate_filters(THREE, [8.2, 10.0], 1.0)


def test_filters_end_where_the_library_does():
    """And what lies beyond it says nothing of filters within it."""
    keep = W <= 13.5
    short = MaterialLibrary(THREE.names, W[keep], THREE.emissivity[:, keep])
    low, high = filter_range(short)
    assert (low, high) == (8.0, 13.5) and filter_range(THREE) == (LOW_UM, HIGH_UM)
    best = design_filters(short, 3, FEW)
    assert (best.wavelength_um + best.fwhm_um / 2).max() == pytest.approx(high)
    width = float(best.fwhm_um[0])
    for a, b in zip(best, rate_filters(THREE, best.wavelength_um, width, FEW), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9)
    with pytest.raises(InputError, match="within 8-13.5 um"):
        rate_filters(short, [9.0, 13.5], 1.0)


def _side_by_side(n):
    centres, width = equidistant_bands(n, LOW_UM, HIGH_UM)
    return centres, float(width[0])
