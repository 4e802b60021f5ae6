"""Truth: what is so in every pixel of a simulated cube, and its file.

The file is an npz without pickles whose keys are the field names.
"""

from dataclasses import dataclass, fields

import numpy as np

from .cube.heat_cube import check_wavelength, numbers
from .errors import InputError
from .machinery.array_file import load_arrays, save_arrays


@dataclass(frozen=True, eq=False)
class Truth:
    """Ground truth of a simulated cube; float32 unless said.

    A mixed pixel's material is the majority of its samples, and all else but `visible` is
    the mean over that material's samples. In sky pixels T is the air's, X = 0 and e is
    S / B(T), so that Eq. 1 holds there too; sky_texture is the sky's own radiance.

    temperature_k   (height, width) K
    material        (height, width) int16 index into material_names
    material_names  names, as in the library
    emissivity      (bands, height, width) e, 0..1
    texture         (bands, height, width) X, W m-2 sr-1 um-1
    sky_view        (height, width) V_sky, cosine-weighted part of the hemisphere that is sky; of
                    a mirror, the part of what it reflects
    sky_texture     (height, width) band mean of X with every emitter but the sky off
    visible         (height, width, 3) linear RGB daylight picture, about 0..1
    wavelength_um   (bands,) float64, um
    """

    temperature_k: np.ndarray
    material: np.ndarray
    material_names: tuple[str, ...]
    emissivity: np.ndarray
    texture: np.ndarray
    sky_view: np.ndarray
    sky_texture: np.ndarray
    visible: np.ndarray
    wavelength_um: np.ndarray

    def __repr__(self):
        height, width = self.material.shape
        names = [self.material_names[i] for i in np.unique(self.material)]
        return f"<Truth of {height} x {width} pixels: {', '.join(names)}>"

    def save(self, path):
        """Write a compressed npz, whole or not at all."""
        arrays = {f.name: np.asarray(getattr(self, f.name)) for f in fields(self)}
        save_arrays(path, arrays, compress=True)

    @staticmethod
    def load(path):
        """Read what `save` wrote; InputError if it is not that."""
        arrays = load_arrays(path, [f.name for f in fields(Truth)], "truth")
        try:
            _check(arrays)
        except InputError as e:
            raise InputError(f"{str(e).rstrip('.')} (in {path}).") from e
        arrays["material_names"] = tuple(str(n) for n in arrays["material_names"])
        return Truth(**arrays)

    def check_cube(self, cube):
        """Raise InputError unless this could be the truth of a HeatCube, by size and bands."""
        own, bands = self.wavelength_um, cube.wavelength_um
        if self.material.shape != cube.shape:
            raise InputError(
                f"truth: it has {self.material.shape} pixels, the cube beside it {cube.shape}; "
                "move it away."
            )
        if own.shape != bands.shape or not np.allclose(own, bands, 0, 1e-3):
            raise InputError(
                "truth: its wavelengths are not those of the cube beside it; move it away."
            )


def _check(arrays):
    """InputError unless arrays, by field name, fit each other as Truth says."""
    material, names = arrays["material"], arrays["material_names"]
    bands = check_wavelength(arrays["wavelength_um"], "truth").shape
    if material.ndim != 2 or names.ndim != 1:
        raise InputError("truth: material must be (height, width), and material_names a list.")
    pixels = material.shape
    shapes = {
        "temperature_k": pixels, "sky_view": pixels, "sky_texture": pixels,
        "emissivity": bands + pixels, "texture": bands + pixels, "visible": (*pixels, 3),
    }  # fmt: skip
    for name, shape in shapes.items():
        if arrays[name].shape != shape:
            raise InputError(f"truth: {name} must be {shape}, got {arrays[name].shape}.")
        if not np.isfinite(numbers(arrays[name], f"truth: {name}")).all():
            raise InputError(f"truth: {name} must be finite.")
    if material.dtype.kind not in "iu" or not ((material >= 0) & (material < names.size)).all():
        raise InputError(f"truth: material must hold whole numbers, 0..{names.size - 1}.")
