"""An answer that was written is read again as it was, and summed up as the command does it."""

import json
from dataclasses import fields, replace

import made_up
import numpy as np
import pytest

import texnet
from physics import InputError
from texnet import Decomposition, decompose, read_decomposition, write_cube, write_decomposition
from texnet.cli import main
from texnet.files.answer_file import save_decomposition


def an_answer(**changed):
    plain = vars(made_up.perfect(made_up.truth(8, 9)))
    return replace(Decomposition(**plain), **changed)


@pytest.mark.parametrize(
    "changed",
    [
        {},
        {"sky": (), "left_out": {}, "sky_assumed": True},
        {"distance_m": np.full((8, 9), 50.0, np.float32), "air_m": 40.0, "air_k": 285.0},
        {"objective": (3.0, 2.5), "band_gains": np.linspace(0.99, 1.01, 6)},
        {"left_out": {9.5: "dead", 12.25: "beyond the library"}, "gain": 1.01},
        {"made_by": {"method": "sgd", "k": None, "cube": "nächtlich.exr"}},
    ],
)
@pytest.mark.parametrize("of", ["folder", "file"])
def test_what_was_written_is_read(tmp_path, changed, of):
    answer = an_answer(**changed)
    paths = write_decomposition(answer, tmp_path / "answer")
    again = read_decomposition(paths["decomposition"] if of == "file" else tmp_path / "answer")
    for field in fields(Decomposition):
        was, now = (getattr(d, field.name) for d in (answer, again))
        if isinstance(was, np.ndarray) or field.name == "band_gains":
            np.testing.assert_array_equal(now, was, err_msg=field.name)
        else:
            assert now == was or (was != was and now != now), field.name
            assert type(now) is type(was), field.name
    np.testing.assert_array_equal(texnet.tex_vision(again), texnet.tex_vision(answer))


@pytest.mark.parametrize(
    "change, sentence",
    [
        (lambda a: a.pop("made_by"), "it lacks made_by"),
        (lambda a: a.update(made_by=np.array("{")), "Expecting"),
        (lambda a: a.update(material=a["material"] + 4), "whole numbers, 0..3"),
        (lambda a: a.update(material=a["material"].astype(float)), "whole numbers, 0..3"),
        (lambda a: a.update(temperature_k=a["temperature_k"][:3]), "does not fit the others"),
        (lambda a: a.update(temperature_k=a["temperature_k"].astype(str)), "must be numbers"),
        (lambda a: a.update(texture=a["texture"][:3]), "does not fit the others"),
        (lambda a: a.update(material_names=np.arange(4)), "must be text"),
        (lambda a: a.update(netd_k=np.ones(2)), "netd_k must have 0 axes"),
        (lambda a: a.update(wavelength_um=-a["wavelength_um"]), "finite and positive"),
        (lambda a: a.update(unknown=np.array([[None] * 9] * 8)), "not a whole npz file of plain"),
    ],
)
def test_what_is_no_answer_is_refused_in_a_sentence(tmp_path, change, sentence):
    path = tmp_path / "decomposition.npz"
    save_decomposition(an_answer(), path)
    with np.load(path) as data:
        arrays = dict(data)
    change(arrays)
    np.savez(path, **arrays)
    with pytest.raises(InputError, match=sentence) as e:
        read_decomposition(path)
    assert "decomposition" in str(e.value) and str(path) in str(e.value)


def test_a_folder_without_an_answer(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        read_decomposition(tmp_path)


def test_an_answer_says_what_made_it_and_the_same_in_words_as_the_command(capfd, tmp_path):
    truth = made_up.truth(24, 30)
    path, out = tmp_path / "night.npz", tmp_path / "answer"
    write_cube(made_up.cube(truth), path)
    cube = texnet.read_cube(path)
    assert main(["decompose", str(path), "--out", str(out), "--k", "3", "--json"]) == 0
    *printed, as_json = capfd.readouterr().out.splitlines()
    answer, asked = read_decomposition(out), {"method": "net+sgd", "k": 3, "seed": 0}
    files = {"cube": "night.npz", "library": None, "model": None, "environment": None}
    assert answer.made_by == asked | files | {"texnet": texnet.__version__}
    assert answer.netd_k == json.loads(as_json)["netd_k"]
    said = texnet.summary(answer, cube).splitlines()
    assert said == printed[: len(said)] and printed[len(said)].startswith("Files")
    own = decompose(cube, k=np.int64(3))
    assert own.made_by == asked | {"environment": None, "texnet": texnet.__version__}
    assert texnet.summary(own, cube).splitlines()[:-1] == said[:-1]  # but for the time


def test_only_the_cube_that_it_is_of_is_said_of_an_answer():
    truth = made_up.truth(8, 9)
    answer, cube = an_answer(), made_up.cube(truth)
    assert "6 bands" in texnet.summary(answer, cube)
    with pytest.raises(InputError, match="not of this cube"):
        texnet.summary(answer, made_up.cube(made_up.truth(8, 10)))
    with pytest.raises(InputError, match="not of this cube"):
        texnet.summary(answer, cube.moved(0.1))
    with pytest.raises(InputError, match="texnet.decompose returns, got HeatCube"):
        texnet.summary(cube, cube)
