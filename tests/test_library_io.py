"""The same curves in every format are the same library; what a file leaves open is refused."""

import json

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from physics import InputError, MaterialLibrary
from texnet.cli import main
from texnet.files.library_io import import_library
from texnet.files.mat_file import read_mat

ANY = settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
NU = np.linspace(760.0, 1240.0, 49)  # cm-1, as HADAR's 49 bands
NAMES = ["sky", "water", "old_brick"]
DIP = np.exp(-(((NU - 1080) / 40) ** 2))
E = np.stack([0.3 + 0.2 * np.cos(NU / 60), np.linspace(0.95, 0.99, 49), 0.9 - 0.2 * DIP])
HEADER = {
    "Name": "Old Brick", "Type": "Manmade", "Description": "Red, from a wall.",
    "Measurement": "Directional (10 Degree) Hemispherical Reflectance",
    "First Column": "X", "Second Column": "Y", "X Units": "Wavelength (micrometers)",
    "Y Units": "Reflectance (percent)", "Number of X Values": "49",
    "Additional Information": "none",
}  # fmt: skip


def cells(names):
    """A MATLAB cell array of strings."""
    return np.array([*names, None], dtype=object)[:-1]


def mat(path, compress=False, **variables):
    savemat(path, variables, do_compression=compress)
    return path


def write_csv(path, unit, x, e, names=NAMES):
    rows = [",".join(map(repr, map(float, row))) for row in np.column_stack([x, e.T])]
    path.write_text("\n".join([",".join([unit, *names]), *rows]) + "\n", encoding="utf-8")
    return path


def spectrum(path, w, e, rows=(), **header):
    """An ECOSTRESS file of emissivity e, as percent reflectance; a key that is None is left out."""
    lines = HEADER | {key.replace("_", " "): value for key, value in header.items()}
    text = [f"{key}: {value}" for key, value in lines.items() if value is not None]
    pairs = zip(w.tolist(), (100 - 100 * e).tolist(), strict=True)
    lines = [*text, "", *(f"{x!r}\t{r!r}" for x, r in pairs), *rows]
    path.write_text("\n".join(lines) + "\n", encoding="iso-8859-1")
    return path


def check_same(library, names=NAMES, e=E, atol=1e-12):
    assert library.names == tuple(names)
    assert (np.diff(library.wavelength_um) > 0).all()
    np.testing.assert_allclose(library.at(1e4 / NU), e, rtol=0, atol=atol)


def refused(capfd, *words):
    """The one sentence that `library import` refuses with."""
    code = main(["library", "import", *map(str, words)])
    out, err = capfd.readouterr()
    assert code == 2 and out == ""
    assert err.startswith("texnet: error: ") and err.count("\n") == 1 and "Traceback" not in err
    return err


# --- the same curves, whatever the file --------------------------------------------------


@pytest.mark.parametrize("compress", [False, True])
@pytest.mark.parametrize("names", [cells(NAMES), cells(NAMES)[:, None], np.array(NAMES)])
@pytest.mark.parametrize("step", [1, -1])
@pytest.mark.parametrize("key", ["matLib", "emiLib"])
def test_hadar(tmp_path, key, step, names, compress):
    table = E[:, ::step].T if key == "matLib" else E[:, ::step]
    path = mat(tmp_path / "lib.mat", compress, **{key: table, "matName": names})
    ends = tuple(NU[::step][[0, -1]])
    library, note = import_library(path, wavenumbers_cm1=ends)
    check_same(library)
    assert key in note and "cm-1" in note and ("reversed" in note) == (step == 1)
    assert "no material is the sky" not in note


@pytest.mark.parametrize("step", [1, -1])
@pytest.mark.parametrize("unit", ["wavelength_um", "wavenumber_cm1"])
def test_csv(tmp_path, unit, step):
    x = (NU if unit == "wavenumber_cm1" else 1e4 / NU)[::step]
    library, note = import_library(write_csv(tmp_path / "lib.csv", unit, x, E[:, ::step]))
    check_same(library)
    assert unit in note and ("reversed" in note) == ((x[0] > x[-1]) == (unit == "wavelength_um"))


@pytest.mark.parametrize("step", [1, -1])
def test_ecostress(tmp_path, step):
    for name, e in zip(NAMES, E, strict=True):
        spectrum(tmp_path / f"{name}.txt", 1e4 / NU[::step], e[::step], Name=name)
    (tmp_path / "water.ancillary.txt").write_text("Name: not a spectrum\n")
    library, note = import_library(tmp_path)
    assert len(library) == 3
    check_same(library.subset(NAMES))
    assert "1 - hemispherical reflectance" in note and "3 files" in note
    check_same(import_library(tmp_path / "water.txt")[0], ["water"], E[1:2])


