"""What one pixel can tell of T, V and its material, whatever the method, in four pictures.

    python -m benchmarks.knowable --out DIR

The shipped library, NETD 50 mK, known surroundings (a clear sky, ground at 288 K), and a surface at
293 K lit half by each, unless stated otherwise. Above, the least possible errors of T and V
(`physics.identifiability`, no prior, no bounds on V), for every material and for more objects and
fewer bands. Below, how many noise standard deviations separate a material from the possible
appearance of another, at any T and any V from 0 to 1 (`apart`): from the nearest other one, in an
enclosure that is nearly as warm, and for all pairs. Writes knowable.png.
"""

import numpy as np
from matplotlib.colors import BoundaryNorm
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from benchmarks.arguments import arguments
from benchmarks.colours import BLUE, GREEN, ORANGE, PURPLE, VERMILLION
from physics.bands import equidistant_bands, quadrature
from physics.eq1 import render
from physics.identifiability import cramer_rao, jacobian
from physics.library import SKY, MaterialLibrary
from physics.machinery.whole_file import whole_file
from physics.planck import noise_sigma, planck
from physics.sky import sky_radiance, usual_atmosphere

NETD_K, BANDS, FEW = 0.05, 54, 4
SURFACE_K, AIR_K = 293.0, 288.0
LOW_SKY, OTHERS_K = 0.15, (283.0, 298.0)  # cosine of its zenith angle; trees, a wall
SPAN_K, STEPS, LOOKS = 90.0, 41, 5  # of T about SURFACE_K; each search spans 1 / 20 of the last
CONTRASTS_K = np.geomspace(0.03, 30, 31)
SHOWN = {"concrete": BLUE, "glass": ORANGE, "bark": GREEN, "aluminium": VERMILLION, "water": PURPLE}
DISTANCES = (0, 1, 3, 10, 30, 100, 1000)


