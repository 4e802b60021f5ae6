"""The command line as a user meets it: exit codes, one sentence, whole files, JSON last."""

import json
import os
import signal
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import made_up
import numpy as np
import pytest
from traced import traced

import texnet.cli
from physics import HeatCube, MaterialLibrary
from physics.planck import planck
from physics.simulator.sensor import add_noise
from physics.truth import Truth
from texnet.cli import main
from texnet.files.band_file import write_bands
from texnet.files.cube_io import read_cube, write_cube


def run(capfd, *words):
    """(exit code, stdout, stderr) of one command."""
    code = main([str(w) for w in words])
    return code, *capfd.readouterr()


def refused(capfd, *words):
    """The one sentence that the command refuses with."""
    code, out, err = run(capfd, *words)
    assert code == 2 and out == ""
    assert err.startswith("texnet: error: ") and err.count("\n") == 1 and "Traceback" not in err
    return err


@pytest.fixture
def cube(tmp_path):
    path = tmp_path / "cube.npz"
    write_cube(made_up.cube(made_up.truth(8, 9)), path)
    return path


def test_to_decompose_a_cube_needs_neither_torch_nor_numba(tmp_path, cube):
    """But for numba, where no sky is in view and objects are counted, or a pixel is far hotter."""
    code = (
        "import sys\n"
        "class Without:\n"
        "    def find_spec(self, name, *_):\n"
        "        assert name not in ('torch', 'kornia', 'numba', 'embreex', 'onnx'), name\n"
        "sys.meta_path.insert(0, Without())\n"
        "from texnet.cli import main\n"
        "assert main(['decompose', sys.argv[1], '--out', sys.argv[2], '--k', '5']) == 0\n"
        "import texnet\n"
        "texnet.decompose(texnet.read_cube(sys.argv[1]), k=5)\n"
    )
    subprocess.run([sys.executable, "-c", code, cube, tmp_path / "out"], check=True)


# --- wrong input -------------------------------------------------------------------------


@pytest.mark.parametrize(
    "change, sentence",
    [
        (lambda a: a["radiance"][1:].__setitem__((..., 0), np.nan), "NaN"),
        (lambda a: a.update(wavelength_um=a["wavelength_um"][:-1]), "6 bands of radiance but 5"),
        (lambda a: a.update(wavelength_um=1e3 * a["wavelength_um"]), "nm or cm-1"),
        (lambda a: a.pop("radiance"), "lacks radiance"),
        (lambda a: a.update(netd=a.pop("netd_k")), "holds netd; call it netd_k"),
    ],
)
def test_wrong_cubes(capfd, tmp_path, cube, change, sentence):
    with np.load(cube) as data:
        arrays = dict(data)
    change(arrays)
    np.savez(cube, **arrays)
    assert sentence in refused(capfd, "decompose", cube, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "change, sentence",
    [
        (lambda t: {"temperature_k": t.temperature_k[:3]}, "temperature_k must be (8, 9)"),
        (lambda t: {"temperature_k": t.temperature_k * np.nan}, "finite"),
        (lambda t: {"temperature_k": t.temperature_k.astype(str)}, "temperature_k must be real"),
        (lambda t: {"material": t.material + 9}, "whole numbers, 0..3"),
        (lambda t: {"material": t.material - 1}, "whole numbers, 0..3"),
        (lambda t: {"material": t.material.astype(float)}, "whole numbers, 0..3"),
        (lambda t: {"material": t.material[0]}, "(height, width)"),
        (lambda t: {"material_names": np.array("grass")}, "a list"),
        (lambda t: {"emissivity": t.emissivity[:3]}, "emissivity must be (6, 8, 9)"),
        (lambda t: {"visible": t.visible[..., :2]}, "visible must be (8, 9, 3)"),
        (lambda t: {"wavelength_um": t.wavelength_um[:3]}, "must be (3, 8, 9)"),
        (lambda t: {"wavelength_um": t.wavelength_um.astype("c8")}, "real numbers"),
        (lambda t: {"wavelength_um": t.wavelength_um + 0.5}, "are not those of the cube"),
        (lambda t: vars(made_up.truth(8, 10)), "it has (8, 10) pixels"),
    ],
)
def test_a_damaged_truth_beside_a_cube(capfd, tmp_path, cube, monkeypatch, change, sentence):
    def never(*args, **kwargs):
        raise AssertionError("worked first, complained later")

    monkeypatch.setattr(import_module("texnet.pipeline"), "decompose", never)
    truth = made_up.truth(8, 9)
    np.savez(tmp_path / "cube.truth.npz", **vars(truth) | change(truth))
    assert sentence in refused(capfd, "decompose", cube, "--out", tmp_path / "out")


