"""The difficulties of the atlas (`benchmarks.stability`), each raised level by level: AXES.

On path-traced test scenes of 72 x 96 pixels, in 54 bands with 50 mK of noise unless that is the
difficulty.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import trimesh
from scipy.ndimage import distance_transform_edt

from benchmarks.accuracy import NETD_K, K
from physics.bands import equidistant_bands
from physics.cube.heat_cube import HeatCube
from physics.library import MaterialLibrary
from physics.machinery.provenance import fingerprint
from physics.planck import noise_sigma, planck, planck_derivative
from physics.simulator import Truth, trace_scene
from physics.simulator.presets import preset
from physics.simulator.scene import SceneObject
from physics.simulator.sensor import Bands, add_noise
from physics.simulator.trace import Tracer
from physics.sky import Atmosphere, level_transmittance
from texnet.metrics import non_sky
from training.scenes import BASE_SEED

SIZE, SPP, BANDS = (72, 96), 64, 54
NO_CLOUD_KM = 50  # instead of infinity, which no axis can show
# of the steel plate: distance from the camera, lean, and height as a share of the picture's
PLATE_AT_M, PLATE_LEANS_DEG, PLATE_SIDE = 3.0, 20.0, 0.4


@dataclass(frozen=True)
class View:
    """A test scene: a preset and its seed, how mirror-like all its surfaces are, or only a steel
    plate put before the camera, and the seed of the sensor's noise."""

    name: str
    seed: int
    mirror: float = 0.0
    plate: float | None = None
    draw: int = 0

    @property
    def traced(self):
        return replace(_traced(self.name, self.seed, self.mirror, self.plate), seed=self.draw)


@lru_cache(maxsize=8)
def _traced(name, seed, mirror, plate):
    scene = preset(name, seed)
    scene = replace(scene, objects=[replace(o, mirror=mirror) for o in scene.objects])
    if plate is not None:
        scene = replace(scene, objects=[*scene.objects, steel_plate(scene, plate)])
    return trace_scene(scene, SIZE, SPP, seed, MaterialLibrary.starter())


def steel_plate(scene, mirror):
    """A SceneObject in the middle of the picture, an eighth of it, that leans over the ground it
    mirrors: 5 K warmer than the air, 3 m away."""
    camera = scene.camera
    ahead = np.subtract(camera.target, camera.position)
    right = np.cross(ahead, [0, 0, 1])
    ahead, right = (a / np.linalg.norm(a) for a in (ahead, right))
    level = np.cross([0, 0, 1], right)
    lean = np.deg2rad(PLATE_LEANS_DEG)
    back = np.cos(lean) * level + np.sin(lean) * np.array([0, 0, 1])  # away from what it faces
    turned = np.eye(4)
    turned[:3, :3] = np.stack([right, back, np.cross(right, back)], axis=1)
    turned[:3, 3] = camera.position + PLATE_AT_M * ahead
    side = PLATE_SIDE * 2 * PLATE_AT_M * np.tan(np.deg2rad(camera.fov_deg / 2))
    plate = trimesh.creation.box((1.3 * side, 0.01, side), turned)
    warm = scene.atmosphere.air_temperature_k + 5
    return SceneObject(plate, "steel", warm, smooth=False, mirror=mirror)


@dataclass(frozen=True)
class Case:
    """What a method is given, and the truth."""

    cube: HeatCube
    truth: Truth
    library: MaterialLibrary
    k: int | None = K
    wrong_k: float | None = None  # error of the given environment, K; None: it is not given
    stated_k: float = 0.0  # stated part of it, K
    said_k: float = 0.0  # stated calibration error, K
    noise_k: float = NETD_K  # NETD of the sensor, whatever is stated
    atmosphere: Atmosphere | None = None  # of its sky, if it differs from its View's

    @property
    def fingerprint(self):
        """Text that distinguishes it from all others."""
        cube, library = self.cube, self.library
        arrays = fingerprint(
            cube.radiance, cube.wavelength_um, cube.fwhm_um, self.truth.temperature_k,
            library.wavelength_um, library.emissivity,
        )  # fmt: skip
        said = self.wrong_k, float(self.stated_k), float(self.said_k)
        return f"{arrays} {cube.netd_k} {library.names} {self.k} {said}"


OUTDOORS = tuple(View("random", BASE_SEED["test"] + i) for i in (1, 2)) + (
    View("forest", 7), View("street", 7)
)  # fmt: skip
INDOORS = (View("room", 7),)


