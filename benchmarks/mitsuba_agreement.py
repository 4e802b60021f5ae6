"""The simulator against an independent renderer: what differs is Monte Carlo noise.

    python -m benchmarks.mitsuba_agreement --out DIR

One scene, three bands, many seeds in both renderers. In Mitsuba 3 (Nimier-David et al. 2019;
variant scalar_rgb) a band is a colour channel: every mesh is a diffuse reflector 1 - e and an
area light e B(T), the sky an environment map. Under the hypothesis that both converge to the
same image, the difference of a pixel's means over seeds, in standard errors, is Student
distributed (Welch); turned into normal scores z, their mean is 0 to 1 / sqrt(pixels) and the
sum of their squares is chi-square with one degree of freedom per pixel.

Area lights of Mitsuba shine from the front only and it treats shading normals below the
facet differently, so the scene is of closed, flat-shaded objects on the ground.
"""

import argparse
import json
import tempfile
import time
from pathlib import Path

import numpy as np
import trimesh
from scipy import stats

from physics import MaterialLibrary
from physics.planck import radiance
from physics.simulator import Camera, Scene, SceneObject, geometry, simulate
from physics.sky import Atmosphere, sky_radiance

WAVELENGTH_UM = np.array([8.6, 9.6, 12.0])  # quartz, ozone, water vapour
SKY_ROWS = 4096


def still_life():
    """A rock, a ball, a block and a post on the ground in front of a wall, under clear sky."""
    up = geometry.mesh(
        [[-200, -200, 0], [200, -200, 0], [200, 200, 0], [-200, 200, 0]], [[0, 1, 2], [0, 2, 3]]
    )
    rock = geometry.place(geometry.rock(3, (0.9, 0.8, 0.7), subdivisions=4), (-1.3, 0.2, 0.4))
    ball = geometry.place(geometry.sphere(3), (0.5, -0.4, 0.55), scale=0.6)
    post = trimesh.creation.cylinder(0.25, 3.0, sections=24).apply_translation((1.6, 0.6, 1.2))
    wall = geometry.box((-6, 2, -0.2), (6, 2.4, 4.0))
    block = geometry.box((0.9, -1.6, -0.1), (1.9, -0.9, 0.5))
    parts = [
        (up, "sand", 296), (rock, "granite", 291), (ball, "aluminium", 287),
        (post, "wood", 301), (wall, "brick", 305), (block, "ice", 272),
    ]  # fmt: skip
    objects = [SceneObject(m, material, float(t), False) for m, material, t in parts]
    return Scene(objects, Camera((0.4, -6, 2.2), (0, 0, 0.9), 32), Atmosphere(), name="still life")


def mitsuba_scene(scene, library, size, folder):
    """The same scene for Mitsuba; meshes go through PLY files in folder."""
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    height, width = size
    camera, to = scene.camera, mi.ScalarTransform4f()
    e = library.at(WAVELENGTH_UM)
    theta = (np.arange(SKY_ROWS) + 0.5) / SKY_ROWS * np.pi
    sky = sky_radiance(WAVELENGTH_UM, np.cos(theta), scene.atmosphere)
    bitmap = np.repeat(sky[:, None].astype(np.float32), 4, axis=1)
    description = {
        "type": "scene",
        # No roulette; what 60 bounces leave out is below float32 here.
        "integrator": {"type": "path", "max_depth": 60, "rr_depth": 1000},
        "sensor": {
            "type": "perspective",
            "fov": camera.fov_deg,
            "fov_axis": "y",
            "to_world": to.look_at(list(camera.position), list(camera.target), [0, 0, 1]),
            "film": {
                "type": "hdrfilm", "width": width, "height": height, "pixel_format": "rgb",
                "component_format": "float32", "rfilter": {"type": "box"},
            },
            "sampler": {"type": "independent"},
        },
        "sky": {
            "type": "envmap",
            "bitmap": mi.Bitmap(bitmap, mi.Bitmap.PixelFormat.RGB),
            "to_world": to.rotate([1, 0, 0], 90),
        },
    }  # fmt: skip
    for i, o in enumerate(scene.objects):
        m, t = library.index(o.material), float(o.temperature_k[0])
        file = Path(folder) / f"{i}.ply"
        o.mesh.export(file)
        glow = e[m] * radiance(WAVELENGTH_UM, t)
        description[f"object{i}"] = {
            "type": "ply",
            "filename": str(file),
            "face_normals": True,
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(1 - e[m])}},
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": list(glow)}},
        }
    return mi, mi.load_dict(description)


