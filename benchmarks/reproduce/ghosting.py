"""Why a thermal image has no texture: the ghosting effect (the paper's Fig. 1).

(a) An ordinary camera sees scattered sunlight; the thermal emission of what it sees lies far from
its response. A thermal camera sees emission and scattered light in the same band.

(b) Snow, grass and sand, each of one material and one temperature, so that all texture is geometry
(the preset `patches` with finer meshes, the camera close to one of them). One set of light paths
gives the picture by day (luminance under sun and sky) and the picture of a broadband thermal camera
at night (8-14 um), each with all bounces. Both have the same pixels and the same signal-to-noise
ratio, mean over standard deviation of the noise: that of the thermal camera, NETD 50 mK at 300 K.

Texture is measured as RMS contrast (Peli 1990), the standard deviation over the mean. Noise of
sensor and of paths is removed: the variance is the covariance of two exposures with independent
paths and noise, so that only what both show counts.

ghosting.csv, one row per material:

    emissivity                       mean over 8-14 um
    visible_/thermal_emission_over_scattering   mean e B(T) over mean (1 - e) X, in each response
    signal_to_noise                  of both pictures
    visible_/thermal_contrast        RMS contrast
    contrast_ratio                   visible over thermal
"""

from dataclasses import dataclass, replace

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from benchmarks.colours import BLUE, VERMILLION
from benchmarks.rows import write_csv
from physics.bands import equidistant_bands
from physics.library import MaterialLibrary
from physics.planck import noise_sigma, planck
from physics.simulator import Camera, simulate
from physics.simulator.presets.patches import patches

from . import common

SUN_K = 5778.0
SUN_RADIUS_M, SUN_DISTANCE_M = 6.957e8, 1.495978707e11
VISIBLE_UM, THERMAL_UM = (0.4, 0.7), (8.0, 14.0)
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # of linear RGB, ITU-R BT.709
X_M = {"snow": -2.6, "grass": 0.0, "sand": 2.95}  # the middle of each patch
FINENESS = 4  # facets of 1 cm
SIZE, SPP = (180, 320), 128
FULL_SPP = 32  # as many paths per dot of the printed picture


@dataclass(frozen=True, eq=False)
class Exposure:
    """Pictures (height, width) of one scene from the same paths.

    visible     luminance, about 0..1
    thermal     W m-2 sr-1, over 8-14 um
    noise       standard deviation of the sensor noise in `thermal`
    emission, scattering   means of e B(T) and of (1 - e) X over 8-14 um and all pixels
    """

    visible: np.ndarray
    thermal: np.ndarray
    noise: float
    emission: float
    scattering: float


def reproduce(out, full, progress):
    """ghosting.csv and ghosting.png in the folder out."""
    size, spp = (common.FULL_SIZE, FULL_SPP) if full else (SIZE, SPP)
    rows, pictures, all_three = [], {}, patches(common.SEED, FINENESS)
    for name in X_M:
        report, scene = common.stage(progress, f"simulate {name}"), close_up(all_three, name)
        seeds = common.SEED, common.SEED + 1
        first, second = (expose(scene, size, spp, seed, report) for seed in seeds)
        rows.append(measure(scene, name, first, second))
        pictures[name] = first
    write_csv(out / "ghosting.csv", rows)
    _draw(rows, pictures, out / "ghosting.png")
    lines = [
        f"{r['material']:6} RMS contrast {r['visible_contrast']:.3f} by day, "
        f"{r['thermal_contrast']:.4f} thermal: {r['contrast_ratio']:.0f} times less"
        for r in rows
    ]
    return "\n".join(lines), {"rows": rows}


def close_up(scene, name):
    """The preset `patches` with its camera close to one patch, which fills the picture."""
    x = X_M[name]
    return replace(scene, camera=Camera((x, -0.6, 2.3), (x, 2.6, 0.05), 15))


def expose(scene, size, spp, seed, progress=None):
    """Both pictures of a scene -> Exposure."""
    w, fwhm = equidistant_bands(common.BANDS, *THERMAL_UM)
    cube, truth = simulate(
        scene, wavelength_um=w, fwhm_um=fwhm, size=size, spp=spp, netd_k=0, seed=seed,
        progress=progress,
    )  # fmt: skip
    over_bands = lambda a: (a * fwhm[:, None, None]).sum(axis=0, dtype=float)
    thermal, visible = over_bands(cube.radiance), truth.visible @ LUMINANCE
    sigma = noise_sigma(w, common.NETD_K) @ fwhm
    scattering = over_bands((1 - truth.emissivity) * truth.texture).mean()
    rng = np.random.default_rng([seed, 1])  # independent of the paths
    noise = sigma / thermal.mean() * rng.standard_normal((2, *size))
    return Exposure(
        visible + visible.mean() * noise[0], thermal + thermal.mean() * noise[1], sigma,
        thermal.mean() - scattering, scattering,
    )  # fmt: skip