@given(
    first=st.integers(7010, 8000),
    steps=st.lists(st.integers(1, 600), min_size=1, max_size=11),
    seed=st.integers(0, 2**32 - 1),
)
@ANY
def test_any_order_of_rows_is_the_same_library(tmp_path, first, steps, seed):
    rng = np.random.default_rng(seed)
    nu = np.sort(1e7 / np.cumsum([first, *steps]))
    e = rng.uniform(0, 1, (3, nu.size))
    mix = rng.permutation(nu.size)
    path = write_csv(tmp_path / "lib.csv", "wavenumber_cm1", nu[mix], e[:, mix])
    library, _ = import_library(path)
    np.testing.assert_allclose(library.wavelength_um, 1e4 / nu[::-1], rtol=1e-15)
    np.testing.assert_array_equal(library.emissivity, e[:, ::-1])


def test_ten_wavenumbers_by_hand(tmp_path):
    """1000 cm-1 is 10 um and 1010 cm-1 is 9.90099 um; the file ascends in cm-1."""
    path = mat(tmp_path / "lib.mat", emiLib=[[0.1, 0.2, 0.3]], matName=cells(["paint"]))
    library, note = import_library(path, (1000, 1020))
    np.testing.assert_allclose(library.wavelength_um, [9.80392157, 9.90099010, 10.0], rtol=1e-8)
    np.testing.assert_array_equal(library.emissivity, [[0.3, 0.2, 0.1]])
    assert "3 bands equidistant from 1000 to 1020 cm-1 became 9.804-10 um" in note
    assert "no material is the sky" in note and note.count(". ") == 0


def test_the_starter_librarys_sky_is_added_when_asked_for(tmp_path):
    nu = np.linspace(720, 1250, 30)
    solid = NAMES[1:]
    path = write_csv(tmp_path / "lib.csv", "wavenumber_cm1", nu, np.full((2, 30), 0.9), solid)
    library, note = import_library(path, add_sky=True)
    starter, w = MaterialLibrary.starter(), np.linspace(8, 13.8, 50)
    assert library.names == (*solid, "sky") and "the starter library's sky" in note
    np.testing.assert_allclose(library.at(w)[-1], starter.at(w)[starter.sky_index], atol=1e-12)
    np.testing.assert_allclose(library.at(w)[:-1], 0.9)
    assert "13.89 um in common" in note
    many = [f"rock{i}" for i in range(20)]
    write_csv(path, "wavenumber_cm1", nu, np.full((20, 30), 0.9), many)
    hue = np.sort(import_library(path, add_sky=True)[0].hue_deg)
    assert np.diff([*hue, hue[0] + 360]).min() > 8  # evenly they would be 17 apart
    with pytest.raises(InputError, match="leave out --add-sky"):
        import_library(path, sky="rock0", add_sky=True)
    write_csv(path, "wavenumber_cm1", nu, np.full((2, 30), 0.9), ["Sky", "rock"])
    with pytest.raises(InputError, match="Then give --sky Sky"):
        import_library(path, add_sky=True)


def test_a_library_of_our_own_kind_gets_a_sky_and_stays_as_it_is(tmp_path):
    w, e = np.linspace(8, 13, 11), np.linspace(0.5, 0.9, 22).reshape(2, 11)
    own = MaterialLibrary(["a", "b"], w, e, [10, 20], [[1, 0, 0], [0, 1, 0]], ["x", "y"], [0, 0.1])
    own.save(tmp_path / "own.json")
    library, note = import_library(tmp_path / "own.json", add_sky=True)
    assert library.names == ("a", "b", "sky") and "8-13 um in common" in note
    np.testing.assert_allclose(library.at(w)[:2], e, atol=1e-12)
    for name in ("hue_deg", "albedo_rgb", "descriptions", "level_sigma"):
        assert np.array_equal(getattr(library, name)[:2], getattr(own, name)), name
    named, _ = import_library(tmp_path / "own.json", sky="b")
    assert named.names == ("a", "sky") and named.hue_deg[1] == 20


def test_black_is_a_measurement_and_less_is_none(tmp_path):
    w, e = np.linspace(7.5, 14.5, 71), np.full(71, 0.9)
    e[20:27], e[40:43] = 1.0, 1.5  # reflectance 0, and -50 %
    library, _ = import_library(spectrum(tmp_path / "a.txt", w, e))
    np.testing.assert_allclose(library.at(w[20:27]), 1, atol=1e-9)
    np.testing.assert_allclose(library.at(w[28:]), 0.9, atol=1e-9)


