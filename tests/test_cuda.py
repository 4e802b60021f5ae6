"""On a GPU what is found on a CPU; run where torch finds one.

Float32 sums of another order differ in their last digits: E and evidence by 1e-3 of a misfit's
nats, T by thousandths of its sigma.
"""

import numpy as np
import pytest
import torch
from test_evidence import World, hypotheses
from test_finetune import NEW, network, same, toy, weights  # noqa: F401
from test_refinement import blocks, one_sided
from traced import one_thread  # noqa: F401
from traced import traced as traced_cube

from physics.eq1 import physics_loss
from physics.evidence import evidence
from physics.hypotheses import GUESS_PRECISION
from physics.library import MaterialLibrary
from physics.planck import noise_sigma, planck
from physics.refinement import refine
from texnet.cli import main
from texnet.files.cube_io import write_cube
from texnet.learned import torch_model
from texnet.pipeline import decompose
from training.finetune import finetune
from training.reshade import ReshadedSet
from training.train import Draws, Training, fit

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="torch finds no GPU")


@pytest.fixture
def draws(tmp_path):
    scenes = ReshadedSet(tmp_path, "train", 2, NEW)
    scenes.make()
    return Draws(scenes, 0, 24)


def there(x):
    """A tensor, or a NamedTuple of such, on the GPU."""
    return type(x)(*(a.cuda() for a in x)) if isinstance(x, tuple) else x.cuda()


def test_equation_1_has_its_gradients():
    w = np.linspace(8.5, 13.5, 5)
    of = lambda a: torch.tensor(a, dtype=torch.float64, device="cuda", requires_grad=True)
    x = [of([285.0, 301.0]), of(np.full((2, 5), 0.8)), of([[0.3, 0.7], [0.9, 0.1]])]
    x.append(of(planck(w, np.array([[250.0], [295.0]]))))
    measured, w = of(planck(w, np.array([[280.0], [300.0]]))).detach(), of(w).detach()
    sigma = noise_sigma(w, 0.5)
    assert torch.autograd.gradcheck(lambda *x: physics_loss(measured, *x, w, sigma), x)


@pytest.mark.parametrize("bands", [4, 24, 54])
def test_evidence_and_refinement_are_the_same(bands):
    world = World(bands=bands, k=4, shape=(8, 12), lighting=one_sided(4, 96, 4))
    known, s = world.known(), world.pixels(world.known())
    h = hypotheses(known)
    nats, x = evidence(h, s)
    on_gpu, x_there = (a.cpu() for a in evidence(there(h), s.cuda()))
    torch.testing.assert_close(on_gpu, nats, rtol=1e-4, atol=1e-2)
    row = torch.from_numpy(world.material)
    best = lambda x: x[row, :, torch.arange(len(row))].T
    t, guess = torch.zeros(len(row)), torch.full((4, len(row)), 0.25)
    b = blocks(h, 4, GUESS_PRECISION)
    usual = known.usual_lighting
    found = refine(b, best(x), row, t, guess, usual)
    again = refine(there(b), *(a.cuda() for a in (best(x_there), row, t, guess, usual)))
    off = (again.t.cpu() - found.t).abs() / found.sigma
    assert off.max() < 0.05
    torch.testing.assert_close(again.lighting.cpu(), found.lighting, rtol=0, atol=5e-3)


@pytest.mark.parametrize("method", ["net", "net+sgd"])
@pytest.mark.parametrize(("scene", "bands"), [("forest", 24), ("street", 8)])
def test_a_traced_cube_has_the_same_answer(method, scene, bands):
    cube, _ = traced_cube(scene, bands)
    library = MaterialLibrary.starter()
    here, there = (
        decompose(cube, library, method=method, model=torch_model(device=device))
        for device in ("cpu", "cuda")
    )
    assert (here.netd_k, here.gain, here.offset_k) == (there.netd_k, there.gain, there.offset_k)
    alike = here.material == there.material
    assert alike.mean() > 0.998
    off = np.abs(here.temperature_k - there.temperature_k) / here.temperature_sigma_k
    assert np.quantile(off[alike], 0.998) < 0.02
    assert (here.unknown == there.unknown).mean() > 0.998
    off = np.abs(here.texture - there.texture).mean(axis=0) / here.texture.mean()
    assert np.quantile(off[alike], 0.998) < 2e-3


def test_a_step_of_training_has_the_same_gradient(draws):
    gradients = []
    for device in ("cpu", "cuda"):
        module = Training(network(), 2).to(device)
        batch = module.transfer_batch_to_device(draws[1], torch.device(device), 0)
        module.loss(*batch).backward()
        gradients.append(torch.cat([p.grad.flatten().cpu() for p in module.parameters()]))
    here, there = gradients
    assert (here - there).norm() < 1e-3 * here.norm()


def test_training_goes_on_to_the_same_weights(tmp_path, draws):
    def run(folder, epochs):
        part = Training(network(), 2)
        fit(part, draws, None, folder, epochs=epochs, per_epoch=4, device="cuda")
        return weights(part.network.cpu())

    whole = run(tmp_path / "whole", 2)
    first = run(tmp_path / "part", 1)
    assert not same(whole, first) and same(whole, run(tmp_path / "part", 2))


def test_fine_tuning_on_scenes_and_on_cubes(tmp_path):
    cube, _ = traced_cube("forest", 20)
    for how in ({"scenes": 2}, {"cubes": [cube]}):
        better, history = finetune(network(), NEW, tmp_path, epochs=1, device="cuda", **how)
        assert not same(weights(better), weights(network()))
        assert {p.device.type for p in better.parameters()} == {"cpu"}
        assert all(np.isfinite(v) for v in history["after"].values())


def test_the_command_answers_as_on_a_cpu(tmp_path):
    cube, _ = traced_cube("forest", 24)
    write_cube(cube, tmp_path / "cube.npz")
    arrays = []
    for device in ("cpu", "cuda"):
        words = ["decompose", tmp_path / "cube.npz", "--out", tmp_path / device, "--device", device]
        assert main([str(w) for w in words]) == 0
        with np.load(tmp_path / device / "decomposition.npz") as npz:
            arrays.append(dict(npz))
    here, there = arrays
    assert (here["material"] == there["material"]).mean() > 0.998
    assert np.median(np.abs(here["temperature_k"] - there["temperature_k"])) < 1e-3
