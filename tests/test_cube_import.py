"""The same scene in every file, order and unit is the same HeatCube; what a file leaves open is
refused."""

import json
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from physics import InputError
from physics.cube.heat_cube import HeatCube
from physics.machinery import scratch
from physics.planck import brightness_temperature, planck
from texnet.cli import main
from texnet.files import raw_cube
from texnet.files.cube_import import import_cube
from texnet.files.cube_io import read_cube, write_cube
from texnet.files.envi import read_envi
from texnet.files.units import UNITS

ANY = settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
NU = np.linspace(720.0, 1250.0, 6)  # cm-1, ascending, so um descending
W = 1e4 / NU
T = np.array([[[280.0, 285.0, 290.0, 295.0], [300.0, 250.0, 310.0, 260.0]]])  # K, 2 x 4 pixels
S = planck(W[:, None, None], T)  # (6, 2, 4) W m-2 sr-1 um-1, bands in descending um
PER_CM1 = S * W[:, None, None] ** 2 / 1e4
TYPES = {1: "u1", 2: "i2", 3: "i4", 4: "f4", 5: "f8", 12: "u2", 13: "u4", 14: "i8", 15: "u8"}
FLAGS = ["--unit", "W/m2/sr/um"]


def envi(path, s, interleave="bsq", big=False, kind=4, skip=0, tail=0, **fields):
    """Write s (bands, lines, samples) number by number, as the format's description says."""
    bands, lines, samples = s.shape
    number = np.dtype((">" if big else "<") + TYPES[kind])
    order = {
        "bsq": ((b, i, j) for b in range(bands) for i in range(lines) for j in range(samples)),
        "bil": ((b, i, j) for i in range(lines) for b in range(bands) for j in range(samples)),
        "bip": ((b, i, j) for i in range(lines) for j in range(samples) for b in range(bands)),
    }[interleave]
    with open(path.with_suffix(".dat"), "wb") as file:
        file.write(b"x" * skip)
        for index in order:
            file.write(np.array(s[index]).astype(number).tobytes())
        file.write(b"y" * tail)
    header = {
        "description": "{\n  A = night, }", "samples": samples, "lines": lines, "bands": bands,
        "header offset": skip, "file type": "ENVI Standard", "data type": kind,
        "interleave": interleave, "byte order": int(big), "wavelength": W[:bands],
        "wavelength units": "Micrometers",
    } | {key.replace("_", " "): value for key, value in fields.items()}  # fmt: skip
    text = ["ENVI", "; a comment with interleave = none"]
    for key, value in header.items():
        if isinstance(value, np.ndarray):
            value = "{" + ",\n ".join(map(repr, value.tolist())) + "}"
        if value is not None:
            text.append(f"{key} = {value}")
    path.with_suffix(".hdr").write_text("\n".join(text) + "\n", encoding="utf-8")
    return path.with_suffix(".hdr")


def mat(path, **variables):
    savemat(path, variables)
    return path


def arrays_file(path, arrays):
    """A .mat or .npz file of a dict of arrays."""
    if path.suffix == ".mat":
        savemat(path, arrays)
    else:
        np.savez(path, **arrays)
    return path


def check_same(cube, s=S, w=W, rtol=1e-6):
    """The cube is s (bands, height, width) at w, in ascending order."""
    order = np.argsort(w)
    np.testing.assert_allclose(cube.wavelength_um, w[order], rtol=1e-7)
    np.testing.assert_allclose(cube.radiance, s[order], rtol=rtol)
    assert cube.radiance.dtype == np.float32 and not cube.radiance.flags.writeable


def refused(capfd, *words):
    """The one sentence that `import` refuses with."""
    code = main(["import", *map(str, words)])
    out, err = capfd.readouterr()
    assert code == 2 and out == ""
    assert err.startswith("texnet: error: ") and err.count("\n") == 1 and "Traceback" not in err
    return err


@pytest.fixture
def in_parts(monkeypatch):
    """Small parts, and every array in a file."""
    monkeypatch.setattr(raw_cube, "PART", 5)
    monkeypatch.setattr(scratch, "LARGE", 0)


# --- ENVI --------------------------------------------------------------------------------


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("interleave", ["bsq", "bil", "bip"])
def test_every_order_of_numbers_and_bytes(tmp_path, in_parts, interleave, big):
    path = envi(tmp_path / "a", S, interleave, big, skip=7)
    cube, note = import_cube(path, "W/m2/sr/um")
    check_same(cube)
    assert cube.netd_k is None and (cube.fwhm_um == 0).all()
    for word in (interleave, "6 bands of 2 x 4 pixels", "order reversed", "narrow", "warmer than"):
        assert word in note
    check_same(import_cube(tmp_path / "a.dat", "W/m2/sr/um")[0])  # by its binary


