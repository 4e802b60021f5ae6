"""What training minimises is least at the truth, and its gradient says how to get there."""

import math

import numpy as np
import pytest
import torch
from scipy.stats import chi2
from test_evidence import World
from traced import one_thread  # noqa: F401

from physics.known import Known
from physics.planck import planck
from texnet.network import Prediction
from training.losses import (
    SKY_VIEW_UNIT,
    SKY_VIEW_WEIGHT,
    TEMPERATURE_WEIGHT,
    TEXTURE_WEIGHT,
    eq1_loss,
    supervised_loss,
)
from training.samples import Sample


class Truth:
    """A World, its first row sky, as a Sample and the Prediction that is right."""

    def __init__(self, noise=0.0, sky=True, dtype=torch.float32, fwhm=0.0, **kwargs):
        world = World(fwhm=fwhm, sky=sky, **kwargs)
        n, shape = len(world.material), world.shape
        maps = lambda a: torch.from_numpy(np.ascontiguousarray(a)).to(dtype).reshape(-1, *shape)
        material = world.material.copy()
        if sky:
            material[: shape[1]] = world.library.sky_index
        s = world.render(material, world.temperature, world.lighting)[0]
        s = s + noise * world.sigma * np.random.default_rng(0).normal(size=s.shape)
        known = Known(*(x.to(dtype) for x in world.known()))
        texture = maps((world.lighting @ world.environment.radiance).T)
        temperature = maps(world.temperature)[0]
        index = torch.from_numpy(material).reshape(shape)
        ground = index != (world.library.sky_index if sky else -1)
        view = maps(world.lighting @ known.sky_object.double().numpy())[0]
        self.sample = Sample(
            known=known, radiance=maps(s.T), material=index, temperature_k=temperature,
            texture=texture, sky_view=view, ground=ground, glance=None,
        )  # fmt: skip
        log_m = torch.full((len(world.library), n), -1e4, dtype=dtype)
        log_m[material, np.arange(n)] = 0
        self.right = Prediction(
            log_m.reshape(-1, *shape), torch.ones(shape, dtype=dtype), temperature.clone(),
            maps(np.log(world.lighting.T)),
        )  # fmt: skip

    def supervised(self, **other):
        return supervised_loss(self.right._replace(**other), self.sample)

    def eq1(self, **other):
        return eq1_loss(self.right._replace(**other), self.sample.known, self.sample.radiance)


@pytest.mark.parametrize(("bands", "fwhm"), [(24, 0.0), (24, 0.25), (6, 1.0), (3, 1.25)])
def test_both_losses_are_zero_at_the_truth(bands, fwhm):
    truth = Truth(bands=bands, fwhm=fwhm)
    assert truth.supervised() < 1e-9
    # B of float32 is right to 1e-4 of 50 mK at best
    assert truth.eq1() < 1e-5


def test_supervised_loss_counts_what_it_says():
    truth = Truth(shape=(6, 8))
    ground, share = truth.sample.ground, 40 / 48
    assert ground.float().mean() == pytest.approx(share)
    # Huber: linear beyond 1 K, over ground alone
    off = truth.supervised(temperature_k=truth.right.temperature_k + 3)
    assert off == pytest.approx(TEMPERATURE_WEIGHT * 2.5, rel=1e-4)
    near = truth.supervised(temperature_k=truth.right.temperature_k + 0.5)
    assert near == pytest.approx(TEMPERATURE_WEIGHT * 0.125, rel=1e-3)
    half = truth.right.log_material - math.log(2)
    assert truth.supervised(log_material=half) == pytest.approx(math.log(2), rel=1e-5)
    # texture in kelvin of 300 K's light, at 300 K
    x = truth.sample.texture.clone()
    w = truth.sample.known.nodes_um.mean(1)[:, None, None]
    warm = truth.sample._replace(texture=x + planck(w, 300.5) - planck(w, 299.5))
    assert supervised_loss(truth.right, warm) == pytest.approx(0.5 * TEXTURE_WEIGHT, rel=0.01)
    open_ = truth.sample._replace(sky_view=truth.sample.sky_view - 2 * SKY_VIEW_UNIT)
    assert supervised_loss(truth.right, open_) == pytest.approx(1.5 * SKY_VIEW_WEIGHT, rel=1e-4)
    blind = open_._replace(known=open_.known._replace(sky_object=torch.zeros(3)))
    assert supervised_loss(truth.right, blind) < 1e-9  # no object stands for the sky


def test_supervised_loss_asks_nothing_but_the_name_of_sky():
    truth = Truth()
    sky = ~truth.sample.ground
    assert sky.any()
    t, v = truth.right.temperature_k.clone(), truth.right.log_lighting.clone()
    t[sky] += 50
    v[:, sky] = torch.log_softmax(torch.randn(3, int(sky.sum())), 0)
    wild = truth.sample.texture.clone()
    wild[:, sky] = 0
    view = torch.where(sky, 1.0, truth.sample.sky_view)
    right = truth.right._replace(temperature_k=t, log_lighting=v)
    assert supervised_loss(right, truth.sample._replace(texture=wild, sky_view=view)) < 1e-9
    m = truth.right.log_material.clone()
    m[:, sky] = math.log(1 / 6)
    share = sky.float().mean().item()
    assert truth.supervised(log_material=m) == pytest.approx(share * math.log(6), rel=1e-5)
    nothing = truth.sample._replace(ground=torch.zeros_like(truth.sample.ground))
    only = supervised_loss(truth.right._replace(log_material=m), nothing)
    assert only == pytest.approx(share * math.log(6), rel=1e-5)