def rms_contrast(first, second):
    """Standard deviation over mean of what two exposures (height, width) of a scene share.

    Zero if their covariance is negative, as it may be for noise alone.
    """
    covariance = np.mean((first - first.mean()) * (second - second.mean()))
    return float(np.sqrt(max(covariance, 0)) / np.mean([first, second]))


def measure(scene, name, first, second):
    """The row of a material from two exposures of it in a scene."""
    library = MaterialLibrary.starter()
    m = library.index(name)
    (t,) = {float(t) for o in scene.objects if o.material == name for t in o.temperature_k}
    visible = rms_contrast(first.visible, second.visible)
    thermal = rms_contrast(first.thermal, second.thermal)
    return {
        "material": name,
        "temperature_k": t,
        "emissivity": float(library.at(np.linspace(*THERMAL_UM, 601))[m].mean()),
        "visible_emission_over_scattering": visible_ratio(
            t, library.albedo_rgb[m].mean(), scene.sun_direction[2]
        ),
        "thermal_emission_over_scattering": float(first.emission / first.scattering),
        "signal_to_noise": float(first.thermal.mean() / first.noise),
        "visible_contrast": visible,
        "thermal_contrast": thermal,
        "contrast_ratio": visible / thermal if thermal else float("inf"),
    }


def visible_ratio(temperature_k, albedo, sun_cosine):
    """Emission over scattered sunlight, 0.4-0.7 um, of a grey Lambertian surface without air."""
    w = np.linspace(*VISIBLE_UM, 301)
    solid_angle = np.pi * (SUN_RADIUS_M / SUN_DISTANCE_M) ** 2
    sunlight = albedo / np.pi * sun_cosine * solid_angle * planck(w, SUN_K)
    return float(((1 - albedo) * planck(w, temperature_k)).sum() / sunlight.sum())


# --- drawing -----------------------------------------------------------------------------


def _draw(rows, pictures, path):
    height = common.WIDTH_INCHES / 3 * SIZE[0] / SIZE[1] + 0.55
    fig = Figure(
        figsize=(common.WIDTH_INCHES, 3.1 + 3 * height), layout="constrained",
        dpi=common.dpi(pictures["snow"].visible.shape),
    )  # fmt: skip
    top, bottom = fig.subfigures(2, 1, height_ratios=[3.1, 3 * height])
    _draw_spectra(top)
    axes = bottom.subplots(3, 3)
    for row, line in zip(rows, axes, strict=True):
        seen = pictures[row["material"]]
        gain = 0.5 * np.ptp(np.percentile(seen.thermal, [0.5, 99.5])) / seen.thermal.mean()
        for ax, title, caption, picture, half in (
            (line[0], "by day", f"RMS contrast {row['visible_contrast']:.2f}", seen.visible, 1.0),
            (line[1], "thermal, 8-14 µm", f"RMS contrast {row['thermal_contrast']:.4f}",
             seen.thermal, 1.0),
            (line[2], f"thermal, contrast x {1 / gain:.0f}",
             f"signal-to-noise ratio {row['signal_to_noise']:.0f}, as by day", seen.thermal, gain),
        ):  # fmt: skip
            norm = Normalize((1 - half) * picture.mean(), (1 + half) * picture.mean())
            common.show(ax, picture, f"{row['material']}, {title}", caption, norm=norm)
    bottom.suptitle("(b) black is 0 and white twice the mean, except on the right", fontsize=11)
    common.save(fig, path, greys=True)  # its contrasts are small


def _draw_spectra(fig):
    w = np.geomspace(0.25, 40, 600)
    shape = lambda t: planck(w, t) / planck(w, t).max()
    fig.suptitle("(a) light in the picture, each curve over its largest value", fontsize=11)
    axes = fig.subplots(1, 2, sharex=True, sharey=True)
    for ax, title, scattered, light, own_k, response in (
        (axes[0], "optical imaging", SUN_K, "sunlight, scattered", 300.0, VISIBLE_UM),
        (axes[1], "thermal imaging", 283.0, "surroundings of 283 K, scattered", 293.0, THERMAL_UM),
    ):
        ax.axvspan(*response, color="0.85", label=f"response, {response[0]:g}-{response[1]:g} µm")
        ax.plot(w, shape(scattered), color=VERMILLION, lw=2, label=light)
        ax.plot(
            w, shape(own_k), "o", color=BLUE, ms=4, markevery=14, fillstyle="none",
            label=f"emission of objects of {own_k:.0f} K",
        )  # fmt: skip
        ax.set_xscale("log")
        ticks = (0.3, 0.5, 1, 2, 5, 10, 20, 40)
        ax.set_xticks(ticks, [f"{t:g}" for t in ticks])
        ax.minorticks_off()
        ax.set(title=title, xlabel="wavelength (µm)", ylim=(0, 1.55), yticks=(0, 0.5, 1))
        ax.title.set_fontsize(common.TEXT)
        ax.legend(fontsize=common.TEXT - 1, loc="upper center", frameon=False)
    axes[0].set_ylabel("normalised radiance")