@given(data=st.data())
@ANY
def test_every_type_of_number_with_gains_and_bad_bands(tmp_path, data):
    """Whole numbers n, bands in any order; radiance is gain n + offset."""
    draw = data.draw
    kind, big = draw(st.sampled_from(list(TYPES))), draw(st.booleans())
    interleave = draw(st.sampled_from(["bsq", "bil", "bip"]))
    shape = tuple(draw(st.integers(1, 5)) for _ in range(3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    numbers = rng.integers(1, 100, shape)
    w = 8 + 0.5 * rng.permutation(8)[: shape[0]]
    good = rng.random(shape[0]) < 0.7
    good[rng.integers(shape[0])] = True
    gain, offset = rng.uniform(0.01, 0.02, shape[0]), rng.uniform(6, 8, shape[0])
    path = envi(
        tmp_path / "a", numbers, interleave, big, kind, draw(st.integers(0, 9)), wavelength=w,
        fwhm=w / 100, bbl=good.astype(int), data_gain_values=gain, data_offset_values=offset,
    )  # fmt: skip
    cube, note = import_cube(path, "W/m2/sr/um", netd_k=0.1)
    expected = [
        (w[b], gain[b] * numbers[b] + offset[b]) for b in sorted(range(shape[0]), key=w.item)
        if good[b]
    ]  # fmt: skip
    assert cube.wavelength_um.tolist() == [at for at, _ in expected] and cube.netd_k == 0.1
    np.testing.assert_allclose(cube.radiance, [s for _, s in expected], rtol=1e-6)
    np.testing.assert_allclose(cube.fwhm_um, cube.wavelength_um / 100)
    left_out = "left out that the file calls bad"
    assert "gain and offset" in note and (left_out in note) == (not good.all())


@pytest.mark.parametrize(
    "words, centre",
    [
        ("Micrometers", W), ("um", W), ("µm", W), ("MICRONS", W),
        ("Nanometers", 1e3 * W), ("nm", 1e3 * W), ("Wavenumber", NU), ("cm-1", NU),
    ],
)  # fmt: skip
def test_every_unit_of_bands(tmp_path, words, centre):
    path = envi(tmp_path / "a", S, wavelength=centre, wavelength_units=words)
    check_same(import_cube(path, "W/m2/sr/um")[0])


@pytest.mark.parametrize("words", [None, "", "Unknown", "Inverse Centimetres", "<unspecified>"])
@pytest.mark.parametrize("axis, centre", [("um", W), ("nm", 1e3 * W), ("cm-1", NU)])
def test_bands_of_a_thermal_camera_tell_their_unit(tmp_path, words, axis, centre):
    path = envi(tmp_path / "a", S, wavelength=centre, wavelength_units=words)
    cube, note = import_cube(path, "W/m2/sr/um")
    check_same(cube)
    why = f"{words.lower()!r} is not a known unit" if words else "their unit is missing"
    assert f"wavelengths taken to be in {axis}, since {why}" in note


def test_a_bad_bands_wavelength_may_be_anything(tmp_path):
    bbl, w = np.array([0, 1, 1, 1, 1, 1]), W.copy()
    w[0] = 0.0
    path = envi(tmp_path / "a", S, wavelength=w, wavelength_units=None, bbl=bbl)
    check_same(import_cube(path, "W/m2/sr/um")[0], S[1:], W[1:])


def test_widths_in_another_unit_are_asked_about(tmp_path):
    for width, said in ((0.1, True), (100.0, False), (6e3, True)):
        nm = dict(wavelength=1e3 * W, wavelength_units="Nanometers", fwhm=np.full(6, width))
        note = import_cube(envi(tmp_path / "a", S, **nm), "W/m2/sr/um")[1]
        assert ("are their widths in the unit of the wavelengths?" in note) == said


def test_widths_by_hand(tmp_path):
    """5 cm-1 at 1000 cm-1 is 10025.06 nm - 9975.06 nm = 50 nm, and 4 times as much at 500 cm-1."""
    for centre, units, width in [
        ([1000.0, 500.0], "Wavenumber", [5.0, 5.0]),
        ([1e4, 2e4], "Nanometers", [50.0, 200.0]),
        ([10.0, 20.0], "Micrometers", [0.05, 0.2]),
    ]:
        path = envi(
            tmp_path / "a", S[:2], wavelength=np.array(centre), wavelength_units=units,
            fwhm=np.array(width),
        )  # fmt: skip
        cube, note = import_cube(path, "W/m2/sr/um")
        np.testing.assert_allclose(cube.wavelength_um, [10, 20])
        np.testing.assert_allclose(cube.fwhm_um, [0.05, 0.2])
        assert "narrow" not in note


def test_the_scale_factor_divides(tmp_path):
    path = envi(tmp_path / "a", 1e4 * S, kind=5, reflectance_scale_factor=1e4)
    cube, note = import_cube(path, "W/m2/sr/um")
    check_same(cube)
    assert "divided by the reflectance scale factor 10000" in note


def test_another_factor_is_named_and_not_applied(tmp_path):
    path = envi(tmp_path / "a", S, kind=5, radiance_scale_factor=10)
    cube, note = import_cube(path, "W/m2/sr/um")
    check_same(cube)
    assert "radiance scale factor 10 not applied" in note


def test_bands_without_a_measurement_stay_dead(tmp_path, in_parts):
    """So that decompose finds them and names them."""
    for interleave in ("bsq", "bip"):
        s = S.copy()
        s[2] = 7777
        path = envi(tmp_path / "a", s, interleave, data_ignore_value=7777)
        cube, _ = import_cube(path, "W/m2/sr/um")
        assert np.isnan(cube.radiance[3]).all()
        np.testing.assert_allclose(cube.radiance[[0, 1, 2, 4, 5]], S[[5, 4, 3, 1, 0]], rtol=1e-6)


def test_pixels_that_hold_the_ignore_value_are_dead(tmp_path, in_parts):
    blank = np.zeros(S.shape[1:], bool)
    blank[1, 2:] = True
    for interleave in ("bsq", "bil", "bip"):
        for value in (-9999, 1.1):  # float32 rounds it
            s = np.where(blank, value, S)
            path = envi(tmp_path / "a", s, interleave, data_ignore_value=value)
            cube, note = import_cube(path, "W/m2/sr/um")
            np.testing.assert_array_equal(cube.dead, blank)
            np.testing.assert_allclose(cube.radiance[:, ~blank], S[::-1, ~blank], rtol=1e-6)
            assert "2 pixels (25%) without a measurement" in note
    s[:] = -9999
    path = envi(tmp_path / "a", s, data_ignore_value=-9999)
    with pytest.raises(InputError, match="all of its pixels are zero, NaN or infinite"):
        import_cube(path, "W/m2/sr/um")
    s[:] = S
    path = envi(tmp_path / "a", s, data_ignore_value=-9999)
    check_same(import_cube(path, "W/m2/sr/um")[0])
    for nothing in ("NaN", "-inf", "-1.#IND", "{nan}", "", "-1.79769313486232e+308"):
        path = envi(tmp_path / "a", s, data_ignore_value=nothing)
        check_same(import_cube(path, "W/m2/sr/um")[0])


@pytest.mark.parametrize("interleave", ["bsq", "bil", "bip"])
@pytest.mark.parametrize("fill", [0, -32768])
def test_one_number_in_all_bands_of_many_pixels_is_no_measurement(
    tmp_path, in_parts, interleave, fill
):  # fmt: skip
    """Where bands have offsets it would be another radiance in each, and a material of its own."""
    wide = np.tile(S, (1, 3, 10))
    low, high = wide.min(axis=(1, 2)), wide.max(axis=(1, 2))
    gain, offset = (high - low) / 50_000, (low + high) / 2
    raw = np.round((wide - offset[:, None, None]) / gain[:, None, None])
    raw[:, :4, :6] = fill
    of = dict(kind=2, data_gain_values=gain, data_offset_values=offset)
    cube, note = import_cube(envi(tmp_path / "a", raw, interleave, **of), "W/m2/sr/um")
    blank = np.zeros(wide.shape[1:], bool)
    blank[:4, :6] = True
    np.testing.assert_array_equal(cube.dead, blank)
    assert f"{fill} in every band treated as no measurement; " in note
    # a few may be as dark as that, and what is as bright as can be was seen
    few = raw.copy()
    few[:, :4, :6] = np.round(raw[:, :4, 6:12])
    few[:, 0, :6] = fill
    few[:, 5, :] = 32767
    assert not import_cube(envi(tmp_path / "b", few, interleave, **of), "W/m2/sr/um")[0].dead.any()
    # the header may say that it is something else
    path = envi(tmp_path / "c", raw, interleave, data_ignore_value=-1, **of)
    assert not import_cube(path, "W/m2/sr/um")[0].dead.any()


@pytest.mark.parametrize("kind", [4, 5])
@pytest.mark.parametrize("said", ["-3.4028235e+38", "-3.40282e+38", "-3.402823e38"])
def test_the_ignore_value_may_be_said_in_fewer_digits(tmp_path, kind, said):
    blank = np.zeros(S.shape[1:], bool)
    blank[0, 1] = True
    s = np.where(blank, np.finfo(np.float32).min, S)
    path = envi(tmp_path / "a", s, kind=kind, data_ignore_value=said)
    np.testing.assert_array_equal(import_cube(path, "W/m2/sr/um")[0].dead, blank)
    if kind == 5:  # of what a scene may show, only the very number
        path = envi(tmp_path / "a", S, kind=5, data_ignore_value=S[2, 0, 1] * (1 + 1e-6))
        assert not import_cube(path, "W/m2/sr/um")[0].dead.any()


def test_a_list_may_begin_on_the_line_after_its_name(tmp_path):
    path = envi(tmp_path / "a", S, bbl=np.array([1, 1, 0, 1, 1, 1]))
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("= {", "=\n; a comment\n  {"), encoding="utf-8")
    check_same(import_cube(path, "W/m2/sr/um")[0], np.delete(S, 2, 0), np.delete(W, 2))


def test_names_that_differ_in_case_alone_are_two_cubes(tmp_path):
    envi(tmp_path / "scan", S)
    envi(tmp_path / "SCAN", 1.1 * S, wavelength=1.01 * W)
    if len(list(tmp_path.iterdir())) < 4:
        pytest.skip("this disk takes them for one")
    for other in ("SCAN.dat", "SCAN.img"):
        (tmp_path / "SCAN.dat").rename(tmp_path / other)
        for name in ("SCAN.hdr", other):
            check_same(import_cube(tmp_path / name, "W/m2/sr/um")[0], 1.1 * S, 1.01 * W)
        for name in ("scan.hdr", "scan.dat"):
            check_same(import_cube(tmp_path / name, "W/m2/sr/um")[0])
    (tmp_path / "SCAN.hdr").rename(tmp_path / "SCAN.dat.hdr")
    check_same(import_cube(tmp_path / "scan.dat", "W/m2/sr/um")[0])


def test_a_binary_without_its_header_is_refused(tmp_path):
    path = envi(tmp_path / "a", S)
    path.unlink()
    with pytest.raises(InputError, match=r"cube: there is no header, a\.hdr, beside"):
        read_envi(tmp_path / "a.dat")


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1"])
def test_a_header_may_be_latin_1(tmp_path, encoding):
    path = envi(tmp_path / "a", S, wavelength_units="µm", description="{nuit à Orléans}")
    path.write_text(path.read_text(encoding="utf-8"), encoding=encoding)
    check_same(import_cube(path, "W/m2/sr/um")[0])


@pytest.mark.parametrize(
    "names", [("n.img", "n.hdr"), ("n.dat.hdr", "n.dat"), ("N.HDR", "n"), ("n.sc", "n.sc.hdr")]
)
def test_names_of_header_and_binary(tmp_path, names):
    header = envi(tmp_path / "a", S)
    for name in names:
        is_header = name.lower().endswith(".hdr")
        (header if is_header else header.with_suffix(".dat")).rename(tmp_path / name)
    for name in names:
        check_same(import_cube(tmp_path / name, "W/m2/sr/um")[0])


def test_bytes_after_the_last_pixel_are_said(tmp_path):
    cube, note = import_cube(envi(tmp_path / "a", S, tail=13), "W/m2/sr/um")
    check_same(cube)
    assert "13 bytes after the last pixel left unread;" in note
    band = S[0].size * np.dtype("<f4").itemsize
    note = import_cube(envi(tmp_path / "a", S, tail=2 * band), "W/m2/sr/um")[1]
    assert "enough for 2 more bands: is bands right?" in note


@pytest.mark.parametrize(
    "fields, sentence",
    [
        (dict(lines=3), "has 192 bytes where its header asks for 0 + 6 x 3 x 4 x 4"),
        (dict(samples=10**17, bands=6), "asks for 0 + 6 x 2 x 100000000000000000 x 4"),
        (dict(header_offset=1), "asks for 1 + 6 x 2 x 4 x 4"),
        (dict(samples=0), "samples must be a whole number >= 1, not '0'"),
        (dict(samples="-4"), "samples must be a whole number"),
        (dict(samples="4.0"), "samples must be a whole number"),
        (dict(samples="9" * 5000), "samples must be a whole number"),
        (dict(samples=None), "the field samples is missing"),
        (dict(byte_order=2), "byte order must be 0"),
        (dict(interLEAVE=""), "not ''"),
        (dict(data_type=6), "data type 6 is not a known real type"),
        (dict(data_type=9), "use 1, 2, 3, 4, 5, 12, 13, 14, 15"),
        (dict(Interleave="tiled"), "interleave must be bsq, bil or bip, not 'tiled'"),
        (dict(file_type="TIFF"), "file type must be ENVI Standard"),
        (dict(file_compression=1), "file compression is not supported"),
        (dict(minor_frame_offsets="{0, 8}"), "minor frame offsets is not supported"),
        (dict(wavelength=W[:5]), "wavelength holds 5 numbers where 6 are needed"),
        (dict(wavelength="{1, 2, x, 4, 5, 6}"), "wavelength must hold finite numbers"),
        (dict(wavelength="{1, 2, inf, 4, 5, 6}"), "wavelength must hold finite numbers"),
        (dict(wavelength="{1, 2"), "the list of 'wavelength' has no end }"),
        (dict(wavelength=np.array([8, 9, 10, 9, 11, 12])), "9 um is there twice"),
        (dict(wavelength=np.zeros(6)), "band centres must be finite and positive"),
        (dict(wavelength=1e3 * W), "13888.9-8000 um are outside 1-100 um"),
        (dict(wavelength_units="Nanometers"), "13.8889-8 nm are outside 1-100 um"),
        (dict(wavelength=None), "does not say where its 6 bands lie"),
        (dict(wavelength_units="Index"), "where its wavelength units are 'Index'"),
        (
            dict(wavelength_units="Unknown", wavelength=W / 2),
            "write Micrometers, Nanometers or Wavenumber",
        ),
        (dict(wavelength_units=None, wavelength=W / 2), "its wavelength units are missing"),
        (dict(fwhm=-W), "one width >= 0"),
        (dict(bbl=np.zeros(6)), "all of its bands bad"),
        (dict(data_gain_values=W[:1]), "data gain values holds 1 numbers where 6 are needed"),
        (dict(data_gain_values=0 * W), "zero, NaN or infinite in every band"),
        (dict(data_gain_values=np.full(6, 1e300)), "NaN or infinite"),
        (dict(data_ignore_value="none"), "data ignore value must be a number, not 'none'"),
        (dict(reflectance_scale_factor=0), "must not be 0"),
        (dict(reflectance_scale_factor=10, data_gain_values=W), "keep those that make radiance"),
    ],
)
def test_wrong_headers(tmp_path, capfd, fields, sentence):
    path = envi(tmp_path / "a", S, **fields)
    assert sentence in refused(capfd, path, "--out", tmp_path / "b.npz", *FLAGS)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.dat", "a.hdr"]


@given(seed=st.integers(0, 2**32 - 1))
@settings(ANY, max_examples=300)
def test_damaged_headers_never_crash(tmp_path, seed):
    path = envi(tmp_path / "a", S, fwhm=W / 100, bbl=np.ones(6), data_gain_values=np.ones(6))
    rng, data = np.random.default_rng(seed), bytearray(path.read_bytes())
    for _ in range(rng.integers(1, 6)):
        data[rng.integers(len(data))] = rng.choice([*b"0123456789-.,{}=;\nE ", 0, 255])
    path.write_bytes(data[: rng.integers(1, len(data))] if rng.integers(2) else data)
    try:
        cube, _ = import_cube(path, "W/m2/sr/um")
    except InputError as e:
        assert str(e).startswith("cube: ") and "\n" not in str(e)
    else:
        assert cube.bands <= 6 and cube.radiance[0].size <= 48


def test_headers_without_a_binary_and_the_reverse(tmp_path, capfd):
    path, out = envi(tmp_path / "a", S), tmp_path / "b.npz"
    (tmp_path / "a.img").write_bytes(b"")
    assert "may belong to a.dat and a.img" in refused(capfd, path, "--out", out, *FLAGS)
    assert "its header asks for" in refused(capfd, tmp_path / "a.img", "--out", out, *FLAGS)
    (tmp_path / "a.img").unlink()
    (tmp_path / "a.dat").unlink()
    assert "there is no a or a.dat beside" in refused(capfd, path, "--out", out, *FLAGS)
    (tmp_path / "c.raw").write_bytes(b"x")
    sentence = refused(capfd, tmp_path / "c.raw", "--out", out, *FLAGS)
    assert "its .hdr must lie beside it" in sentence
    (tmp_path / "c.hdr").write_bytes(b"BYTEORDER I\nNROWS 2\n")
    assert "first line must be ENVI" in refused(capfd, tmp_path / "c.raw", "--out", out, *FLAGS)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
@pytest.mark.parametrize("interleave", ["bsq", "bip"])
def test_a_cube_is_imported_in_less_memory_than_it_takes(tmp_path, interleave):
    bands, lines, samples = 24, 1000, 1600  # 154 MB
    path = envi(
        tmp_path / "a", np.ones((bands, 1, 1)), interleave, lines=lines, samples=samples,
        wavelength=np.linspace(8, 14, bands),
    )  # fmt: skip
    np.full(bands * lines * samples, 7, "<f4").tofile(path.with_suffix(".dat"))
    code = (
        "import re, sys; from texnet.files import raw_cube; from texnet.cli import main;"
        "import texnet.files.cube_import, texnet.progress; raw_cube.PART = 1 << 20;"
        # not ru_maxrss, which starts at that of the tests
        "peak = lambda: int(re.search(r'VmHWM:\\s*(\\d+)', open('/proc/self/status').read())[1]);"
        "before = peak(); sys.stdout = sys.stderr;"
        "main(['import', *sys.argv[1:], '--unit', 'W/m2/sr/um']);"
        "print(peak() - before, file=sys.__stdout__)"
    )
    command = [sys.executable, "-c", code, path, "--out", tmp_path / "b.npz"]
    out = subprocess.run(command, capture_output=True, text=True, check=True)
    assert 1024 * int(out.stdout) < 0.5 * 4 * bands * lines * samples


# --- units -------------------------------------------------------------------------------


@pytest.mark.parametrize("unit", UNITS)
def test_planck_in_any_unit_gives_its_temperature_back(tmp_path, unit):
    """Per cm-1 by Planck's law in wavenumbers, 2 h c^2 nu^3 / (exp(h c nu / k T) - 1), in SI."""
    h, c, k = 6.62607015e-34, 299792458.0, 1.380649e-23
    nu = 100 * NU[:, None, None]  # m-1
    per_m1 = 2 * h * c**2 * nu**3 / np.expm1(h * c * nu / (k * T))  # W m-2 sr-1 per m-1
    area = 1e-4 if "/cm2" in unit else 1.0
    prefix = {"W": 1.0, "mW": 1e3, "uW": 1e6, "nW": 1e9, "microflick": 1e4}[unit.split("/")[0]]
    if unit == "microflick":
        area = 1e-2  # 1 W m-2 is 100 uW cm-2
    per_length = 1e-9 if unit.endswith("/nm") else 1e-6  # m
    s = prefix * area * (100 * per_m1 if unit.endswith("cm-1") else per_m1 * nu**2 * per_length)
    cube, note = import_cube(envi(tmp_path / "a", s, kind=5), unit)
    check_same(cube)
    became = " kept" if unit == "W/m2/sr/um" else " became W m-2 sr-1 um-1"
    assert f"; {unit}{became};" in note and "half of it is warmer than 288 K" in note


@pytest.mark.parametrize(
    "true, said, sentence",
    [
        ("microflick", "W/m2/sr/um", " K in microflick)."),
        ("mW/m2/sr/um", "W/m2/sr/um", " K in mW/m2/sr/um)."),
        ("mW/m2/sr/cm-1", "W/m2/sr/cm-1", " K in mW/m2/sr/cm-1)."),
        ("W/m2/sr/um", "W/cm2/sr/um", " K in W/m2/sr/um)."),
        ("W/cm2/sr/um", "W/m2/sr/um", " K in W/cm2/sr/um)."),
        ("W/cm2/sr/um", "mW/m2/sr/um", "give the right --unit (288 K in W/cm2/sr/um)."),
    ],
)
def test_a_wrong_unit_is_refused_and_the_right_one_named(tmp_path, capfd, true, said, sentence):
    factor, per_cm1 = UNITS[true]
    path = envi(tmp_path / "a", (PER_CM1 if per_cm1 else S) / factor)
    error = refused(capfd, path, "--out", tmp_path / "b.npz", "--unit", said)
    assert sentence in error and f"in {said} half of it would be warmer than" in error


@pytest.mark.parametrize(
    "true, said", [("W/m2/sr/cm-1", "W/m2/sr/um"), ("mW/m2/sr/um", "microflick")]
)
def test_an_unusual_temperature_is_said(tmp_path, true, said):
    factor, per_cm1 = UNITS[true]
    path = envi(tmp_path / "a", (PER_CM1 if per_cm1 else S) / factor)
    note = import_cube(path, said)[1]
    assert note.splitlines()[1].startswith("Warning: ") and f"(288 K in {true})." in note


@pytest.mark.parametrize("unit", ["W/m2/sr/um", "mW/m2/sr/um", "microflick"])
def test_brightness_temperatures_are_no_radiance_unless_so_said(tmp_path, capfd, unit):
    kelvin = 290 + np.random.default_rng(0).normal(scale=3, size=S.shape)
    out = tmp_path / "b.npz"
    for s, said in ((kelvin, True), (S, False)):
        main(["import", str(envi(tmp_path / "a", s)), "--out", str(out), "--unit", unit])
        assert (
            "similar in all bands, brightness temperatures in K? Then give --unit K."
            in ("".join(capfd.readouterr()))
        ) == said


@pytest.mark.parametrize("kelvin", [262.0, 279.0, 284.0, 289.0, 299.0])
def test_brightness_temperatures_are_no_radiance_whatever_they_are(tmp_path, capfd, kelvin):
    s = kelvin + np.random.default_rng(0).normal(scale=3, size=S.shape)
    said = refused(capfd, envi(tmp_path / "a", s), "--out", tmp_path / "b.npz", *FLAGS)
    assert "brightness temperatures in K? Then give --unit K." in said


def test_brightness_temperatures_that_are_said_to_be_become_radiance(tmp_path, capfd):
    kelvin = np.broadcast_to(T, S.shape)
    cube, note = import_cube(envi(tmp_path / "a", kelvin, kind=5), "K")
    check_same(cube)
    assert "K became W m-2 sr-1 um-1" in note and note.endswith("half of it is warmer than 288 K.")
    of = {"data_gain_values": np.full(6, 0.01), "data_offset_values": np.full(6, 273.15)}
    celsius = np.round(100 * (kelvin - 273.15))
    check_same(import_cube(envi(tmp_path / "b", celsius, kind=2, **of), "Kelvin")[0])
    path = envi(tmp_path / "c", kelvin, data_units="K")  # of each band, or of the surface?
    assert "give --unit K; else" in refused(capfd, path, "--out", tmp_path / "c.npz")
    nothing = np.where(T == 260, 0.0, kelvin)
    dead = import_cube(envi(tmp_path / "d", nothing), "K")[0].dead
    np.testing.assert_array_equal(dead, T[0] == 260)


def test_degrees_celsius_are_no_kelvin(tmp_path):
    """Nor is radiance; numbers below some 14 would glow less than 32 bits hold."""
    celsius = np.broadcast_to(T - 273.15, S.shape)
    for numbers, sentence in (
        (celsius, r"than \d\d K; add 273.15 if these are degrees Celsius, else give the --unit"),
        (celsius - 30, "in K nothing of it would be warm enough to glow; add 273.15 if these"),
        (S, "in K nothing of it would be warm enough to glow; .* give the --unit of the radiance"),
    ):
        with pytest.raises(InputError, match=sentence):
            import_cube(envi(tmp_path / "a", numbers, kind=5), "K")
    with pytest.raises(InputError, match="zero, NaN or infinite"):
        import_cube(envi(tmp_path / "b", np.full(S.shape, np.nan), kind=5), "K")


def test_a_unit_is_never_guessed(tmp_path, capfd):
    path, out = envi(tmp_path / "a", S), tmp_path / "b.npz"
    assert "give --unit, one of W/m2/sr/um, mW" in refused(capfd, path, "--out", out)
    assert "'DN' is not a known unit" in refused(capfd, path, "--out", out, "--unit", "DN")


# --- .mat, .npz and .npy -----------------------------------------------------------------


@pytest.mark.parametrize("key", ["S", "HSI"])
def test_hadar(tmp_path, in_parts, key):
    path = mat(tmp_path / "a.mat", **{key: PER_CM1.transpose(1, 2, 0), "other": ["x"]})
    cube, note = import_cube(path, wavenumbers_cm1=(720, 1250))
    check_same(cube)
    assert f"HADAR .mat, {key}" in note and "W/m2/sr/cm-1 became" in note
    assert "720-1250 cm-1 became 8-13.89 um, order reversed" in note
    micro = mat(tmp_path / "b.mat", **{key: 100 * S.transpose(1, 2, 0)})
    check_same(import_cube(micro, "microflick", wavenumbers_cm1=(720, 1250))[0])


@pytest.mark.parametrize("key", ["S", "HSI", "cube"])
def test_a_cube_beside_its_wavelengths_is_one_s_own(tmp_path, capfd, key):
    """By whatever name: of its own bands, and of no unit but the one that is said."""
    path = mat(tmp_path / "a.mat", **{key: S.transpose(1, 2, 0), "wavelength": W})
    check_same(import_cube(path, "W/m2/sr/um")[0])
    assert "--unit" in refused(capfd, path, "--out", tmp_path / "b.npz")


@pytest.mark.parametrize("width", [None, 0.1, np.linspace(0.1, 0.2, 6)])
def test_an_npz_of_ours_need_not_be_in_order(tmp_path, width):
    widths = {} if width is None else {"fwhm_um": width}
    path = arrays_file(tmp_path / "a.npz", {"radiance": S, "wavelength_um": W} | widths)
    cube, note = import_cube(path)
    check_same(cube)
    whole = np.uint8([13, 12, 11, 10, 9, 8])  # whose differences wrap
    path = arrays_file(tmp_path / "b.npz", {"radiance": S, "wavelength_um": whole})
    np.testing.assert_array_equal(import_cube(path)[0].wavelength_um, whole[::-1])
    assert "order reversed" in note
    expected = 0.0 if width is None else np.broadcast_to(width, 6)[::-1]
    np.testing.assert_allclose(cube.fwhm_um, expected)


@pytest.mark.parametrize("key", ["S", "cube"])
def test_one_band_has_no_third_axis_in_matlab(tmp_path, key):
    wavelength = {} if key == "S" else {"wavelength": W[:1]}
    path = mat(tmp_path / "a.mat", **{key: S[0]}, **wavelength)
    stated = {} if wavelength else {"wavelengths_um": (W[0], W[0])}
    check_same(import_cube(path, "W/m2/sr/um", **stated)[0], S[:1], W[:1])


def test_the_published_mean_radiances_are_289_k(tmp_path):
    """Channel means of the published cubes: 0.12648 at 720 and 0.04625 at 1250 cm-1."""
    s = np.full((2, 3, 2), [0.12648, 0.04625])
    cube, note = import_cube(mat(tmp_path / "a.mat", S=s), wavenumbers_cm1=(720, 1250))
    t = brightness_temperature(cube.wavelength_um, cube.spectra)
    np.testing.assert_allclose(t, 289, atol=0.5)
    assert "half of it is warmer than 289 K" in note


@pytest.mark.parametrize("first", [True, False])
@pytest.mark.parametrize("suffix", [".mat", ".npz"])
def test_tex1500(tmp_path, in_parts, suffix, first):
    arrays = {
        "denoised_hsi_original": 100 * (S if first else S.transpose(1, 2, 0)),
        "HSI": np.zeros((2, 2, 2)), "working_wav": W[None], "hsi_wav": 0 * W[None],
        "good_band_indices": np.array([[0, 1, 3, 5]]),
    }  # fmt: skip
    cube, note = import_cube(arrays_file(tmp_path / f"a{suffix}", arrays), "microflick")
    check_same(cube, S[[0, 1, 3, 5]], W[[0, 1, 3, 5]])
    axes = "bands x height x width" if first else "height x width x bands"
    assert f"denoised_hsi_original ({axes}) over working_wav" in note
    assert "good_band_indices counts from 0" in note and "2 bands left out" in note


@pytest.mark.parametrize("suffix", [".mat", ".npz"])
@pytest.mark.parametrize("first", [True, False])
@pytest.mark.parametrize("mask", [None, bool, np.uint8, float])
@pytest.mark.parametrize("both", [True, False])
@pytest.mark.parametrize("good", [np.array([0, 1, 3, 5]), np.uint8([0, 1, 3, 5]), [5, 3, 1, 0]])
def test_wavelengths_of_good_bands_alone(tmp_path, suffix, first, mask, both, good):
    good = np.sort(good) if mask else np.asarray(good)
    s = np.tile(S, (1, 4, 4))
    arrays = {
        "hsi": s if first else s.transpose(1, 2, 0), "working_wav": W[None, good],
        "good_bands": np.isin(np.arange(6), good).astype(mask) if mask else good,
    } | ({"hsi_wav": W} if both else {})  # fmt: skip
    cube, note = import_cube(arrays_file(tmp_path / f"a{suffix}", arrays), "W/m2/sr/um")
    good = np.sort(good)
    np.testing.assert_array_equal(cube.wavelength_um, W[good][::-1])
    np.testing.assert_allclose(cube.radiance[:, :2, :4], S[good][::-1], rtol=1e-6)
    assert ("is a mask" in note) == bool(mask) and ("lists only these" in note) != both


@pytest.mark.parametrize("good", [["a"] * 6, np.zeros(6, "M8[s]"), np.zeros(6, "i4,i4"), [1j] * 6])
def test_good_bands_that_are_no_numbers_are_refused(tmp_path, good):
    np.savez(tmp_path / "a.npz", cube=S, wav=W, good_bands=np.array(good))
    with pytest.raises(InputError, match="good_bands in .* must hold finite real numbers"):
        import_cube(tmp_path / "a.npz", "W/m2/sr/um")


@pytest.mark.parametrize("width", ["fwhm_um", "fwhm"])
@pytest.mark.parametrize("alone", [True, False])
@pytest.mark.parametrize("suffix", [".mat", ".npz"])
def test_widths_and_noise_beside_them_are_taken(tmp_path, suffix, alone, width):
    good, widths = np.array([0, 1, 3, 5]), np.linspace(0.1, 0.3, 6)
    of = good if alone else np.arange(6)
    arrays = {
        "radiance": 100 * np.tile(S, (1, 4, 4)), "wavelength_um": W[of], width: widths[of],
        "netd_k": 0.03, "good_bands": good,
    }  # fmt: skip
    cube, note = import_cube(arrays_file(tmp_path / f"a{suffix}", arrays), "microflick")
    check_same(cube, np.tile(S, (1, 4, 4))[good], W[good])
    np.testing.assert_allclose(cube.fwhm_um, widths[good][::-1])
    assert cube.netd_k == 0.03 and "taken as narrow" not in note


@pytest.mark.parametrize(
    "width, taken",
    [
        (0.2, 0.2),
        ([], 0),
        ([np.nan] * 6, 0),
        ([0.1, 0.2, 0.3, 0.4, 0.5, 0.6], [0.6, 0.4, 0.2, 0.1]),
    ],
)
def test_one_width_for_all_none_or_also_those_of_bad_bands(tmp_path, width, taken):
    good, s = np.array([0, 1, 3, 5]), np.tile(S, (1, 4, 4))
    np.savez(tmp_path / "a.npz", cube=s, wav=W[good], good_bands=good, fwhm=width, netd_k=[])
    cube, note = import_cube(tmp_path / "a.npz", "W/m2/sr/um")
    np.testing.assert_allclose(cube.fwhm_um, taken)
    assert cube.netd_k is None and ("taken as narrow" in note) == (taken == 0)


@pytest.mark.parametrize(
    "arrays, sentence",
    [
        (dict(fwhm=[0.1] * 5), "fwhm in .* holds 5 widths for 6 bands"),
        (dict(netd_k=[0.1] * 6), "netd_k in .* must be one number"),
        (dict(netd_k=None), "netd_k in .* holds None or other objects; leave it out"),
    ],
)
def test_wrong_widths_and_noise_beside_them(tmp_path, arrays, sentence):
    np.savez(tmp_path / "a.npz", cube=S, wav=W, **arrays)
    with pytest.raises(InputError, match=sentence):
        import_cube(tmp_path / "a.npz", "W/m2/sr/um")


def test_indices_that_reach_the_number_of_bands_count_from_1(tmp_path):
    np.savez(tmp_path / "a.npz", cube=S, wav=W, good_bands=[2, 4, 6])
    cube, note = import_cube(tmp_path / "a.npz", "W/m2/sr/um")
    check_same(cube, S[1::2], W[1::2])
    assert "counts from 1" in note


@pytest.mark.parametrize("good, doubted", [([1, 3, 5], True), ([0, 3, 5], False)])
def test_indices_that_may_count_from_1_are_doubted(tmp_path, good, doubted):
    np.savez(tmp_path / "a.npz", cube=S, wav=W, good_bands=good)
    cube, note = import_cube(tmp_path / "a.npz", "W/m2/sr/um")
    check_same(cube, S[good], W[good])
    assert ("\nWarning: if good_bands counts from 1" in note) == doubted


@pytest.mark.parametrize(
    "arrays, sentence",
    [
        (dict(cube=S), "its wavelengths in um (working_wav, hsi_wav"),
        (dict(wav=W), "must hold a cube (denoised_hsi_original"),
        (dict(cube=S, wav=W[:5]), "cube in {} is 6 x 2 x 4, so that its 5 bands (wav)"),
        (dict(cube=np.ones((6, 4, 6)), wav=W), "may be its first axis or its last"),
        (dict(cube=S[0], wav=W), "are neither its first axis nor its last"),
        (dict(cube=S, wav=W, good_bands=[0, 6]), "must hold indices of its 6 bands"),
        (dict(cube=S, wav=W, good_bands=[0, 1, 1, 3]), "each once"),
        (dict(cube=S, wav=W, good_bands=[0.5]), "must hold indices"),
        (dict(cube=S, wav=W, good_bands=[]), "all of its bands bad"),
        (dict(cube=S, wav=[np.nan] * 6), "wav in {} must hold finite real numbers"),
        (dict(cube=S * 1j, wav=W), "real numbers"),
    ],
)
@pytest.mark.parametrize("suffix", [".npz", ".mat"])
def test_wrong_tex1500_files(tmp_path, capfd, suffix, arrays, sentence):
    path = tmp_path / f"a{suffix}"
    if suffix == ".mat":
        mat(path, **arrays)
        if np.iscomplexobj(arrays.get("cube")):
            sentence = "cube in {} must be an array of real numbers, not complex"
        if arrays.get("good_bands") == []:
            sentence = "all of its bands bad"
    else:
        np.savez(path, **arrays)
    error = refused(capfd, path, "--out", tmp_path / "b.npz", *FLAGS)
    assert sentence.format(path) in error and [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("flag, ends", [("wavenumbers_cm1", NU), ("wavelengths_um", W)])
def test_npy(tmp_path, in_parts, order, flag, ends):
    w = 1e4 / NU if flag == "wavenumbers_cm1" else np.linspace(W[0], W[-1], 6)
    s = np.tile(planck(w[:, None, None], T), (1, 4, 2))
    np.save(tmp_path / "a.npy", np.asarray(s, ">f8", order=order))
    cube, note = import_cube(tmp_path / "a.npy", "W/m2/sr/um", **{flag: tuple(ends[[0, -1]])})
    check_same(cube, s, w)
    assert "6 bands of 8 x 8 pixels" in note


@pytest.mark.parametrize("axis", ["wavelengths_um", "wavenumbers_cm1"])
def test_the_width_of_bands_may_be_stated(tmp_path, axis):
    """Filters 1 um wide, and 40 cm-1, which in um are wider the longer their wavelength."""
    centre, width = (np.linspace(8.5, 13, 6), 1.0) if axis == "wavelengths_um" else (NU, 40.0)
    np.save(tmp_path / "a.npy", np.tile(S, (1, 8, 8)))
    cube, note = import_cube(
        tmp_path / "a.npy", "W/m2/sr/um", **{axis: tuple(centre[[0, -1]])}, fwhm=width
    )
    ends = np.stack([centre - width / 2, centre + width / 2])
    um = np.sort(np.abs(np.diff(ends if axis == "wavelengths_um" else 1e4 / ends, axis=0)[0]))
    np.testing.assert_allclose(cube.fwhm_um, um, rtol=2e-3)
    assert "taken as narrow" not in note


def test_a_width_is_stated_once_and_of_bands_in_nm_in_um(tmp_path, capfd):
    fields = dict(wavelength=1e3 * W, wavelength_units="Nanometers")
    path = envi(tmp_path / "a", S, **fields)
    assert import_cube(path, "W/m2/sr/um", fwhm=0.2)[0].fwhm_um == pytest.approx(np.full(6, 0.2))
    path = envi(tmp_path / "b", S, **fields, fwhm=np.full(6, 200.0))
    words = [path, "--out", tmp_path / "c.npz", *FLAGS, "--fwhm", "0.2"]
    assert "states the widths of its bands; leave out --fwhm" in refused(capfd, *words)
    assert "need a width above 0" in refused(capfd, *words[:-1], "0")
    with pytest.raises(InputError, match="fwhm must be one width above 0"):
        import_cube(path, "W/m2/sr/um", fwhm=[0.2] * 6)
    with pytest.raises(InputError, match="fwhm must be real numbers"):
        import_cube(path, "W/m2/sr/um", fwhm=[[0.2], [0.2, 0.2]])
    # a heat cube whose bands were taken as narrow
    write_cube(HeatCube(S[::-1], W[::-1]), tmp_path / "narrow.npz")
    assert (import_cube(tmp_path / "narrow.npz", fwhm=0.3)[0].fwhm_um == 0.3).all()
    assert "taken as narrow" in import_cube(tmp_path / "narrow.npz")[1]


@pytest.mark.parametrize("axes, right", [((0, 1, 2), True), ((1, 2, 0), False), ((1, 0, 2), False)])
def test_axes_in_another_order_show(tmp_path, axes, right):
    """Narrow pictures of many bands, too: the numbers tell, not the shape."""
    w = np.linspace(8, 14, 30)
    t = 280 + 10 * np.random.default_rng(0).random((9, 6))
    s = 0.95 * planck(w[:, None, None], t) + 0.05 * planck(w[:, None, None], 250.0)
    np.save(tmp_path / "a.npy", s.transpose(axes))
    cube, note = import_cube(tmp_path / "a.npy", "W/m2/sr/um", wavelengths_um=(8, 14))
    assert cube.bands == s.transpose(axes).shape[0]
    assert ("check the order of axes and bands" not in note) == right


@pytest.mark.parametrize(
    "array, sentence",
    [
        (np.ones((6, 9)), "three axes"),
        (1j * S, "real numbers"),
        (np.array([["a"]]), "real numbers"),
        (np.array([{}]), "not a whole npy file of plain numbers"),
        (np.ones((0, 2, 2)), "it holds no numbers (0 x 2 x 2)"),
    ],
)
def test_wrong_npy_files(tmp_path, capfd, array, sentence):
    np.save(tmp_path / "a.npy", array)
    flags = [*FLAGS, "--wavelengths", "8:14"]
    assert sentence in refused(capfd, tmp_path / "a.npy", "--out", tmp_path / "b.npz", *flags)


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".mat"])
@given(seed=st.integers(0, 2**32 - 1))
@settings(ANY, max_examples=100)
def test_damaged_arrays_never_crash(tmp_path, suffix, seed):
    path = tmp_path / f"a{suffix}"
    if suffix == ".npy":
        np.save(path, S)
    elif suffix == ".npz":
        np.savez_compressed(path, cube=S, wav=W)
    else:
        mat(path, S=PER_CM1.transpose(1, 2, 0))
    rng, data = np.random.default_rng(seed), bytearray(path.read_bytes())
    for _ in range(rng.integers(1, 4)):
        data[rng.integers(len(data))] = rng.integers(0, 256)
    path.write_bytes(data[: rng.integers(1, len(data))] if rng.integers(2) else data)
    try:
        import_cube(path, "W/m2/sr/um", wavenumbers_cm1=None if suffix == ".npz" else (720, 1250))
    except InputError as e:
        assert str(e).startswith("cube: ")