def test_percent_fraction_and_other_spellings(tmp_path):
    w, e = np.array([8.0, 9.0, 10.0]), np.array([0.9, 0.95, 0.85])
    percent = spectrum(tmp_path / "p.txt", w, e)
    fraction = spectrum(tmp_path / "f.txt", w, 1 - (1 - e) / 100, Y_Units="Reflectance (fraction)")
    spelt = spectrum(
        tmp_path / "s.txt", w, e, Y_Units="Reflectance (Percentage)", X_Units="Wavelength (µm)",
        Measurement="hemispherical reflectance",
    )  # fmt: skip
    for path in (percent, fraction, spelt):
        np.testing.assert_allclose(import_library(path)[0].emissivity[0], e, atol=1e-12)


def test_bad_rows_are_skipped_and_counted(tmp_path):
    w, e = np.array([10.0, 9.0, 8.0]), np.array([0.9, 0.95, 0.85])
    rows = ["0 0", "9.5", "-9.5 3", "9.5 -1.23e34", "9.5 n/a", "", "9.5 nan"]
    library, note = import_library(spectrum(tmp_path / "s.txt", w, e, rows))
    np.testing.assert_allclose(library.wavelength_um, w[::-1])
    np.testing.assert_allclose(library.emissivity[0], e[::-1])
    assert "6 rows skipped" in note


def test_header_lines_are_not_counted(tmp_path):
    w, e = np.array([8.0, 9.0, 10.0]), np.array([0.9, 0.95, 0.85])
    described = "Bought at\nthe shop; 2 bricks:\n\n12 14\nred ones, Sorte Ä."
    path = spectrum(tmp_path / "s.txt", w, e, Description=described, Number_of_X_Values="2151")
    library, note = import_library(path)
    np.testing.assert_allclose(library.emissivity[0], e)
    assert library.names == ("old_brick",) and "skipped" not in note


def test_spectra_meet_on_the_finest_grid_of_their_common_range(tmp_path):
    def line(w):
        return 0.9 - 0.01 * w  # linear, so that interpolation is exact

    fine = np.linspace(7.9, 16.0, 500)
    for name, w in [("a", np.linspace(0.4, 14.2, 200)), ("b", fine), ("c", np.linspace(3, 25, 99))]:
        spectrum(tmp_path / f"{name}.txt", w, line(w))
    library, note = import_library(tmp_path)
    w = library.wavelength_um
    assert w[0] == 7.9 and w[-1] == 14.2
    np.testing.assert_array_equal(w[1:-1], fine[(fine > 7.9) & (fine < 14.2)])
    np.testing.assert_allclose(library.emissivity, np.tile(line(w), (3, 1)), atol=1e-12)
    assert library.names == ("old_brick", "old_brick_2", "old_brick_3")
    assert "7.9-14.2 um" in note


def test_noise_outside_0_and_1_is_clipped_and_said(tmp_path):
    e = np.array([[0.5, 1.015, -0.004], [0.2, 0.3, 0.4]])
    path = write_csv(tmp_path / "lib.csv", "wavelength_um", [8, 9, 10], e, ["a", "b"])
    library, note = import_library(path)
    np.testing.assert_array_equal(library.emissivity, [[0.5, 1, 0], [0.2, 0.3, 0.4]])
    assert "2 values up to 0.015 outside 0..1 clipped" in note


def test_the_sky_is_named(tmp_path):
    path = write_csv(tmp_path / "lib.csv", "wavelength_um", [8, 9], E[:2, :2], ["Air", "b"])
    library, note = import_library(path, sky="Air")
    assert library.names == ("sky", "b") and library.sky_index == 0 and "'Air' is the sky" in note
    assert import_library(path)[0].sky_index is None


# --- the command -------------------------------------------------------------------------


def test_the_command_writes_what_load_reads(tmp_path, capfd):
    path = mat(tmp_path / "lib.mat", matLib=E.T)
    (tmp_path / "names.txt").write_text("Himmel\n water \n\nold_brick\n", encoding="utf-8")
    out = tmp_path / "lib.json"
    code = main([
        "library", "import", str(path), "--out", str(out), "--wavenumbers", "760:1240",
        "--names", str(tmp_path / "names.txt"), "--sky", "Himmel", "--json",
    ])  # fmt: skip
    said, err = capfd.readouterr()
    assert code == 0 and err == ""
    result = json.loads(said.splitlines()[-1])
    assert result["materials"] == NAMES and len(result["wavelength_um"]) == 49
    assert result["note"] in said.splitlines()[0]
    check_same(MaterialLibrary.load(out))
    assert "lib.mat" in MaterialLibrary.load(out).descriptions[0]


