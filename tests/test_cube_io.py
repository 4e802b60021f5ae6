"""Cubes on disk: what goes in comes out, in our units, or a clear sentence."""

import os
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import OpenEXR
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from physics.cube.heat_cube import HeatCube
from physics.errors import InputError
from texnet.files.answer_folder import check_directory
from texnet.files.cube_io import (
    CHANNEL,
    channel_name,
    channel_wavelength_um,
    check_cube_path,
    read_cube,
    write_cube,
)

UNITS = "W.m^-2.sr^-1"


@st.composite
def cubes(draw):
    # Steps of 1e-9 um, the resolution of the channel names.
    nm6 = draw(st.lists(st.integers(3 * 10**9, 15 * 10**9), min_size=1, max_size=6, unique=True))
    n, h, w = len(nm6), draw(st.integers(1, 5)), draw(st.integers(1, 5))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    netd = draw(st.none() | st.floats(1e-3, 10))
    return HeatCube(rng.uniform(0.1, 20, (n, h, w)), np.sort(nm6) / 1e9, rng.uniform(0, 1, n), netd)


@pytest.mark.parametrize("suffix", [".exr", ".npz", ".EXR"])
@given(cube=cubes())
@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_round_trip(tmp_path, suffix, cube):
    path = tmp_path / f"cube{suffix}"
    write_cube(cube, path)
    back = read_cube(path)
    np.testing.assert_array_equal(back.radiance, cube.radiance)
    np.testing.assert_allclose(back.wavelength_um, cube.wavelength_um, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(back.fwhm_um, cube.fwhm_um)
    assert back.netd_k == cube.netd_k
    assert [p.name for p in tmp_path.iterdir()] == [path.name], "a partial file was left"


def test_channel_names_are_those_of_fichet():
    assert channel_name(8.055555556) == "S0.8055,555556nm"
    assert channel_name(10.0) == "S0.10000,000000nm"
    for w in np.linspace(3, 15, 50):
        assert CHANNEL.match(channel_name(w))
        assert channel_wavelength_um(channel_name(w)) == pytest.approx(w, abs=5e-10)


@pytest.mark.parametrize(
    "name, um",
    [
        ("S0.10000,000000nm", 10.0),
        ("S0.10um", 10.0),
        ("S0.0,00001m", 10.0),
        ("S0.1,2E1um", 12.0),
        ("S0.0,012mm", 12.0),
        ("S0.1dam", 1e7),
        ("S0.29,9792458THz", 10.0),
        ("S0.2,99792458E13Hz", 10.0),
        ("S0.37474,0572500GHz", 8.0),
    ],
)
def test_any_unit_of_wavelength_or_frequency(name, um):
    assert channel_wavelength_um(name) == pytest.approx(um, rel=1e-12)


@pytest.mark.parametrize("name", ["R", "Y", "T", "S1.8000nm", "T.8000nm", "S0.8000.5nm", "S4.8nm"])
def test_other_channels_are_no_bands(name):
    assert channel_wavelength_um(name) is None


@pytest.mark.parametrize("name", ["S0.nm", "S0.,nm", "S0.0nm", "S0.0,0Hz"])
def test_a_band_at_no_wavelength_is_refused(name):
    with pytest.raises(InputError, match="no wavelength"):
        channel_wavelength_um(name)


def write_exr(path, channels, **header):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage} | header
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))


def plane(value, dtype=np.float32):
    return np.full((3, 4), value, dtype)


@pytest.mark.parametrize("density, factor", [(".um^-1", 1.0), (".nm^-1", 1e3), (".m^-1", 1e-6)])
def test_a_file_of_another_writer(tmp_path, density, factor):
    """Frequencies, half floats, polarisation and display channels, any order of bands."""
    path = tmp_path / "other.exr"
    channels = {
        "S0.30THz": plane(2 / factor),
        "S0.9000,0nm": plane(1 / factor),
        "S0.12um": plane(3 / factor),
        "S1.9000,0nm": plane(-1),
        "T.9000,0nm": plane(0.5),
        "R": plane(0.1, np.float16), "G": plane(0.2, np.float16), "B": plane(0.3, np.float16),
    }  # fmt: skip
    write_exr(path, channels, spectralLayoutVersion="1.0", emissiveUnits=UNITS + density)
    cube = read_cube(path)
    np.testing.assert_allclose(cube.wavelength_um, [9.0, 9.99308193, 12.0], rtol=1e-9)
    np.testing.assert_allclose(cube.radiance[:, 0, 0], [1, 2, 3], rtol=1e-6)
    assert cube.shape == (3, 4) and cube.netd_k is None and (cube.fwhm_um == 0).all()


