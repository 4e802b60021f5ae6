"""One exported file answers as the torch model does, on any sizes, without torch."""

import json
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from threading import Lock

import numpy as np
import onnx
import pytest
import torch
from conftest import small_library

import texnet
from export import Runtime
from export.to_onnx import _graphs, export_onnx
from physics import Environment, HeatCube, InputError
from physics.eq1 import render
from physics.evidence import tensors
from physics.expected import Expected
from physics.hypotheses import set_up
from physics.known import bytes_per_pixel, known_arrays
from physics.planck import noise_sigma, planck
from texnet.chunks import SOLVED, chunks_of
from texnet.files.weights import load_network
from texnet.learned import shipped_network, torch_model
from texnet.model import TeXModel
from texnet.network import TeXNet

FLOATS = (
    "material_probability", "temperature_k", "temperature_sigma_k", "thermal_lighting",
    "texture", "sky_texture", "residual",
)  # fmt: skip
HISTORY = {"seed": 3, "validation": {"accuracy": 0.5}}


PATH = Path(texnet.__file__).parent / "data" / "texnet.onnx"


@pytest.fixture(scope="module")
def network():
    return shipped_network()


@pytest.fixture(scope="module")
def runtime():
    return Runtime(PATH, threads=2)


def scene(bands=24, k=3, materials=8, shape=(20, 30), spreads=(3, 2, 4, 0), seed=0, sky=True):
    """radiance and known arrays of a cube by Eq. 1, with as many spreads as said; the last material
    is the sky, which a tenth of the other pixels are in part, if it is in view."""
    rng = np.random.default_rng(seed)
    pixels, library = shape[0] * shape[1], small_library(materials, seed)
    if sky:
        library = replace(library, names=(*library.names[:-1], "sky"))
    w = np.linspace(8.05, 13.95, bands) if bands > 1 else np.array([10.0])
    cold = np.clip(0.25 + np.abs(w - 10.8) / 3.5, 0, 1) * planck(w, 285.0)
    warm = [planck(w, t) for t in np.linspace(280, 310, k - 1)]
    sigma = noise_sigma(w, 0.05)
    rows = [rng.normal(0, 0.02, (d, bands)) for d in spreads]
    above = 0.7 * cold + 0.3 * planck(w, 285.0)
    environment = Environment(
        np.stack([cold, *warm]), w, (0,), spread=rows[0], skylight_spread=rows[1],
        curve_spread=rows[2], sky_spread=rows[3], error_k=0.05, sky_mean=above if sky else None,
    )  # fmt: skip
    # patches, so that the neighbours have something to say
    across = rng.integers(0, materials, (-(-shape[0] // 5), -(-shape[1] // 5)))
    material = across.repeat(5, 0).repeat(5, 1)[: shape[0], : shape[1]].ravel()
    s, _ = render(
        rng.uniform(278, 308, pixels), library.at(w)[material],
        rng.dirichlet(np.ones(k), pixels), environment.radiance, w,
    )  # fmt: skip
    if sky:
        share = np.where(
            material == materials - 1, 1.0, rng.choice([0.0, 0.25], pixels, p=[0.9, 0.1])
        )
        s = s + share[:, None] * (above - s)
    s = s + rng.normal(size=s.shape) * sigma
    cube = HeatCube(s.T.reshape(bands, *shape), w, netd_k=0.05)
    return cube.radiance, known_arrays(cube, library, environment)


def expected_of(image, known, step=4):
    """A little more of one material here, of another there."""
    rng, size = np.random.default_rng(2), [-(-n // step) for n in image.shape[1:]]
    return Expected(rng.normal(size=(len(known["is_sky"]), *size)).astype(np.float32), step)


def in_torch(network, image, known, expected=None):
    scene = tensors(set_up(known))
    if expected is not None:
        expected = torch.from_numpy(expected.of_tile(0, 0, *image.shape[1:]))
    answer = TeXModel(network)(scene, torch.from_numpy(np.array(image)), expected)
    return {name: a.numpy() for name, a in answer._asdict().items()}


def assert_close(a, b, temperature_k=5e-3, lighting=1e-3):
    assert a.keys() == b.keys()
    same = a["material"] == b["material"]
    assert same.mean() >= 0.999
    t = np.abs(a["temperature_k"] - b["temperature_k"])[same]
    assert most(t) <= temperature_k
    v = np.abs(a["thermal_lighting"] - b["thermal_lighting"])[:, same]
    assert most(v.max(axis=0)) <= lighting
    # what `texnet.camera.calibration` compares, to a tenth of a nat
    off = np.abs(a["log_evidence"] - b["log_evidence"])
    assert most(off - 1e-4 * np.abs(b["log_evidence"])) <= 0.02


def most(off):
    """The most that all pixels are off, but one in 10,000: where a hypothesis is about as unlikely
    as those that are not refined, rounding decides whether it is."""
    return np.sort(off, axis=None)[-1 - off.size // 10_000]


RANDOM = np.random.default_rng(5)
CONFIGURATIONS = [
    dict(
        bands=int(RANDOM.integers(4, 101)), k=int(RANDOM.integers(2, 9)),
        materials=int(RANDOM.integers(4, 31)),
        shape=tuple(RANDOM.integers(12, 40, 2).tolist()),
        spreads=tuple(RANDOM.integers(0, 6, 4).tolist()), seed=seed, sky=seed % 3 > 0,
    )
    for seed in range(6)
]  # fmt: skip
EDGES = [
    dict(bands=4, k=2, materials=2, spreads=(0, 0, 0, 0)),
    dict(bands=4, k=2, materials=2, spreads=(0, 0, 0, 0), sky=False),
    dict(k=4, materials=3, sky=False),
    dict(bands=100, k=10, materials=30, spreads=(6, 6, 6, 6), shape=(9, 11)),
    dict(k=1, spreads=(0, 2, 1, 0)),
    dict(bands=30, k=10),
    dict(shape=(1, 17)),
    dict(shape=(17, 1)),
    dict(shape=(1, 1)),
    dict(bands=1, k=2),
    dict(bands=7, materials=20, shape=(131, 127)),  # more chunks than one, the last not full
]


@pytest.mark.parametrize("sizes", CONFIGURATIONS + EDGES, ids=str)
def test_one_file_answers_as_torch_does(network, runtime, sizes):
    image, known = scene(**sizes)
    for expected in (None, expected_of(image, known)):
        in_file = runtime.run(image, known, expected=expected)
        there = in_torch(network, image, known, expected)
        assert_close(in_file, there)
        for name, a in in_file.items():
            assert a.shape == there[name].shape, name


def test_some_of_them_come_in_chunks():
    assert chunks_of(131 * 127, 20, SOLVED) > 1 and chunks_of(100**2, 20, SOLVED) > 1


def test_dtypes(runtime):
    answer = runtime.run(*scene(shape=(5, 6)))
    assert answer["material"].dtype == np.int16 and answer["unknown"].dtype == bool
    assert all(answer[name].dtype == np.float32 for name in FLOATS)


def test_the_network_part_matters(network, runtime):
    image, known = scene()
    plain = in_torch(TeXNet().eval(), image, known)
    answer = runtime.run(image, known)
    assert np.abs(plain["material_probability"] - answer["material_probability"]).max() > 0.05


@pytest.mark.parametrize(
    "pixels, materials, shape",
    [(47**2, 8, (61, 75)), (70**2, 8, (61, 75)), (100**2, 8, (61, 75)), (120**2, 20, (131, 200))],
)
def test_tiles_do_not_show(runtime, monkeypatch, pixels, materials, shape):
    image, known = scene(shape=shape, bands=9, materials=materials)
    expected = expected_of(image, known)
    whole = runtime.run(image, known, expected=expected)
    per_pixel = bytes_per_pixel(known)
    monkeypatch.setattr("texnet.runtime.TILE_BYTES", 2 * pixels * per_pixel)
    done = []
    tiled = runtime.run(image, known, lambda n, of: done.append((n, of)), expected)
    assert len(done) > 1 and done == [(n + 1, len(done)) for n in range(len(done))]
    assert_close(tiled, whole, temperature_k=1e-3, lighting=1e-4)
    monkeypatch.setattr("texnet.learned.TILE_BYTES", pixels * per_pixel)
    assert_close(torch_model()(image, known, expected=expected), whole)


def test_permuting_library_and_environment_permutes_the_answer(runtime):
    image, known = scene()
    rng = np.random.default_rng(1)
    m, j = rng.permutation(8), rng.permutation(3)
    turned = known | {
        "emissivity": known["emissivity"][m], "is_sky": known["is_sky"][m],
        "environment": known["environment"][j], "light": known["light"][j],
        "sky_object": known["sky_object"][j],
    }  # fmt: skip
    a, b = runtime.run(image, known), runtime.run(image, turned)
    b["material"] = m[b["material"]]
    b["thermal_lighting"] = b["thermal_lighting"][np.argsort(j)]
    assert_close(b, a)


@pytest.mark.parametrize("said, threads", [("1", 1), ("2,1", 2), ("0", 2), ("many", 2), ("9", 2)])
def test_as_many_threads_as_cores_or_as_the_environment_says(monkeypatch, said, threads):
    monkeypatch.setattr("os.sched_getaffinity", lambda process: {0, 1}, raising=False)
    monkeypatch.setenv("OMP_NUM_THREADS", said)
    assert Runtime(PATH).at_once == threads and Runtime(PATH, threads=3).at_once == 3


def test_the_answer_needs_no_torch(runtime, tmp_path):
    image, known = scene()
    np.savez(tmp_path / "scene.npz", image=image, **known)
    code = (
        "import sys\n"
        "for name in ('torch', 'sklearn', 'numba', 'kornia', 'onnx', 'scipy', 'matplotlib'):\n"
        "    sys.modules[name] = None\n"
        "import numpy as np\n"
        "from export import Runtime\n"
        "known = dict(np.load(sys.argv[2]))\n"
        "image = known.pop('image')\n"
        "np.savez(sys.argv[3], **Runtime(sys.argv[1], threads=2).run(image, known))\n"
    )
    out = tmp_path / "answer.npz"
    subprocess.run([sys.executable, "-c", code, PATH, tmp_path / "scene.npz", out], check=True)
    with np.load(out) as answer:
        assert_close(dict(answer), runtime.run(image, known), 1e-4, 1e-5)


def test_the_shipped_file_holds_the_shipped_weights(runtime):
    _, history = load_network(PATH.with_suffix(".safetensors"))
    assert runtime.about["history"] == history


def test_a_new_export_answers_as_its_network_and_says_what_it_is(tmp_path, monkeypatch):
    """Slow: the export takes minutes, fewer with one round of each of the refinement's loops. (The
    shipped file has all of them, and is held to torch above.)"""
    for loop in ("FREE_STEPS", "MAX_AT_ZERO"):
        monkeypatch.setattr(f"physics.refinement.{loop}", 1)
    with torch.random.fork_rng():
        torch.manual_seed(3)
        network = TeXNet(width=16, dilations=(1, 2), messages=1).eval()
        with torch.no_grad():  # so that what it learns matters
            network.heads.weight.mul_(10)
            network.heads.bias.normal_(0, 0.3)
    path = tmp_path / "model.onnx"
    export_onnx(network, HISTORY, path)
    runtime = Runtime(path)
    image, known = scene()
    assert_close(runtime.run(image, known), in_torch(network, image, known))
    about = runtime.about
    assert about["texnet_version"] == version("texnet") and about["history"] == HISTORY
    assert about["halo_px"] == network.halo == 8 and about["cell_px"] == 2
    assert about["meaning"]["radiance"]["sizes"] == ["bands", "height", "width"]
    names = {m["name"] for m in about["library"]["materials"]}
    assert "sky" in names and len(names) == 30
    file = onnx.load(path, load_external_data=False)
    assert os.listdir(tmp_path) == [path.name] and path.stat().st_size < 2e6
    tensors = [i for graph in _graphs(file.graph) for i in graph.initializer]
    assert tensors and not any(i.data_location for i in tensors)  # nothing lies elsewhere
    assert b"/physics/" not in path.read_bytes()  # nor says whose machine wrote it


def test_files_of_others_are_named_as_such(tmp_path, runtime):
    with pytest.raises(InputError, match="cannot read .*none.onnx: No such file"):
        Runtime(tmp_path / "none.onnx")
    garbage = tmp_path / "garbage.onnx"
    garbage.write_bytes(b"not a model" * 9)
    with pytest.raises(InputError, match="not an ONNX file that texnet wrote"):
        Runtime(garbage)
    x = onnx.helper.make_tensor_value_info("x", onnx.TensorProto.FLOAT, [1])
    y = onnx.helper.make_tensor_value_info("y", onnx.TensorProto.FLOAT, [1])
    graph = onnx.helper.make_graph([onnx.helper.make_node("Abs", ["x"], ["y"])], "g", [x], [y])
    opset = onnx.helper.make_opsetid("", 18)
    other = tmp_path / "other.onnx"
    onnx.save(onnx.helper.make_model(graph, opset_imports=[opset], ir_version=10), other)
    with pytest.raises(InputError, match="not an ONNX file that texnet wrote"):
        Runtime(other)
    before = onnx.load(PATH)
    next(p for p in before.metadata_props if p.key == "format").value = "1"
    onnx.save(before, other)
    with pytest.raises(InputError, match="is of another version of texnet; export it again"):
        Runtime(other)


def test_no_more_tiles_at_once_than_said_whoever_asks():
    """As memory is for so many."""
    runtime, counting, most, now = Runtime(PATH, threads=2), Lock(), 0, 0
    session, (image, known) = runtime._session, scene()

    class Counted:
        def run(self, *of):
            nonlocal most, now
            with counting:
                now += 1
                most = max(most, now)
            time.sleep(0.05)
            maps = session.run(*of)
            with counting:
                now -= 1
            return maps

        def __getattr__(self, name):
            return getattr(session, name)

    runtime._session = Counted()
    with ThreadPoolExecutor(6) as pool:
        maps = list(pool.map(lambda _: runtime.run(image, known), range(6)))
    assert most == 2
    for other in maps[1:]:
        assert_close(maps[0], other, 0, 0)


def test_expectations_of_other_materials_are_refused(runtime):
    image, known = scene()
    wrong = Expected(np.zeros((3, 2, 2), np.float32), 4)
    with pytest.raises(InputError, match="expected must be of 8 materials, got 3"):
        runtime.run(image, known, expected=wrong)


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda k: k.pop("error"), "see error"),
        (lambda k: k.update(sigma=k["sigma"][:-1]), "sigma must be"),
        (lambda k: k.update(prior_k=np.ones(3)), "prior_k must be"),
        (lambda k: k.update(emissivity=k["emissivity"][:1], is_sky=k["is_sky"][:1]), "at least 2"),
    ],
)
def test_wrong_input_is_said_in_one_sentence(runtime, change, message):
    image, known = scene()
    change(known)
    with pytest.raises(InputError, match=message):
        runtime.run(image, known)


def test_an_empty_image_is_refused(runtime):
    image, known = scene()
    with pytest.raises(InputError, match="must not be empty"):
        runtime.run(image[:, :0], known)


def test_a_file_that_cannot_be_written_is_said_at_once(network, tmp_path):
    with pytest.raises(InputError, match="there is no folder"):
        export_onnx(network, HISTORY, tmp_path / "none" / "model.onnx")


def test_the_command_exports_weights(network, tmp_path, capsys, monkeypatch):
    from texnet.cli import main
    from texnet.files.weights import save_network

    save_network(network, tmp_path / "w.safetensors", HISTORY)

    def write(network, history, path):  # the real one takes minutes and is tested above
        assert history == HISTORY and network.config == TeXNet().config
        path.write_bytes(b"12345")

    monkeypatch.setattr("export.to_onnx.export_onnx", write)
    out = tmp_path / "m.onnx"
    assert main(["export", str(tmp_path / "w.safetensors"), "--out", str(out), "--json"]) == 0
    result = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert result["file"] == str(out) and result["bytes"] == 5
