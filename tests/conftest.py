"""Fixtures shared by the solver's tests: a library with features, and Eq. 1 pixels.

Pixels here come from the k-object model itself; they test the solver, never accuracy.
"""

import signal

import hypothesis
import numpy as np
import pytest

from physics import Environment, HeatCube, MaterialLibrary
from physics.eq1 import render
from physics.planck import noise_sigma, planck

# no test asserts a time, and what is green stays so: the same examples every time
hypothesis.settings.register_profile("texnet", deadline=None, derandomize=True)
hypothesis.settings.load_profile("texnet")


def small_library(materials=8, seed=0):
    rng = np.random.default_rng(seed)
    x, w = np.linspace(-1, 1, 141), np.linspace(7.5, 14.5, 141)
    curves = [np.polynomial.chebyshev.chebval(x, rng.normal(size=8)) for _ in range(materials)]
    depth = rng.uniform(0.03, 0.15, materials)
    e = [0.98 - d * np.abs(c) / np.abs(c).max() for d, c in zip(depth, curves, strict=True)]
    return MaterialLibrary([f"m{i}" for i in range(materials)], w, np.array(e))


def small_environment(w, k=3):
    cold = np.clip(0.25 + np.abs(w - 10.8) / 3.5, 0, 1) * planck(w, 285.0)  # like a sky
    warm = [planck(w, t) for t in np.linspace(280, 310, k - 1)] if k > 1 else []
    return Environment(np.stack([cold, *warm]), w)


class Pixels:
    """shape[0] x shape[1] pixels of Eq. 1 with sensor noise, and what made them."""

    def __init__(self, bands=54, k=3, shape=(20, 30), netd=0.05, seed=0, library=None):
        rng = np.random.default_rng(seed)
        n = shape[0] * shape[1]
        self.library = library or small_library()
        self.wavelength = np.linspace(8.05, 13.95, bands) if bands > 1 else np.array([10.0])
        self.environment = small_environment(self.wavelength, k)
        self.material = rng.integers(0, len(self.library), n)
        self.temperature = rng.uniform(278, 308, n)
        self.lighting = rng.dirichlet(np.ones(k), n)
        e = self.library.at(self.wavelength)[self.material]
        s, self.texture = render(
            self.temperature, e, self.lighting, self.environment.radiance, self.wavelength
        )
        s = s + rng.normal(size=s.shape) * noise_sigma(self.wavelength, netd)
        self.cube = HeatCube(s.T.reshape(bands, *shape), self.wavelength, netd_k=netd)


@pytest.fixture(scope="session")
def pixels():
    return Pixels()


@pytest.fixture(scope="session")
def make_pixels():
    return Pixels


def hear_ctrl_c():
    """For preexec_fn: a test run in the background, deaf to Ctrl-C, would hand that down."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
