"""Shared by the figures made of pictures: the night scenes, and panels with numbers below.

Curves have the colours of `benchmarks.colours`, and each also its own marker or line style.
"""

from types import SimpleNamespace

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from PIL import Image

from benchmarks.accuracy import NETD_K
from physics.bands import equidistant_bands
from physics.library import MaterialLibrary
from physics.machinery.whole_file import whole_file
from physics.simulator import simulate
from physics.simulator.presets import preset
from texnet.figures import LEAST_SHARE, colour_of
from texnet.metrics import names_in_view
from texnet.vision import tex_vision

SIZE, FULL_SIZE = (256, 384), (1080, 1920)  # pixels; the second is the published one
BANDS, SPP, SEED = 54, 64, 7
NOTHING = "#cfe0f0"  # where a picture has no value, as in the sky
WIDTH_INCHES, TEXT, LEGEND_COLUMNS = 10.0, 10, 8
SCREEN_DPI, PRINT_DPI = 100, 300  # 1000 pixels wide, text legible a little smaller; 3000


def night(name, full=False, progress=None, *, size=None, bands=BANDS, spp=SPP, exposure=0):
    """(HeatCube, Truth) of a preset at seed 7, of size (height, width) or the one for full.

    exposure  another number gives other light paths and noise, but the same scene
    """
    size = size or (FULL_SIZE if full else SIZE)
    wavelength_um, fwhm_um = equidistant_bands(bands)
    return simulate(
        preset(name, SEED), wavelength_um=wavelength_um, fwhm_um=fwhm_um, size=size, spp=spp,
        netd_k=NETD_K, seed=SEED + exposure, progress=stage(progress, f"simulate {name}"),
    )  # fmt: skip


def stage(progress, what):
    """progress(done, total, what) as a progress(done, total), or None."""
    return progress and (lambda done, total: progress(done, total, what))


def scene_library(truth):
    """The starter library reduced to the materials in a Truth."""
    return MaterialLibrary.starter().subset(
        [truth.material_names[m] for m in np.unique(truth.material)]
    )


def true_vision(truth):
    """The TeX vision of a Truth, whose materials are the starter library's: (H, W, 3) uint8."""
    starter = MaterialLibrary.starter()
    hue_deg = starter.hue_deg[[starter.index(name) for name in truth.material_names]]
    none = np.zeros(truth.material.shape, bool)
    return tex_vision(SimpleNamespace(**vars(truth), hue_deg=hue_deg, dead=none))


def dpi(shape):
    """Dots per inch for pictures of shape (height, width); large ones are for print."""
    return PRINT_DPI if shape[1] >= FULL_SIZE[1] else SCREEN_DPI


def panels(rows, columns, shape, more_inches=0.0):
    """(Figure, axes (rows, columns)) for pictures of shape (height, width), captions below.

    more_inches  of height per row, for captions of several lines
    """
    height = WIDTH_INCHES / columns * shape[0] / shape[1] + 0.6 + more_inches
    fig = Figure(figsize=(WIDTH_INCHES, rows * height), dpi=dpi(shape), layout="constrained")
    return fig, fig.subplots(rows, columns, squeeze=False)


def name_materials(fig, *truths):
    """A legend below the figure: the hues of the materials visible in Truths."""
    starter = MaterialLibrary.starter()
    names = dict.fromkeys(n for t in truths for n in names_in_view(t, LEAST_SHARE))
    colours = {n: colour_of(starter.hue_deg[starter.index(n)]) for n in names}
    lines = -(-len(names) // LEGEND_COLUMNS)
    fig.set_figheight(fig.get_figheight() + 0.25 * lines)
    fig.legend(
        handles=[Patch(color=colour, label=n) for n, colour in colours.items()],
        loc="outside lower center", ncols=LEGEND_COLUMNS, fontsize=TEXT - 1, frameon=False,
        handlelength=1.2,
    )  # fmt: skip


def show(ax, picture, title, caption="", cmap="gray", norm=None, unit=None):
    """A picture with its title above and its measures below.

    norm  matplotlib's, for the colour map; None: `between` the values of this picture
    unit  of the values; if given, a colour bar is drawn with it
    """
    ax.set_title(title, fontsize=TEXT)
    ax.set_xlabel(caption, fontsize=TEXT)
    ax.set_xticks([])
    ax.set_yticks([])
    ax.set_facecolor(NOTHING)
    if picture.ndim == 3:
        ax.imshow(picture)
        return
    image = ax.imshow(picture, cmap=cmap, norm=norm or between(picture))
    if unit is not None:
        bar = ax.figure.colorbar(image, ax=ax, location="bottom", shrink=0.9, pad=0.02, aspect=30)
        bar.set_label(unit, fontsize=TEXT - 1)
        bar.ax.tick_params(labelsize=TEXT - 1)


def between(*pictures):
    """The linear norm that spans all but the outermost 2 % of the finite values."""
    values = np.concatenate([np.ravel(p) for p in pictures])
    return Normalize(*np.percentile(values[np.isfinite(values)], [1, 99]))


def save(fig, path, greys=False):
    """Write a figure as a PNG of half the usual size.

    greys  nearly all of it is grey: a palette of 256 colours keeps every grey. Otherwise a
           channel has 32 levels, which changes no hue but hides contrasts of 3 %
    """
    canvas = FigureCanvasAgg(fig)
    canvas.draw()
    rgb = np.asarray(canvas.buffer_rgba())[..., :3]
    rounded = np.minimum((rgb.astype(int) + 4) // 8 * 8, 255).astype(np.uint8)
    image = Image.fromarray(rgb).quantize(256) if greys else Image.fromarray(rounded)
    with whole_file(path) as part:
        image.save(part, optimize=True)