# --- a part of it ------------------------------------------------------------------------


@given(data=st.data())
@ANY
def test_a_part_is_what_numpy_cuts_out(tmp_path, data):
    draw = data.draw
    s = np.random.default_rng(draw(st.integers(0, 99))).uniform(5, 9, (6, 5, 4))
    (top, bottom), (left, right) = (
        sorted(draw(st.sets(st.integers(0, n), min_size=2, max_size=2))) for n in (5, 4)
    )
    path = envi(tmp_path / "a", s, draw(st.sampled_from(["bsq", "bil", "bip"])), kind=5)
    low, high = sorted(draw(st.sets(st.sampled_from(W.tolist()), min_size=2, max_size=2)))
    cube, note = import_cube(
        path, "W/m2/sr/um", rows=slice(top, bottom), columns=slice(left, right),
        range_um=(low, high),
    )  # fmt: skip
    there = (W >= low) & (W <= high)
    check_same(cube, s[there][:, top:bottom, left:right], W[there])
    assert f"rows {top} to {bottom - 1} of 0 to 4" in note and f"{there.sum()} bands within" in note


def test_what_has_no_measurement_can_be_cut_off(tmp_path, capfd, in_parts):
    s = S.copy()
    s[:, :, 0], s[2] = -99, -99
    path = envi(tmp_path / "a", s, data_ignore_value=-99, bbl=np.array([1, 1, 0, 1, 1, 1]))
    out = tmp_path / "b.npz"
    words = ["import", path, "--out", out, *FLAGS, "--columns", "1:"]
    assert main([str(word) for word in words]) == 0
    said = capfd.readouterr().out
    cut, note = import_cube(path, "W/m2/sr/um", columns=slice(1, None, 2))
    assert cut.shape[1] == 2 and "columns 1 to 3 in steps of 2 of 0 to 3" in note
    assert "columns 1 to 3 of 0 to 3" in said and "1 band left out that the file calls bad" in said
    check_same(read_cube(out), np.delete(S, 2, 0)[:, :, 1:], np.delete(W, 2))