def test_save_and_load_are_inverse(tmp_path):
    library = MaterialLibrary.starter()
    library.save(tmp_path / "again.json")
    again = MaterialLibrary.load(tmp_path / "again.json")
    for key, value in vars(library).items():
        np.testing.assert_array_equal(getattr(again, key), value)


def test_emissivity_may_leave_0_and_1_by_0_02(tmp_path):
    (tmp_path / "a.csv").write_text("wavelength_um,water\n8,1.02\n9,-0.02\n")
    library, note = import_library(tmp_path / "a.csv")
    np.testing.assert_array_equal(library.emissivity, [[1, 0]])
    assert "2 values up to 0.02 outside 0..1 clipped" in note


@pytest.mark.parametrize(
    "name, text, sentence",
    [
        ("a.csv", "wavelength,water\n8,0.9\n", "headed wavelength_um or wavelength_nm or"),
        ("a.csv", "wavelength_um;water\n8;0,9\n", "with a decimal point"),
        ("a.csv", "", "headed wavelength_um"),
        ("a.csv", "wavelength_um,water\n", "a row per wavelength"),
        ("a.csv", "wavelength_um\n8\n", "a column per material"),
        ("a.csv", "wavelength_um,water\n8,0.9\n9\n", "line 3"),
        ("a.csv", "wavelength_um,water\n8,wet\n", "line 2"),
        ("a.csv", "wavelength_um,water\n8,inf\n", "line 2"),
        ("a.csv", "wavelength_um,water\n8,0.9\n8,0.8\n", "8 um is there twice"),
        (
            "a.csv",
            "wavelength_um,water\n8,97\n9,98\n",
            "off by 0.02 at most; divide the file's numbers by 100",
        ),
        ("a.csv", "wavelength_um,water\n8,1.03\n9,1\n", "off by 0.02 at most"),
        ("a.csv", "wavelength_um,water\n8000,0.9\n", "looks like nm"),
        ("a.csv", "wavelength_um,water\n8,0.9\n", "no two bands in 7-15 um"),
        ("a.csv", "wavelength_um,water\n0.5,0.9\n1.2,0.9\n", "no two bands in 7-15 um"),
        ("a.csv", "wavelength_nm,water\n7.5,0.9\n8.5,0.9\n", "unit of wavelengths"),
        ("a.csv", "wavenumber_cm1,water\n8,0.9\n", "10 um is 1000 cm-1"),
        ("a.csv", "wavelength_um,water,water\n8,0.9,0.9\n9,0.9,0.9\n", "two materials 'water'"),
        ("a.csv", "wavelength_um,wa\x07ter\n8,0.9\n9,0.9\n", "'wa\\x07ter' has invalid characters"),
        ("a.csv", "wavelength_um,\xe4\n8,0.9\n", "UTF-8"),
        ("a.txt", "8 0.9\n9 0.8\n", "no 'key: value' lines"),
        ("a.txt", "Name: a\n\n8 0.9\n9 0.8\n", "no line 'X Units:'"),
        ("a.mat", "", "no .mat file of version 5 to 7"),
        ("a.xlsx", "", "use .mat, .csv, ENVI .hdr or .sli, .txt"),
    ],
)
def test_wrong_texts(tmp_path, capfd, name, text, sentence):
    (tmp_path / name).write_text(text, encoding="iso-8859-1")
    assert sentence in refused(capfd, tmp_path / name, "--out", tmp_path / "lib.json")
    assert [p.name for p in tmp_path.iterdir()] == [name]


def envi(path, values, w, title="Emissivity", **changes):
    """An ENVI spectral library of values (spectra, bands); a field that is None is left out."""
    fields = {
        "samples": len(w), "lines": len(values), "bands": 1, "header offset": 0, "data type": 4,
        "interleave": "bsq", "byte order": 0, "file type": "ENVI Spectral Library",
        "wavelength units": "Micrometers", "wavelength": f"{{{', '.join(map(repr, w.tolist()))}}}",
        "spectra names": "{Sky, Water,\n Old Brick}", "y axis title": title,
    } | {key.replace("_", " "): value for key, value in changes.items()}  # fmt: skip
    lines = [f"{key} = {value}" for key, value in fields.items() if value is not None]
    path.with_suffix(".hdr").write_text("\n".join(["ENVI", *lines]) + "\n")
    path.with_suffix(".sli").write_bytes(values.astype("<f4").tobytes())
    return path


