"""Planck's law against its known integrals, limits and gradients."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from physics.planck import brightness_temperature, noise_sigma, planck, planck_derivative

STEFAN_BOLTZMANN = 5.670374419e-8


def test_total_radiance_is_stefan_boltzmann():
    w = np.geomspace(0.5, 2000, 200_001)
    for t in (200.0, 300.0, 1000.0):
        total = np.pi * np.trapezoid(planck(w, t), w)
        assert total == pytest.approx(STEFAN_BOLTZMANN * t**4, rel=1e-4)


def test_peak_obeys_wien():
    w = np.linspace(5, 20, 150_001)
    assert w[planck(w, 300.0).argmax()] == pytest.approx(2897.771955 / 300, rel=1e-4)


def test_hadar_channel_means_are_planck_at_289_k():
    """Published means of the HADAR set at 720 and 1250 cm-1, in W m-2 sr-1 per cm-1."""
    for wavenumber, mean in ((720, 0.12648), (1250, 0.04625)):
        w = 1e4 / wavenumber
        assert planck(w, 289.0) * w**2 / 1e4 == pytest.approx(mean, rel=0.01)


@given(st.floats(7, 15), st.floats(100, 1500))
def test_brightness_temperature_inverts(w, t):
    assert brightness_temperature(w, planck(w, t)) == pytest.approx(t, rel=1e-10)


def test_float32_stays_finite_and_accurate_from_1_k():
    w = torch.tensor(10.0)
    t = torch.tensor([1.0, 50.0, 300.0, 3000.0], requires_grad=True)
    b = planck(w, t)
    b.sum().backward()
    assert torch.isfinite(b).all() and torch.isfinite(t.grad).all()
    exact = planck(10.0, np.array([300.0, 3000.0]))
    np.testing.assert_allclose(b[2:].detach().numpy(), exact, rtol=3e-6)
    back = brightness_temperature(w, b[2:].detach())
    np.testing.assert_allclose(back.numpy(), [300, 3000], rtol=1e-6)


def test_derivative_is_the_derivative():
    w = torch.linspace(8, 14, 7, dtype=torch.float64)[:, None]
    t = torch.linspace(150, 900, 5, dtype=torch.float64).requires_grad_()
    (slope,) = torch.autograd.grad(planck(w, t).sum(), t)
    np.testing.assert_allclose(planck_derivative(w, t).sum(0).detach(), slope, rtol=1e-10)
    assert torch.autograd.gradcheck(planck, (w.clone().requires_grad_(), t))


def test_noise_sigma_is_netd_seen_as_radiance():
    w = np.array([8.0, 12.0])
    step = planck(w, 300.0 + 1e-3) - planck(w, 300.0)
    np.testing.assert_allclose(noise_sigma(w, 1e-3), step, rtol=1e-4)