def z_scores(a, b):
    """Normal scores of the differences of means of a and b (seeds, ...), by Welch's test."""
    va, vb = a.var(0, ddof=1) / len(a), b.var(0, ddof=1) / len(b)
    t = (a.mean(0) - b.mean(0)) / np.sqrt(va + vb)
    freedom = (va + vb) ** 2 / (va**2 / (len(a) - 1) + vb**2 / (len(b) - 1))
    return -np.sign(t) * stats.norm.ppf(stats.t.sf(np.abs(t), freedom))


def compare(size=(48, 64), spp=64, seeds=64):
    """Render with both and compare -> (result, z (bands, height, width), image)."""
    scene, library = still_life(), MaterialLibrary.starter()
    start = time.perf_counter()
    ours = np.array(
        [
            simulate(scene, wavelength_um=WAVELENGTH_UM, fwhm_um=np.zeros(3), size=size, spp=spp,
                     netd_k=0, seed=s, library=library)[0].radiance
            for s in range(seeds)
        ],
        dtype=float,
    )  # fmt: skip
    middle = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        mi, theirs_scene = mitsuba_scene(scene, library, size, folder)
        theirs = np.array(
            [np.array(mi.render(theirs_scene, spp=spp, seed=s)) for s in range(seeds)], dtype=float
        )
    end = time.perf_counter()
    theirs = np.moveaxis(theirs, -1, 1)
    z = z_scores(ours, theirs)
    pixels = z[0].size
    bands = []
    for w, band in zip(WAVELENGTH_UM, z, strict=True):
        chi2 = float((band**2).sum())
        bands.append(
            {
                "wavelength_um": float(w),
                "z_mean": float(band.mean()),
                "z_mean_p": float(2 * stats.norm.sf(abs(band.mean()) * np.sqrt(pixels))),
                "z_std": float(band.std()),
                "z_max": float(np.abs(band).max()),
                "chi2_per_pixel": chi2 / pixels,
                "chi2_p": float(2 * min(stats.chi2.sf(chi2, pixels), stats.chi2.cdf(chi2, pixels))),
            }
        )
    noise = np.sqrt(np.mean([x.var(0, ddof=1).mean((1, 2)) for x in (ours, theirs)], axis=-1))
    result = {
        "scene": scene.name,
        "size": list(size),
        "spp": spp,
        "seeds": seeds,
        "mitsuba": mi.__version__,
        "bands": bands,
        "relative_difference": float(abs(ours.mean() / theirs.mean() - 1)),
        "noise_ours_over_mitsuba": float(noise[0] / noise[1]),
        "seconds_ours": middle - start,
        "seconds_mitsuba": end - middle,
        "agree": all(min(b["z_mean_p"], b["chi2_p"]) > 0.01 / (2 * len(bands)) for b in bands),
    }
    return result, z, ours.mean(0)


def draw(z, image, path):
    """The scene beside the z-map of every band, and the histogram of z."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 2.8), layout="constrained")
    axes = figure.subplots(1, 5)
    axes[0].imshow(image.mean(0), cmap="gray")
    axes[0].set_title("S, ours")
    for axis, band, w in zip(axes[1:4], z, WAVELENGTH_UM, strict=True):
        shown = axis.imshow(band, cmap="RdBu", vmin=-4, vmax=4)
        axis.set_title(f"z at {w:g} um")
    figure.colorbar(shown, ax=axes[3])
    for axis in axes[:4]:
        axis.set_axis_off()
    x = np.linspace(-4.5, 4.5, 61)
    axes[4].hist(z.ravel(), x, density=True, color="0.7")
    axes[4].plot(x, stats.norm.pdf(x), "k")
    axes[4].set_title("z and the unit normal")
    figure.savefig(path, dpi=120)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for JSON and picture")
    parser.add_argument("--seeds", type=int, default=64)
    parser.add_argument("--spp", type=int, default=64)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    result, z, image = compare(spp=args.spp, seeds=args.seeds)
    draw(z, image, args.out / "mitsuba_agreement.png")
    text = json.dumps(result, indent=1)
    (args.out / "mitsuba_agreement.json").write_text(text + "\n", encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