def test_envi_spectral_libraries(tmp_path):
    w = 1e4 / NU
    for values, title, factor in ((E, "Emissivity", None), (1e4 * (1 - E), "Reflectance", 1e4)):
        path = envi(tmp_path / "a.sli", values, w, title, reflectance_scale_factor=factor)
        for name in (path, path.with_suffix(".hdr")):
            library, note = import_library(name)
            check_same(library, atol=1e-6)
            assert title.lower() in note
    for factor in (None, 1, 100):  # which makes a share of it
        percent = 100 * (1 - E), w, "Reflectance (percent)"
        path = envi(tmp_path / "a.sli", *percent, reflectance_scale_factor=factor)
        check_same(import_library(path)[0], atol=1e-6)
    said = dict(
        z_plot_titles="{Wavelength [um], Emissivity}", spectra_names="{Sky, Water, Old Brick,}"
    )
    check_same(import_library(envi(tmp_path / "a.sli", E, w, None, **said))[0], atol=1e-6)
    ignored = E.copy()
    ignored[0, 3] = -1.1  # which float32 rounds
    library, note = import_library(envi(tmp_path / "a.sli", ignored, w, data_ignore_value=-1.1))
    check_same(library, NAMES[1:], E[1:], atol=1e-6)
    beyond = np.append(w, [16.0, 0.5])
    deleted = np.pad(E, ((0, 0), (0, 2)))
    deleted[1, 3] = -1.23e34  # as USGS marks what was not measured
    deleted[2, -1] = -1.23e34  # where nobody looks
    library, note = import_library(envi(tmp_path / "a.sli", deleted, beyond))
    check_same(library, ["sky", "old_brick"], E[[0, 2]], atol=1e-6)
    assert "left out because of deleted bands: Water" in note
    some, bad = np.arange(len(w)) % 4 != 2, E.copy()
    bad[:, ~some] = 0.0
    bbl = f"{{{', '.join(map(str, some.astype(int)))}}}"
    library, note = import_library(envi(tmp_path / "a.sli", bad, w, bbl=bbl))
    np.testing.assert_allclose(library.at(np.sort(w[some])), E[:, some][:, np.argsort(w[some])],
                               atol=1e-6)  # fmt: skip
    assert f"{(~some).sum()} bands left out that bbl calls bad" in note
    none = f"{{{', '.join('0' * len(w))}}}"  # which says nothing
    check_same(import_library(envi(tmp_path / "a.sli", E, w, bbl=none))[0], atol=1e-6)
    far = np.append(w, 216.0)  # as spectrometers reach
    check_same(import_library(envi(tmp_path / "a.sli", np.pad(E, ((0, 0), (0, 1))), far))[0],
               atol=1e-6)  # fmt: skip


@pytest.mark.parametrize(
    "changes, sentence",
    [
        (dict(y_axis_title=None), "does not say whether it holds emissivity or reflectance"),
        (dict(y_axis_title="Bidirectional Reflectance"), "only from hemispherical reflectance"),
        (dict(y_axis_title="Value"), "write y axis title = Emissivity, or Reflectance"),
        (dict(spectra_names="{a, b}"), "2 spectra names for 3 spectra"),
        (dict(spectra_names=None), "spectra names is missing"),
        (dict(wavelength=None), "it must have wavelength"),
        (dict(wavelength_units="Index"), "wavelength units: Micrometers"),
        (dict(wavelength_units="Nanometers"), "no two bands in 7-15 um"),
        (dict(file_type="ENVI Standard"), "must be ENVI Spectral Library"),
        (dict(lines=4), "is cut off"),
        (dict(reflectance_scale_factor=0.01), "by 100 if they are in percent"),
        (dict(bands=3, lines=1, spectra_names="{a}"), "bands must be 1"),
    ],
)
def test_wrong_envi_libraries(tmp_path, capfd, changes, sentence):
    path = envi(tmp_path / "a.sli", E, 1e4 / NU, **changes)
    said = refused(capfd, path, "--out", tmp_path / "lib.json")
    assert sentence in said and "library: " in said
    path.with_suffix(".hdr").unlink()
    assert "no header, a.hdr" in refused(capfd, path, "--out", tmp_path / "lib.json")


def test_a_folder_s_spectra_of_another_range_are_left_out_and_named(tmp_path, capsys):
    folder = tmp_path / "spectra"
    folder.mkdir()
    spectrum(folder / "a.txt", np.linspace(7.5, 14.5, 15), np.linspace(0.8, 0.9, 15))
    visible = np.array([0.4, 2.5]), np.array([0.9, 0.9])
    spectrum(folder / "visible.txt", *visible, Measurement="Bidirectional reflectance")
    (folder / "README.txt").write_text("Files: from a database\nof 2024\n")
    thermal = np.linspace(7.5, 14.5, 15), np.linspace(0.8, 0.9, 15)
    spectrum(folder / "through.txt", *thermal, Y_Units="Transmittance (percent)")
    words = ["library", "import", str(folder), "--out", str(tmp_path / "lib.json")]
    assert main(words) == 0
    said = capsys.readouterr().out
    assert "no spectrum of 7-15 um in README.txt, visible.txt: left out" in said
    assert "no hemispherical reflectance in through.txt: left out" in said
    assert len(MaterialLibrary.load(tmp_path / "lib.json")) == 1
    (folder / "a.txt").unlink()
    assert main(words) == 2