def shaded(view, library, bands=BANDS, netd_k=NETD_K):
    return view.traced.shade(library, *equidistant_bands(bands), netd_k)


def with_curves(library, change):
    """The library with change(e (materials, n)) -> e applied to all but the sky."""
    e = library.emissivity.copy()
    ground = ~library.is_sky
    e[ground] = np.clip(change(e[ground]), 1e-3, 1)
    return replace(library, emissivity=e)


def smooth(shape, wavelength_um, seed):
    """(n, bands) random functions of wavelength of unit variance, smooth over 1 um."""
    rng = np.random.default_rng(seed)
    turns = np.arange(1, 7)[:, None] * np.pi * (wavelength_um - 8) / 6
    a, b = rng.normal(size=(2, shape, 6)) / np.sqrt(6)
    return a @ np.cos(turns) + b @ np.sin(turns)


def emissivity_to_one(view, library, share):
    library = with_curves(library, lambda e: 1 - share * (1 - e))
    return Case(*shaded(view, library), library)


def grey_bodies(view, library, share):
    mean = lambda e: e.mean(axis=1, keepdims=True)
    library = with_curves(library, lambda e: mean(e) + share * (e - mean(e)))
    return Case(*shaded(view, library), library)


def thermal_crossover(view, library, share):
    """Everything in a closed room converges to one temperature."""
    traced = view.traced
    mean = np.concatenate([b.value for b in traced.blocks]).mean()
    blocks = [replace(b, value=mean + np.float32(share) * (b.value - mean)) for b in traced.blocks]
    traced = replace(traced, blocks=tuple(blocks))
    return Case(*traced.shade(library, *equidistant_bands(BANDS), NETD_K), library)


def fewer_bands(view, library, bands):
    return Case(*shaded(view, library, bands), library)


def bands_that_end_early(view, library, last_um):
    """The bands of 8-14 um up to last_um, as in many cameras, none of which is opaque."""
    cube, truth = shaded(view, library)
    held = cube.wavelength_um + cube.fwhm_um / 2 < last_um + 1e-6
    truth = replace(
        truth, emissivity=truth.emissivity[held], texture=truth.texture[held],
        wavelength_um=truth.wavelength_um[held],
    )  # fmt: skip
    return Case(cube.only(held), truth, library)


def noise(view, library, netd_k):
    return Case(*shaded(view, library, netd_k=netd_k), library, noise_k=netd_k)


def unstated_noise(view, library, bands):
    cube, truth = shaded(view, library, bands)
    return Case(replace(cube, netd_k=None), truth, library)


def sky_out_of_view(view, library, share):
    """The picture's upper part is cut off, down to the last row with sky in it."""
    cube, truth = shaded(view, library)
    sky = np.flatnonzero((~non_sky(truth)).any(axis=1))
    top = int(round(share * (sky.max() + 1))) if sky.size else 0
    return Case(*cropped(cube, truth, min(top, cube.shape[0] - 12)), library, None)


def overcast(view, library, base_km):
    """The whole sky, in view and overhead, is a cloud at this height."""
    traced = view.traced
    air = replace(traced.atmosphere, cloud_base_km=base_km if base_km < NO_CLOUD_KM else math.inf)
    traced = replace(traced, atmosphere=air)
    cube, truth = traced.shade(library, *equidistant_bands(BANDS), NETD_K)
    return Case(cube, truth, library, atmosphere=air)


def objects_at_54_bands(view, library, k):
    return Case(*shaded(view, library), library, k)


def objects_at_6_bands(view, library, k):
    return Case(*shaded(view, library, 6), library, k)


def wrong_curves(view, library, percent):
    off = 1 + percent / 100 * smooth(len(library) - 1, library.wavelength_um, 1)
    return Case(*shaded(view, library), with_curves(library, lambda e: e * off))


def missing_materials(view, library, n):
    cube, truth = shaded(view, library)
    left = [m for m in library.names if m not in common(truth)[:n]]
    return Case(cube, truth, library.subset(left))


def twin_materials(view, library, percent):
    """The library contains a material this similar to the scene's commonest one."""
    cube, truth = shaded(view, library)
    i = library.index(common(truth)[0])
    off = percent / 100 * smooth(1, library.wavelength_um, 2)
    twin = np.clip(library.emissivity[i] + off, 1e-3, 1)
    names = [*library.names, "twin"]
    return Case(cube, truth, MaterialLibrary(
        names, library.wavelength_um, np.concatenate([library.emissivity, twin])
    ))  # fmt: skip


