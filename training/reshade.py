"""Training scenes made of any library: traced once, then shaded again with its curves.

The geometry, temperatures and skies are those of `scenes`; each object gets one of the
library's materials at random. Light paths hold no wavelength and no material's curve, so they
are traced once for all libraries and kept on disk; a Record is shaded from them when asked
for, in a third of a second, each time a scene's turn comes with other materials.

    <folder>/<hash>-traced-<e>/train-0000.npz   a TracedScene
"""

import numpy as np

from physics.bands import equidistant_bands
from physics.errors import InputError
from physics.library import SKY, MaterialLibrary
from physics.simulator.presets.random_scene import random_scene
from physics.simulator.traced import TracedScene, trace_scene
from texnet.library_io import with_sky

from .scenes import BASE_SEED, Record, SceneSet, Settings, of_seed

TRACED_WITH = 0.3  # e: paths long enough for curves down to that of bare metal
TURNS = 8  # other materials for each scene, before they repeat
MIN_BANDS = 8  # half a micrometre


class ReshadedSet:
    """The first `count` scenes of a split made of a library's materials; TURNS times as many
    Records.

    folder    as for SceneSet
    library   MaterialLibrary that covers at least half a micrometre of 8-14 um; one without
              sky gets the starter library's (`with_sky`)
    seed      of which object is made of which material
    settings  Settings

    Raises InputError where these are not that.
    """

    def __init__(self, folder, split, count, library, seed=0, settings=Settings()):  # noqa: B008 (it is frozen)
        like = SceneSet(folder, split, count, settings)
        # the same hash: the same scenes
        self.folder = like.folder.with_name(f"{like.folder.name}-traced-{TRACED_WITH}")
        self.split, self.count, self.seed, self.settings = split, count, seed, settings
        self.library = with_sky(library)
        if len(self.library) < 2:
            raise InputError("library: it holds no material but the sky.")
        w, width = equidistant_bands(settings.bands)
        low, high = self.library.wavelength_um[[0, -1]]
        inside = (w - width / 2 >= low - 1e-9) & (w + width / 2 <= high + 1e-9)
        if inside.sum() < MIN_BANDS:
            raise InputError(
                f"library: it covers {low:g}-{high:g} um; training needs half a micrometre or "
                "more of 8-14 um."
            )
        self.wavelength_um, self.fwhm_um = w[inside], width[inside]

    def __len__(self):
        return TURNS * self.count

    def __getitem__(self, i):
        """Record i: scene i modulo count. InputError if it is not traced yet."""
        cube, truth = self.shade(i, self.wavelength_um, self.fwhm_um, 0)
        return Record(
            cube.radiance, truth.texture.astype(np.float16), truth.temperature_k, truth.sky_view,
            truth.sky_texture, truth.material.astype(np.min_scalar_type(len(self.library))),
            self.library.at(self.wavelength_um).astype(np.float32), self.library.names,
            self.wavelength_um, BASE_SEED[self.split] + i % self.count,
        )  # fmt: skip

    def shade(self, i, wavelength_um, fwhm_um, netd_k):
        """Record i as a camera sees it -> (HeatCube, Truth); arguments as TracedScene.shade."""
        turn, scene = divmod(range(len(self))[i], self.count)
        traced = TracedScene.load(self.path(scene))
        rng = np.random.default_rng([self.seed, BASE_SEED[self.split] + scene, turn])
        solid = rng.permutation([n for n in self.library.names if n != SKY])
        solid = np.resize(solid, len(traced.materials))
        materials = dict(zip(traced.materials, solid, strict=True))
        return traced.shade(self.library, wavelength_um, fwhm_um, netd_k, materials)

    def path(self, scene):
        """The file of a traced scene."""
        return self.folder / f"{self.split}-{scene:04d}.npz"

    def make(self, progress=None):
        """Trace the scenes that are missing; may be interrupted, what is done is kept.

        progress  called as progress(done, total) at first and after each scene

        Raises InputError where the folder cannot be written.
        """
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as e:
            raise InputError(f"scenes: cannot make the folder {self.folder}: {e.strerror}.") from e
        missing = [i for i in range(self.count) if not self.path(i).exists()]
        for done in range(self.count - len(missing), self.count + 1):
            if progress is not None:
                progress(done, self.count)
            if missing:
                i = missing.pop(0)
                trace(self.settings, self.split, i).save(self.path(i))


def trace(settings, split, i):
    """Trace scene i of a split -> TracedScene."""
    starter = MaterialLibrary.starter()
    grey = MaterialLibrary(
        starter.names, starter.wavelength_um, np.full_like(starter.emissivity, TRACED_WITH)
    )
    size = (settings.size,) * 2
    return of_seed(
        lambda seed: trace_scene(random_scene(seed), size, settings.spp, seed, grey), split, i
    )