@pytest.mark.parametrize("both", ["directional hemispherical", "hemispherical"])
def test_what_is_bidirectional_at_shorter_wavelengths_is_known(tmp_path, both):
    """As of the plants in ECOSTRESS, below 2.5 um."""
    w, e = np.linspace(7.5, 14.5, 15), np.linspace(0.8, 0.9, 15)
    measured = f"Bidirectional and {both} reflectance"
    path = spectrum(tmp_path / "a.txt", w, e, Measurement=measured, X_Units="Wavelength (µm)")
    np.testing.assert_allclose(import_library(path)[0].emissivity[0], e)
    path.write_bytes(path.read_text(encoding="iso-8859-1").encode("utf-8-sig"))
    np.testing.assert_allclose(import_library(path)[0].emissivity[0], e)


@pytest.mark.parametrize(
    "change, sentence",
    [
        (dict(Measurement="Bidirectional reflectance"), "only from hemispherical reflectance"),
        (dict(Measurement="Bidirectional, no hemispherical reflectance"), "only from hemisph"),
        (dict(Measurement="Hemispherical Transmittance"), "only from hemispherical reflectance"),
        (dict(Y_Units="Transmittance (percent)"), "only from hemispherical reflectance"),
        (dict(Measurement="Reflectance"), "only from hemispherical reflectance"),
        (dict(Measurement=None), "no line 'Measurement:'"),
        (dict(X_Units="Wavenumber (cm-1)"), "only micrometers"),
        (dict(X_Units="Wavelength (nanometers)"), "only micrometers"),
        (dict(Y_Units="Reflectance"), "write 'Reflectance (percent)'"),
        (dict(w=np.array([0.4, 2.5])), "covers 0.4-2.5 um"),
        (dict(w=np.array([8.0, 11.0])), "no good row from 8 to 11 um"),
        (dict(w=np.zeros(2)), "holds no spectrum"),
    ],
)
def test_wrong_spectra(tmp_path, capfd, change, sentence):
    good = dict(w=np.array([8.0, 8.5]), e=np.array([0.9, 0.8]))
    path = spectrum(tmp_path / "a.txt", **good | change)
    assert sentence in refused(capfd, path, "--out", tmp_path / "lib.json")


def test_wrong_folders(tmp_path, capfd):
    out = tmp_path / "lib.json"
    assert "holds no spectrum .txt file" in refused(capfd, tmp_path, "--out", out)
    w, e = np.array([8.0, 8.5]), np.array([0.9, 0.8])
    spectrum(tmp_path / "a.txt", w, e)
    spectrum(tmp_path / "b.txt", w + 3, e)
    assert "b.txt starts at 11 um, beyond the end of a.txt" in refused(
        capfd, tmp_path, "--out", out
    )
    (tmp_path / "folder.txt").mkdir()
    (tmp_path / "gone.txt").symlink_to(tmp_path / "nowhere")
    for name in ("c.txt", "d.txt"):
        spectrum(tmp_path / name, w, e, Y_Units="Reflectance")
    sentence = refused(capfd, tmp_path, "--out", out)
    assert "c.txt has Y Units" in sentence and "also refused: d.txt" in sentence


