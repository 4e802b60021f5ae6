"""Trace once, shade again: a scene's light paths, kept for any library and any bands.

Paths hold no wavelength (`trace`), so the costly part, geometry and rays, is done once, and
a second library or camera costs only its shading. The roulette that ended the paths is kept
with them and divides out, so the curves of another library are shaded without bias. Where
they reflect more than those traced with, single paths weigh more and noise grows, between
surfaces of (1 - e)^2 > q beyond all bounds: such a scene is to be traced anew.

Pixels are worked off in blocks, one per core at a time. A block's random numbers depend on
the seed and the block alone, so the result does not depend on how threads are timed.
"""

from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace
from functools import partial

import numpy as np

from ..bands import BOX
from ..cube.heat_cube import MAX_NETD_K, TYPICAL_K, HeatCube
from ..errors import Implausible, InputError
from ..library import SKY
from ..machinery.array_file import load_arrays, save_arrays
from ..machinery.threads import in_threads, usual_threads
from ..planck import planck
from ..sky import Atmosphere, sky_radiance
from ..truth import Truth
from .daylight import daylight
from .sensor import FLOOR_K, Bands, add_noise
from .shade import Shader, shade
from .trace import ESCAPED, Paths, Tracer, roulette

PATHS_PER_BLOCK = 2**16  # some 10 MB of rays and paths, and a quarter of a second
OF_NOISE = 0  # which of a seed's random numbers
KEYS = (
    "size", "spp", "seed", "materials", "roulette", "day_roulette", "temperature_range_k",
    "atmosphere", "vertices", "of_heat", "material", "value", "sun",
)  # fmt: skip
ROULETTES = "roulette", "day_roulette"
ROUNDING_K = 1e-2  # of a temperature between three corners, in 32 bits


