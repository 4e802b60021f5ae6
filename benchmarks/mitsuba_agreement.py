"""The simulator against an independent renderer: they differ only by Monte Carlo noise.

    python -m benchmarks.mitsuba_agreement --out DIR

The preset `patterned` (relief of eight materials, sky both seen and reflected), three bands, many
seeds in both renderers. In Mitsuba 3 (Nimier-David et al. 2019; variant scalar_rgb) a band is a
colour channel: every mesh is a diffuse reflector 1 - e and an area light e B(T), the sky an
environment map. If both converge to the same image, the difference of a pixel's means over seeds,
in standard errors, has a Student distribution (Welch); converted to normal scores z, their mean is
0 to 1 / sqrt(pixels) and the sum of their squares is chi-square with one degree of freedom per
pixel.

Both renderers use the preset with three changes that Mitsuba requires: an object has its mean
temperature (an area light's radiance is constant over it), facets are flat (normals that dip below
the facet are treated differently), and open sheets are thin solids (an area light shines only from
its front). Also, Mitsuba starts a bounce at 9e-5 (1 + the largest coordinate) off the surface. With
the preset's origin that is a millimetre, which misses light in the relief's corners (5e-5 of the
mean); so its origin is amid the objects, its unit 1 cm.
"""

import dataclasses
import json
import tempfile
import time
from pathlib import Path

import numpy as np
import trimesh
from matplotlib.figure import Figure
from scipy import stats

from benchmarks.arguments import arguments
from physics import MaterialLibrary
from physics.machinery.whole_file import whole_file
from physics.planck import planck
from physics.simulator import geometry, simulate
from physics.simulator.presets import preset
from physics.sky import sky_radiance

WAVELENGTH_UM = np.array([8.6, 9.6, 12.0])  # quartz, ozone, water vapour
PRESET = "patterned"
THICKNESS_M = 1e-4
SKY_ROWS = 4096
UNIT_M = 0.01


def two_sided(m):
    """The mesh itself if it is a solid that faces outwards, else a solid THICKNESS_M thin.

    An open or cracked sheet gets a back, shifted against its normals and wound the other way, and a
    rim along its borders, so that whatever a ray hits is a front.
    """
    m = m.copy()
    m.update_faces(m.area_faces > 0)
    m.merge_vertices()
    if m.is_watertight and m.volume > 0:
        return m
    n = len(m.vertices)
    a, b = m.edges[trimesh.grouping.group_rows(m.edges_sorted, require_count=1)].T
    rim = np.concatenate([np.stack([b, a, a + n], 1), np.stack([b, a + n, b + n], 1)])
    return geometry.mesh(
        np.concatenate([m.vertices, m.vertices - THICKNESS_M * geometry.normals(m)]),
        np.concatenate([m.faces, m.faces[:, ::-1] + n, rim]),
    )


def exact_in_both():
    """The preset as both can render it: two-sided meshes, one temperature each, flat facets."""
    scene = preset(PRESET)
    objects = [
        dataclasses.replace(
            o, mesh=two_sided(o.mesh), temperature_k=o.temperature_k.mean(), smooth=False
        )
        for o in scene.objects
    ]
    return dataclasses.replace(scene, objects=objects)


def mitsuba_scene(scene, library, size, folder):
    """The same scene for Mitsuba (mi), with meshes passed as PLY files in folder."""
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    height, width = size
    camera, to = scene.camera, mi.ScalarTransform4f()
    origin = np.array(camera.target)
    e = library.at(WAVELENGTH_UM)
    theta = np.linspace(0, np.pi, SKY_ROWS)  # the first and last row are the poles
    sky = sky_radiance(WAVELENGTH_UM, np.cos(theta), scene.atmosphere)
    bitmap = np.repeat(sky[:, None].astype(np.float32), 4, axis=1)
    description = {
        "type": "scene",
        # Roulette is unbiased; a limit on bounces is not.
        "integrator": {"type": "path", "max_depth": -1, "rr_depth": 4},
        "sensor": {
            "type": "perspective",
            "fov": camera.fov_deg,
            "fov_axis": "y",
            "to_world": to.look_at(list((camera.position - origin) / UNIT_M), [0, 0, 0], [0, 0, 1]),
            "near_clip": 0.1 / UNIT_M,
            "far_clip": 1000 / UNIT_M,
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
        geometry.place(o.mesh, -origin / UNIT_M, scale=1 / UNIT_M).export(file)
        glow = e[m] * planck(WAVELENGTH_UM, t)
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
    scene, library = exact_in_both(), MaterialLibrary.starter()
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
    means, theirs_means = (x.mean((1, 2, 3)) for x in (ours, theirs))
    error = np.sqrt((means.var(ddof=1) + theirs_means.var(ddof=1)) / seeds)
    noise = np.sqrt(np.mean([x.var(0, ddof=1).mean((1, 2)) for x in (ours, theirs)], axis=-1))
    result = {
        "scene": scene.name,
        "size": list(size),
        "spp": spp,
        "seeds": seeds,
        "mitsuba": mi.__version__,
        "bands": bands,
        "relative_difference": float(ours.mean() / theirs.mean() - 1),
        "relative_standard_error": float(error / theirs.mean()),
        "noise_ours_over_mitsuba": float(noise[0] / noise[1]),
        "seconds_ours": middle - start,
        "seconds_mitsuba": end - middle,
        "agree": all(min(b["z_mean_p"], b["chi2_p"]) > 0.01 / (2 * len(bands)) for b in bands),
    }
    return result, z, ours.mean(0)


def draw(z, image, path):
    """The scene beside the z-map of every band, and the histogram of z."""
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
    with whole_file(path) as part:
        figure.savefig(part, dpi=120)


def main():
    args = arguments(__doc__, seeds=64, spp=64)
    result, z, image = compare(spp=args.spp, seeds=args.seeds)
    draw(z, image, args.out / "mitsuba_agreement.png")
    text = json.dumps(result, indent=1)
    with whole_file(args.out / "mitsuba_agreement.json") as part:
        part.write_text(text + "\n", encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
