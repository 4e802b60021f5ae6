"""Eq. 1's analytic limits, gradients and Eq. 7."""

import numpy as np
import pytest
import torch

from physics.bands import quadrature
from physics.contrast import contrast_terms
from physics.eq1 import physics_loss, render
from physics.errors import InputError
from physics.planck import noise_sigma, planck

W = np.linspace(8, 14, 9)
RNG = np.random.default_rng(1)


def scene(*shape, k=3):
    t = RNG.uniform(270, 310, shape)
    e = RNG.uniform(0.1, 0.99, (*shape, W.size))
    v = RNG.dirichlet(np.ones(k), shape)
    env = planck(W, RNG.uniform(240, 320, (k, 1)))
    return t, e, v, env


def test_black_surface_shows_only_its_glow():
    t, e, v, env = scene(4, 5)
    s, _ = render(t, np.ones_like(e), v, env, W)
    np.testing.assert_allclose(s, planck(W, t[..., None]), rtol=1e-12)


def test_mirror_shows_only_its_surroundings():
    t, e, v, env = scene(6)
    s, x = render(t, np.zeros_like(e), v, env, W)
    np.testing.assert_allclose(s, x, rtol=1e-12)


def test_isothermal_enclosure_hides_every_emissivity():
    _, e, v, _ = scene(50)
    t = np.full(50, 295.0)
    env = np.tile(planck(W, 295.0), (3, 1))
    np.testing.assert_allclose(render(t, e, v, env, W)[0], planck(W, t[:, None]), rtol=1e-12)


def test_one_hot_lighting_picks_that_object():
    t, e, _, env = scene(3)
    _, x = render(t, e, np.eye(3), env, W)
    np.testing.assert_array_equal(x, env)


def test_permuting_the_environment_with_its_lighting_changes_nothing():
    t, e, v, env = scene(7)
    p = [2, 0, 1]
    np.testing.assert_allclose(
        render(t, e, v, env, W)[0], render(t, e, v[:, p], env[p], W)[0], rtol=1e-13
    )


def test_a_wide_band_is_the_mean_of_narrow_ones():
    """By nodes as by many narrow bands, whether the surroundings vary within a band or not."""
    t, e, v, env = scene(4)
    e, nodes = RNG.uniform(0.1, 0.99, (4, 3, 16)), quadrature([9.0, 11.0, 13.0], [2.0] * 3)
    env = env[:, :3]
    uneven = env[..., None] * RNG.uniform(0.5, 1.5, (3, 3, 16))
    for given, fine in ((env, np.repeat(env, 16, axis=1)), (uneven, uneven.reshape(3, -1))):
        s, x = render(t, e, v, given, nodes)
        narrow, texture = render(t, e.reshape(4, -1), v, fine, nodes.ravel())
        np.testing.assert_allclose(s, narrow.reshape(4, 3, 16).mean(-1), rtol=1e-12)
        np.testing.assert_allclose(x, texture.reshape(4, 3, 16).mean(-1), rtol=1e-12)
    # a grey band's glow at its centre is colder than the band's by many times the noise
    glow = planck(nodes, 300.0).mean(-1) - planck(nodes.mean(-1), 300.0)
    assert np.abs(glow / noise_sigma(nodes.mean(-1), 0.05)).max() > 3


def test_gradients_in_every_argument():
    args = [torch.tensor(a, requires_grad=True) for a in scene(2)]
    w = torch.tensor(W)
    assert torch.autograd.gradcheck(lambda *a: render(*a, w), args)
    t, e, v, env = args
    nodes = torch.tensor(quadrature([9.0, 12.0], [2.0, 2.0]))
    e = torch.rand(2, *nodes.shape, dtype=e.dtype, requires_grad=True)
    uneven = torch.rand(3, *nodes.shape, dtype=e.dtype)
    for given in (env[:, :2].detach(), uneven):
        args = t, e, v, given.requires_grad_()
        assert torch.autograd.gradcheck(lambda *a: render(*a, nodes), args)


def test_soft_material_weights_reach_the_library_curve():
    t, _, v, env = scene(2)
    library = RNG.uniform(0, 1, (4, W.size))
    weights = np.eye(4)[[3, 1]]
    np.testing.assert_allclose(
        render(t, weights @ library, v, env, W)[0], render(t, library[[3, 1]], v, env, W)[0]
    )


def test_physics_loss_is_one_where_only_noise_is_left():
    t, e, v, env = (torch.tensor(a) for a in scene(4000))
    w = torch.tensor(W)
    s, _ = render(t, e, v, env, w)
    noisy = s + noise_sigma(w, 0.1) * torch.tensor(RNG.normal(size=s.shape))
    loss = physics_loss(noisy, t, e, v, env, w, noise_sigma(w, 0.1))
    n = s.numel()
    assert loss.shape == t.shape
    assert abs(float(loss.mean()) - 1) < 5 * np.sqrt(2 / n)


def test_eq7_terms_add_up_to_the_gradient_of_s():
    y, x = np.mgrid[0:30, 0:40] / 40.0
    for step in (1e-3, 1e-4):  # first order: the remainder falls as the square
        t = 290 + 30 * step * (x + y**2)
        e = np.stack([0.9 + step * np.sin(3 * x + b) for b in range(W.size)])
        texture = planck(W, 280.0)[:, None, None] * (1 + 10 * step * x * y)
        s = e * planck(W[:, None, None], t) + (1 - e) * texture
        terms = contrast_terms(t, e, texture, W)
        left = np.stack(np.gradient(s, axis=(1, 2))) - sum(terms.values())
        assert np.abs(left).max() < 50 * step**2
    with pytest.raises(InputError, match="two rows and columns"):
        contrast_terms(t[:1], e[:, :1], texture[:, :1], W)
    only_t = contrast_terms(t, np.broadcast_to(e[:, :1, :1], e.shape),
                            np.broadcast_to(texture[:, :1, :1], e.shape), W)  # fmt: skip
    assert not only_t["material"].any() and not only_t["texture"].any()
    assert only_t["temperature"].any()