@pytest.mark.parametrize("suffix", [".npz", ".exr"])
def test_a_part_of_a_heat_cube_keeps_its_widths_and_its_noise(tmp_path, suffix):
    whole = HeatCube(S[::-1], W[::-1], np.linspace(0.1, 0.3, 6), 0.03)
    write_cube(whole, tmp_path / f"a{suffix}")
    cube, note = import_cube(tmp_path / f"a{suffix}", columns=slice(1, 3), range_um=(9, 14))
    there = whole.wavelength_um >= 9
    np.testing.assert_array_equal(cube.radiance, whole.radiance[there][:, :, 1:3])
    np.testing.assert_allclose(cube.fwhm_um, whole.fwhm_um[there])
    assert cube.netd_k == 0.03 and "taken as narrow" not in note
    assert import_cube(tmp_path / f"a{suffix}", netd_k=0.1)[0].netd_k == 0.1
    if suffix == ".exr":
        with pytest.raises(InputError, match="states its unit"):
            import_cube(tmp_path / "a.exr", "microflick")
    else:  # which says no unit: of what was written like it, the caller does
        arrays = dict(np.load(tmp_path / "a.npz"))
        np.savez(tmp_path / "a.npz", **arrays | {"radiance": 100 * arrays["radiance"]})
        cube, _ = import_cube(tmp_path / "a.npz", "microflick")
        np.testing.assert_allclose(cube.radiance, whole.radiance, rtol=1e-6)
        np.testing.assert_array_equal(cube.fwhm_um, whole.fwhm_um)
        assert cube.netd_k == 0.03