def test_objects_of_one_spectrum_are_worth_the_same_lighting():
    truth = Truth()
    twins = truth.sample.known.environment.clone()
    twins[2] = twins[1]
    v = truth.right.log_lighting
    texture = torch.einsum("khw,kb->bhw", v.exp(), twins)
    sample = truth.sample._replace(
        known=truth.sample.known._replace(environment=twins), texture=texture
    )
    assert supervised_loss(truth.right._replace(log_lighting=v[[0, 2, 1]]), sample) < 1e-9
    assert supervised_loss(truth.right._replace(log_lighting=v[[1, 0, 2]]), sample) > 0.1


def test_physics_loss_of_the_truth_is_that_of_noise():
    """About log 2 where only noise is left: the mean of log(1 + chi^2 / n) of n bands."""
    truth = Truth(noise=1.0, sky=False, shape=(30, 30))
    n = chi2(30)
    mean = n.expect(lambda x: np.log1p(x / 30))
    error = math.sqrt(n.expect(lambda x: (np.log1p(x / 30) - mean) ** 2) / 900)
    assert truth.eq1() == pytest.approx(mean, abs=5 * error)
    assert mean == pytest.approx(math.log(2), abs=0.01)


def test_physics_loss_grows_away_from_the_truth():
    truth = Truth(noise=1.0, sky=False)
    least = truth.eq1()
    assert truth.eq1(temperature_k=truth.right.temperature_k + 0.5) > least + 1
    assert truth.eq1(log_lighting=truth.right.log_lighting[[1, 2, 0]]) > least + 0.3
    assert truth.eq1(log_material=truth.right.log_material.roll(1, 0)) > least + 0.3


def test_physics_loss_leaves_out_what_is_believed_to_be_sky():
    truth = Truth()
    sky = ~truth.sample.ground
    wild = truth.sample.radiance.clone()
    wild[:, sky] *= 2
    assert eq1_loss(truth.right, truth.sample.known, wild) < 1e-5
    # but calling it sky is no way out: that weight has no gradient
    logits = torch.zeros(6, *sky.shape, requires_grad=True)
    truth.eq1(log_material=torch.log_softmax(logits, 0)).backward()
    flat = Truth(sky=True)
    same = torch.zeros(6, *sky.shape, requires_grad=True)
    known = flat.sample.known
    p = torch.log_softmax(same, 0)
    weight = (1 - (p.exp() * known.is_sky[:, None, None]).sum(0)).detach()
    one = lambda y, x: eq1_loss(
        Prediction(*(a[..., y : y + 1, x : x + 1] for a in flat.right._replace(log_material=p))),
        known._replace(is_sky=0 * known.is_sky), flat.sample.radiance[:, y : y + 1, x : x + 1],
    )  # fmt: skip
    parts = [[one(y, x) for x in range(sky.shape[1])] for y in range(sky.shape[0])]
    slow = (weight * torch.stack([torch.stack(row) for row in parts])).sum() / weight.sum()
    slow.backward()
    torch.testing.assert_close(logits.grad, same.grad, rtol=1e-4, atol=1e-7)
    everything = torch.full_like(truth.right.log_material, -1e4)
    everything[truth.sample.known.is_sky.argmax()] = 0
    assert truth.eq1(log_material=everything) == 0


@pytest.mark.parametrize("loss", ["supervised", "eq1"])
def test_gradients_reach_temperature_lighting_and_material(loss):
    truth = Truth(noise=1.0, sky=False, dtype=torch.float64, shape=(2, 2), bands=6, materials=3)
    n = torch.Generator().manual_seed(0)
    draw = lambda *shape: torch.randn(*shape, generator=n, dtype=torch.float64)
    inputs = [
        (truth.right.temperature_k + draw(2, 2)).requires_grad_(),
        draw(3, 2, 2).requires_grad_(), draw(3, 2, 2).requires_grad_(),
    ]  # fmt: skip

    def of(t, m, v):
        p = truth.right._replace(temperature_k=t, log_material=torch.log_softmax(m, 0),
                                 log_lighting=torch.log_softmax(v, 0))  # fmt: skip
        if loss == "supervised":
            return supervised_loss(p, truth.sample)
        return eq1_loss(p, truth.sample.known, truth.sample.radiance)

    assert torch.autograd.gradcheck(of, inputs, eps=1e-5, rtol=1e-4, atol=1e-7)
    for slope in torch.autograd.grad(of(*inputs), inputs):
        assert (slope.abs() > 1e-9).all()
