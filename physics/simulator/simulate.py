"""A scene goes in; a heat cube and its truth come out, from the same traced paths.

Pixels are worked off in blocks, one per core at a time: trace the block's paths, shade
them in all bands, keep the pixel means, drop the paths. A block's random numbers depend on
the seed and the block alone, so the result does not depend on how threads are timed.
"""

import os
from concurrent.futures import ThreadPoolExecutor, as_completed

import numpy as np

from ..errors import InputError
from ..heat_cube import HeatCube
from ..library import SKY as SKY_NAME
from ..library import MaterialLibrary
from ..planck import radiance
from .daylight import daylight
from .sensor import Bands, add_noise
from .shade import Shader, shade
from .trace import SKY, Tracer, roulette
from .truth import Truth

PATHS_PER_BLOCK = 2**16  # some 10 MB of rays and paths, and a quarter of a second


def simulate(
    scene, *, wavelength_um, fwhm_um, size, spp=64, netd_k=0.05, seed=0, library=None,
    progress=None,
):  # fmt: skip
    """Path-trace a scene -> (HeatCube, Truth).

    scene          Scene
    wavelength_um  (bands,) centres in um, ascending
    fwhm_um        (bands,) widths in um, 0 for a narrow band
    size           (height, width) in pixels
    spp            paths per pixel
    netd_k         sensor noise in K at 300 K; 0 leaves it out
    seed           same seed, same result
    library        MaterialLibrary; the starter library if None
    progress       called as progress(done, total) between blocks of pixels

    Raises InputError where the scene, the library and the bands do not fit together, or
    where rays leave a scene without atmosphere.
    """
    library = MaterialLibrary.starter() if library is None else library
    height, width = (int(n) for n in size)
    if height < 1 or width < 1 or spp < 1:
        raise InputError(f"simulate: size and spp must be positive, got {tuple(size)} and {spp}.")
    if not 0 <= netd_k < 100:
        raise InputError(f"simulate: NETD must be at least 0 and below 100 K, got {netd_k}.")
    bands = Bands.of(wavelength_um, fwhm_um)
    emissivity = library.at(bands.fine_um)
    q = roulette(emissivity)
    tracer = Tracer(scene, library)
    temperatures = tracer.temperature_k.min(), tracer.temperature_k.max()
    shader = Shader.build(bands.fine_um, emissivity, q, temperatures, scene.atmosphere)

    pixels, n = height * width, len(bands.wavelength_um)
    step = max(1, PATHS_PER_BLOCK // spp)
    blocks = [range(i, min(i + step, pixels)) for i in range(0, pixels, step)]
    noise_seed, *seeds = np.random.SeedSequence(seed).spawn(1 + len(blocks))
    s, x = (np.empty((n, pixels), np.float32) for _ in range(2))
    temperature_k, sky_view, sky_texture = (np.empty(pixels, np.float32) for _ in range(3))
    material, visible = np.empty(pixels, np.uint16), np.empty((pixels, 3), np.float32)

    def render(block, block_seed):
        paths = tracer.paths((height, width), block, spp, q, np.random.default_rng(block_seed))
        result = shade(paths, shader, spp)
        at = slice(block.start, block.stop)
        s[:, at] = bands.average(result.radiance).T
        x[:, at] = bands.average(result.texture).T
        sky_texture[at] = bands.average(result.sky_texture).mean(axis=1)
        temperature_k[at], sky_view[at] = result.temperature_k, result.sky_view
        material[at] = result.material
        visible[at] = daylight(paths, library.albedo_rgb, spp, scene.atmosphere is None)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        jobs = [pool.submit(render, *job) for job in zip(blocks, seeds, strict=True)]
        try:
            for done, job in enumerate(as_completed(jobs), 1):
                job.result()
                if progress is not None:
                    progress(done, len(jobs))
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise

    sky = material == SKY
    if sky.any() and library.sky_index is None:
        raise InputError(f"simulate: the camera sees sky, but the library has no {SKY_NAME!r}.")
    e = bands.average(emissivity).T[:, np.where(sky, 0, material)].astype(np.float32)
    if sky.any():
        air = scene.atmosphere.air_temperature_k
        glow = bands.average(radiance(bands.fine_um, air))
        temperature_k[sky] = air
        e[:, sky] = np.minimum(x[:, sky] / glow[:, None], 1)
        x[:, sky] = 0
        material[sky] = library.sky_index
    truth = Truth(
        temperature_k.reshape(height, width), material.astype(np.int16).reshape(height, width),
        library.names, e.reshape(n, height, width), x.reshape(n, height, width),
        sky_view.reshape(height, width), sky_texture.reshape(height, width),
        visible.reshape(height, width, 3), bands.wavelength_um,
    )  # fmt: skip
    cube = s.reshape(n, height, width)
    if netd_k > 0:
        cube = add_noise(cube, bands.wavelength_um, netd_k, np.random.default_rng(noise_seed))
    return HeatCube(cube, bands.wavelength_um, bands.fwhm_um, netd_k or None), truth
