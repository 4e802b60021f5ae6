"""TeX vision means what it shows: hue material, saturation temperature, value texture."""

import colorsys
import errno
import json
from types import SimpleNamespace

import made_up
import matplotlib.image
import numpy as np
import OpenEXR
import pytest

import texnet.figures
import texnet.outputs
from physics.errors import InputError
from texnet.baselines import baseline_correlations, baseline_pictures
from texnet.metrics import names_in_view, names_lacking
from texnet.outputs import write_decomposition
from texnet.stretch import stretch
from texnet.vision import tex_vision


def picture_hsv(d):
    rgb = tex_vision(d) / 255
    return np.apply_along_axis(lambda p: colorsys.rgb_to_hsv(*p), 2, rgb)


@pytest.fixture
def answer():
    return made_up.perfect(made_up.truth())


@pytest.mark.parametrize("show", [tex_vision, lambda what: write_decomposition(what, "none")])
def test_what_is_no_answer_has_no_picture(show):
    with pytest.raises(InputError, match="must be what texnet.decompose returns, got NoneType"):
        show(None)


def test_the_picture_is_rgb_bytes(answer):
    picture = tex_vision(answer)
    assert picture.shape == (*answer.material.shape, 3) and picture.dtype == np.uint8
    np.testing.assert_array_equal(picture, tex_vision(answer))


def test_hue_follows_the_material_alone(answer):
    rng = np.random.default_rng(0)
    answer.temperature_k = rng.uniform(200, 400, answer.material.shape)
    answer.sky_texture = rng.uniform(0, 10, answer.material.shape)
    hue = 360 * picture_hsv(answer)[..., 0]
    off = np.abs((hue - answer.hue_deg[answer.material] + 180) % 360 - 180)
    assert off.max() < 6, "more than rounding to bytes can explain"


def test_hue_is_an_angle(answer):
    before = tex_vision(answer)
    answer.hue_deg = answer.hue_deg + [360, -360, 720, 0]
    np.testing.assert_array_equal(tex_vision(answer), before)


def ground_only(answer):
    answer.material = np.zeros_like(answer.material)
    return answer


def ramp(answer, low, high):
    return np.linspace(low, high, answer.material.size).reshape(answer.material.shape)


def test_value_follows_the_texture_alone(answer):
    d = ground_only(answer)
    d.sky_texture = ramp(d, 0.5, 3.0)
    value = picture_hsv(d)[..., 2].ravel()
    assert (np.diff(value) >= 0).all() and value[0] < 0.2 and value[-1] > 0.98
    d.temperature_k = d.temperature_k[::-1]
    np.testing.assert_allclose(picture_hsv(d)[..., 2].ravel(), value, atol=1 / 255)


def test_saturation_follows_the_temperature_alone(answer):
    d = ground_only(answer)
    d.temperature_k = ramp(d, 280, 300)
    d.sky_texture = np.random.default_rng(0).uniform(0, 1, d.material.shape)
    saturation = picture_hsv(d)[..., 1].ravel()
    # Dark pixels have few levels per channel: two of 255 on a value of 0.15 or more.
    assert (saturation >= np.maximum.accumulate(saturation) - 2 / (255 * 0.15)).all()
    assert saturation[0] < 0.3 and saturation[-1] > 0.7


def test_the_sky_is_paler_and_brighter_than_the_ground(answer):
    hsv = picture_hsv(answer)
    sky = np.asarray(answer.material_names)[answer.material] == "sky"
    assert hsv[sky, 1].max() < 0.35 and hsv[sky, 2].min() > 0.8
    assert hsv[~sky, 1].mean() > hsv[sky, 1].mean() and hsv[~sky, 2].mean() < hsv[sky, 2].mean()


def test_what_the_sky_s_pixels_hold_does_not_change_the_ground(answer):
    before = tex_vision(answer)
    sky = np.asarray(answer.material_names)[answer.material] == "sky"
    answer.temperature_k = np.where(sky, 200.0, answer.temperature_k)
    answer.sky_texture = np.where(sky, 99.0, answer.sky_texture)
    np.testing.assert_array_equal(tex_vision(answer)[~sky], before[~sky])


