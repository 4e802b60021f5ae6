"""What training minimises: supervised T, m and V, and Eq. 1 itself.

    supervised   -log p(m), and Huber's loss of T, of the sky's V in units of SKY_VIEW_UNIT, and
                 of the texture that V yields: objects of equal spectra are interchangeable in V
    physics      log(1 + |S - S~|^2 / sigma^2) of Eq. 1 with e = sum_m p_m e_m, weighted by the
                 network's belief that there is no sky. Needs no truth.

The texture error is in kelvin: its radiance error divided by dB/dT at 300 K.
"""

import torch
from torch.nn import functional

from physics.eq1 import physics_loss
from physics.planck import noise_sigma

PHYSICS_WEIGHT = 0.05
TEXTURE_WEIGHT = 0.2
TEMPERATURE_WEIGHT = 0.5
SKY_VIEW_WEIGHT, SKY_VIEW_UNIT = 0.2, 0.1


def cross_entropy(prediction, sample):
    """Mean -log p of the true materials of a Sample; unlike torch's own, deterministic on a GPU."""
    return -prediction.log_material.gather(0, sample.material[None]).mean()


def supervised_loss(prediction, sample):
    """Scalar loss against the truth of a Sample."""
    ground, wavelength = sample.ground, sample.known.nodes_um.mean(1)
    loss = cross_entropy(prediction, sample)
    if not ground.any():
        return loss
    t_error = (prediction.temperature_k - sample.temperature_k)[ground]
    v = prediction.log_lighting.exp()[:, ground]
    per_kelvin = noise_sigma(wavelength, 1.0)
    x_error = (v.T @ sample.known.environment - sample.texture[:, ground].T) / per_kelvin
    sky_error = (v.T @ sample.known.sky_object - sample.sky_view[ground]) / SKY_VIEW_UNIT
    sky_error = sky_error * sample.known.sky_object.amax()  # no sky object: no loss
    return (
        loss
        + SKY_VIEW_WEIGHT * functional.huber_loss(sky_error, torch.zeros_like(sky_error))
        + TEMPERATURE_WEIGHT * functional.huber_loss(t_error, torch.zeros_like(t_error))
        + TEXTURE_WEIGHT * functional.huber_loss(x_error, torch.zeros_like(x_error))
    )


def eq1_loss(prediction, known, radiance):
    """Scalar physics loss of a prediction for radiance (bands, height, width)."""
    p = prediction.log_material.exp()
    emissivity = (p.movedim(0, -1) @ known.emissivity.flatten(1)).unflatten(
        -1, known.nodes_um.shape
    )
    misfit = physics_loss(
        radiance.movedim(0, -1), prediction.temperature_k, emissivity,
        prediction.log_lighting.exp().movedim(0, -1), known.light, known.nodes_um,
        known.sigma,
    )  # fmt: skip
    ground = 1 - (p * known.is_sky[:, None, None]).sum(0).detach()
    return (ground * torch.log1p(misfit)).sum() / ground.sum().clamp(min=1.0)