@dataclass(frozen=True, eq=False)
class TracedScene:
    """The light paths of a scene, as one camera sees it.

    size                 (height, width) in pixels
    spp                  paths per pixel
    seed                 of the paths and of the sensor noise
    materials            names of the scene's materials; Paths.material points into them
    roulette             (materials,) q that the paths were traced with
    day_roulette         (materials,) the same of daylight
    temperature_range_k  (low, high) of all surfaces, K
    atmosphere           Atmosphere, or None in a closed scene
    blocks               sequence of Paths, of `pixel_blocks(size, spp)`
    """

    size: tuple[int, int]
    spp: int
    seed: int
    materials: tuple[str, ...]
    roulette: np.ndarray
    day_roulette: np.ndarray
    temperature_range_k: tuple[float, float]
    atmosphere: Atmosphere | None
    blocks: Sequence[Paths]

    def shade(
        self, library, wavelength_um, fwhm_um, netd_k=0.05, materials=None, sky=None, progress=None,
        response=BOX,
    ):  # fmt: skip
        """Shade the paths -> (HeatCube, Truth), in terms of `library`.

        library        MaterialLibrary, any
        wavelength_um  (bands,) centres in um, ascending
        fwhm_um        (bands,) full widths at half maximum in um, 0 for a narrow band
        netd_k         sensor noise in K at 300 K; 0 leaves it out
        materials      dict from each of the scene's materials to a name in the library,
                       several of them to one if need be; each to its own name if None
        sky            (wavelength_um, cos_zenith) -> (directions, n) radiance, as
                       `physics.sky.sky_radiance`, of another sky than the atmosphere's; a scene
                       without atmosphere has none
        progress       called as progress(done, total) between blocks of pixels
        response       of the bands: "box" or "gaussian"

        Where the curves reflect more than those traced with, a few paths may sum to less than
        nothing; such an S or X is that of FLOOR_K, as in the noise of a sensor.

        Raises InputError where the library, the names and the bands do not fit together.
        """
        if not 0 <= netd_k <= MAX_NETD_K:
            raise InputError(f"simulate: NETD must be 0 to {MAX_NETD_K:g} K, got {netd_k}.")
        bands = Bands.of(wavelength_um, fwhm_um, response)
        emissivity = bands.in_cells(library.at)
        kind = self._kinds(library, materials)
        if self.atmosphere is None:
            sky = None
        elif sky is None:
            sky = partial(sky_radiance, atmosphere=self.atmosphere)
        shader = Shader.build(
            bands, emissivity[kind], self.roulette, self.temperature_range_k, sky, kind
        )
        albedo_rgb = library.albedo_rgb[kind]

        (height, width), n = self.size, len(bands.wavelength_um)
        pixels, spans = height * width, pixel_blocks(self.size, self.spp)
        s, x = (np.empty((n, pixels), np.float32) for _ in range(2))
        temperature_k, sky_view, sky_texture = (np.empty(pixels, np.float32) for _ in range(3))
        material, visible = np.empty(pixels, np.uint16), np.empty((pixels, 3), np.float32)

        def render(block):
            paths, at = self.blocks[block], slice(spans[block].start, spans[block].stop)
            result = shade(paths, shader, self.spp)
            s[:, at] = bands.average(result.radiance).T
            x[:, at] = bands.average(result.texture).T
            sky_texture[at] = bands.average(result.sky_texture).mean(axis=1)
            temperature_k[at], sky_view[at] = result.temperature_k, result.sky_view
            material[at] = result.material
            visible[at] = daylight(paths, albedo_rgb, self.spp, self.atmosphere is None)

        in_threads(render, range(len(spans)), usual_threads(), progress)

        floor = planck(bands.wavelength_um[:, None], FLOOR_K)
        for light in (s, x):
            np.copyto(light, floor, where=light < 0, casting="same_kind")
        of_sky = material == ESCAPED
        if of_sky.any() and library.sky_index is None:
            raise InputError(f"simulate: the camera sees sky, but the library has no {SKY!r}.")
        e = bands.average(emissivity).T.astype(np.float32)[:, np.where(of_sky, 0, material)]
        if of_sky.any():
            air = self.atmosphere.air_temperature_k
            glow = bands.average(bands.in_cells(lambda w: planck(w, air)))
            temperature_k[of_sky] = air
            e[:, of_sky] = np.minimum(x[:, of_sky] / glow[:, None], 1)
            x[:, of_sky] = 0
            material[of_sky] = library.sky_index
        truth = Truth(
            temperature_k.reshape(height, width), material.astype(np.int16).reshape(height, width),
            library.names, e.reshape(n, height, width), x.reshape(n, height, width),
            sky_view.reshape(height, width), sky_texture.reshape(height, width),
            visible.reshape(height, width, 3), bands.wavelength_um,
        )  # fmt: skip
        cube = s.reshape(n, height, width)
        if netd_k > 0:
            cube = add_noise(cube, bands.wavelength_um, netd_k, _generator(self.seed, OF_NOISE))
        try:
            seen = HeatCube(
                cube, bands.wavelength_um, bands.fwhm_um, netd_k or None, response=response
            )
            return seen, truth
        except Implausible as e:
            low, high = TYPICAL_K
            raise InputError(
                f"scene: half of the picture looks colder than {low:g} K or hotter than {high:g}, "
                "which a heat cube may not; change temperatures or the view."
            ) from e

    def _kinds(self, library, materials):
        """(materials,) the index into the library of each of the scene's materials."""
        if materials is None:
            materials = {name: name for name in self.materials}
        missing = [name for name in self.materials if name not in materials]
        if missing:
            raise InputError(f"simulate: materials lacks the scene's {', '.join(missing)}.")
        return np.array([library.index(materials[name]) for name in self.materials])

    def save(self, path):
        """Write a compressed npz, whole or not at all; about 9 bytes per path."""
        join = lambda key: np.concatenate([getattr(b, key) for b in self.blocks])
        vertices = np.concatenate([np.diff(b.start) for b in self.blocks])
        of_heat = np.concatenate([b.end - b.start[:-1] for b in self.blocks])
        material, sky = join("material"), len(self.materials)
        arrays = {
            "size": np.array(self.size),
            "spp": np.array(self.spp),
            "seed": np.array(self.seed, np.uint64),
            "materials": np.array(self.materials),
            "roulette": self.roulette,
            "day_roulette": self.day_roulette,
            "temperature_range_k": np.array(self.temperature_range_k),
            "atmosphere": np.array(astuple(self.atmosphere) if self.atmosphere else ()),
            # The smallest integers that hold them; most files need one byte each.
            "vertices": vertices.astype(np.min_scalar_type(vertices.max())),
            "of_heat": of_heat.astype(np.min_scalar_type(of_heat.max())),
            "material": np.where(material == ESCAPED, sky, material).astype(
                np.min_scalar_type(sky)
            ),
            "value": join("value"),
            "sun": join("sun"),
        }
        save_arrays(path, arrays, compress=True)

    @staticmethod
    def load(path):
        """Read what `save` wrote; InputError if it is not that."""
        a = load_arrays(path, KEYS, "traced scene")
        try:
            return TracedScene._of(a)
        except (TypeError, ValueError, IndexError, ArithmeticError) as e:
            raise InputError(
                f"traced scene: {path} is no traced scene file; its arrays do not fit."
            ) from e

    @staticmethod
    def _of(a):
        """The scene in arrays as `save` wrote them; other errors than InputError if they are not
        that."""
        (height, width), spp = (int(n) for n in a["size"]), int(a["spp"])
        size, sky = (height, width), len(a["materials"])
        if min(*size, spp) < 1:
            raise ValueError
        material = a["material"].astype(np.uint16)
        material[material == sky] = ESCAPED
        start = np.concatenate([[0], np.cumsum(a["vertices"], dtype=np.int64)])
        of_path, of_vertex = {size[0] * size[1] * spp}, {int(start[-1])}
        if {len(a[key]) for key in ("vertices", "of_heat")} != of_path:
            raise ValueError
        if {len(a[key]) for key in ("material", "value", "sun")} != of_vertex:
            raise ValueError
        if a["material"].max() > sky or {len(a[key]) for key in ROULETTES} != {sky}:
            raise ValueError
        if not all(((a[key] > 0) & (a[key] <= 1)).all() for key in ROULETTES):
            raise ValueError
        blocks = []
        for pixels in pixel_blocks(size, spp):
            first, last = pixels.start * spp, pixels.stop * spp
            at, of_block = slice(start[first], start[last]), start[first : last + 1] - start[first]
            blocks.append(
                Paths(of_block, of_block[:-1] + a["of_heat"][first:last], material[at],
                      a["value"][at], a["sun"][at], a["roulette"], a["day_roulette"])
            )  # fmt: skip
        low, high = a["temperature_range_k"]
        of_surfaces = a["value"][material != ESCAPED]
        coldest, hottest = of_surfaces.min(initial=high), of_surfaces.max(initial=low)
        if not low - ROUNDING_K <= coldest <= hottest <= high + ROUNDING_K:
            raise ValueError
        return TracedScene(
            size, spp, int(a["seed"]), tuple(str(n) for n in a["materials"]), a["roulette"],
            a["day_roulette"], (float(low), float(high)),
            Atmosphere(*(float(v) for v in a["atmosphere"])) if len(a["atmosphere"]) else None,
            tuple(blocks),
        )  # fmt: skip


