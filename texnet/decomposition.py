"""Decomposition: the answer for every pixel of a cube, and how sure it is."""

import math
from dataclasses import dataclass, field

import numpy as np

from physics.errors import InputError


@dataclass(frozen=True, eq=False, repr=False)
class Decomposition:
    """TeX and how sure it is. Maps are (height, width).

    temperature_k         K; of sky pixels that of what may stand before the sky, or the air's
    material              int16, index into material_names
    emissivity            (materials, bands) the means of their curves over the bands: a pixel's e
                          is that of its material
    thermal_lighting      V (k, height, width), summing to 1; of sky pixels zero, or by net and
                          net+sgd, where it may be, that of what stands before the sky
    environment           (k, bands) W m-2 sr-1 um-1;  sky: which of them stand for the sky
    sky_assumed           True where none is in view, and a clear one explains what is
    texture               X (bands, height, width) W m-2 sr-1 um-1, its mean over each band, of sky
                          pixels likewise
    sky_texture           the texture that the sky alone lights, W m-2 sr-1 um-1 (band mean),
                          likewise; where sky is (), the residual instead, in noise units
    residual              root mean square of S - S~ in noise units, less what deviations of
                          the surroundings from the k objects, and of curves, explain
    temperature_sigma_k   one standard deviation of T, K; doubt about m, at edges and of the
                          calibration, stated and found, included; 15 K and more where the pixel
                          is saturated or dead
    material_probability  (materials, height, width); zero what `glance` did not see there
    unknown               True where the answer should not be trusted: no material of the library
                          fits, or clearly worse than elsewhere in the scene, or is likely enough
                          (`uncertainty`); only the neighbours speak for the one given; or the
                          pixel is saturated or dead
    saturated             True where a band is at its ceiling: T is a lower bound
    dead                  True where nothing was measured: maps are a guess by the nearest spectrum
    hot                   True where a pixel is far hotter than the rest, and was solved apart
    wavelength_um         (bands,) um, as stated, of the bands that were used
    spectral_shift_um     um by which they were taken to be less than stated (negative: more)
    gain, offset_k        errors of all bands together that were taken out: the cube showed
                          gain S + offset, the offset in K at 300 K; 1 and 0 where none was found
    band_gains            (bands,) further factors of the bands among each other, taken out
                          likewise; 1 where none was found
    air_m, air_k          length, m, and temperature, K, of the air before the camera that was
                          taken out; 0 and NaN where there is too little to tell
    air_error             one standard deviation of its optical depth, as a share of that, more
                          where usual air does not fit: bands are so much noisier, beyond netd_k
    air_error_k           K by which T would be another, were that much of it off in many bands
                          alike; sigma holds it
    distance_m            (height, width) m of that air before each pixel; None where there is too
                          little to tell
    calibration_error_k   as it was stated, K at 300 K
    curve_error           one standard deviation by which e of the library's curves is taken to be
                          off, where pixels are likelier so; sigma holds it. 0 where they fit
    suspected_error_k     K by which T would be another if corrected by a gain, an offset or air
                          that is likelier than none, but not surely there; sigma holds it
    environment_error_k   K by which an environment that was given is likely off, and which T and
                          its sigma take into account; 0 where it fits
    left_out              {wavelength_um: why} of those that were not: dead, hot, off or beyond the
                          library where they were found to lie
    hue_deg               (materials,) TeX-vision hues
    camera_netd_k         the camera's NETD, as stated or estimated, K
    noise_raised          how many times that was assumed: above 1 where the fit asks for more
                          noise, or the camera has less than what k objects leave out
    netd_k                NETD that this makes of the corrected cube, K; where air was taken out, of
                          which opaque bands are noisier, that of even noise that tells as much
    made_by               what made it: "texnet" (its version), "method", "k", "seed" and
                          "environment" (None, or that one was given) as decompose was asked; by the
                          command also the names of its files, or None: "cube", "library", "model"
                          and "environment"
    objective             E of `physics.exact.semiglobal` along the refinement, nats; () but for sgd
    seconds               time by stage
    """

    temperature_k: np.ndarray
    material: np.ndarray
    material_names: tuple[str, ...]
    thermal_lighting: np.ndarray
    environment: np.ndarray
    sky: tuple[int, ...]
    texture: np.ndarray
    sky_texture: np.ndarray
    residual: np.ndarray
    temperature_sigma_k: np.ndarray
    material_probability: np.ndarray
    unknown: np.ndarray
    saturated: np.ndarray
    dead: np.ndarray
    hot: np.ndarray
    wavelength_um: np.ndarray
    emissivity: np.ndarray
    hue_deg: np.ndarray
    camera_netd_k: float
    netd_k: float
    sky_assumed: bool = False
    noise_raised: float = 1.0
    spectral_shift_um: float = 0.0
    gain: float = 1.0
    band_gains: np.ndarray | float = 1.0
    offset_k: float = 0.0
    air_m: float = 0.0
    air_k: float = math.nan
    air_error: float = 0.0
    air_error_k: float = 0.0
    distance_m: np.ndarray | None = None
    calibration_error_k: float = 0.0
    curve_error: float = 0.0
    suspected_error_k: float = 0.0
    environment_error_k: float = 0.0
    left_out: dict = field(default_factory=dict)
    made_by: dict = field(default_factory=dict)
    objective: tuple[float, ...] = ()
    seconds: dict = field(default_factory=dict)

    def __repr__(self):
        (height, width), seen = self.material.shape, ~self.dead
        return (
            f"<Decomposition of {height} x {width} pixels: half warmer than "
            f"{np.nanmedian(self.temperature_k[seen]):.1f} K, "
            f"{len(np.unique(self.material[seen]))} materials, {self.unknown[seen].mean():.1%} "
            "unknown>"
        )


def check_decomposition(decomposition):
    """Raise InputError for what has no map of materials, as a cube has none."""
    if not hasattr(decomposition, "material_names"):
        raise InputError(
            "decomposition: it must be what texnet.decompose returns, got "
            f"{type(decomposition).__name__}."
        )
