"""Environment: S_1 ... S_k of Eq. 1, the k objects whose light falls on every pixel."""

from dataclasses import dataclass, replace

import numpy as np

from .cube.dead_pixels import HOTTEST_K
from .cube.heat_cube import check_wavelength, numbers
from .errors import Implausible, InputError
from .machinery.read_only import ReadOnly
from .planck import brightness_temperature, planck, planck_derivative
from .prior import MIN_TEMPERATURE_SPREAD_K, SampledSpectra, lighting_scale

MOST_OBJECTS = 10  # what a pixel takes grows with their square
HOTTER_K = 100.0  # than the cube: in other units
COLDER_K = 150.0  # than it is no dry sky between 10 and 12 um, nor what lights a heated plate
WARM_SKY_K = 60.0  # warmer than all that is seen is no sky, but an irradiance
# an environment that is COLD_SKY_K colder than the scene, and if it were per cm-1 within NEAR_K of
# it, is per cm-1; sky alone also if it were colder then by less than COLD_SKY_K
COLD_SKY_K, NEAR_K = 110.0, 30.0
SMOOTH_UM, SMALL = 0.5, 0.003  # of errors of curves; of the largest of them, and left out


@dataclass(frozen=True, eq=False)
class Environment(ReadOnly):
    """Spectra S_1..S_k of the equivalent environment objects, immutable.

    radiance       (k, bands) W m-2 sr-1 um-1, finite and positive
    wavelength_um  (bands,) um, ascending
    sky            indices of the objects that stand for the sky; empty if none does
    spread         (d, bands) one-sigma deviations of true surroundings from the k spectra
    skylight_spread  (d, bands) those of the sky's light from the objects that stand for it
    error_k        the remaining deviation, in each band independently, as an NETD, K at 300 K;
                   None: not known, and 0 unless a cube's pixels tell (`estimate.completed`)
    sky_mean       (bands,) mean of the sky's own pixels; None if it is not in view: then no pixel
                   can be sky, or partly sky
    sky_spread     (d, bands) one-sigma deviations of the sky's pixels from their mean
    within         (len(sky), bands, n) the sky's objects at the n nodes of `bands.quadrature`
                   within each band, in any unit; None: constant within each band
    curve_spread   (d, bands) one-sigma deviations of everything but sky, from errors of its curves
    usual_lighting (k,) prior mean of V over the scene; None: 1/k each, unless the pixels suggest
                   another (`lighting`)

    Raises InputError if the data are not as described.
    """

    radiance: np.ndarray
    wavelength_um: np.ndarray
    sky: tuple[int, ...] = ()
    spread: np.ndarray | None = None
    skylight_spread: np.ndarray | None = None
    error_k: float | None = None
    sky_mean: np.ndarray | None = None
    sky_spread: np.ndarray | None = None
    within: np.ndarray | None = None
    curve_spread: np.ndarray | None = None
    usual_lighting: np.ndarray | None = None

    def __post_init__(self):
        w = check_wavelength(self.wavelength_um, "environment")
        s = np.array(numbers(self.radiance, "environment: radiance"), dtype=np.float64)
        if s.ndim != 2 or s.shape[1] != w.size or s.shape[0] == 0:
            raise InputError(
                f"environment: radiance must be (k, {w.size} bands) with k >= 1, got {s.shape}."
            )
        if len(s) > MOST_OBJECTS:
            raise InputError(
                f"environment: it holds {len(s)} objects; give at most {MOST_OBJECTS}, averaging "
                "similar ones."
            )
        if not np.isfinite(s).all() or (s <= 0).any():
            raise Implausible("environment: radiance must be finite and positive.")
        if (s > planck(w, HOTTEST_K)).any():
            raise Implausible(
                f"environment: radiance looks hotter than {HOTTEST_K:.0f} K; give it in "
                "W m-2 sr-1 um-1."
            )
        sky = tuple(np.atleast_1d(self.sky).tolist())
        known = all(type(j) is int and j in range(len(s)) for j in sky)
        if not known or len(set(sky)) != len(sky):
            raise InputError(
                f"environment: sky must hold different indices in 0..{len(s) - 1}, not a mask."
            )
        error = numbers(0.0 if self.error_k is None else self.error_k, "environment: error_k")
        if error.ndim or not 0 <= error <= 100:
            raise InputError(f"environment: error_k must be 0-100 K, got {self.error_k}.")
        none = np.zeros((0, w.size))
        names = ("spread", "skylight_spread", "curve_spread", "sky_spread")
        given = {name: getattr(self, name) for name in names}
        fields = {
            n: none if a is None else np.array(numbers(a, f"environment: {n}"), np.float64)
            for n, a in given.items()
        }
        if self.sky_mean is not None:
            mean = numbers(self.sky_mean, "environment: sky_mean")
            fields["sky_mean"] = np.array(mean, np.float64)
        for name, array in fields.items():
            if array.shape[-1:] != (w.size,) or array.ndim != 2 - (name == "sky_mean"):
                raise InputError(f"environment: {name} must hold {w.size} bands.")
            if not np.isfinite(array).all():
                raise Implausible(f"environment: {name} must be finite.")
            if name == "sky_mean" and (array <= 0).any():
                raise Implausible("environment: sky_mean must be positive.")
        if self.within is not None:
            within = np.array(numbers(self.within, "environment: within"), np.float64)
            if within.ndim != 3 or within.shape[:2] != (len(sky), w.size) or not within.size:
                raise InputError(
                    f"environment: within must be ({len(sky)} of the sky, {w.size} bands, n), got "
                    f"{within.shape}."
                )
            if not np.isfinite(within).all() or (within <= 0).any():
                raise InputError("environment: within must be finite and positive.")
            fields["within"] = within
        if self.usual_lighting is not None:
            usual = numbers(self.usual_lighting, "environment: usual_lighting").astype(np.float64)
            if usual.shape != (len(s),) or not (usual >= 0).all() or abs(usual.sum() - 1) > 1e-5:
                raise InputError(
                    f"environment: usual_lighting must be {len(s)} shares that sum to 1."
                )
            fields["usual_lighting"] = usual
        self._set(radiance=s, sky=sky, wavelength_um=w, **fields)

    def __repr__(self):
        w, n = self.wavelength_um, len(self)
        sky = f", of which sky {', '.join(map(str, self.sky))}" if self.sky else ""
        return (
            f"<Environment of {n} object{'s' * (n > 1)}{sky}, {w.size} bands at "
            f"{w[0]:.4g}-{w[-1]:.4g} um>"
        )

    def __len__(self):
        return len(self.radiance)

    @property
    def known_error_k(self):
        """error_k, or 0 if it is not known."""
        return self.error_k or 0.0

    @property
    def usual(self):
        """(k,) usual_lighting, or 1/k each."""
        if self.usual_lighting is None:
            return np.full(len(self), 1 / len(self))
        return self.usual_lighting

    def only(self, good):
        """The Environment of some of its bands, (bands,) bool."""
        names = (
            "radiance", "spread", "skylight_spread", "curve_spread", "sky_mean", "sky_spread"
        )  # fmt: skip
        given = {n: a for n in names if (a := getattr(self, n)) is not None}
        cut = {n: a[..., good] for n, a in given.items()}
        if self.within is not None:
            cut["within"] = self.within[:, good]
        return replace(self, wavelength_um=self.wavelength_um[good], **cut)

    def at_nodes(self, nodes_um):
        """(k, bands, n) the objects' spectra at nodes (bands, n) um within each band, with
        `radiance` as their mean: the sky's shaped as in `within`, the others' like black bodies."""
        n = nodes_um.shape[1]
        if n == 1:
            return self.radiance[..., None].copy()
        seen_k = brightness_temperature(self.wavelength_um, self.radiance)
        light = planck(nodes_um, seen_k[..., None])
        light[list(self.sky)] = 1.0  # to be even is nearer to a sky than a black body
        if self.within is not None:
            m = self.within.shape[2]  # of more bands, which may have been wider
            at, told = (np.arange(n) + 0.5) / n, (np.arange(m) + 0.5) / m
            for j, sky in zip(self.sky, self.within, strict=True):
                light[j] = [np.interp(at, told, band) for band in sky]
        return light * (self.radiance / light.mean(axis=-1))[..., None]

    def off_by(self, kelvin, objects=None):
        """The Environment with all of its objects, or some (by index), possibly warmer or colder
        together by so many K (one standard deviation), which adds to `spread`: for spectra that
        were measured elsewhere or at another time.

        Raises InputError if kelvin is not 0-100.
        """
        error = numbers(kelvin, "environment: off_by")
        if error.ndim or not 0 <= error <= 100:
            raise InputError(f"environment: off_by must be 0-100 K, got {kelvin}.")
        seen_k = brightness_temperature(self.wavelength_um, self.radiance)
        off = error * planck_derivative(self.wavelength_um, seen_k)
        if objects is not None:
            off[np.isin(np.arange(len(off)), objects, invert=True)] = 0
        # of sum V_j off_j, of any V as likely as it is a priori, the two directions that vary most
        free = (off - off.mean(axis=0)) * lighting_scale(len(off))
        rows = np.concatenate([(self.usual @ off)[None], free])
        _, length, direction = np.linalg.svd(rows, full_matrices=False)
        rows = (length[:, None] * direction)[:2]
        return replace(self, spread=np.concatenate([self.spread, rows]))

    def with_curves_off_by(self, error):
        """The Environment with the materials' emissivity possibly off by error (one standard
        deviation, 0..1), smoothly over SMOOTH_UM: by Eq. 1 that changes a spectrum by de (B - X).

        B is taken at the temperatures of these objects and up to some 15 K warmer or colder, V from
        its prior. This replaces an earlier curve_spread.

        Raises InputError if error is not 0-1."""
        error = numbers(error, "environment: with_curves_off_by")
        if error.ndim or not 0 <= error <= 1:
            raise InputError(f"environment: with_curves_off_by must be 0-1, got {error}.")
        w, s = self.wavelength_um, self.radiance
        usual_k = np.median(brightness_temperature(w, s).max(axis=1))  # the sky's: about the air's
        off = np.concatenate([
            [planck(w, usual_k) - self.usual @ s],
            (s - s.mean(axis=0)) * lighting_scale(len(s)),
            [MIN_TEMPERATURE_SPREAD_K * planck_derivative(w, usual_k)],
        ])  # fmt: skip
        alike = np.exp(-0.5 * ((w[:, None] - w) / SMOOTH_UM) ** 2)
        variance, direction = np.linalg.eigh(error**2 * alike * (off.T @ off))
        some = variance > SMALL**2 * variance[-1]
        return replace(self, curve_spread=(direction * np.sqrt(variance.clip(0))).T[some])

    def check(self, cube):
        """Raise InputError unless the environment is plausible for a HeatCube: it has the cube's
        bands, some object is not far hotter than the pixels, no sky object is hotter than they are
        in any band, and some object is in some band not far colder than half of the pixels."""
        self.check_bands(cube.wavelength_um)
        objects_k = brightness_temperature(self.wavelength_um, self.radiance)
        coldest, warmest = objects_k.mean(axis=1).min(), objects_k.max()
        scene_k = SampledSpectra.of(cube).brightness_k.mean(axis=1)
        half, hottest = np.median(scene_k), scene_k.max()
        if coldest > hottest + HOTTER_K:
            raise InputError(
                f"environment: all of it looks like {coldest:.0f} K and hotter, but the cube like "
                f"{hottest:.0f} K at most; give both in W m-2 sr-1 um-1."
            )
        sky = objects_k[list(self.sky)].max(initial=0.0)
        if sky > hottest + WARM_SKY_K:
            raise InputError(
                f"environment: its sky looks like {sky:.0f} K in some band, but the cube like "
                f"{hottest:.0f} K at most; give both as radiance in W m-2 sr-1 um-1, not as "
                "irradiance."
            )
        per_um = self.radiance * 1e4 / self.wavelength_um**2
        converted = brightness_temperature(self.wavelength_um, per_um).max()
        all_sky = len(self.sky) == len(self)
        colder = COLD_SKY_K if all_sky else NEAR_K
        if warmest < half - COLD_SKY_K and half - colder < converted < half + NEAR_K:
            raise InputError(
                f"environment: it looks like {warmest:.0f} K at most, or like {converted:.0f} K if "
                "it is per cm-1; in that case multiply it by 1e4 / wavelength^2 (um)."
            )
        if warmest < half - COLDER_K:
            raise InputError(
                f"environment: all of it looks like {warmest:.0f} K and colder, but half of the "
                f"cube like {half:.0f} K and warmer; give both in W m-2 sr-1 um-1."
            )

    def check_bands(self, wavelength_um):
        """Raise InputError unless the environment has a cube's bands, wavelength_um (bands,)."""
        own = self.wavelength_um
        if own.shape != wavelength_um.shape or not np.allclose(own, wavelength_um, 0, 1e-3):
            raise InputError(
                "environment: its wavelengths are not the cube's; estimate it from this cube, or "
                "give its spectra at the cube's bands."
            )