@pytest.mark.parametrize(
    "variables, flags, sentence",
    [
        (dict(matLib=E.T, matName=cells(NAMES)), [], "bands need 760:1240"),
        (dict(matLib=E.T), ["--wavenumbers", "760:1240"], "--names FILE with one name a line"),
        (dict(matLib=E, matName=cells(NAMES)), ["--wavenumbers", "760:1240"], "3 names for 49"),
        (dict(emiLib=E, matName=cells(NAMES)), ["--wavenumbers", "8:14"], "10 um is 1000 cm-1"),
        (dict(emiLib=E, matName=cells(NAMES)), ["--wavenumbers", "760:760"], "two different ends"),
        (dict(emiLib=E, matName=cells(NAMES)), ["--wavenumbers", "760-1240"], "FIRST:LAST"),
        (dict(emiLib=E, matName=[[1.0]]), ["--wavenumbers", "760:1240"], "no readable matName"),
        (dict(emiLib=100 * E, matName=cells(NAMES)), ["--wavenumbers", "760:1240"], "within 0..1"),
        (dict(emiLib=E, matLib=E.T), ["--wavenumbers", "760:1240"], "must hold one of matLib"),
        (dict(S=E, other=[1.0]), ["--wavenumbers", "760:1240"], "it holds S, other"),
        (dict(emiLib=1j * E), ["--wavenumbers", "760:1240"], "full table of real numbers"),
        (
            dict(emiLib=E, matName=cells(NAMES)),
            ["--wavenumbers", "760:1240", "--sky", "water"],
            "leave out --sky",
        ),
        (
            dict(emiLib=E, matName=cells(NAMES)),
            ["--wavenumbers", "760:1240", "--sky", "air"],
            "there is no material 'air' among sky, water, old_brick",
        ),
    ],
)
def test_wrong_mat_files(tmp_path, capfd, variables, flags, sentence):
    path = mat(tmp_path / "lib.mat", **variables)
    assert sentence in refused(capfd, path, "--out", tmp_path / "lib.json", *flags)
    assert [p.name for p in tmp_path.iterdir()] == ["lib.mat"]


def test_a_mat_file_of_another_range(tmp_path, capfd):
    path = mat(tmp_path / "a.mat", matLib=E.T, matName=cells(NAMES))
    flags = ["--wavenumbers", "2000:3000", "--out", tmp_path / "lib.json"]
    assert "covers 3.333-5 um, with no two bands" in refused(capfd, path, *flags)


def test_a_name_of_half_a_character_is_refused(tmp_path, capfd):
    path = tmp_path / "half.json"
    for name, description, sentence in (
        ("a\ud800b", "", "has invalid characters"), ("ab", "\ud800", "descriptions must hold")
    ):  # fmt: skip
        row = {"name": name, "description": description, "emissivity": [0.9, 0.9]}
        path.write_text(json.dumps({"wavelength_um": [7.5, 14.5], "materials": [row]}))
        assert sentence in refused(capfd, path, "--add-sky", "--out", tmp_path / "o.json")


def test_the_bands_of_the_other_published_file(tmp_path):
    path = mat(tmp_path / "lib.mat", emiLib=np.full((2, 54), 0.9), matName=cells("ab"))
    with pytest.raises(InputError, match="54 bands need 720:1250"):
        import_library(path)


def test_a_v73_file_is_refused(tmp_path, capfd):
    path = tmp_path / "lib.mat"
    head = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
    path.write_bytes(head.ljust(512, b"\0") + b"\x89HDF\r\n\x1a\n" + bytes(99))
    assert "save -v7." in refused(capfd, path, "--out", tmp_path / "lib.json")


def test_other_mistakes(tmp_path, capfd):
    path = write_csv(tmp_path / "lib.csv", "wavelength_um", 1e4 / NU, E)
    out = tmp_path / "lib.json"
    assert "no file" in refused(capfd, tmp_path / "gone.csv", "--out", out)
    assert "no folder" in refused(capfd, path, "--out", tmp_path / "gone" / "lib.json")
    flags = ["--wavenumbers", "760:1240"]
    assert "leave out --wavenumbers" in refused(capfd, path, "--out", out, *flags)
    assert "cannot read" in refused(capfd, path, "--out", out, "--names", tmp_path / "gone.txt")


def test_an_empty_name_is_not_the_current_folder(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["library", "import", "", "--out", "a.json"]) == 2
    assert "its name is empty" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_failed_import_leaves_the_old_library(tmp_path, capfd):
    out = tmp_path / "lib.json"
    out.write_text("old", encoding="utf-8")
    (tmp_path / "a.csv").write_text("wavelength_um,water\n8,9\n", encoding="utf-8")
    refused(capfd, tmp_path / "a.csv", "--out", out)
    assert out.read_text(encoding="utf-8") == "old" and len(list(tmp_path.iterdir())) == 2


# --- .mat files --------------------------------------------------------------------------


@pytest.mark.parametrize("compress", [False, True])
@pytest.mark.parametrize("dtype", ["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"])
def test_numbers_of_every_class(tmp_path, dtype, compress):
    array = np.arange(24).reshape(2, 3, 4).astype(dtype)
    path = mat(tmp_path / "a.mat", compress, array=array, other={"a": 1}, row=array[0, 0])
    held = read_mat(path)
    assert list(held) == ["array", "other", "row"] and held["other"] is None
    assert held["array"].dtype == array.dtype and held["row"].shape == (1, 4)
    np.testing.assert_array_equal(held["array"], array)


