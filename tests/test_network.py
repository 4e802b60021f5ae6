"""TeXNet: sets stay sets, pixels see so far and no farther, weights survive the disk."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.torch import save_file
from test_evidence import World, hypotheses
from traced import one_thread  # noqa: F401

from physics import InputError
from texnet.files.weights import load_network, save_network
from texnet.network import DILATIONS, STRIDE, TeXNet, stem

SEEN = STRIDE * sum(DILATIONS) + STRIDE - 1  # by 3 x 3 convolutions over cells
HALO = SEEN + 1 + 2  # and by two rounds of messages


def network(seed=0, strength=10.0, **config):
    """A network of random weights, whose heads count as much as if they had been trained."""
    torch.manual_seed(seed)
    net = TeXNet(**config).eval()
    with torch.no_grad():
        net.heads.weight.mul_(strength)
    return net


@torch.no_grad()
def predict(net, known, cube, expected=None):
    """What it predicts of a cube where materials are expected (M, height, width); none if None."""
    s = stem(known, hypotheses(known), torch.from_numpy(cube.radiance.copy()).flatten(1))
    expected = torch.zeros_like(s.log_evidence) if expected is None else expected.flatten(1)
    return net(known, s, expected, cube.shape)


def some_expected(known, shape):
    """(M, height, width) nats at random."""
    size = (len(known.is_sky), *shape)
    return torch.from_numpy(np.random.default_rng(8).normal(size=size).astype(np.float32))


def assert_same(a, b, atol, at=np.s_[...]):
    for name, x, y in zip(a._fields, a, b, strict=True):
        np.testing.assert_allclose(x.numpy()[..., *at] if isinstance(at, tuple) else x.numpy(),
                                   y.numpy(), atol=atol, err_msg=name)  # fmt: skip


def test_it_is_small():
    assert sum(p.numel() for p in TeXNet().parameters()) < 110_000


def test_permuting_the_library_permutes_the_materials():
    world, net = World(seed=1), network(1)
    known, order = world.known(), [3, 0, 5, 1, 4, 2]
    expected = some_expected(known, world.shape)
    a = predict(net, known, world.cube, expected)
    shuffled = known._replace(emissivity=known.emissivity[order], is_sky=known.is_sky[order])
    b = predict(net, shuffled, world.cube, expected[order])
    assert_same(a._replace(log_material=a.log_material[order]), b, 1e-3)
    assert a.log_material.exp().std(dim=0).max() > 0.1  # there was something to permute


def test_permuting_the_environment_permutes_lighting_alone():
    world, net = World(k=4, seed=2), network(2)
    known, order = world.known(), [2, 0, 3, 1]
    a = predict(net, known, world.cube)
    turned = known._replace(
        environment=known.environment[order],
        light=known.light[order],
        sky_object=known.sky_object[order],
        usual_lighting=known.usual_lighting[order],
    )
    b = predict(net, turned, world.cube)
    assert_same(a._replace(log_lighting=a.log_lighting[order]), b, 2e-3)
    assert a.log_lighting.exp().std(dim=0).max() > 0.1


@settings(max_examples=15)
@given(seed=st.integers(0, 1000), bands=st.integers(4, 100), k=st.integers(1, 10),
       materials=st.integers(2, 40), height=st.integers(1, 6), rich=st.booleans(),
       sky=st.booleans())  # fmt: skip
def test_one_network_takes_any_bands_objects_and_materials(
    seed, bands, k, materials, height, rich, sky
):
    world = World(bands, k, materials, sky, rich, seed=seed, shape=(height, 5))
    p = predict(NETWORK, world.known(), world.cube)
    assert p.log_material.shape == (materials, height, 5) and p.log_lighting.shape == (k, height, 5)
    assert p.temperature_k.shape == p.trust.shape == (height, 5)
    assert all(torch.isfinite(x).all() for x in p)
    one = torch.ones(height, 5)
    torch.testing.assert_close(p.log_material.exp().sum(0), one, atol=1e-5, rtol=0)
    torch.testing.assert_close(p.log_lighting.exp().sum(0), one, atol=1e-5, rtol=0)
    assert (p.trust > 0).all()


NETWORK = network(3)


def test_a_pixel_is_seen_as_far_as_the_halo_and_no_farther():
    world, at = World(shape=(51, 51), seed=4), (25, 25)
    known, net = world.known(), network(4)
    assert net.halo == HALO  # what tiles rely on
    a = predict(net, known, world.cube)
    s = world.cube.radiance.copy()
    s[:, *at] *= 1.15
    b = predict(net, known, type(world.cube)(s, world.wavelength, world.width, world.netd))
    y, x = np.indices((51, 51))
    far = np.maximum(abs(y - at[0]), abs(x - at[1]))
    for name, before, after in zip(a._fields, a, b, strict=True):
        change = (before - after).abs().numpy().reshape(-1, 51, 51).max(axis=0)
        assert (change[far > HALO] == 0).all(), name
        assert (change[(far >= 16) & (far <= HALO)] > 0).any(), name
        assert change[at] > 0, name
    # T and V see as far as the trunk, and materials, so T, farther by the messages
    assert (a.log_lighting - b.log_lighting).abs().numpy()[:, far > SEEN].max() == 0
    assert ((a.log_material - b.log_material).abs().numpy()[:, far == HALO - 1] > 0).any()


def test_moving_the_camera_moves_the_answer():
    """By whole cells."""
    world, net = World(shape=(52, 54), seed=5), network(5)
    known = world.known()
    expected = some_expected(known, (52, 54))
    whole = predict(net, known, world.cube, expected)
    cropped = type(world.cube)(world.cube.radiance[:, 4:, 6:], world.wavelength, world.width,
                               world.netd)  # fmt: skip
    part = predict(net, known, cropped, expected[:, 4:, 6:])
    inner = np.s_[..., 4 + HALO : 52 - HALO, 6 + HALO : 54 - HALO]
    same = np.s_[..., HALO : 48 - HALO, HALO : 48 - HALO]
    for name, a, b in zip(whole._fields, whole, part, strict=True):
        np.testing.assert_allclose(a.numpy()[inner], b.numpy()[same], atol=2e-3, err_msg=name)
        assert a.numpy()[inner].size
    edge = (whole.temperature_k[4:, 6:] - part.temperature_k)[0].abs().max()
    assert edge > 2e-3  # at the border there is less to see


def test_a_band_that_tells_nothing_may_be_noisier_yet():
    """As one that air hides; how noisy it is must not pass for the noise of all."""
    world, net = World(seed=7), network(7)
    known = world.known()

    def opaque(times):
        sigma = known.sigma.clone()
        sigma[3] *= times
        return predict(net, known._replace(sigma=sigma), world.cube)

    a, b = opaque(1e3), opaque(1e5)
    assert_same(a, b, 2e-3)
    assert (a.log_material - predict(net, known, world.cube).log_material).abs().max() > 0.1


def test_untrained_it_says_what_physics_says():
    """Regions of materials well apart: heads of weight zero pass the evidence on."""
    block = (np.indices((12, 15))[0] // 6 * 3 + np.indices((12, 15))[1] // 5).ravel() % 5
    world = World(shape=(12, 15), depth=(0.3, 0.6), material=np.array([0, 2, 3, 4, 5])[block])
    p = predict(network(strength=0.0), world.known(), world.cube)
    assert (p.log_material.argmax(0).numpy().ravel() == world.material).mean() > 0.95
    error = p.temperature_k.numpy().ravel() - world.temperature
    assert np.sqrt((error**2).mean()) < 1
    np.testing.assert_allclose(p.trust, 1, atol=1e-3)


def test_untrained_it_takes_what_is_expected_for_a_prior():
    """Without messages: p(m | z, expected) is p(m | z) exp(expected), normalised."""
    world, net = World(shape=(8, 9), seed=8), network(strength=0.0, messages=0)
    known = world.known()
    expected = some_expected(known, world.shape)
    p = predict(net, known, world.cube).log_material.exp() * expected.exp()
    told = predict(net, known, world.cube, expected).log_material.exp()
    torch.testing.assert_close(told, p / p.sum(0), atol=2e-3, rtol=0)
    assert (told - p).abs().max() > 0.1  # it had something to say


def test_every_weight_is_trained():
    world = World(seed=6)
    known, net = world.known(), network(6)
    s = stem(
        known, hypotheses(known), torch.from_numpy(world.cube.radiance.copy()).flatten(1)
    )  # fmt: skip
    p = net(known, s, some_expected(known, world.shape).flatten(1), world.shape)
    target = torch.from_numpy(world.material).reshape(1, *world.shape)
    loss = torch.nn.functional.nll_loss(p.log_material[None], target) + p.trust.mean()
    loss = loss + (p.temperature_k - 290).square().mean() + p.log_lighting[0].exp().mean()
    loss.backward()
    for name, weight in net.named_parameters():
        assert torch.isfinite(weight.grad).all() and weight.grad.abs().max() > 0, name


# --- files -------------------------------------------------------------------------------------


def test_weights_survive_the_disk(tmp_path):
    world, net = World(seed=7), network(7, width=20, dilations=(1, 3), messages=1)
    path = tmp_path / "net.safetensors"
    save_network(net, path, {"scenes": 3, "note": "a ü"})
    again, history = load_network(path)
    assert history == {"scenes": 3, "note": "a ü"} and not again.training
    assert again.config == net.config
    assert_same(predict(net, world.known(), world.cube), predict(again, world.known(), world.cube),
                0)  # fmt: skip
    assert [p.name for p in tmp_path.iterdir()] == ["net.safetensors"]
    (tmp_path / "other").touch()
    assert path.stat().st_mode == (tmp_path / "other").stat().st_mode, "others may not read it"


def bad_files(folder):
    good = folder / "good"
    save_network(network(width=8, dilations=(1,)), good, {})
    whole = good.read_bytes()
    tensors = {n: p.detach() for n, p in network(width=8, dilations=(1,)).state_dict().items()}
    config = '{"width": 8, "dilations": [1], "messages": 2}'
    files = {
        "empty": b"", "text": b"no weights here", "half": whole[: len(whole) // 2],
        "header": whole[:60],
    }  # fmt: skip
    about = {
        "bare": None, "no history": {"config": config}, "no json": {"config": "{", "history": "{}"},
        "list": {"config": "[1]", "history": "{}"}, "word": {"config": '"a"', "history": "{}"},
        "wider": {"config": config.replace("8", "9"), "history": "{}"},
        "other key": {"config": '{"depth": 3}', "history": "{}"},
        "no number": {"config": config.replace("8", '"8"'), "history": "{}"},
        "negative": {"config": config.replace("8", "-8"), "history": "{}"},
        "history": {"config": config, "history": "so it was"},
        "no stride": {"config": config[:-1] + ', "stride": 0}', "history": "{}"},
        "odd stride": {"config": config[:-1] + ', "stride": 3}', "history": "{}"},
        "half a stride": {"config": config[:-1] + ', "stride": 2.5}', "history": "{}"},
        "no dilation": {"config": config.replace("[1]", "[0]"), "history": "{}"},
    }  # fmt: skip
    for name, content in files.items():
        (folder / name).write_bytes(content)
    for name, metadata in about.items():
        save_file(tensors, folder / name, metadata)
    save_file({n: p for n, p in list(tensors.items())[1:]}, folder / "one less",
              {"config": config, "history": "{}"})  # fmt: skip
    save_file({n: p / 0 for n, p in tensors.items()}, folder / "endless",
              {"config": config, "history": "{}"})  # fmt: skip
    (folder / "folder").mkdir()
    return [*files, *about, "one less", "endless", "folder", "not there"]


def test_files_that_hold_no_network_are_named_in_one_sentence(tmp_path):
    for name in bad_files(tmp_path):
        with pytest.raises(InputError) as caught:
            load_network(tmp_path / name)
        said = str(caught.value)
        assert said.startswith("model: ") and str(tmp_path / name) in said, name
        rest = said.replace(str(tmp_path / name), "")
        assert rest.endswith(".") and rest.count(". ") == 0 and "\n" not in said, said
    load_network(tmp_path / "good")


def test_weights_that_diverged_are_not_written(tmp_path):
    net = network(width=8, dilations=(1,))
    with torch.no_grad():
        net.heads.bias[0] = torch.nan
    with pytest.raises(InputError, match="diverged"):
        save_network(net, tmp_path / "net.safetensors", {})
    assert not list(tmp_path.iterdir())