def test_one_band_has_one_centre(tmp_path, capfd):
    np.save(tmp_path / "a.npy", planck(11.0, T))
    words = tmp_path / "a.npy", "--out", tmp_path / "b.npz", *FLAGS, "--wavelengths"
    assert "give its centre twice" in refused(capfd, *words, "8:14")
    assert main([str(word) for word in ("import", *words, "11:11")]) == 0
    np.testing.assert_allclose(read_cube(tmp_path / "b.npz").radiance, planck(11.0, T), 1e-6)


@pytest.mark.parametrize(
    "flags, sentence",
    [
        (["--rows", "2:"], "no rows lie in 2:; it has 0:2"),
        (["--columns", "3:3"], "no columns lie in 3:3; it has 0:4"),
        (["--columns", "1-3"], "need FROM:TO such as 10:500"),
        (["--range", "13:8"], "need LOW:HIGH such as 8:13, in um, got '13:8'"),
        (["--range", "3:5"], "no good band lies within 3-5 um; they lie at 8-13.89 um"),
    ],
)
def test_parts_that_are_not_there(tmp_path, capfd, flags, sentence):
    path = envi(tmp_path / "a", S)
    assert sentence in refused(capfd, path, "--out", tmp_path / "b.npz", *FLAGS, *flags)