def test_what_dead_pixels_hold_does_not_change_the_rest(answer):
    answer.dead = np.random.default_rng(0).random(answer.material.shape) < 0.1
    before = tex_vision(answer)
    answer.temperature_k = np.where(answer.dead, 400.0, answer.temperature_k)
    answer.sky_texture = np.where(answer.dead, 99.0, answer.sky_texture)
    np.testing.assert_array_equal(tex_vision(answer)[~answer.dead], before[~answer.dead])


def test_the_sky_is_even_whatever_may_stand_before_it(answer):
    rng = np.random.default_rng(0)
    sky = np.asarray(answer.material_names)[answer.material] == "sky"
    answer.sky_texture = rng.uniform(0, 10, sky.shape) * rng.integers(0, 2, sky.shape)
    answer.temperature_k = rng.uniform(200, 400, sky.shape)
    assert len(np.unique(tex_vision(answer)[sky], axis=0)) == 1


def test_one_hot_pixel_does_not_wash_out_the_rest(answer):
    d = ground_only(answer)
    d.sky_texture = ramp(d, 0.5, 3.0)
    before = tex_vision(d)
    d.sky_texture[0, 0] = 1e6
    changed = np.abs(tex_vision(d).astype(int) - before)[1:]
    assert changed.max() < 12


def test_value_is_where_the_texture_lies_between_its_percentiles_lifted_by_gamma(answer):
    d = ground_only(answer)
    d.sky_texture = ramp(d, 0.5, 3.0)
    low, high = np.percentile(d.sky_texture, [1, 99])
    place = np.clip((d.sky_texture - low) / (high - low), 0, 1)
    np.testing.assert_allclose(picture_hsv(d)[..., 2], 0.15 + 0.85 * place**0.8, atol=1 / 255)


def test_what_a_dead_pixel_holds_changes_no_other(answer):
    d = ground_only(answer)
    d.sky_texture, d.temperature_k = ramp(d, 0.5, 3.0), ramp(d, 280, 300)
    d.dead[::3, ::3] = True
    before = tex_vision(d)
    d.sky_texture = np.where(d.dead, 99.0, d.sky_texture)
    d.temperature_k = np.where(d.dead, 500.0, d.temperature_k)
    np.testing.assert_array_equal(tex_vision(d)[~d.dead], before[~d.dead])


def test_areas_without_a_measurement_are_black_but_no_single_pixel(answer):
    d = ground_only(answer)
    d.dead[10:16, 10:20] = True
    area = d.dead.copy()
    d.dead[2, 3] = True
    np.testing.assert_array_equal((tex_vision(d) == 0).all(axis=-1), area)


def test_stretch():
    a = np.arange(101.0)
    np.testing.assert_allclose(stretch(a, None, 10, 90), np.clip((a - 10) / 80, 0, 1))
    mask = a < 51
    np.testing.assert_allclose(stretch(a, mask, 0, 100), np.clip(a / 50, 0, 1))
    assert (stretch(np.ones(5)) == 0.5).all()
    rounded = np.full(1000, 280.0, np.float32)
    rounded[7] = np.nextafter(rounded[7], np.float32(np.inf))
    assert (stretch(rounded) == 0.5).all()
    lit = np.zeros(1000)
    lit[3] = 2.0  # all else is the same
    np.testing.assert_array_equal(stretch(lit), lit / 2)


def test_what_is_no_number_is_as_dark_as_the_darkest():
    a = np.append(np.arange(11.0), np.nan)
    np.testing.assert_allclose(stretch(a, None, 0, 100), np.append(np.arange(11) / 10, 0))


# --- files -------------------------------------------------------------------------------


def varied(d):
    """Of a made-up answer no map is the same everywhere, nor as another."""
    rng = np.random.default_rng(1)
    shape = d.material.shape
    d.unknown, d.dead, d.saturated, d.hot = rng.random((4, *shape)) < [[[0.3]], [[0.1]], [[0.05]],
                                                                       [[0.02]]]  # fmt: skip
    d.residual = rng.uniform(0.5, 2, shape).astype(np.float32)
    d.temperature_sigma_k = rng.uniform(0.05, 1, shape).astype(np.float32)
    return d