def test_a_truncated_exr(capfd, tmp_path):
    path = tmp_path / "cube.exr"
    write_cube(made_up.cube(made_up.truth()), path)
    path.write_bytes(path.read_bytes()[:-500])
    assert "not a whole OpenEXR file" in refused(
        capfd, "decompose", path, "--out", tmp_path / "out", "--json"
    )


def test_a_library_that_does_not_cover_the_bands(capfd, tmp_path, cube):
    rows = [{"name": n, "emissivity": [0.9, 0.95]} for n in ("grass", "sky")]
    library = tmp_path / "library.json"
    library.write_text(json.dumps({"wavelength_um": [8.0, 10.0], "materials": rows}))
    sentence = refused(capfd, "decompose", cube, "--out", tmp_path / "out", "--library", library)
    assert "cover 8-10 um but the bands need 7.562-14.44 um" in sentence  # to their edges


def test_wrong_scenes(capfd, tmp_path):
    out = tmp_path / "cube.exr"
    scene = tmp_path / "scene.json"
    for text in ("", "{}", '{"objects": []}', "[]"):
        scene.write_text(text)
        assert "scene" in refused(capfd, "simulate", scene, "--out", out)
    assert "gone.json" in refused(capfd, "simulate", tmp_path / "gone.json", "--out", out)
    assert "forest" in refused(capfd, "simulate", "no-such-preset", "--out", out)
    assert not out.exists()


@pytest.mark.parametrize(
    "words",
    [
        ["--size", "0x5"], ["--size", "5"], ["--size", "axb"], ["--size", "-3x4"],
        ["--bands", "0"], ["--bands", "-1"], ["--bands", "2.5"], ["--spp", "0"],
        ["--netd", "-1"], ["--netd", "nan"], ["--netd", "x"], ["--netd", "50"], ["--seed", "-1"],
        ["--bandz", "3"],
    ],
)  # fmt: skip
def test_wrong_options_of_simulate(capfd, tmp_path, words):
    assert words[0] in refused(capfd, "simulate", "forest", "--out", tmp_path / "c.exr", *words)


@pytest.mark.parametrize(
    "words", [["--k", "0"], ["--k", "11"], ["--k", "x"], ["--method", "nets"], ["--out", ""]]
)
def test_wrong_options_of_decompose(capfd, tmp_path, cube, words):
    assert words[0] in refused(capfd, "decompose", cube, "--out", tmp_path / "out", *words)


def test_wrong_places_are_refused_before_the_work(capfd, tmp_path, cube, monkeypatch):
    import physics.simulator

    def never(*args, **kwargs):
        raise AssertionError("worked first, complained later")

    monkeypatch.setattr(physics.simulator, "simulate", never)
    monkeypatch.setattr(import_module("texnet.pipeline"), "decompose", never)
    assert "there is no folder" in refused(
        capfd, "simulate", "forest", "--out", tmp_path / "no" / "cube.exr"
    )
    assert "end in .exr or .npz" in refused(
        capfd, "simulate", "forest", "--out", tmp_path / "c.tif"
    )
    assert "it is a file" in refused(capfd, "decompose", cube, "--out", cube)
    assert "no file" in refused(capfd, "decompose", tmp_path / "gone.exr", "--out", tmp_path)