# --- the command -------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".npz", ".exr"])
def test_the_command_writes_what_decompose_reads(tmp_path, capfd, suffix):
    path, out = envi(tmp_path / "a", 100 * S, "bil"), tmp_path / f"b{suffix}"
    words = ["import", path, "--out", out, "--unit", "microflick", "--netd", "0.05", "--json"]
    code = main([str(word) for word in words])
    said, err = capfd.readouterr()
    assert code == 0 and err == ""
    result = json.loads(said.splitlines()[-1])
    assert result["note"] == said.splitlines()[0] and said.splitlines()[1].endswith("4 pixels.")
    assert result["bands"] == 6 and result["size"] == [2, 4] and result["netd_k"] == 0.05
    cube = read_cube(out)
    check_same(cube)
    assert cube.netd_k == 0.05


def test_an_array_of_our_own_names_is_a_heat_cube(tmp_path):
    """As the README makes one, which decompose takes as it is: whatever its sizes."""
    w = np.linspace(8.0, 14.0, 5)
    s = planck(w[:, None, None], np.linspace(285.0, 300.0, 15).reshape(3, 5))
    np.savez(tmp_path / "mine.npz", radiance=s, wavelength_um=w)
    cube, _ = import_cube(tmp_path / "mine.npz", rows=slice(1, 3))
    np.testing.assert_allclose(cube.radiance, s[:, 1:], rtol=1e-6)
    np.savez(tmp_path / "mine.npz", radiance=100 * s, wavelength_um=w, fwhm_um=0 * w + 0.1)
    cube, note = import_cube(tmp_path / "mine.npz", "microflick")
    np.testing.assert_allclose(cube.radiance, s, rtol=1e-6)
    assert "TeX-1500" not in note