def trace_scene(scene, size, spp, seed, library):
    """Path-trace a scene and keep the paths -> TracedScene.

    scene    Scene
    size     (height, width) in pixels
    spp      paths per pixel
    seed     0 or more, below 2**64; same seed, same result
    library  MaterialLibrary that holds the scene's materials; the roulette is fit to the
             whole of its curves. With the curves at a camera's bands alone (`library.at`)
             the paths are those of `simulate`. To shade with any library later, trace
             with curves as low as its lowest: longer paths, and no path weighs much.

    Raises InputError where the scene and the library do not fit together, or where rays
    leave a scene without atmosphere.
    """
    scene = trace_on_demand(scene, size, spp, seed, library)
    every = range(len(scene.blocks))
    blocks = in_threads(scene.blocks.__getitem__, every, usual_threads())
    return replace(scene, blocks=tuple(blocks))


def trace_on_demand(scene, size, spp, seed, library):
    """As trace_scene, but a block is traced each time it is asked for, and kept by nobody."""
    for what, n, least in (("height", size[0], 1), ("width", size[1], 1), ("spp", spp, 1),
                           ("seed", seed, 0)):  # fmt: skip
        if not isinstance(n, (int, np.integer)) or not least <= n < 2**64:
            wanted = f"a whole number of {least}..2**64 - 1"
            raise InputError(f"simulate: {what} must be {wanted}, got {n!r}.")
    height, width = (int(n) for n in size)
    library = library.subset(dict.fromkeys(o.material for o in scene.objects))
    tracer = Tracer(scene, library)
    q = roulette(library.emissivity)
    q_day = q  # a closed scene is lit from the camera, with one bounce
    if scene.atmosphere is not None:
        q_day = np.maximum(q, roulette(1 - library.albedo_rgb))
    low, high = tracer.temperature_k.min(), tracer.temperature_k.max()
    return TracedScene(
        (height, width), spp, seed, library.names, q, q_day, (float(low), float(high)),
        scene.atmosphere, _BlocksOnDemand(tracer, (height, width), spp, q, q_day, seed),
    )  # fmt: skip


class _BlocksOnDemand(Sequence):
    def __init__(self, tracer, size, spp, q, q_day, seed):
        self._tracer, self._size, self._spp, self._q, self._q_day = tracer, size, spp, q, q_day
        self._spans, self._seed = pixel_blocks(size, spp), seed

    def __len__(self):
        return len(self._spans)

    def __getitem__(self, block):
        block = range(len(self))[block]  # counted from the end, too
        rng = _generator(self._seed, OF_NOISE + 1 + block)
        return self._tracer.paths(
            self._size, self._spans[block], self._spp, self._q, self._q_day, rng
        )


def pixel_blocks(size, spp):
    """Ranges of row-major pixels, with about PATHS_PER_BLOCK paths each."""
    pixels, step = size[0] * size[1], max(1, PATHS_PER_BLOCK // spp)
    return [range(i, min(i + step, pixels)) for i in range(0, pixels, step)]


def _generator(seed, which):
    """Independent random numbers: of the sensor noise, OF_NOISE, then of each block of pixels."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(which,)))