@pytest.mark.parametrize(
    "words",
    [
        "decompose out/maps.exr --out out",
        "decompose cube.npz --library out/decomposition.npz --out out",
        "decompose cube.npz --model out/decomposition.npz --out out",
        "decompose cube.npz --environment out/decomposition.npz --out out",
        "import cube.npz --out cube.npz",
        "simulate linked.json --out linked.npz",
        "simulate forest --bands linked.json --out linked.npz",
        "bands --n 4 --library mine.json --out mine.json",
        "bands --n 4 --library mine.json --out link",
        "library import read.csv --out read.csv",
        "library import read.mat --names names.txt --out names.txt",
        "library import folder --out folder/A.TXT",
        "library from-cube cube.npz --out cube.npz",
        "finetune --cache tmp --library mine.json --out mine.json",
        "finetune --cache tmp --library mine.json --model read.safetensors --out read.safetensors",
        "finetune --cache tmp --library mine.json --cubes cube.npz --out cube.npz",
        "export read.safetensors --out read.safetensors",
    ],
)
def test_what_a_command_reads_it_does_not_write_over(capfd, tmp_path, cube, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    MaterialLibrary.starter().save("mine.json")
    (tmp_path / "link").symlink_to("mine.json")
    (tmp_path / "linked.npz").symlink_to("linked.json")
    (tmp_path / "out").mkdir()
    for file in words.split():
        path = tmp_path / file
        if path.suffix and not path.exists():
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(cube.read_bytes())
    if "decompose" in words:
        write_cube(read_cube(cube), "out/maps.exr")
        MaterialLibrary.starter().save("out/decomposition.npz")
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    assert "reads it" in refused(capfd, *words.split())
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before


@pytest.mark.parametrize("words", [[], ["paint"], ["library"], ["library", "paint"], ["decompose"]])
def test_no_command_or_no_such_command(capfd, words):
    assert "--help" in refused(capfd, *words)


# --- what works --------------------------------------------------------------------------


def last_json(out):
    return json.loads(
        out.splitlines()[-1], parse_constant=lambda c: pytest.fail(f"{c} is not JSON")
    )


def test_library(capfd):
    names = MaterialLibrary.starter().names
    code, out, _ = run(capfd, "library", "list", "--json")
    assert code == 0 and [m["name"] for m in last_json(out)["materials"]] == list(names)
    code, out, _ = run(capfd, "library", "show", "water", "--json")
    shown = last_json(out)
    assert code == 0 and len(shown["emissivity"]) == len(shown["wavelength_um"]) > 10
    out = run(capfd, "library", "show", "water")[1]
    assert "One row in 8 is shown" in out and out.count("\n") < 25
    assert "no material 'cheese'" in refused(capfd, "library", "show", "cheese")


def test_no_two_cubes_share_a_truth(capfd, tmp_path):
    """The truth goes by the cube's name alone."""
    words = ["--size", "8x9", "--spp", 2, "--bands", 4]
    code, *_ = run(capfd, "simulate", "forest", "--out", tmp_path / "a.exr", *words)
    assert code == 0
    truth = (tmp_path / "a.truth.npz").read_bytes()
    said = refused(capfd, "simulate", "patches", "--out", tmp_path / "a.npz", *words)
    assert "a.exr" in said and not (tmp_path / "a.npz").exists()
    assert (tmp_path / "a.truth.npz").read_bytes() == truth
    code, *_ = run(capfd, "simulate", "patches", "--out", tmp_path / "a.exr", *words)
    assert code == 0 and (tmp_path / "a.truth.npz").read_bytes() != truth


def test_bands_then_simulate(capfd, tmp_path):
    file, cube, mine = tmp_path / "filters.json", tmp_path / "night.npz", tmp_path / "mine.json"
    MaterialLibrary.starter().subset(["water", "granite", "sky"]).save(mine)
    code, out, err = run(capfd, "bands", "--n", 4, "--library", mine, "--out", file, "--json")
    assert code == 0, err
    made = last_json(out)
    assert made["designed"]["loss"] <= made["equidistant"]["loss"]
    assert "sigma of T: the least error" in out and "NETD is lower" in out
    code, out, err = run(
        capfd, "simulate", "forest", "--bands", file, "--out", cube, "--size", "8x9", "--spp", 2
    )
    assert code == 0, err
    np.testing.assert_allclose(read_cube(cube).wavelength_um, made["designed"]["wavelength_um"])
    np.testing.assert_allclose(read_cube(cube).fwhm_um, made["designed"]["fwhm_um"])

    write_bands(file, np.array([10.299999999999994, 11.0]), np.full(2, 0.6000000000000001))
    assert json.loads(file.read_text()) == {"wavelength_um": [10.3, 11], "fwhm_um": [0.6, 0.6]}

    simulate = ("simulate", "forest", "--out", cube, "--bands")
    assert "cannot read" in refused(capfd, *simulate, tmp_path / "gone.json")
    # what simulate would not take for a file is not written
    assert "must end in .json" in refused(capfd, "bands", "--n", 4, "--out", tmp_path / "six")
    for text in ("[1]", "{", '{"wavelength_um": [9]}', '{"wavelength_um": 9, "fwhm_um": "x"}'):
        file.write_text(text)
        assert "wavelength_um and fwhm_um" in refused(capfd, *simulate, file)
    file.write_text('{"wavelength_um": [9, 10], "fwhm_um": [1]}')
    assert "one width" in refused(capfd, *simulate, file)


def said_of_scene(capfd, tmp_path, size, camera, *objects):
    """What simulate says of a scene file of objects of soil."""
    file, soil = tmp_path / "scene.json", {"material": "soil", "temperature_k": 287}
    scene = {"camera": camera, "atmosphere": {}, "objects": [o | soil for o in objects]}
    file.write_text(json.dumps(scene))
    words = file, "--out", tmp_path / "night.npz", "--bands", 3, "--size", size, "--spp", 1
    code, out, err = run(capfd, "simulate", *words)
    assert code == 0, err
    return out


@pytest.mark.parametrize("side_m, said", [(10000, False), (20, True)])
def test_a_ground_that_ends_in_view_is_said(capfd, tmp_path, side_m, said):
    # 3 m up and level: down to -20 degrees, of which -3 / 10 and flatter go past 10 m of ground
    camera = {"position": [0, 0, 3], "target": [0, 1, 3]}
    plane = {"mesh": {"shape": "plane", "size": [side_m, side_m]}}
    out = said_of_scene(capfd, tmp_path, "40x4", camera, plane)
    assert ("looks past the ground's end" in out) == said
    if said:
        past = 100 * 0.3 / np.tan(np.radians(20)) / 2
        assert float(out.split("Warning: ")[1].split("%")[0]) == pytest.approx(past, abs=1.3)


@pytest.mark.parametrize("above_m, said", [(0, True), (0.003, False)])
def test_objects_that_lie_in_one_another_are_named(capfd, tmp_path, above_m, said):
    """A road of 2 x 2 m on a ground, seen from 30 degrees above in a picture 4 m high."""
    plane = lambda name, side_m, z: {
        "name": name, "mesh": {"shape": "plane", "size": [side_m, side_m]},
        "translate": [0, 0, z], "rotate_z_deg": 20,
    }  # fmt: skip
    camera = {"position": [0, -8.66, 5], "target": [0, 0, 0], "fov_deg": 22.6}
    planes = plane("ground", 3000, 0), plane("road", 2, above_m)
    out = said_of_scene(capfd, tmp_path, "64x64", camera, *planes)
    assert ("'ground' and 'road'" in out) == said
    if said:  # four square metres, half as high, of sixteen
        assert float(out.split("Warning: in ")[1].split("%")[0]) == pytest.approx(12.5, abs=0.5)


def test_library_from_cube(capfd, tmp_path):
    import test_blind

    cube, library = tmp_path / "night.npz", tmp_path / "mine.json"
    write_cube(test_blind.make(netd_k=0.05)[0], cube)
    code, out, err = run(
        capfd, "library", "from-cube", cube, "--out", library, "--materials", 3, "--json"
    )
    assert code == 0, err
    made = last_json(out)
    assert made["materials"] == ["sky", "material_1", "material_2", "material_3"]
    assert "0.96" in made["note"]
    assert MaterialLibrary.load(library).names == tuple(made["materials"])
    words = ["decompose", cube, "--library", library, "--out", tmp_path / "out", "--json"]
    code, out, err = run(capfd, *words, "--method", "local")
    assert code == 0 and set(last_json(out)["materials"]) <= set(made["materials"])
    assert "--materials" in refused(
        capfd, "library", "from-cube", cube, "--out", library, "--materials", 0
    )


def test_the_summary_says_where_its_numbers_come_from(capfd, tmp_path):
    truth = made_up.truth(40, 50)
    made = made_up.cube(truth)
    path = tmp_path / "cube.npz"
    for netd_k, said in ((0.05, "NETD 50 mK (as stated)"), (None, "mK (estimated)")):
        write_cube(HeatCube(made.radiance, made.wavelength_um, made.fwhm_um, netd_k), path)
        words = ["decompose", path, "--out", tmp_path / "out", "--method", "local", "--json"]
        code, out, _ = run(capfd, *words, "--k", 2)
        assert code == 0 and said in out and "k = 2\n" in out and " 0 %" not in out
        answer = last_json(out)
        assert "Suspicious" not in out and "Uneven" not in out and answer["netd_k"] < 1
        assert 220 < answer["brightness_k"] < 400 and answer["uneven_k"] == 0
        assert answer["k"] == 2 and not answer["k_chosen"]
    s = add_noise(made.radiance, made.wavelength_um, 3.0, np.random.default_rng(0))
    write_cube(HeatCube(s, made.wavelength_um, made.fwhm_um), path)
    assert "Suspicious   so much noise" in run(capfd, *words, "--k", 2)[1]
    write_cube(HeatCube(made.radiance / 1000, made.wavelength_um, made.fwhm_um), path)  # per nm
    out = run(capfd, *words, "--k", 2)[1]
    assert "Suspicious   half of the cube looks colder than" in out and "\nUneven " in out
    assert last_json(out)["brightness_k"] < 220 and last_json(out)["uneven_k"] > 2.5
    write_cube(HeatCube(made.radiance, made.wavelength_um, made.fwhm_um, 0.005), path)
    code, out, _ = run(capfd, *words, "--k", 2)
    assert code == 0 and "NETD 5 mK (as stated), taken for " in out
    assert last_json(out)["camera_netd_k"] == 0.005
    code, out, _ = run(capfd, *words, "--k", "auto")
    assert code == 0 and f"k = {last_json(out)['k']}, chosen\n" in out


@pytest.mark.parametrize(
    "names, said",
    [
        (("grass", "water", "sky", "bark"), "% of the pixels get their material\n"),
        (("grass", "water", "sky", "log"), "get their material (the library lacks bark)"),
        (("lawn", "sea", "sky", "log"), "materials not compared: the library lacks "),
    ],
)
def test_names_that_the_library_lacks_are_named(capfd, tmp_path, cube, names, said):
    made_up.truth(8, 9).save(cube.with_suffix(".truth.npz"))
    e = MaterialLibrary.starter().subset(made_up.NAMES)
    MaterialLibrary(names, e.wavelength_um, e.emissivity).save(tmp_path / "mine.json")
    words = ["--library", tmp_path / "mine.json", "--method", "local", "--json"]
    code, out, err = run(capfd, "decompose", cube, "--out", tmp_path / "out", *words)
    assert code == 0 and said in out, err
    metrics = last_json(out)["metrics"]
    assert (metrics["material_accuracy"] is None) == ("not compared" in said)
    assert set(metrics["not_in_library"]) == set(made_up.NAMES) - set(names)


@pytest.mark.parametrize("method", ["local", "net+sgd"])
def test_a_library_without_sky(capfd, tmp_path, cube, method):
    """The truth beside the cube knows the sky; the library does not, and the summary says so."""
    made_up.truth(8, 9).save(cube.with_suffix(".truth.npz"))
    solid = MaterialLibrary.starter().subset([n for n in made_up.NAMES if n != "sky"])
    solid.save(tmp_path / "mine.json")
    words = ["--library", tmp_path / "mine.json", "--method", method, "--json"]
    code, out, err = run(capfd, "decompose", cube, "--out", tmp_path / "out", *words)
    assert code == 0 and "the library has none: sky pixels get other names" in out, err
    assert not last_json(out)["sky_in_library"] and "first row" not in out


@pytest.mark.parametrize("name, in_view", [("forest", True), ("room", False)])
def test_one_object_leaves_no_room_for_the_sky(capfd, tmp_path, name, in_view):
    write_cube(traced(name)[0], tmp_path / "cube.npz")
    words = ["--out", tmp_path / "out", "--k", 1, "--json"]
    code, out, err = run(capfd, "decompose", tmp_path / "cube.npz", *words)
    assert code == 0 and last_json(out)["sky_in_view"] == in_view, err
    assert ("none in view" in out) != in_view and ("with k = 1 no object" in out) == in_view


def test_weights_refine_as_the_onnx_file_does(capfd, tmp_path, cube):
    """--model takes what `finetune` writes; the shipped weights are what the shipped file holds."""
    weights = Path(texnet.__file__).parent / "data" / "texnet.safetensors"
    for name, words in (("onnx", []), ("torch", ["--model", weights])):
        code, _, err = run(capfd, "decompose", cube, "--out", tmp_path / name, *words)
        assert code == 0, err
    a, b = (np.load(tmp_path / name / "decomposition.npz") for name in ("onnx", "torch"))
    np.testing.assert_allclose(a["temperature_k"], b["temperature_k"], atol=5e-3)


def test_ctrl_c(capfd, tmp_path, monkeypatch):
    def interrupted(*args, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr("physics.simulator.simulate", interrupted)
    code, out, err = run(capfd, "simulate", "forest", "--out", tmp_path / "cube.exr")
    assert code == 130 and err == "texnet: interrupted\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("package", ["trimesh", "numba"])
def test_ctrl_c_while_a_package_loads(tmp_path, package):
    """trimesh, for one, goes on as if nothing had been where an import of its own is stopped."""
    code = (
        "import os, signal, sys\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # in the background: ignored
        "class Interrupted:\n"
        "    def find_spec(self, name, *_):\n"
        f"        if name == {package!r}:\n"
        "            os.kill(os.getpid(), signal.SIGINT)\n"
        "            try: [None for _ in range(10**6)]\n"
        "            except BaseException: pass\n"
        "sys.meta_path.insert(0, Interrupted())\n"
        "from texnet.cli import main\n"
        "sys.exit(main(['simulate', 'patches', '--size', '4x4', '--out', sys.argv[1]]))\n"
    )
    done = subprocess.run([sys.executable, "-c", code, tmp_path / "c.exr"], capture_output=True)
    assert done.returncode == 130 and done.stderr == b"texnet: interrupted\n"
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_while_the_command_line_loads():
    code = (
        "import os, runpy, signal, sys\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "class Interrupted:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'numpy': os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Interrupted())\n"
        "sys.argv = ['texnet', '--help']\n"
        "runpy.run_module('texnet', run_name='__main__')\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "texnet: interrupted\n")


@pytest.mark.parametrize(
    "name, handler, ends",
    [
        ("SIGINT", "SIG_DFL", True), ("SIGINT", "SIG_IGN", False),
        ("SIGINT", "default_int_handler", True), ("SIGTERM", "SIG_DFL", True),
    ],
)  # fmt: skip
def test_a_signal_while_loading_counts_once_all_is_loaded(name, handler, ends):
    code = -getattr(signal, name) if ends else 0
    text = (
        "import os, signal\n"
        "from texnet.loading import loading\n"
        f"signal.signal(signal.{name}, signal.{handler})\n"
        "with loading():\n"
        "    with loading():\n"
        f"        os.kill(os.getpid(), signal.{name})\n"
        "    print('loaded', flush=True)\n"
    )
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True)
    assert done.returncode == code and done.stdout == "loaded\n"


def test_demo_takes_what_decompose_does():
    """It runs decompose, with all of its arguments but the cube."""
    of = vars(texnet.cli._parser().parse_args(["decompose", "night.exr", "--out", "x"]))
    assert of.keys() - vars(texnet.cli._parser().parse_args(["demo"])).keys() == {"cube"}


def test_json_has_no_nan():
    plain = texnet.cli._plain(
        {"a": np.float32("nan"), "b": [np.inf, np.int16(3)], "c": (np.bool_(True), None)}
    )
    assert json.dumps(plain, allow_nan=False) == '{"a": null, "b": [null, 3], "c": [true, null]}'


@pytest.mark.parametrize(
    "suffix, method", [(".exr", "net+sgd"), (".npz", "local"), (".npz", "net")]
)
def test_simulate_then_decompose(capfd, tmp_path, suffix, method):
    cube, out_dir = tmp_path / f"night{suffix}", tmp_path / "out"
    code, out, err = run(
        capfd, "simulate", "forest", "--out", cube, "--bands", 24, "--size", "24x36", "--spp", 16,
        "--seed", 5, "--json",
    )  # fmt: skip
    assert code == 0, err
    made = last_json(out)
    assert made["bands"] == 24 and made["size"] == [24, 36]
    assert {p.name for p in tmp_path.iterdir()} == {cube.name, "night.truth.npz"}
    assert read_cube(cube).shape == Truth.load(tmp_path / "night.truth.npz").material.shape

    words = ["decompose", cube, "--out", out_dir, "--method", method, "--k", 3, "--json"]
    code, out, err = run(capfd, *words)
    assert code == 0, err
    assert err == "", "no progress bar where stderr is no terminal"
    answer = last_json(out)
    assert answer["k"] == 3 and answer["method"] == method
    assert 0 < answer["metrics"]["material_accuracy"] <= 1
    assert 250 < answer["temperature_k"]["median"] < 320
    assert sum(answer["materials"].values()) == pytest.approx(1)
    assert {p.name for p in out_dir.iterdir()} == {
        "decomposition.npz", "tex_vision.png", "maps.png", "comparison.png", "maps.exr"
    }  # fmt: skip


def test_the_truth_beside_the_cube_makes_the_comparison(capfd, tmp_path):
    cube, out_dir = tmp_path / "night.npz", tmp_path / "out"
    seen, truth = traced("patterned", 4, (24, 36))
    write_cube(seen, cube)
    truth.save(tmp_path / "night.truth.npz")
    words = ["decompose", cube, "--out", out_dir, "--method", "local", "--k", 3, "--json"]
    code, out, err = run(capfd, *words)
    assert code == 0 and last_json(out)["metrics"] and (out_dir / "comparison.png").exists()
    (own := tmp_path / "own").mkdir()
    (own / "comparison.png").write_bytes(b"somebody's")
    (tmp_path / "night.truth.npz").unlink()
    code, out, err = run(capfd, *words)
    assert code == 0 and last_json(out)["metrics"] is None
    assert not (out_dir / "comparison.png").exists(), "it was of another answer"
    run(capfd, "decompose", cube, "--out", own, "--method", "local", "--k", 3)
    assert (own / "decomposition.npz").exists()
    assert (own / "comparison.png").read_bytes() == b"somebody's"
    code, out, err = run(capfd, *words, "--compare")
    assert code == 0 and (out_dir / "comparison.png").exists()
    assert last_json(out)["files"]["comparison"] == str(out_dir / "comparison.png")


# --- as a process ------------------------------------------------------------------------


def process(*words, **more):
    """One command in a process of its own, where nothing is loaded yet and output is buffered."""
    env = {key: value for key, value in os.environ.items() if key != "PYTHONUNBUFFERED"}
    words = [sys.executable, "-m", "texnet.cli", *map(str, words)]
    return subprocess.run(words, env=env | more.pop("env", {}), stderr=subprocess.PIPE, **more)


@pytest.mark.parametrize("words", [["--method", "net"], ["--model", "texnet.safetensors"]])
def test_torch_may_load_while_the_cube_is_read(tmp_path, cube, words):
    data = Path(texnet.__file__).parent / "data"
    words = [data / word if word.endswith(".safetensors") else word for word in words]
    done = process("decompose", cube, "--out", tmp_path / "out", *words, stdout=subprocess.PIPE)
    assert done.returncode == 0, done.stderr.decode()


@pytest.mark.parametrize("words", [("library", "list"), ("--help",), ("--version",)])
def test_a_reader_that_has_seen_enough_and_a_full_disk(words):
    read, write = os.pipe()
    os.close(read)
    done = process(*words, stdout=write)
    os.close(write)
    assert done.returncode == 0 and done.stderr == b""
    if os.path.exists("/dev/full"):
        with open("/dev/full", "w") as full:
            done = process(*words, stdout=full)
        assert done.returncode == 2
        said = "texnet: error: cannot write to the standard output: No space left on device.\n"
        assert done.stderr.decode() == said


@pytest.mark.skipif(os.name != "posix", reason="closes a file descriptor before the start")
@pytest.mark.parametrize("kind", [".exr", ".npz"])
def test_a_closed_stderr(tmp_path, cube, kind):
    write_cube(read_cube(cube), tmp_path / f"a{kind}")
    code = "import os, sys; os.close(2); os.execv(sys.executable, [sys.executable, *sys.argv[1:]])"
    words = ["-m", "texnet.cli", "import", tmp_path / f"a{kind}", "--out", tmp_path / "b.npz"]
    done = subprocess.run([sys.executable, "-c", code, *map(str, words)], capture_output=True)
    assert done.returncode == 0 and (tmp_path / "b.npz").exists()


def test_names_beyond_the_terminals_letters(tmp_path):
    text = "wavelength_um,caf\xe9\n8,0.9\n8.5,0.9\n"
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    words = ["library", "import", tmp_path / "a.csv", "--out", tmp_path / "b.json"]
    done = process(*words, stdout=subprocess.PIPE, env={"PYTHONIOENCODING": "ascii:strict"})
    assert done.returncode == 0 and b"caf\\xe9" in done.stdout, done.stderr


@pytest.mark.skipif(os.name != "posix", reason="limits the size of files")
@pytest.mark.parametrize("kind", [".exr", ".npz"])
def test_no_room_for_what_is_written(tmp_path, kind):
    """One sentence, and what was there, a cube and its truth, stays."""
    import resource

    cube, truth = tmp_path / f"night{kind}", tmp_path / "night.truth.npz"
    words = ["simulate", "room", "--size", "40x50", "--spp", "1", "--bands", "20", "--out", cube]
    assert process(*words).returncode == 0
    before = cube.read_bytes(), truth.read_bytes()
    least = lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
    done = process(*words, "--seed", "1", preexec_fn=least)
    assert done.returncode == 2 and done.stderr.count(b"\n") == 1 and b"large" in done.stderr
    assert (cube.read_bytes(), truth.read_bytes()) == before
    assert set(tmp_path.iterdir()) == {cube, truth}


def test_a_user_s_style_of_plots_changes_nothing(tmp_path, cube):
    """Nor does the backend of a notebook, or a name that looks like a formula."""
    library = tmp_path / "library.json"
    names = ["sky", "grass", "water", "bark"]
    plain = MaterialLibrary.starter().subset(names)
    MaterialLibrary(["sky", "$x_{$", "\u6c34", "bark"], plain.wavelength_um, plain.emissivity,
                    plain.hue_deg).save(library)  # fmt: skip
    (tmp_path / "matplotlibrc").write_text("image.origin: lower\ntext.usetex: True\n")
    own = {"MATPLOTLIBRC": str(tmp_path / "matplotlibrc"), "MPLBACKEND": "module://of_a_notebook"}
    pictures = []
    for env in ({}, own):
        out = tmp_path / f"answer{len(env)}"
        words = ["decompose", cube, "--library", library, "--out", out, "--method", "local"]
        done = process(*words, env=env)
        assert done.returncode == 0 and b"Warning" not in done.stderr, done.stderr.decode()
        pictures.append([(out / f"{name}.png").read_bytes() for name in ("tex_vision", "maps")])
    assert pictures[0] == pictures[1]


@pytest.mark.skipif(os.name != "posix", reason="names that are no text")
def test_names_of_files_that_openexr_cannot_open(capfd, tmp_path, cube):
    name = os.fsdecode(os.fsencode(tmp_path) + b"/w\xfc")
    assert "only UTF-8 names" in refused(capfd, "import", cube, "--out", f"{name}.exr")
    assert "only UTF-8 names" in refused(capfd, "decompose", cube, "--out", name)
    assert run(capfd, "import", cube, "--out", f"{name}.npz")[0] == 0


def test_json_of_editors_that_mark_it_as_utf_8(capfd, tmp_path):
    bands, library = tmp_path / "bands.json", tmp_path / "library.json"
    MaterialLibrary.starter().subset(["water", "sky"]).save(library)
    write_bands(bands, np.array([9.0, 10.0]), np.array([1.0, 1.0]))
    for file in (bands, library):
        file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
    out = tmp_path / "night.npz"
    words = ["simulate", "room", "--size", "8x9", "--spp", 1, "--bands", bands, "--out", out]
    assert run(capfd, *words)[0] == 0
    assert run(capfd, "library", "list", "--library", library)[0] == 0
    for file, start in ((bands, '{"wavelength_um": [1%s'), (library, '{"wavelength_um": [1%s')):
        file.write_text(start % (400 * "0") + "]}")
    assert "must be JSON with lists" in refused(capfd, *words)
    assert "there is no 'materials'" in refused(capfd, "library", "list", "--library", library)


def test_the_range_that_is_advised_is_one_that_the_library_covers(capfd, tmp_path):
    """Though a band reaches beyond it whose centre is within."""
    w = np.linspace(7.32, 14.2, 36)
    s = np.broadcast_to(planck(w, 290.0)[:, None, None], (36, 8, 9))
    wide, part = tmp_path / "wide.npz", tmp_path / "part.npz"
    write_cube(HeatCube(s, w, np.full(36, w[1] - w[0]), 0.05), wide)
    out = ["--out", tmp_path / "out", "--method", "local", "--k", 1]
    advised = refused(capfd, "decompose", wide, *out).split("--range ")[1].split("`")[0]
    assert run(capfd, "import", wide, "--out", part, "--range", advised.split()[0])[0] == 0
    assert read_cube(part).bands == 34
    assert run(capfd, "decompose", part, *out)[0] == 0