def apart(spectra, emissivity, objects, wavelength_um, noise):
    """(P,) noise standard deviations from spectra (P, bands) to the nearest possible spectrum of a
    material with emissivity (bands,) between objects (2, bands): over T within SPAN_K of SURFACE_K
    and V on the simplex. Radiances and noise (bands,) in W m-2 sr-1 um-1."""
    centre = np.full(len(spectra), SURFACE_K)
    first, last = (1 - emissivity) * objects / noise
    way = first - last
    for look in range(LOOKS):
        t = centre[:, None] + SPAN_K / (STEPS // 2) ** look * np.linspace(-1, 1, STEPS)
        glow = emissivity * planck(wavelength_um, t[..., None]) / noise
        rest = (spectra / noise)[:, None] - glow - last
        v = np.clip(rest @ way / max(way @ way, np.finfo(float).tiny), 0, 1)
        left = np.linalg.norm(rest - v[..., None] * way, axis=2)
        centre = np.take_along_axis(t, left.argmin(axis=1)[:, None], axis=1)[:, 0]
    return left.min(axis=1)


def all_apart(library, bands, objects_at, temperature_k):
    """(L, L) noise standard deviations from each material of a MaterialLibrary, at a temperature,
    K, lit equally by both objects, to each other one. objects_at(wavelength_um) -> (2, bands)."""
    w, fwhm = equidistant_bands(bands)
    e, objects, noise = library.of_bands(quadrature(w, fwhm)), objects_at(w), noise_sigma(w, NETD_K)
    spectra = render(np.full(len(e), temperature_k), e, np.array([0.5, 0.5]), objects, w)[0]
    return np.stack([apart(spectra, other, objects, w, noise) for other in e], axis=1)


def sky_and_ground(wavelength_um, k=2):
    """(k, bands) W m-2 sr-1 um-1: sky overhead, ground, low sky, and two more black bodies."""
    overhead, low = sky_radiance(wavelength_um, (1.0, LOW_SKY), usual_atmosphere(AIR_K))
    others = (planck(wavelength_um, t) for t in OTHERS_K)
    return np.stack([overhead, planck(wavelength_um, AIR_K), low, *others])[:k]


def enclosure(wavelength_um):
    """(2, bands) for walls at SURFACE_K, both alike."""
    return np.repeat(planck(wavelength_um, SURFACE_K)[None], 2, axis=0)


def least_sigmas(library):
    """Least possible errors of T, K, and V, both (L,), for each material of a library."""
    w, fwhm = equidistant_bands(BANDS)
    e = library.of_bands(quadrature(w, fwhm))
    t = np.full(len(e), SURFACE_K)
    j = jacobian(w, noise_sigma(w, NETD_K), e, sky_and_ground(w), t)
    return np.sqrt(np.moveaxis(np.linalg.inv(j.mT @ j).diagonal(axis1=1, axis2=2), 1, 0))


def _mirrors(ax, library):
    w, fwhm = equidistant_bands(BANDS)
    reflected = 1 - library.of_bands(quadrature(w, fwhm)).mean(axis=1)
    temperature, lighting = least_sigmas(library)
    ax.loglog(reflected, temperature, "o", color=BLUE, label="T (K)")
    ax.loglog(reflected, lighting, "s", color=ORANGE, label="V, of 1")
    ends = reflected.argmin(), reflected.argmax()
    for i in (*ends, library.names.index("glass"), library.names.index("steel")):
        at = reflected[i], temperature[i]
        ax.annotate(library.names[i], at, (0, 6), textcoords="offset points", ha="center")
    ax.margins(0.12)  # room for the names
    ax.set(
        title="A mirror has no temperature, a black body no texture",
        xlabel="1 - e, mean of 54 bands: each mark a material", ylabel="least standard deviation",
    )  # fmt: skip
    _plain(ax)
    ax.legend()


def _objects(ax, library):
    for k, colour in zip((1, 2, 3, 5), (BLUE, ORANGE, GREEN, VERMILLION), strict=True):
        bands = [n for n in (1, 2, 3, 4, 5, 6, 9, 13, 18, 27, 38, 54) if n >= k]
        least = []
        for n in bands:
            w, fwhm = equidistant_bands(n)
            e = library.subset(["concrete"]).of_bands(quadrature(w, fwhm))
            objects, noise = sky_and_ground(w, k), noise_sigma(w, NETD_K)
            least.append(cramer_rao(w, noise, e, objects, np.array([SURFACE_K]))[0])
        ax.loglog(bands, least, "o-", color=colour, label=f"k = {k}")
    ax.set(
        title="k objects need k bands", xlabel="bands, 8-14 um",
        ylabel="least standard deviation of T (K)",
    )  # fmt: skip
    _plain(ax)
    ax.legend(title="concrete")


def _crossover(ax, library):
    nearest = []
    for contrast in CONTRASTS_K:
        d = all_apart(library, BANDS, enclosure, SURFACE_K + contrast)
        nearest.append(np.where(np.eye(len(d), dtype=bool), np.inf, d).min(axis=1))
    for name, colour in SHOWN.items():
        of = np.array(nearest)[:, library.names.index(name)]
        ax.loglog(CONTRASTS_K, of, color=colour, label=name)
    ax.axhline(3, color="0.7", ls=":")
    ax.set(
        title="At thermal crossover everything looks alike",
        xlabel="T of the object over that of its enclosure (K)",
        ylabel="noise sigmas to the nearest other material",
    )  # fmt: skip
    _plain(ax)
    ax.legend()


def _plain(ax):
    """Numbers as 0.1, not 10^-1, on both axes."""
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(NullFormatter())


def _pairs(figure, ax, library):
    many, few = (all_apart(library, n, sky_and_ground, SURFACE_K) for n in (BANDS, FEW))
    either = np.where(np.triu(np.ones_like(many, bool)), np.minimum(many, many.T), 0)
    either += np.tril(np.minimum(few, few.T), -1)
    np.fill_diagonal(either, np.nan)
    norm = BoundaryNorm(DISTANCES, 256)
    image = ax.imshow(either, cmap="cividis", norm=norm)
    names = [name.replace("_", " ") for name in library.names]
    ax.set_xticks(range(len(names)), names, rotation=90, fontsize=6)
    ax.set_yticks(range(len(names)), names, fontsize=6)
    ax.set_title(f"Two materials: {BANDS} bands above the diagonal, {FEW} below")
    figure.colorbar(image, ax=ax, label="noise sigmas apart, at any T and V")


def draw(library, path):
    """Draw the four pictures of a MaterialLibrary without sky to path."""
    figure = Figure(figsize=(12, 10), layout="constrained")
    (top, right), (bottom, corner) = figure.subplots(2, 2)
    _mirrors(top, library)
    _objects(right, library)
    _crossover(bottom, library)
    _pairs(figure, corner, library)
    with whole_file(path) as part:
        figure.savefig(part, dpi=80)


def main():
    args = arguments(__doc__)
    library = MaterialLibrary.starter()
    library = library.subset([name for name in library.names if name != SKY])
    draw(library, args.out / "knowable.png")


if __name__ == "__main__":
    main()