@pytest.mark.parametrize("unit, width", [("Wavenumber", 7.5), ("Nanometers", 160.0)])
def test_widths_without_wavelengths_are_left_out(tmp_path, unit, width):
    """They are in the unit of the header, and the bands in that of the caller."""
    path = envi(tmp_path / "a", S, wavelength=None, wavelength_units=unit, fwhm=np.full(6, width))
    cube, note = import_cube(path, "W/m2/sr/um", wavelengths_um=(8, 14))
    assert (cube.fwhm_um == 0).all() and "band widths are not stated (--fwhm)" in note
    cube, _ = import_cube(path, "W/m2/sr/um", wavelengths_um=(8, 14), fwhm=0.1)
    assert cube.fwhm_um == pytest.approx(np.full(6, 0.1))


@pytest.mark.parametrize("key", ["data units", "radiance data units", "units"])
def test_a_unit_that_the_header_names_is_taken(tmp_path, key):
    path = envi(tmp_path / "a", 100 * S, **{key.replace(" ", "_"): "Microflick"})
    check_same(import_cube(path)[0])
    check_same(import_cube(path, "uW/cm2/sr/um")[0])
    check_same(import_cube(envi(tmp_path / "a", 100 * S, data_units="uW/cm^2/sr/um"))[0])
    path = envi(tmp_path / "a", S, **{key.replace(" ", "_"): "DN"})
    with pytest.raises(InputError, match="says 'DN'; give --unit"):
        import_cube(path)
    with pytest.raises(InputError, match="does not say which unit"):
        import_cube(envi(tmp_path / "a", S))
    for temperature in ("Kelvin", "K", "deg C", "Brightness Temperature (K)"):
        path = envi(tmp_path / "a", S, **{key.replace(" ", "_"): temperature})
        with pytest.raises(InputError, match="in K, give --unit K; else use the radiance"):
            import_cube(path)