@pytest.mark.parametrize("with_truth", [True, False])
@pytest.mark.parametrize("sky", [(0,), ()])
def test_every_file_is_written(tmp_path, with_truth, sky):
    truth = made_up.truth()
    d = varied(made_up.perfect(truth))
    d.sky = sky
    d.material_names = ("grass", "water", "sky", "bark, wet")
    pictures = baseline_pictures(made_up.cube(truth))
    paths = write_decomposition(d, tmp_path, pictures, truth if with_truth else None)
    assert {p.name for p in tmp_path.iterdir()} == {p.name for p in paths.values()} == {
        "decomposition.npz", "tex_vision.png", "maps.png", "comparison.png", "maps.exr"
    }  # fmt: skip

    with np.load(paths["decomposition"], allow_pickle=False) as npz:
        assert npz["left_out"].tolist() == [9.5] and npz["netd_k"] == 0.05
        assert tuple(npz["material_names"]) == d.material_names
        for name in ("temperature_k", "material", "texture", "thermal_lighting", "unknown", "sky"):
            np.testing.assert_array_equal(npz[name], getattr(d, name), err_msg=name)
    shown = matplotlib.image.imread(paths["tex_vision"])[..., :3]
    np.testing.assert_array_equal(np.rint(255 * shown), tex_vision(d))
    for name in ("maps", "comparison"):
        picture = matplotlib.image.imread(paths[name])
        assert picture.shape[1] > 600 and picture[..., :3].std() > 0.05, "an empty figure"
    with OpenEXR.File(str(paths["maps_exr"]), separate_channels=True) as file:
        maps = {name: c.pixels for name, c in file.channels().items()}
        assert tuple(json.loads(file.header()["materialNames"])) == d.material_names
    held = {
        "T": d.temperature_k, "sigmaT": d.temperature_sigma_k, "material": d.material,
        "unknown": d.unknown, "dead": d.dead, "residual": d.residual, "skyTexture": d.sky_texture,
        "V.0": d.thermal_lighting[0], "V.1": d.thermal_lighting[1],
    }  # fmt: skip
    assert set(maps) == set(held)
    for name, map_ in held.items():
        np.testing.assert_array_equal(maps[name], map_, err_msg=name)


def test_figures_of_answers_without_sky_or_ground(tmp_path):
    """One material everywhere, a constant texture, infinite sigma: drawn, without warnings."""
    truth = made_up.truth()
    pictures = baseline_pictures(made_up.cube(truth))
    for i, name in enumerate(made_up.NAMES):
        d = made_up.perfect(truth)
        d.material = np.full_like(d.material, i)
        d.sky_texture = np.ones_like(d.sky_texture)
        d.temperature_sigma_k = np.full_like(d.temperature_sigma_k, np.inf)
        write_decomposition(d, tmp_path / name, pictures, truth)
        assert (tmp_path / name / "maps.png").stat().st_size > 1000


def test_a_picture_that_is_no_older_answer_s_stays(tmp_path, answer):
    own = tmp_path / "comparison.png"
    own.write_bytes(b"somebody's")
    write_decomposition(varied(answer), tmp_path)
    assert own.read_bytes() == b"somebody's"
    write_decomposition(varied(answer), tmp_path)  # now it is an older answer's
    assert not own.exists()


