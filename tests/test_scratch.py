"""Arrays in files hold what arrays in memory hold, and give memory back."""

import subprocess
import sys
import zipfile

import numpy as np
import pytest

from physics import HeatCube, InputError
from physics.machinery import scratch
from physics.machinery.array_file import load_arrays, save_arrays
from physics.machinery.tiles import run_tiled
from texnet.files.cube_io import read_cube, write_cube


@pytest.fixture
def all_large(monkeypatch):
    monkeypatch.setattr(scratch, "LARGE", 0)


def test_what_is_released_is_there_again(all_large):
    a = scratch.zeros((5, 300, 400), np.float32)
    assert isinstance(a, np.memmap)
    b = np.random.default_rng(0).random(a.shape, np.float32)
    a[:] = b
    for part, own in zip(scratch.parts(a[1:, ::2].reshape(4, -1)), b[1:, ::2], strict=True):
        np.testing.assert_array_equal(part, own.ravel())
    np.testing.assert_array_equal(a, b)


def test_small_arrays_stay_in_memory():
    a = scratch.zeros((3, 4), np.int16)
    assert type(a) is np.ndarray and a.dtype == np.int16
    scratch.release(a)


@pytest.mark.parametrize("suffix", [".exr", ".npz"])
def test_a_cube_in_a_file_is_the_cube(tmp_path, all_large, suffix):
    rng = np.random.default_rng(1)
    cube = HeatCube(rng.uniform(5, 9, (6, 70, 33)), np.linspace(8, 14, 6), None, 0.05)
    write_cube(cube, tmp_path / f"cube{suffix}")
    again = read_cube(tmp_path / f"cube{suffix}")
    np.testing.assert_array_equal(again.radiance, cube.radiance)
    index = rng.integers(0, 70 * 33, 50)
    np.testing.assert_array_equal(again.pixels(index), cube.spectra[index])


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("dtype", ["<f4", ">f8", "<i2"])
@pytest.mark.parametrize("packed", [True, False])
def test_an_npz_of_others_in_any_order_and_type(tmp_path, all_large, order, dtype, packed):
    s = np.asarray(np.random.default_rng(2).integers(5, 9, (4, 11, 7)), dtype, order=order)
    save = np.savez_compressed if packed else np.savez
    save(tmp_path / "cube.npz", radiance=s, wavelength_um=np.linspace(8, 14, 4), other=["x"])
    np.testing.assert_array_equal(read_cube(tmp_path / "cube.npz").radiance, s)


def test_a_private_map_of_others_is_left_alone(tmp_path):
    np.save(tmp_path / "a.npy", np.full((3, 40, 50), 8, np.float32))
    theirs = np.load(tmp_path / "a.npy", mmap_mode="c")
    theirs /= 2
    theirs.setflags(write=False)
    cube = HeatCube(theirs, [8.0, 9.0, 10.0], None, 0.05)
    assert (cube.radiance == 4).all() and (theirs == 4).all()


@pytest.mark.parametrize("suffix", [".exr", ".npz"])
def test_a_view_is_written_as_it_is_seen(tmp_path, suffix):
    s = np.random.default_rng(4).uniform(5, 9, (3, 20, 30)).astype(np.float32)
    s.setflags(write=False)
    for view in (s[:, 2:17, 3:20], s.transpose(0, 2, 1)):
        write_cube(HeatCube(view, [8.0, 9.0, 10.0], None, 0.05), tmp_path / f"view{suffix}")
        np.testing.assert_array_equal(read_cube(tmp_path / f"view{suffix}").radiance, view)


def test_an_array_that_ends_early_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "short.npz", "w") as file:
        for name, values in {"radiance": np.full(1, 7.0), "wavelength_um": [8.0, 9.0]}.items():
            with file.open(f"{name}.npy", "w") as npy:
                np.lib.format.write_array_header_1_0(npy, {
                    "descr": "<f8", "fortran_order": False,
                    "shape": (2, 3, 4) if name == "radiance" else (2,),
                })  # fmt: skip
                npy.write(np.asarray(values, "<f8").tobytes())
    with pytest.raises(ValueError, match="not a whole npz"):
        read_cube(tmp_path / "short.npz")


def test_no_room_is_one_sentence(tmp_path, monkeypatch, all_large):
    def full(*_):
        raise OSError(28, "No space left on device")

    cube = HeatCube(np.full((3, 4, 5), 7.0), [8.0, 9.0, 10.0], None, 0.05)
    write_cube(cube, tmp_path / "cube.npz")
    monkeypatch.setattr(scratch.os, "posix_fallocate", full, raising=False)
    with pytest.raises(InputError, match="set TMPDIR"):
        read_cube(tmp_path / "cube.npz")


def test_tiles_of_a_picture_in_a_file(all_large):
    picture = np.random.default_rng(3).random((3, 40, 50)).astype(np.float32)
    filed = scratch.zeros(picture.shape, np.float32)
    filed[:] = picture

    def doubled(tile, inner, _):
        top, left, h, w = inner
        return {"twice": 2 * tile[:, top : top + h, left : left + w]}

    np.testing.assert_array_equal(run_tiled(doubled, filed, 4, 400)["twice"], 2 * picture)


def test_saved_arrays_come_back(tmp_path, all_large):
    arrays = {"a": np.arange(24.0).reshape(2, 3, 4)[:, ::-1], "b": np.array("text"), "c": 3}
    for compress in (True, False):
        save_arrays(tmp_path / "x.npz", arrays, compress=compress)
        for name, array in load_arrays(tmp_path / "x.npz", arrays, "test").items():
            np.testing.assert_array_equal(array, arrays[name])


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_a_cube_is_read_in_less_memory_than_it_takes(tmp_path):
    shape = (24, 1000, 1600)  # 154 MB
    np.savez(
        tmp_path / "cube.npz", radiance=np.full(shape, 7, np.float32),
        wavelength_um=np.linspace(8, 14, 24), netd_k=0.05,
    )  # fmt: skip
    code = (
        "import resource, sys; from texnet.files.cube_io import read_cube; import sklearn.cluster;"
        "peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss;"
        "before = peak(); cube = read_cube(sys.argv[1]).with_netd(); cube.sample(1000);"
        "print(peak() - before)"
    )
    command = [sys.executable, "-c", code, tmp_path / "cube.npz"]
    out = subprocess.run(command, capture_output=True, text=True, check=True)
    assert 1024 * int(out.stdout) < 0.7 * 4 * np.prod(shape)