def test_a_fill_value_beyond_float32_in_our_unit_is_a_dead_pixel(tmp_path):
    filled = plane(1e-3)
    filled[0, 1] = np.finfo(np.float32).max
    channels = {f"S0.{w}um": filled for w in (9, 10, 11)}
    write_exr(tmp_path / "a.exr", channels, emissiveUnits=UNITS + ".nm^-1")
    assert (read_cube(tmp_path / "a.exr").dead == (filled > 1)).all()


def test_a_name_that_no_disk_takes_is_no_file():
    with pytest.raises(InputError, match="there is no file"):
        read_cube("n" * 300 + ".exr")


@pytest.mark.parametrize(
    "header",
    [
        {},
        {"emissiveUnits": ""},
        {"emissiveUnits": UNITS},
        {"emissiveUnits": UNITS + ".cm"},
        {"emissiveUnits": UNITS, "texnetSpectralDensity": "nm^-1"},
    ],
)
def test_open_units_are_refused(tmp_path, header):
    path = tmp_path / "open.exr"
    write_exr(path, {"S0.9000,0nm": plane(1)}, **header)
    with pytest.raises(InputError, match="per what unit of wavelength"):
        read_cube(path)


def test_an_exr_without_spectra_is_refused(tmp_path):
    path = tmp_path / "rgb.exr"
    write_exr(path, {"R": plane(1), "G": plane(1), "B": plane(1)})
    with pytest.raises(InputError, match="no spectral channels.*B, G, R"):
        read_cube(path)


@pytest.mark.parametrize("text", [b"S0.9000,0nm", b"red", UNITS.encode(), b"0.25", b"0.0625"])
def test_an_exr_with_text_that_is_not_utf_8_is_refused(tmp_path, text):
    """A byte is damaged in a band's name, another channel's, the units, a width, the NETD."""
    path = tmp_path / "cube.exr"
    own = {"texnetFwhmUm": "0.25", "texnetNetdK": "0.0625", "emissiveUnits": UNITS + ".um^-1"}
    write_exr(path, {"S0.9000,0nm": plane(1), "red": plane(1)}, **own)
    assert read_cube(path).netd_k == 0.0625
    path.write_bytes(path.read_bytes().replace(text, b"\xe5" + text[1:], 1))
    with pytest.raises(InputError, match="not UTF-8"):
        read_cube(path)


@pytest.mark.parametrize(
    "mark, offset, damage",
    [
        (b"'shape': (2, 1, 1), }", 16, b", ( "),  # a bracket that never closes
        (b"'shape': (2,), }", 12, b", ( "),
        (b"PK\x01\x02", 8, b"\x01"),  # encrypted
        (b"PK\x01\x02", 10, b"\x63"),  # a method of packing that zipfile does not know
    ],
)
def test_an_npz_with_a_damaged_header_is_refused(tmp_path, mark, offset, damage):
    path = tmp_path / "cube.npz"
    np.savez(path, radiance=np.full((2, 1, 1), 5.0), wavelength_um=np.array([9.0, 10.0]))
    assert read_cube(path).bands == 2
    data = path.read_bytes()
    at = data.index(mark) + offset
    path.write_bytes(data[:at] + damage + data[at + len(damage) :])
    with pytest.raises(InputError, match="not a whole npz file"):
        read_cube(path)


@pytest.fixture
def cube():
    rng = np.random.default_rng(3)
    return HeatCube(rng.uniform(5, 9, (8, 40, 50)), np.linspace(8, 14, 8), np.full(8, 0.75), 0.05)


@pytest.mark.parametrize("suffix", [".exr", ".npz"])
@pytest.mark.parametrize("part", [0.0, 0.01, 0.5, 0.999])
def test_truncated_files_are_refused_quietly(tmp_path, capfd, cube, suffix, part):
    path = tmp_path / f"cube{suffix}"
    write_cube(cube, path)
    data = path.read_bytes()
    path.write_bytes(data[: int(part * len(data))])
    with pytest.raises(InputError, match="not a whole"):
        read_cube(path)
    assert capfd.readouterr() == ("", ""), "the library's own complaints must not show"


def test_what_others_say_meanwhile_is_said(tmp_path, capfd, monkeypatch, cube):
    """A thread that prints, or a library that writes to stderr itself, while a cube is read."""
    path = tmp_path / "cube.exr"
    write_cube(cube, path)
    real = OpenEXR.File

    def talkative(*args, **how):
        print("a line")
        os.write(2, b"a warning\n")
        return real(*args, **how)

    monkeypatch.setattr(OpenEXR, "File", talkative)
    read_cube(path)
    out, err = capfd.readouterr()
    assert set(out.split("\n")) == {"a line", ""} and set(err.split("\n")) == {"a warning", ""}


@pytest.mark.parametrize("suffix", [".exr", ".npz"])
def test_a_flipped_byte_is_noticed(tmp_path, cube, suffix):
    path = tmp_path / f"cube{suffix}"
    write_cube(cube, path)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    with pytest.raises(InputError, match="not a whole"):
        read_cube(path)


