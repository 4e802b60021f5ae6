"""Truth: what is so in every pixel of a simulated cube, and its file.

The file is an npz without pickles whose keys are the field names.
"""

import zipfile
import zlib
from dataclasses import dataclass, fields

import numpy as np

from ..errors import InputError
from ..whole_file import whole_file


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
    sky_view        (height, width) V_sky, cosine-weighted part of the hemisphere that is sky
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

    def save(self, path):
        """Write a compressed npz, whole or not at all."""
        arrays = {f.name: np.asarray(getattr(self, f.name)) for f in fields(self)}
        # A file and not its name, to which numpy would add .npz.
        with whole_file(path) as part, open(part, "wb") as file:
            np.savez_compressed(file, **arrays)

    @staticmethod
    def load(path):
        """Read what `save` wrote; InputError if it is not that."""
        try:
            # Opened here, because np.load leaks the file if it is no whole zip.
            with open(path, "rb") as file, np.load(file, allow_pickle=False) as data:
                missing = [f.name for f in fields(Truth) if f.name not in data.files]
                arrays = {f.name: data[f.name] for f in fields(Truth) if f.name in data.files}
        except (OSError, ValueError, EOFError, TypeError, zipfile.BadZipFile, zlib.error) as e:
            reason = getattr(e, "strerror", None) or "it is not a whole npz file of plain arrays"
            raise InputError(f"truth: cannot read {path}: {reason}.") from e
        if missing:
            raise InputError(f"truth: {path} is no truth file; it lacks {', '.join(missing)}.")
        arrays["material_names"] = tuple(str(n) for n in arrays["material_names"])
        return Truth(**arrays)
