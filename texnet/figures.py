"""The two figures of a decomposition: every map with its truth; TeX vision and today's displays.

Colour maps keep their order for colour-blind readers; a value and its truth share one scale.
"""

import warnings
from contextlib import contextmanager

import matplotlib
import numpy as np
from matplotlib.colors import hsv_to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from physics.cube.dead_pixels import gaps
from physics.library import SKY, MaterialLibrary, hues_between
from physics.machinery import scratch
from physics.machinery.whole_file import whole_file

from .baselines import baseline_correlations
from .metrics import names_in_view, names_lacking, non_sky, texture_at, texture_correlation
from .stretch import stretch
from .vision import tex_vision

PANEL_INCHES, MARGIN_INCHES = 2.4, 0.08
DPI = 130
TITLE, SMALL = 11, 8  # points: legible when a page scales the figure down
ERROR_MAP = "RdBu_r"
RADIANCE = "W/m²/sr/µm"
STRETCHED = 8.0  # a picture this many times as wide as high, or as high as wide, fills its panel
LEAST_SHARE, MOST_NAMES = 0.005, 16  # least share of the pixels, and most materials, in a legend
LETTER_INCHES, LINE_INCHES = 0.067, 0.19  # of a legend's text


@contextmanager
def own_style():
    """Draw pictures in one style, whatever a user or a folder has set; names are plain text,
    including dollar signs."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams["text.parse_math"] = False
        yield


def maps_figure(decomposition, truth, path):
    """Draw every map of a Decomposition, with units and colour bars, into a png file.

    truth  a Truth: its maps and the errors fill a second and third row; None: no such rows

    Maps are blank at sky pixels, which have no temperature or texture, and where nothing was
    measured. Materials are not compared if the library has none of the truth's names, nor is the
    sky's light if the answer has no sky.
    """
    d, hues, seen = decomposition, _hues(decomposition, truth), ~gaps(decomposition.dead)
    ground = non_sky(d) & seen
    legend = _legend(hues, d, truth)
    fields = [  # title, colour map, picture
        ("temperature (K)", "magma", _on(ground, d.temperature_k)),
        _lighting(d, ground),
        (f"texture X ({RADIANCE})", "cividis", _on(ground, _band_mean(d.texture))),
        (_texture_title(d), "gray", _on(ground, d.sky_texture)),
    ]
    unknown = np.ma.array(d.unknown, mask=~seen)
    own = [
        ("sigma of T (K)", "viridis", _on(ground, d.temperature_sigma_k)),
        ("residual (noise units)", "viridis", _on(seen, d.residual)),
        (f"unknown ({100 * d.unknown[~d.dead].mean():.1f} %, white)", "gray", unknown),
    ]
    if truth is None:
        fig, axes = _panels(2, 4, d.residual.shape, legend)
        _show_materials(axes[0, 0], "material", d, hues, ~seen)
        for ax, (title, cmap, picture) in zip(axes.flat[1:], fields + own, strict=True):
            _show(ax, title, cmap, picture, _span(picture))
    else:
        true_ground = non_sky(truth)
        by_sky = (truth.sky_view, truth.sky_texture) if d.sky else (None, None)
        x = texture_at(truth, d.wavelength_um)
        true = [truth.temperature_k, by_sky[0], _band_mean(x), by_sky[1]]
        fig, axes = _panels(3, 6, d.residual.shape, legend)
        _show_materials(axes[0, 0], "material", d, hues, ~seen)
        _show_materials(axes[1, 0], "truth", truth, hues)
        if names_lacking(d, truth)[1]:
            axes[2, 0].set_axis_off()
            axes[2, 0].set_title("not compared: no name shared", fontsize=TITLE)
        else:
            wrong = np.ma.array(_names(d) != _names(truth), mask=d.dead)
            _show(axes[2, 0], f"wrong ({100 * wrong.mean():.1f} %, white)", "gray", wrong, (0, 1))
        for column, field, t in zip(axes.T[1:5], fields, true, strict=True):
            _compare(column, *field, None if t is None else _on(true_ground, t))
        for ax, (title, cmap, picture) in zip(axes[:, 5], own, strict=True):
            _show(ax, title, cmap, picture, _span(picture))
    _save(fig, path)


def _band_mean(cube):
    return sum(scratch.parts(cube)) / len(cube)


def comparison_figure(decomposition, pictures, truth, path):
    """Draw raw thermal, CLAHE and principal components (baseline_pictures of the cube) and TeX
    vision side by side into a png.

    truth  a Truth: adds the visible picture and, above each picture, its correlation with the true
           sky-lit texture, if the scene has one (baseline_correlations; for TeX vision the sign
           counts). None: without
    """
    d, blank = decomposition, gaps(decomposition.dead)
    (raw,), (equalised,) = pictures["panchromatic"], pictures["clahe"]
    components = [stretch(c, ~d.dead) for c in pictures["principal_components"]]
    shown = {  # title, picture
        "panchromatic": ("thermal, all bands", np.dstack([stretch(raw, ~d.dead)] * 3)),
        "clahe": ("CLAHE of all bands", np.dstack([equalised] * 3)),
        "principal_components": ("3 principal components", np.dstack(components)),
        "tex_vision": ("TeX vision", tex_vision(d)),
    }
    scores = dict.fromkeys(shown, np.nan)
    if truth is not None:
        scores = baseline_correlations(pictures, truth, ~d.dead)
        scores["tex_vision"] = texture_correlation(d.sky_texture, truth, ~d.dead)
    hues, columns = _hues(d), 2 if truth is None else 3
    fig, axes = _panels(2, columns, blank.shape, _legend(hues, d), bar=0.1, title=0.5)
    for ax, (name, (title, picture)) in zip(axes.flat, shown.items(), strict=False):
        r = scores[name]
        _bare(ax, title if np.isnan(r) else f"{title}\ntexture correlation {r:.2f}")
        ax.imshow(np.where(blank[..., None], 0, picture), aspect=_aspect(picture))
    if truth is not None:
        _bare(axes[1, 1], "the scene by day (truth)")
        axes[1, 1].imshow(daylight_srgb(truth), aspect=_aspect(blank))
        _show_materials(axes[1, 2], "material (estimated)", d, hues, blank)
    _save(fig, path)


def daylight_srgb(truth):
    """The linear daylight picture of a Truth as (height, width, 3) sRGB in 0..1.

    Exposed so that its 99th percentile is white.
    """
    from kornia.color import linear_rgb_to_rgb  # torch takes a second to load
    from torch import tensor

    linear = truth.visible / max(np.percentile(truth.visible, 99), 1e-6)
    return linear_rgb_to_rgb(tensor(np.clip(linear, 0, 1)).movedim(-1, 0)).movedim(0, -1).numpy()


# --- what the maps show ------------------------------------------------------------------


def _on(mask, picture):
    return np.where(mask, picture, np.nan)


def _names(answer):
    return np.asarray(answer.material_names)[answer.material]


def _lighting(d, ground):
    """The sky's lighting factor; without a sky, that of each pixel's strongest object."""
    if not d.sky:
        return "largest lighting factor V", "viridis", _on(ground, d.thermal_lighting.max(axis=0))
    by_sky = d.thermal_lighting[list(d.sky)].sum(axis=0)
    return "lighting factor V of the sky", "viridis", _on(ground, by_sky)


def _texture_title(d):
    # Without a sky the pipeline shows the residual instead (physics.exact.distill).
    if not d.sky:
        return "residual texture (noise units)"
    return "sky-lit X (relative)"


def _span(*pictures):
    """Limits that contain all but the outermost 2 % of the finite values."""
    values = np.concatenate([np.ma.compressed(p) for p in pictures]).astype(float)
    values = values[np.isfinite(values)]
    low, high = np.percentile(values, [1, 99]) if values.size else (0.0, 1.0)
    return (low, high) if high > low else (low - 0.5, high + 0.5)


def _compare(column, title, cmap, estimate, truth):
    if truth is None:
        _show(column[0], title, cmap, estimate, _span(estimate))
        for ax in column[1:]:
            ax.set_axis_off()
        return
    span = _span(estimate, truth)
    _show(column[0], title, cmap, estimate, span)
    _show(column[1], "truth", cmap, truth, span)
    error = estimate - truth
    finite = np.abs(error[np.isfinite(error)])
    limit = (np.percentile(finite, 98) if finite.size else 0.0) or 1.0
    _show(column[2], "estimate - truth", ERROR_MAP, error, (-limit, limit))


# --- drawing -----------------------------------------------------------------------------


def _panels(rows, columns, shape, legend, bar=0.66, title=0.36):
    """Figure and axes for pictures of this shape, with bar inches beside and title inches above
    each, and a legend {label: colour} below all."""
    # Laid out in inches: matplotlib's own layout takes as long as all of the drawing. Our own
    # Figure instead of pyplot's: no global state, no display, no leak.
    height = PANEL_INCHES * min(max(shape[0] / shape[1], 0.4), 2.0)
    wide = columns * (PANEL_INCHES + bar) + MARGIN_INCHES
    per_row = max(1, int(wide / (LETTER_INCHES * (max(map(len, legend), default=0) + 4))))
    lines = -(-len(legend) // per_row)
    foot = lines * LINE_INCHES + 2 * MARGIN_INCHES
    high = rows * (height + title) + foot
    fig = Figure(figsize=(wide, high), dpi=DPI)
    axes = np.empty((rows, columns), object)
    for row, column in np.ndindex(rows, columns):
        left = MARGIN_INCHES + column * (PANEL_INCHES + bar)
        bottom = foot + (rows - 1 - row) * (height + title)
        axes[row, column] = fig.add_axes(
            (left / wide, bottom / high, PANEL_INCHES / wide, height / high)
        )
    fig.legend(
        handles=[Patch(color=colour, label=label) for label, colour in legend.items()],
        fontsize=SMALL, ncols=-(-len(legend) // max(1, lines)), columnspacing=1.0,
        handlelength=1.2, loc="lower center", frameon=False, borderaxespad=0.2,
    )  # fmt: skip
    return fig, axes


def _bare(ax, title):
    ax.set_title(title, fontsize=TITLE, y=1.0)  # a given y saves a search
    ax.xaxis.set_visible(False)
    ax.yaxis.set_visible(False)
    ax.set_facecolor("0.85")


def _aspect(picture):
    height, width = picture.shape[:2]
    return "auto" if max(height, width) >= STRETCHED * min(height, width) else "equal"


def _show(ax, title, cmap, picture, span):
    _bare(ax, title)
    image = ax.imshow(
        picture, cmap=cmap, vmin=span[0], vmax=span[1], interpolation="nearest",
        aspect=_aspect(picture),
    )  # fmt: skip
    if picture.dtype != bool:
        bar = ax.figure.colorbar(image, cax=ax.inset_axes((1.02, 0.05, 0.05, 0.9)))
        bar.ax.tick_params(labelsize=SMALL)


def _hues(d, truth=None):
    """{name: hue} of the materials in view; those missing in the library get hues in between."""
    starter = MaterialLibrary.starter()
    of_library = {SKY: starter.hue_deg[starter.sky_index]}  # a truth may have sky, a library not
    of_library |= zip(d.material_names, d.hue_deg, strict=True)
    hues = {n: of_library[n] for n in names_in_view(d, seen=~d.dead)}
    if truth is not None:
        lacking = names_lacking(d, truth)[0]
        hues |= {n: of_library[n] for n in names_in_view(truth) if n in of_library}
        hues |= zip(lacking, hues_between(list(hues.values()), len(lacking)), strict=True)
    return hues


def _show_materials(ax, title, answer, hues, blank=False):
    _bare(ax, title)
    colours = np.array([colour_of(hues.get(n, 0.0)) for n in answer.material_names])
    picture = np.rint(255 * colours).astype(np.uint8)[answer.material]
    if np.any(blank):
        picture = np.dstack([picture, np.where(blank, 0, 255).astype(np.uint8)])
    ax.imshow(picture, interpolation="nearest", aspect=_aspect(picture))


def _legend(hues, d, truth=None):
    """{label: colour} of what is in view; materials of the truth that the library lacks are
    marked."""
    labels, there = {n: n for n in names_in_view(d, LEAST_SHARE, ~d.dead)}, []
    if truth is not None:
        lacking = names_lacking(d, truth)[0]
        there = names_in_view(truth, LEAST_SHARE, ~d.dead)
        labels |= {n: f"{n} (truth)" if n in lacking else n for n in there}
    full = max(0, len(labels) - MOST_NAMES)
    rarest = [n for n in labels if n not in there][::-1] + there[::-1]
    shown = {label: colour_of(hues[n]) for n, label in labels.items() if n not in rarest[:full]}
    everything = {n for a in (d, truth) if a is not None for n in names_in_view(a, 0, ~d.dead)}
    more = len(everything) - len(shown)
    return shown | ({f"and {more} more": "none"} if more else {})


def colour_of(hue_deg):
    """The colour (r, g, b) of a hue in legends and maps of materials."""
    return tuple(hsv_to_rgb((hue_deg % 360 / 360, 0.65, 0.85)))


def _save(fig, path):
    with whole_file(path) as part, warnings.catch_warnings():
        # a material's name may contain letters that the font lacks
        warnings.filterwarnings("ignore", message="Glyph")
        # stronger compression takes longer than all else here, and saves a twentieth
        fig.savefig(part, pil_kwargs={"compress_level": 1})