def npz(path, **arrays):
    good = dict(radiance=np.full((3, 2, 2), 7.0), wavelength_um=np.array([8.0, 9.0, 10.0]))
    arrays = {key: a for key, a in (good | arrays).items() if a is not None}
    np.savez(path, **arrays)
    return path


@pytest.mark.parametrize(
    "change, sentence",
    [
        (dict(radiance=None), "lacks radiance; it holds wavelength_um"),
        (dict(wavelength_um=None), "lacks wavelength_um"),
        (dict(wavelength_um=[8000.0, 9000.0, 10000.0]), "looks like nm or cm-1"),
        (dict(wavelength_um=[8.0, 9.0]), "3 bands of radiance but 2 wavelengths"),
        (dict(wavelength_um=[9.0, 8.0, 10.0]), "ascend"),
        (dict(wavelength_um=np.array(["8", "9", "10"])), "must be real numbers"),
        (dict(radiance=np.full((3, 2, 2), 7j)), "must be real numbers"),
        (dict(radiance=np.full((3, 2, 2), np.nan)), "NaN"),
        (dict(radiance=np.full((3, 2), 7.0)), "must be .bands, height, width."),
        (dict(radiance=np.array([{"pickled": 1}])), "must be real numbers"),
        (dict(netd_k=[0.1, 0.2]), "one number"),
        (dict(netd_k=-1.0), "NETD"),
    ],
)
def test_wrong_npz_files(tmp_path, change, sentence):
    with pytest.raises(InputError, match=sentence) as e:
        read_cube(npz(tmp_path / "wrong.npz", **change))
    assert "\n" not in str(e.value)


def test_an_npz_may_leave_noise_and_widths_open(tmp_path):
    cube = read_cube(npz(tmp_path / "short.npz", netd_k=np.nan))
    assert cube.netd_k is None and (cube.fwhm_um == 0).all()


def test_an_array_saved_as_npz_is_refused(tmp_path):
    with open(tmp_path / "array.npz", "wb") as f:
        np.save(f, np.ones((3, 2, 2)))
    with pytest.raises(InputError, match="not a whole npz"):
        read_cube(tmp_path / "array.npz")


def test_paths_that_are_no_cube(tmp_path, cube):
    (tmp_path / "folder.npz").mkdir()
    for name, sentence in [
        ("gone.exr", "no file"),
        ("folder.npz", "is a folder"),
        ("cube.tiff", ".exr or .npz"),
        ("cube", ".exr or .npz"),
    ]:
        with pytest.raises(InputError, match=sentence):
            read_cube(tmp_path / name)
    for name, sentence in [
        ("folder.npz", "is a folder"),
        ("cube.tiff", ".exr or .npz"),
        ("nowhere/cube.exr", "there is no folder"),
    ]:
        with pytest.raises(InputError, match=sentence):
            write_cube(cube, tmp_path / name)
        with pytest.raises(InputError, match=sentence):
            check_cube_path(tmp_path / name)


def test_what_openexr_cannot_name_is_refused_before_the_work(tmp_path, cube, monkeypatch):
    folder = tmp_path / os.fsdecode(b"d\xff")
    folder.mkdir()
    link = tmp_path / "link.exr"
    link.symlink_to(folder / "cube.exr")
    monkeypatch.chdir(folder)
    for refused in (
        lambda: check_cube_path(folder / "cube.exr"), lambda: check_cube_path(link),
        lambda: write_cube(cube, link), lambda: check_directory("answer"),
        lambda: check_directory(folder),
    ):  # fmt: skip
        with pytest.raises(InputError, match=r"only UTF-8 names; rename .*d\\udcff"):
            refused()
    assert list(folder.iterdir()) == []
    write_cube(cube, folder / "cube.npz")


def test_a_failed_write_leaves_the_old_file(tmp_path, cube, monkeypatch):
    path = tmp_path / "cube.npz"
    write_cube(cube, path)
    before = path.read_bytes()

    def half(file, *_, **__):
        file.write(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(np.lib.format, "write_array", half)
    with pytest.raises(KeyboardInterrupt):
        write_cube(cube, path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_many_threads_may_read_at_once(tmp_path, cube):
    """OpenEXR's words are kept from stdout and stderr, which all threads share."""
    write_cube(cube, tmp_path / "a.exr")
    before = sys.stdout, os.fstat(2)
    with ThreadPoolExecutor(4) as pool:
        read = list(pool.map(read_cube, 40 * [tmp_path / "a.exr"]))
    assert (sys.stdout, os.fstat(2)) == before
    for one in read:
        np.testing.assert_array_equal(one.radiance, cube.radiance)