@given(names=st.lists(st.text(st.characters(codec="utf-8", exclude_characters="\0")), max_size=4))
@ANY
def test_strings_of_a_cell_array(tmp_path, names):
    names = [n for n in names if max(map(ord, n), default=0) < 2**16]
    held = read_mat(mat(tmp_path / "a.mat", x=cells(names)))["x"]
    assert held == [n.rstrip() for n in names]


def test_a_name_with_a_line_break_is_damage(tmp_path):
    path = mat(tmp_path / "lib.mat", matLib=E[:, :4].T, matName=cells(NAMES))
    path.write_bytes(path.read_bytes().replace(b"matLib", b"m\ntLib"))
    with pytest.raises(InputError, match="is not a whole .mat file"):
        import_library(path, (760, 790))


@given(seed=st.integers(0, 2**32 - 1), compress=st.booleans())
@settings(ANY, max_examples=300)
def test_damaged_files_never_crash(tmp_path, seed, compress):
    """Flipped bytes of any tag, and cuts anywhere; scipy's reader crashes on some of these."""
    path = mat(tmp_path / "lib.mat", compress, matLib=E[:, :4].T, matName=cells(NAMES))
    rng, data = np.random.default_rng(seed), bytearray(path.read_bytes())
    for _ in range(rng.integers(1, 4)):
        data[rng.integers(100, len(data))] = rng.integers(0, 256)
    path.write_bytes(data[: rng.integers(1, len(data))] if rng.integers(2) else data)
    try:
        library, _ = import_library(path, (760, 790))
    except InputError as e:
        assert str(e).startswith("library: ") and "\n" not in str(e)
    else:
        assert library.emissivity.shape[0] == len(library.names)


def test_no_curve_is_drawn_over_a_gap(tmp_path):
    file = tmp_path / "a.csv"
    file.write_text("wavelength_um,stone\n8,0.9\n10,0.8\n10.5,0.8\n")
    with pytest.raises(InputError, match="no good row from 8 to 10 um"):
        import_library(file)
    for w in (np.arange(6.8, 15), 1e4 / np.arange(400, 4001, 20)):
        path = write_csv(tmp_path / "b.csv", "wavelength_um", w, np.full((3, w.size), 0.9))
        assert import_library(path)[0].wavelength_um.size == ((w >= 7) & (w <= 15)).sum()


def test_noise_beyond_the_thermal_infrared_is_no_matter(tmp_path):
    """As of spectrometers that measure 2.5 to 25 um."""
    w = np.linspace(2.5, 25, 226)
    e = np.where((w < 6) | (w > 16), 1.3, 0.9)
    path = write_csv(tmp_path / "a.csv", "wavelength_um", w, e[None], ["stone"])
    library, note = import_library(path)
    assert (library.emissivity == 0.9).all() and "those of 7-15 um kept" in note
    e[50] = -0.2
    with pytest.raises(InputError, match="worst at 7.5 um"):
        import_library(write_csv(path, "wavelength_um", w, e[None], ["stone"]))


@pytest.mark.parametrize("change, warning", [(lambda e: 1 - e, "reflectances"), (None, "")])
def test_reflectance_taken_for_emissivity_is_said(tmp_path, change, warning):
    e = np.array([0.8, 0.9, 0.97, 0.04])[:, None] + np.zeros((4, 7))  # one of them metal
    w = np.linspace(8, 14, 7)
    e = change(e) if change else e
    path = write_csv(tmp_path / "a.csv", "wavelength_um", w, e, list("abcd"))
    note = import_library(path)[1]
    assert ("Warning" in note) == bool(warning) and warning in note


@pytest.mark.parametrize("apart, said", [(5e-4, True), (5e-3, False)])
def test_two_of_one_curve_are_named(tmp_path, apart, said):
    w = np.linspace(8, 14, 7)
    e = np.array([0.8, 0.9, 0.97, 0.9 + apart])[:, None] + 0.01 * np.sin(w)
    note = import_library(write_csv(tmp_path / "a.csv", "wavelength_um", w, e, list("abcd")))[1]
    assert ("the curves of 'b' and 'd' are the same" in note) == said


def test_a_library_of_one_s_own_can_be_looked_at(tmp_path, capsys):
    path = tmp_path / "l.json"
    MaterialLibrary(["quartzite", "mud"], [8, 14], [[0.7, 0.9], [0.95, 0.96]]).save(path)
    for words in (["list"], ["show", "mud"]):
        assert main(["library", *words, "--library", str(path)]) == 0
    out = capsys.readouterr().out
    assert "quartzite" in out and "14.000  0.9600" in out and "granite" not in out