@pytest.mark.parametrize(
    "said",
    [
        "uW/(cm^2*sr*nm)", "\u00b5W/cm2/sr/nm", "mW/(cm^2 * sr * um)", "mW cm^-2 sr^-1 um^-1",
        "uW.cm-2.sr-1.nm-1", "{uW cm-2 sr-1 nm-1}", "uW/(cm\u00b2 sr nm)", "mWatts/cm^2/sr/micron",
        "mW cm\u207b\u00b2 sr\u207b\u00b9 \u03bcm\u207b\u00b9",
    ],
)  # fmt: skip
def test_a_unit_may_be_written_with_times_and_powers(tmp_path, said):
    check_same(import_cube(envi(tmp_path / "a", S / 10, data_units=said))[0])
    check_same(import_cube(envi(tmp_path / "a", S / 10), said)[0])
    with pytest.raises(InputError, match="give --unit"):  # nothing is below that line
        import_cube(envi(tmp_path / "a", S / 10, data_units="uW*cm^2/sr/um"))


def test_a_header_without_byte_order_is_little_endian(tmp_path):
    check_same(import_cube(envi(tmp_path / "a", S, byte_order=None), "W/m2/sr/um")[0])


def test_bands_are_said_once(tmp_path, capfd):
    path, out = envi(tmp_path / "a", S), tmp_path / "b.npz"
    flag = ["--wavelengths", "8:14"]
    assert "leave out --wavelengths" in refused(capfd, path, "--out", out, *FLAGS, *flag)
    path = mat(tmp_path / "a.mat", S=np.ones((2, 2, 54)))
    assert "54 bands need --wavenumbers 720:1250" in refused(capfd, path, "--out", out)
    for wavenumbers, said in (((760, 1240), True), ((720, 1250), False)):
        words = import_cube(path, wavenumbers_cm1=wavenumbers)[1]
        assert ("not the 720:1250 cm-1 of published cubes of 54 bands" in words) is said
    flag += ["--wavenumbers", "720:1250"]
    assert "not both" in refused(capfd, path, "--out", out, *flag)
    flag = ["--wavenumbers", "8:14"]
    assert "8-14 cm-1 are outside 1-100 um" in refused(capfd, path, "--out", out, *flag)
    assert "need FIRST:LAST" in refused(capfd, path, "--out", out, "--wavenumbers", "720-1250")


def test_an_index_is_replaced_by_a_flag(tmp_path):
    path = envi(tmp_path / "a", S, wavelength=np.arange(6.0) + 1, wavelength_units="Index")
    check_same(import_cube(path, "W/m2/sr/um", wavenumbers_cm1=(720, 1250))[0])


def test_other_mistakes(tmp_path, capfd):
    path, out = envi(tmp_path / "a", S), tmp_path / "b.npz"
    assert "does not exist" in refused(capfd, tmp_path / "gone.hdr", "--out", out)
    assert "must end in .exr or .npz" in refused(capfd, path, "--out", tmp_path / "b.hdr", *FLAGS)
    (tmp_path / "a.exr").write_bytes(b"")
    assert "cube: " in refused(capfd, tmp_path / "a.exr", "--out", out)
    (tmp_path / "a.mat").write_bytes(b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\2IM" + bytes(99))
    assert "save -v7." in refused(capfd, tmp_path / "a.mat", "--out", out)
    path = mat(tmp_path / "a.mat", S=S[None])
    assert "S in" in refused(capfd, path, "--out", out, "--wavenumbers", "720:1250")
    path = envi(tmp_path / "c", -S)
    assert "zero, negative" in refused(capfd, path, "--out", out, *FLAGS)
    path = envi(tmp_path / "c", S)
    assert "need more than 0 K" in refused(capfd, path, "--out", out, *FLAGS, "--netd", "0")
    (tmp_path / "b.truth.npz").write_bytes(b"of another scene")
    assert "be taken for the truth of" in refused(capfd, path, "--out", out, *FLAGS)
    assert not out.exists()


def test_a_failed_import_leaves_the_old_cube(tmp_path, capfd):
    out = tmp_path / "b.npz"
    out.write_text("old", encoding="utf-8")
    refused(capfd, envi(tmp_path / "a", -S), "--out", out, *FLAGS)
    assert out.read_text(encoding="utf-8") == "old" and len(list(tmp_path.iterdir())) == 3


def test_to_import_a_cube_needs_neither_torch_nor_numba(tmp_path):
    code = (
        "import sys\n"
        "from texnet.cli import main\n"
        "code = main(['import', sys.argv[1], '--out', sys.argv[2], '--unit', 'W/m2/sr/um'])\n"
        "heavy = {'torch', 'numba', 'sklearn', 'matplotlib', 'trimesh'} & set(sys.modules)\n"
        "sys.exit(code or ' '.join(heavy) or 0)\n"
    )
    path = envi(tmp_path / "a", S)
    subprocess.run([sys.executable, "-c", code, path, tmp_path / "b.npz"], check=True)


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ({"wavelengths_um": [9.0]}, "wavelengths_um must be two numbers"),
        ({"wavenumbers_cm1": "700:1240"}, "wavenumbers_cm1 must be real numbers"),
        ({"range_um": 13}, "range_um must be two numbers"),
        ({"rows": (0, 10)}, r"rows must be a slice, as slice\(0, 100\)"),
        ({"columns": 3}, "columns must be a slice"),
        ({"columns": slice(0.5, 2)}, "columns must be a slice"),
        ({"rows": slice(0, 3, 0)}, "rows must be a slice"),
        ({"range_um": (9.0, np.nan)}, "range_um must be two numbers"),
    ],
)
def test_arguments_of_another_kind_are_refused(tmp_path, how, message):
    np.save(tmp_path / "s.npy", np.ones((3, 4, 5)))
    with pytest.raises(InputError, match=message):
        import_cube(tmp_path / "s.npy", "W/m2/sr/um", **how)


def test_ends_of_the_bands_may_be_an_array(tmp_path):
    w = np.linspace(9.0, 11.0, 3)
    np.save(tmp_path / "s.npy", np.broadcast_to(planck(w, 290.0)[:, None, None], (3, 4, 5)))
    cube, _ = import_cube(tmp_path / "s.npy", "W/m2/sr/um", wavelengths_um=w[[0, -1]])
    np.testing.assert_allclose(cube.wavelength_um, w)