def mixed_pixels(view, library, n):
    """n x n pixels become one, whose true material is that of most of them."""
    cube, truth = shaded(view, library, netd_k=0)
    h, w = (m // n for m in cube.shape)
    cut = lambda a: a[..., : h * n, : w * n].reshape(*a.shape[:-2], h, n, w, n)
    mean = lambda a, weight=1.0: (weight * cut(a)).mean(axis=(-3, -1))
    rng = np.random.default_rng(view.draw)
    s = add_noise(mean(cube.radiance), cube.wavelength_um, NETD_K, rng)
    each = cut(truth.material).transpose(0, 2, 1, 3).reshape(h, w, -1)
    most = np.array([[np.bincount(p).argmax() for p in row] for row in each])
    own = (cut(truth.material) == most[:, None, :, None]).astype(np.float32)
    own /= own.mean(axis=(-3, -1), keepdims=True)
    names = "temperature_k", "emissivity", "texture", "sky_view", "sky_texture"
    truth = replace(
        truth, **{name: mean(getattr(truth, name), own) for name in names},
        material=most.astype(truth.material.dtype),
        visible=mean(np.moveaxis(truth.visible, -1, 0)).transpose(1, 2, 0),
    )  # fmt: skip
    return Case(HeatCube(s, cube.wavelength_um, cube.fwhm_um, NETD_K), truth, library)


def wrong_environment(view, library, kelvin):
    return Case(*shaded(view, library), library, wrong_k=float(kelvin))


def stated_environment(view, library, kelvin):
    return replace(wrong_environment(view, library, kelvin), stated_k=kelvin)


def wrong_wavelengths(view, library, bands):
    cube, truth = shaded(view, library)
    w = cube.wavelength_um + bands * np.diff(cube.wavelength_um).mean()
    # the truth takes the same wavelengths, to be comparable at all
    return Case(changed(cube, wavelength_um=w), replace(truth, wavelength_um=w), library)


def wrong_gain(view, library, percent):
    cube, truth = shaded(view, library)
    return Case(changed(cube, cube.radiance * (1 + percent / 100)), truth, library)


def uneven_bands(view, library, percent):
    """Every band has its own gain."""
    cube, truth = shaded(view, library)
    off = percent / 100 * np.random.default_rng(6).normal(size=(cube.bands, 1, 1))
    return Case(changed(cube, cube.radiance * (1 + off)), truth, library)


def wrong_offset(view, library, kelvin):
    cube, truth = shaded(view, library)
    off = noise_sigma(cube.wavelength_um, kelvin)[:, None, None]
    return Case(changed(cube, cube.radiance + off), truth, library)


def stated_gain(view, library, percent):
    """The gain's error is stated, in kelvin at 300 K (mean over the bands)."""
    case = wrong_gain(view, library, percent)
    w = case.cube.wavelength_um
    per_percent = (planck(w, 300.0) / planck_derivative(w, 300.0)).mean() / 100
    return replace(case, said_k=percent * float(per_percent))


def stated_offset(view, library, kelvin):
    return replace(wrong_offset(view, library, kelvin), said_k=kelvin)


def dead_bands(view, library, n):
    """n bands show only their mean."""
    cube, truth = shaded(view, library)
    s, which = cube.radiance.copy(), np.random.default_rng(3).permutation(cube.bands)[:n]
    s[which] = s[which].mean(axis=(1, 2), keepdims=True)
    return Case(changed(cube, s), truth, library)


def noisy_bands(view, library, n):
    """n bands have ten times the stated noise."""
    cube, truth = shaded(view, library)
    s, which = cube.radiance.copy(), np.random.default_rng(3).permutation(cube.bands)[:n]
    rng = np.random.default_rng([4, view.draw])
    s[which] = add_noise(s[which], cube.wavelength_um[which], 0.5, rng)
    return Case(changed(cube, s), truth, library)


def stripes(view, library, netds):
    """Every column of the detector has its own offset in every band."""
    cube, truth = shaded(view, library)
    off = np.random.default_rng(5).normal(size=(cube.bands, 1, cube.shape[1]))
    off = netds * off * cube.sigma[:, None, None]
    return Case(changed(cube, cube.radiance + off), truth, library)


def saturated_pixels(view, library, percent):
    cube, truth = shaded(view, library)
    most = np.percentile(cube.radiance, 100 - percent, axis=(1, 2), keepdims=True)
    return Case(changed(cube, np.minimum(cube.radiance, most)), truth, library)


def hot_part(view, library, percent):
    """A square of the ground is 300 K hotter, as in a fire; the light it casts is left out."""
    cube, truth = shaded(view, library)
    side = round((percent / 100 * cube.radiance[0].size) ** 0.5)
    left = (cube.shape[1] - side) // 2
    at = np.s_[cube.shape[0] - side :, left : left + side]
    part, t, w = (slice(None), *at), truth.temperature_k.copy(), cube.wavelength_um[:, None, None]
    s, t[at] = cube.radiance.copy(), t[at] + 300
    hotter = planck(w, t[at]) - planck(w, truth.temperature_k[at])
    s[part] += truth.emissivity[part] * hotter
    return Case(changed(cube, s), replace(truth, temperature_k=t), library)


def mirrors(view, library, share):
    return Case(*shaded(replace(view, mirror=share), library), library)


def polished_plate(view, library, share):
    return Case(*shaded(replace(view, plate=share), library), library)


def air_between(view, library, metres):
    """So many metres of air before half of the ground, and more or less before the rest. It is as
    humid as the scene's, and absorbs by turns a third more and less than the sky's own."""
    cube, truth = shaded(view, library, netd_k=0)
    air, bands = view.traced.atmosphere, Bands.of(cube.wavelength_um, cube.fwhm_um)
    distance, is_sky = _distances(view.name, view.seed), ~non_sky(truth)
    ground = np.isfinite(distance)
    distance = distance.copy()
    distance[ground] *= metres / np.median(distance[ground])
    off = lambda w: np.exp(0.3 * smooth(1, w, 7)[0])
    through = lambda m: bands.average(bands.in_cells(
        lambda w: level_transmittance(w, m, air) ** off(w)
    ))  # fmt: skip
    steps = np.concatenate([[0.0], np.geomspace(0.1, 1e5, 91)])
    t = np.append([through(m) for m in steps], np.zeros((1, cube.bands)), axis=0)  # infinitely far
    at = np.interp(distance, steps, np.arange(len(steps)))
    at[np.isinf(distance)] = len(steps)
    low, high = np.floor(at).astype(int), np.ceil(at).astype(int)
    beyond = (at - low)[..., None]
    t = ((1 - beyond) * t[low] + beyond * t[high]).mean(axis=-2).transpose(2, 0, 1)
    sky = np.isinf(distance).mean(axis=-1)
    # a pixel is a mix of sky, which already includes all its air, and ground behind some air
    s, w = cube.radiance.astype(np.float64), cube.wavelength_um
    at = distance_transform_edt(~is_sky, return_distances=False, return_indices=True)
    of_sky = sky * s[:, *at]
    glow = planck(w, air.air_temperature_k)[:, None, None]
    seen = t / np.maximum(1 - sky, 1e-9) * (s - of_sky) + (1 - sky - t) * glow + of_sky
    s = add_noise(np.where(is_sky, s, seen), w, NETD_K, np.random.default_rng(view.draw))
    return Case(HeatCube(s, w, cube.fwhm_um, NETD_K), truth, library)


@lru_cache(maxsize=8)
def _distances(name, seed):
    """(height, width, parts) m to parts of each pixel."""
    scene, library, n = preset(name, seed), MaterialLibrary.starter(), 4
    of_scene = library.subset(dict.fromkeys(o.material for o in scene.objects))
    distance = Tracer(scene, of_scene).seen((SIZE[0] * n, SIZE[1] * n))[1]
    parts = distance.reshape(SIZE[0], n, SIZE[1], n).transpose(0, 2, 1, 3)
    return parts.reshape(*SIZE, n * n)


def changed(cube, radiance=None, wavelength_um=None):
    """A HeatCube without dead pixels, with another radiance or other wavelengths."""
    return replace(
        cube, dead=None, radiance=cube.radiance if radiance is None else radiance,
        wavelength_um=cube.wavelength_um if wavelength_um is None else wavelength_um,
    )  # fmt: skip


def cropped(cube, truth, top):
    """Cube and truth without their first rows."""
    maps = ("temperature_k", "material", "sky_view", "sky_texture", "visible")
    truth = replace(
        truth, **{name: getattr(truth, name)[top:] for name in maps},
        emissivity=truth.emissivity[:, top:], texture=truth.texture[:, top:],
    )  # fmt: skip
    return changed(cube, cube.radiance[:, top:]), truth


def common(truth):
    """Names of the visible materials except the sky, most pixels first."""
    seen = np.bincount(truth.material[non_sky(truth)], minlength=len(truth.material_names))
    return [truth.material_names[m] for m in np.argsort(-seen) if seen[m]]


@dataclass(frozen=True)
class Axis:
    """label describes the levels; case(view, library, level) -> Case."""

    label: str
    levels: tuple
    case: Callable
    views: tuple = OUTDOORS


AXES = {
    "emissivity to 1": Axis(
        "share of 1 - e left", (1, 0.5, 0.2, 0.1, 0.05, 0.02), emissivity_to_one
    ),
    "grey bodies": Axis("share of spectral contrast", (1, 0.5, 0.2, 0.1, 0.02, 0), grey_bodies),
    "thermal crossover": Axis(
        "share of T contrast, indoors", (1, 0.5, 0.2, 0.1, 0.03, 0), thermal_crossover, INDOORS
    ),
    "bands": Axis("bands", (54, 27, 18, 9, 6, 4, 3, 2, 1), fewer_bands),
    "bands end early": Axis(
        "last band ends by (um)", (14, 13, 12.5, 12, 11.5), bands_that_end_early
    ),
    "noise": Axis("NETD (K)", (0.005, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2), noise),
    "noise not stated": Axis("bands", (54, 18, 12, 9, 6, 4, 3), unstated_noise),
    "sky out of view": Axis("share of sky rows cut off", (0, 0.3, 0.6, 0.9, 1), sky_out_of_view),
    "overcast": Axis(
        f"base of the cloud (km; {NO_CLOUD_KM}: none)", (NO_CLOUD_KM, 7, 4, 2, 1, 0.5), overcast
    ),
    "k at 54 bands": Axis("objects k", (1, 2, 3, 5, 8, 10), objects_at_54_bands),
    "k at 6 bands": Axis("objects k", (1, 2, 3, 5, 8, 10), objects_at_6_bands),
    "wrong curves": Axis("error of e (%)", (0, 0.5, 1, 2, 5, 10), wrong_curves),
    "material missing": Axis("materials missing", (0, 1, 2, 3), missing_materials),
    "twin materials": Axis("difference of e (%)", (5, 2, 1, 0.5, 0.2), twin_materials),
    "mixed pixels": Axis("pixels in one, a side", (1, 2, 3, 4, 6), mixed_pixels),
    "wrong environment": Axis("environment's error (K)", (0, 1, 3, 10, 30), wrong_environment),
    "wrong environment, as stated": Axis(
        "environment's error (K)", (0, 1, 3, 10, 30), stated_environment
    ),
    "wavelengths off": Axis("shift (bands)", (0, 0.1, 0.3, 1, 2, 3), wrong_wavelengths),
    "gain off": Axis("gain error (%)", (0, 0.3, 1, 3, 10), wrong_gain),
    "gain off, as stated": Axis("gain error (%)", (0, 0.3, 1, 3, 10), stated_gain),
    "bands' gains off": Axis("error of each by itself (%)", (0, 0.1, 0.3, 1, 3), uneven_bands),
    "offset": Axis("offset (K at 300 K)", (0, 0.1, 0.3, 1, 3), wrong_offset),
    "offset, as stated": Axis("offset (K at 300 K)", (0, 0.1, 0.3, 1, 3), stated_offset),
    "dead bands": Axis("how many are dead", (0, 1, 2, 5, 10), dead_bands),
    "noisy bands": Axis("how many are noisy", (0, 1, 2, 5, 10), noisy_bands),
    "stripes": Axis("stripes' sigma (NETD)", (0, 0.5, 1, 3, 10), stripes),
    "mirror-like surfaces": Axis("share of the reflection", (0, 0.1, 0.3, 0.6, 1), mirrors),
    "polished steel": Axis(
        "an eighth of the picture; share of the reflection", (0, 0.1, 0.3, 0.6, 1), polished_plate
    ),
    "saturation": Axis("saturated in each band (%)", (0, 1, 5, 20, 50), saturated_pixels),
    "hot part": Axis("pixels 300 K hotter (%)", (0, 1, 3, 6, 10), hot_part),
    "air between": Axis("m to half of the ground", (0, 10, 30, 100, 300, 1000), air_between),
}
