"""Decomposition: the answer for every pixel of a cube, and how sure it is."""

import math
from dataclasses import dataclass, field

import numpy as np

from physics.errors import InputError


@dataclass(frozen=True, eq=False, repr=False)
class Decomposition:
    """TeX, S = e B(T) + (1 - e) X with X lit by V (`physics.eq1`), and its uncertainty. Maps are
    (height, width).

    temperature_k         K; at sky pixels that of what may stand before the sky, or of the air
    material              int16, index into material_names
    emissivity            (materials, bands) library curves averaged over each band; the emissivity
                          of a pixel is that of its material
    thermal_lighting      V (k, height, width), summing to 1; zero at sky pixels, except that net
                          and net+sgd give that of what may stand before the sky
    environment           (k, bands) W m-2 sr-1 um-1;  sky: indices of its sky objects
    sky_assumed           True if no sky is in view, but a clear sky explains the pixels
    texture               X (bands, height, width) W m-2 sr-1 um-1, averaged over each band; sky
                          pixels as in thermal_lighting
    sky_texture           the part of X that the sky contributes, W m-2 sr-1 um-1 (band mean), sky
                          pixels likewise; if sky is (), the residual instead, in noise units
    residual              root mean square of S - S~ in noise units, after removing what deviations
                          of the surroundings from the k objects, and of the curves, explain
    temperature_sigma_k   one standard deviation of T, K, including doubt about m, mixing at edges
                          and the calibration error, stated and found; 15 K and more where the
                          pixel is saturated or dead
    material_probability  (materials, height, width); zero for materials `glance` did not see there
    unknown               True where the answer should not be trusted: no material of the library
                          fits or is likely enough (`uncertainty`); the fit is clearly worse than
                          elsewhere in the scene; only the neighbours support the material given; or
                          the pixel is saturated or dead
    saturated             True where a band is at its ceiling: T is a lower bound
    dead                  True where nothing was measured: maps are a guess by the nearest spectrum
    hot                   True where a pixel is far hotter than the rest, and was solved separately
    wavelength_um         (bands,) um, stated wavelengths of the bands used
    spectral_shift_um     um subtracted from the stated wavelengths (negative: added)
    gain, offset_k        errors common to all bands that were corrected: the cube showed
                          gain S + offset, the offset in K at 300 K; 1 and 0 if none was found
    band_gains            (bands,) relative gains of the bands, also corrected; 1 if none was found
    air_m, air_k          length, m, and temperature, K, of the air before the camera that was
                          corrected for; 0 and NaN if there is too little to tell
    air_error             one standard deviation of its optical depth, as a fraction of it, larger
                          if usual air does not fit; it adds to the bands' noise, beyond netd_k
    air_error_k           change in T, K, if the optical depth were off by that much in many bands
                          together; included in sigma
    distance_m            (height, width) m of that air before each pixel; None if there is too
                          little to tell
    calibration_error_k   as stated, K at 300 K
    curve_error           one standard deviation of e assumed for the library's curves, if that
                          makes the pixels likelier; included in sigma. 0 if the curves fit
    suspected_error_k     change in T, K, if a gain, an offset or air that is likelier than none,
                          but not certain, were corrected; included in sigma
    environment_error_k   K by which a given environment is probably off; T and sigma account for
                          it. 0 if it fits
    left_out              {wavelength_um: reason} of bands not used: dead, hot, off, or outside the
                          library at the wavelengths found for them
    hue_deg               (materials,) TeX-vision hues
    camera_netd_k         the camera's NETD, as stated or estimated, K
    noise_raised          factor by which that was raised: above 1 if the fit needs more noise, or
                          if the camera's is less than what k objects leave unexplained
    netd_k                the resulting NETD of the corrected cube, K; after correction for air,
                          which makes opaque bands noisier, the equally informative uniform one
    made_by               what made it: "texnet" (its version), "method", "k", "seed" and
                          "environment" (None, or that one was given) as decompose was asked; by the
                          command also the names of its files, or None: "cube", "library", "model"
                          and "environment"
    objective             E of `physics.exact.semiglobal` during refinement, nats; () except in sgd
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
