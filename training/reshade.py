"""Training scenes made of any library: traced once, then shaded with its curves.

The geometry, temperatures and skies are those of `scenes`; each object gets one of the library's
materials at random. Light paths depend on no wavelength and no curve, so they are traced once for
all libraries and kept on disk. A Record is shaded from them on request, in a third of a second,
each time a scene is used with other materials.

    <folder>/<hash>-traced-<e>/train-0000.npz   a TracedScene
"""

from dataclasses import replace

import numpy as np

from physics.bands import equidistant_bands
from physics.errors import InputError
from physics.library import SKY, MaterialLibrary
from physics.simulator.traced import TracedScene, trace_scene
from texnet.files.library_io import with_sky

from .scenes import BASE_SEED, Record, SceneSet, Settings, loaded, of_seed, scene_of

# e of all surfaces while tracing: the less, the longer the paths. Weights
# (1 - e) / (1 - TRACED_WITH) stay tame if their mean square is below 1: for e of 0.16, 0.05 and
# 0.015 and more
TRACED_WITH = 0.3, 0.1, 0.03
TURNS = 8  # versions of each scene with other materials, before they repeat
MIN_BANDS = 8  # half a micrometre


class ReshadedSet(SceneSet):
    """The first `count` scenes of a split made of a library's materials; TURNS times as many
    Records.

    folder    as for SceneSet
    library   MaterialLibrary that covers at least half a micrometre of 8-14 um; one without
              sky gets the starter library's (`with_sky`)
    seed      of the assignment of materials to objects
    settings  Settings

    Raises InputError for invalid arguments.
    """

    def __init__(self, folder, split, count, library, seed=0, settings=Settings()):  # noqa: B008 (it is frozen)
        super().__init__(folder, split, count, settings)
        self.library, self.seed = with_sky(library), seed
        if len(self.library) < 2:
            raise InputError("library: it holds no material but the sky.")
        w, width = equidistant_bands(settings.bands)
        inside = self.library.covers(w - width / 2) & self.library.covers(w + width / 2)
        if inside.sum() < MIN_BANDS:
            low, high = self.library.wavelength_um[[0, -1]]
            raise InputError(
                f"library: it covers {low:g}-{high:g} um; training needs half a micrometre or "
                "more of 8-14 um."
            )
        self.wavelength_um, self.fwhm_um = w[inside], width[inside]
        solids = self.library.at(self.wavelength_um)[~self.library.is_sky]
        most_reflected = 1 - solids.min()
        tame = [e for e in TRACED_WITH if most_reflected**2 < 1 - e]
        self.traced_with = tame[0] if tame else TRACED_WITH[-1]
        # the same hash: the same scenes
        self.folder = self.folder.with_name(f"{self.folder.name}-traced-{self.traced_with}")

    def __len__(self):
        return TURNS * self.count

    def __getitem__(self, i):
        """Record i, of scene i modulo count. InputError if it is not traced yet."""
        cube, truth = self.shade(i, self.wavelength_um, self.fwhm_um, 0)
        return Record(
            cube.radiance, truth.texture.astype(np.float16), truth.temperature_k, truth.sky_view,
            truth.material.astype(np.min_scalar_type(len(self.library))),
            self.library.at(self.wavelength_um).astype(np.float32), self.library.names,
            self.wavelength_um, BASE_SEED[self.split] + i % self.count,
        )  # fmt: skip

    def shade(self, i, wavelength_um, fwhm_um, netd_k):
        """Record i as a camera sees it -> (HeatCube, Truth); arguments as TracedScene.shade."""
        turn, scene = divmod(range(len(self))[i], self.count)
        traced = loaded(TracedScene, self.path(scene))
        rng = np.random.default_rng([self.seed, BASE_SEED[self.split] + scene, turn])
        solid = rng.permutation([n for n in self.library.names if n != SKY])
        solid = np.resize(solid, len(traced.materials))
        materials = dict(zip(traced.materials, solid, strict=True))
        return traced.shade(self.library, wavelength_um, fwhm_um, netd_k, materials)

    def render(self, i):
        """Trace scene i -> TracedScene."""
        return of_seed(self._trace, self.split, i)

    def _trace(self, seed):
        starter = MaterialLibrary.starter()
        grey = replace(starter, emissivity=np.full_like(starter.emissivity, self.traced_with))
        size = (self.settings.size,) * 2
        return trace_scene(scene_of(seed), size, self.settings.spp, seed, grey)

    def in_words(self):
        """Description of the folder's content, a dict of plain values."""
        return {
            "what": "light paths of simulated scenes, traced by training/reshade.py",
            "size": self.settings.size,
            "spp": self.settings.spp,
            "traced_with_emissivity": self.traced_with,
            "first_seed": BASE_SEED,
        }