def test_a_failure_leaves_an_older_answer_as_it_was(tmp_path, monkeypatch):
    truth = made_up.truth()
    d, out = made_up.perfect(truth), tmp_path / "out"
    pictures = baseline_pictures(made_up.cube(truth))
    write_decomposition(d, out, pictures, truth)
    before = {p.name: p.read_bytes() for p in out.iterdir()}
    broken = SimpleNamespace(**vars(d) | {"temperature_k": d.temperature_k + 1})
    monkeypatch.setattr(OpenEXR, "File", lambda *_: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(OSError, match="disk full"):
        write_decomposition(broken, out, pictures, truth)
    assert {p.name: p.read_bytes() for p in out.iterdir()} == before
    assert list(tmp_path.iterdir()) == [out]


def test_a_file_in_the_folder_s_place_is_refused(tmp_path):
    truth = made_up.truth()
    (tmp_path / "out").write_text("mine")
    with pytest.raises(InputError, match="it is a file"):
        write_decomposition(made_up.perfect(truth), tmp_path / "out", truth=truth)
    assert (tmp_path / "out").read_text() == "mine"


@pytest.mark.parametrize("there", [True, False])
def test_a_full_disk_is_said_of_the_folder_that_was_asked_for(tmp_path, monkeypatch, there):
    """Not of the hidden one beside it, nor what is elsewhere of it."""
    out, elsewhere = tmp_path / "out", "/usr/share/fonts/none.ttf"
    if there:
        out.mkdir()

    for of, said in (
        (lambda path: path, out / "maps.png"), (lambda path: path.parent, out),
        (lambda path: elsewhere, elsewhere),
    ):  # fmt: skip

        def fails(decomposition, truth, path, of=of):
            raise OSError(errno.ENOSPC, "No space left on device", str(of(path)))

        monkeypatch.setattr(texnet.outputs, "maps_figure", fails)
        with pytest.raises(OSError, match="No space left") as raised:
            write_decomposition(made_up.perfect(made_up.truth()), out)
        assert raised.value.filename == str(said)
    assert list(tmp_path.rglob("*")) == ([out] if there else [])


# --- what the figures say ----------------------------------------------------------------


@pytest.fixture
def drawn(monkeypatch):
    """Draws a figure and returns it, instead of a file."""
    figures = []
    monkeypatch.setattr(texnet.figures, "_save", lambda figure, _: figures.append(figure))

    def draw(function, *arguments):
        function(*arguments, None)
        return figures[-1]

    return draw


def titles(figure):
    return [ax.get_title() for ax in figure.axes]


def legend(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def panel(figure, title):
    return next(ax for ax in figure.axes if ax.get_title() == title).images[0].get_array()


def renamed(truth, **names):
    names = tuple(names.get(n, n) for n in truth.material_names)
    return SimpleNamespace(**vars(truth) | {"material_names": names})


def test_legends_name_what_is_there_in_one_order(drawn):
    truth = made_up.truth(40, 50)
    d = made_up.perfect(truth, ("sky", "bark", "water", "grass"))
    d.material[d.material == 1] = 0
    d.material[0, 0] = 1  # a pixel in 2000
    pictures = baseline_pictures(made_up.cube(truth))
    shown = legend(drawn(texnet.figures.comparison_figure, d, pictures, None))
    common = [n for n in names_in_view(d) if n != "bark"]
    assert shown == [*common, "and 1 more"] and len(common) == 3
    assert legend(drawn(texnet.figures.maps_figure, d, truth)) == [*common, "bark"]


def test_a_legend_that_is_full_leaves_out_what_only_the_answer_has(drawn, monkeypatch):
    truth = made_up.truth(40, 50)
    d = made_up.perfect(truth)
    d.material[:10] = list(d.material_names).index("bark")
    lacking = renamed(truth, bark="log")
    monkeypatch.setattr(texnet.figures, "MOST_NAMES", 4)
    shown = legend(drawn(texnet.figures.maps_figure, d, lacking))
    assert "log (truth)" in shown and "bark" not in shown and shown[-1] == "and 1 more"


def test_names_that_the_library_lacks_are_no_errors_of_the_answer(drawn):
    truth = made_up.truth()
    d = made_up.perfect(truth)
    one, all_ = renamed(truth, grass="lawn"), renamed(truth, grass="lawn", water="sea", bark="log")
    assert names_lacking(d, truth) == ([], False)
    assert names_lacking(d, one) == (["lawn"], False)
    lacking, whole = names_lacking(d, all_)
    assert set(lacking) == {"lawn", "sea", "log"} and whole
    assert any("wrong" in t for t in titles(drawn(texnet.figures.maps_figure, d, one)))
    figure = drawn(texnet.figures.maps_figure, d, all_)
    said = titles(figure)
    assert "not compared: no name shared" in said and not any("wrong" in t for t in said)
    assert {"grass", "sky", "lawn (truth)", "sea (truth)", "log (truth)"} <= set(legend(figure))
    colours = np.unique(panel(figure, "truth")[..., :3].reshape(-1, 3), axis=0)
    apart = np.abs(colours[:, None] - colours).max(axis=2)[~np.eye(len(colours), dtype=bool)]
    assert len(colours) == 4 and apart.min() > 0.1


def test_every_panel_is_what_its_title_says(drawn):
    """As far as it is shown: not where nothing was measured, nor T and light where sky is."""
    truth = made_up.truth()
    d = varied(made_up.perfect(truth))
    d.dead = np.zeros_like(d.dead)
    d.dead[10:14, 5:11] = True
    d.temperature_k = d.temperature_k + np.float32(3) * (d.residual - 1)
    d.texture = d.texture * (1 + 0.1 * d.residual)
    d.sky_texture = d.sky_texture * (2 - d.residual)
    figure = drawn(texnet.figures.maps_figure, d, truth)
    # ground is what an answer calls so
    ground = np.array([name != "sky" for name in d.material_names])[d.material]
    there, true_there = ground & ~d.dead, truth.material != 2
    fields = {
        "temperature (K)": (d.temperature_k, truth.temperature_k),
        "lighting factor V of the sky": (d.thermal_lighting[0], truth.sky_view),
        "texture X": (d.texture.mean(axis=0), truth.texture.mean(axis=0)),
        "sky-lit X": (d.sky_texture, truth.sky_texture),
    }
    shown = [ax for ax in figure.axes if ax.images]
    for title, (ours, true) in fields.items():
        (at,) = (i for i, ax in enumerate(shown) if ax.get_title().startswith(title))
        column = shown[at].get_position().x0
        of = [ax for ax in shown if ax.get_position().x0 == column]
        pictures = {ax.get_title(): ax.images[0] for ax in of}
        own, truths, error = (
            np.ma.filled(image.get_array(), np.nan) for image in pictures.values()
        )
        np.testing.assert_allclose(own, np.where(there, ours, np.nan), rtol=1e-5, err_msg=title)
        np.testing.assert_allclose(truths, np.where(true_there, true, np.nan), rtol=1e-5)
        off = np.where(there & true_there, ours.astype(float) - true, np.nan)
        np.testing.assert_allclose(error, off, atol=1e-4, err_msg=title)
        low, high = pictures["truth"].get_clim()
        both = np.concatenate([own[there], truths[true_there]])
        assert 0.97 < np.mean((low <= both) & (both <= high)) < 1
        low, high = pictures["estimate - truth"].get_clim()
        assert low == -high
    for title, own, seen in (
        ("sigma of T (K)", d.temperature_sigma_k, there), ("residual", d.residual, ~d.dead),
        ("unknown", d.unknown, ~d.dead),
    ):  # fmt: skip
        (ax,) = (ax for ax in shown if ax.get_title().startswith(title))
        picture = np.ma.filled(ax.images[0].get_array().astype(float), np.nan)
        np.testing.assert_allclose(picture, np.where(seen, own, np.nan), rtol=1e-5, err_msg=title)


def test_a_room_has_no_texture_correlation(drawn):
    truth = made_up.truth()
    d, pictures = made_up.perfect(truth), baseline_pictures(made_up.cube(truth))
    count = lambda t: sum(
        "correlation" in title
        for title in titles(drawn(texnet.figures.comparison_figure, d, pictures, t))
    )
    assert count(truth) == 4 and count(None) == 0
    d.sky = ()
    maps = titles(drawn(texnet.figures.maps_figure, d, truth))
    assert maps.count("estimate - truth") == 2 and "largest lighting factor V" in maps
    room = SimpleNamespace(**vars(truth) | {"sky_texture": np.zeros_like(truth.sky_texture)})
    assert count(room) == 0
    assert np.isnan(list(baseline_correlations(pictures, room).values())).all()
