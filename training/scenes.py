"""Sets of simulated scenes, cached on disk.

Scene i of a split is a pure function of the settings, the split and i, so a set can be made by any
number of processes, interrupted at any point and resumed. A set lives in a folder named by a hash
of all our code and data that determine it, including the simulator's source: what is found there is
what would be made.

    <folder>/<hash>/made.json        the settings, for people
    <folder>/<hash>/train-0000.npz   a Record

Radiance is clean; training adds noise, and drops and merges bands, on the fly. Half of the scenes
are made of the starter library, half of a library varied from it. Of those for training and
validation every other one is enclosed, if outdoors: in a wood or a street.
"""

import json
import multiprocessing
import signal
import sys
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from multiprocessing.connection import wait
from pathlib import Path

import numpy as np

import physics
from physics.bands import equidistant_bands
from physics.errors import InputError
from physics.library import MaterialLibrary
from physics.machinery.array_file import load_arrays, save_arrays
from physics.machinery.provenance import provenance
from physics.machinery.threads import usual_threads
from physics.machinery.whole_file import whole_file
from physics.simulator import simulate
from physics.simulator.presets.random_scene import enclosed_scene, random_scene

from .vary import vary
from .workers import deaf_to_ctrl_c

# Seeds below 10,000 were looked at while the simulator was built and never train or test.
BASE_SEED = {"train": 1_000_000, "validation": 2_000_000, "test": 3_000_000}
MAX_SCENES = 100_000  # of a split; also the step to the seed that stands in for a bad one
MAPS = "temperature_k", "sky_view", "material"  # of a Record
MAX_TRIES = 10  # MAX_TRIES * MAX_SCENES seeds fit between two bases
_PHYSICS, _HERE = Path(physics.__file__).parent, Path(__file__).parent
# of the content of a scene's file, or a traced one's
SOURCES = (
    *(_PHYSICS / name for name in (
        "simulator", "bands.py", "errors.py", "library.py", "planck.py", "sky.py", "truth.py",
        "cube/dead_pixels.py", "cube/heat_cube.py", "cube/netd.py", "cube/saturation.py",
        "machinery/array_file.py", "machinery/compiled.py", "machinery/json_file.py",
        "machinery/read_only.py", "machinery/whole_file.py",
        "data/lowtran7.csv", "data/starter_library.json",
    )),
    *(_HERE / name for name in ("scenes.py", "vary.py", "reshade.py")),
)  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """How a scene is rendered: size x size pixels, spp paths each, bands over 8-14 um.

    From 48 bands on each is narrow, so that Eq. 1 holds with e at its centre.
    """

    size: int = 96
    spp: int = 64
    bands: int = 100


@dataclass(frozen=True, eq=False)
class Record:
    """One simulated scene; float32 unless stated. In sky pixels T is the air's and X is 0.

    radiance       (bands, height, width) S without noise, W m-2 sr-1 um-1
    texture        (bands, height, width) float16 X, W m-2 sr-1 um-1
    temperature_k  (height, width) K
    sky_view       (height, width) V_sky, 0..1
    material       (height, width) uint8 index into curves
    curves         (materials, bands) e of the scene's library at the centres
    names          (materials,) names of that library; one is "sky"
    wavelength_um  (bands,) float64 centres in um; bands are contiguous
    seed           of the scene
    """

    radiance: np.ndarray
    texture: np.ndarray
    temperature_k: np.ndarray
    sky_view: np.ndarray
    material: np.ndarray
    curves: np.ndarray
    names: tuple[str, ...]
    wavelength_um: np.ndarray
    seed: int

    def save(self, path):
        """Write an uncompressed npz, whole or not at all."""
        arrays = {f.name: np.asarray(getattr(self, f.name)) for f in fields(self)}
        save_arrays(path, arrays, compress=False)

    @staticmethod
    def load(path):
        """Read what `save` wrote; InputError if it is not that."""
        a = load_arrays(path, [f.name for f in fields(Record)], "scene record")
        try:
            a["names"], a["seed"] = tuple(str(n) for n in a["names"]), int(a["seed"])
            bands, height, width = a["radiance"].shape
            shapes = {"texture": (bands, height, width), "wavelength_um": (bands,)}
            shapes |= {"curves": (len(a["names"]), bands)}
            shapes |= dict.fromkeys(MAPS, (height, width))
            if any(a[name].shape != shape for name, shape in shapes.items()):
                raise ValueError
        except (TypeError, ValueError) as e:
            raise InputError(
                f"scene record: {path} is no scene record file; its arrays do not fit."
            ) from e
        return Record(**a)


class SceneSet:
    """The first `count` scenes of a split, in a folder shared by all splits and settings.

    folder    where sets are cached; created if necessary
    split     "train", "validation" or "test"
    count     scenes, at most MAX_SCENES
    settings  Settings

    Raises InputError for invalid arguments.
    """

    def __init__(self, folder, split, count, settings=Settings()):
        if split not in BASE_SEED:
            raise InputError(f"scenes: no split {split!r}; choose from {', '.join(BASE_SEED)}.")
        if not 1 <= count <= MAX_SCENES:
            raise InputError(f"scenes: a split has 1 to {MAX_SCENES} scenes, got {count}.")
        self.split, self.count, self.settings = split, count, settings
        self.folder = Path(folder) / _hash(settings)

    def __len__(self):
        return self.count

    def __getitem__(self, i):
        """Record i; InputError if it is not made yet."""
        return loaded(Record, self.path(range(self.count)[i]))

    def path(self, i):
        """The file of scene i."""
        return self.folder / f"{self.split}-{i:04d}.npz"

    def render(self, i):
        """The content of scene i's file, with a method `save(path)`."""
        return make_record(self.settings, self.split, i)

    def make(self, workers=None, progress=None):
        """Render the scenes that are missing.

        workers   processes; if None, one per core, or OMP_NUM_THREADS if less. The files do not
                  depend on it.
        progress  called as progress(done, total) initially and after each scene

        May be interrupted at any time; finished scenes are kept. Raises InputError if the
        folder cannot be written.
        """
        missing = [i for i in range(self.count) if not self.path(i).exists()]
        if progress is not None:
            progress(self.count - len(missing), self.count)
        if not missing:
            return
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as e:
            raise InputError(f"scenes: cannot make the folder {self.folder}: {e.strerror}.") from e
        with whole_file(self.folder / "made.json") as part:
            part.write_text(json.dumps(self.in_words(), indent=2), encoding="utf-8")
        for done, _ in enumerate(_in_processes(self, missing, workers or usual_threads()), 1):
            if progress is not None:
                progress(self.count - len(missing) + done, self.count)

    def in_words(self):
        """Description of the folder's content, a dict of plain values."""
        bands = self.settings.bands
        return {
            "what": "simulated scenes, rendered by training/scenes.py; see its Record",
            "scenes": "random ones, by turns enclosed in a wood or a street, but those for tests",
            **asdict(self.settings),
            "wavelengths": f"{bands} box bands side by side over 8-14 um",
            "library": "the starter library in half of the scenes, varied in the others",
            "first_seed": BASE_SEED,
            "noise": "none",
        }


def loaded(kind, path):
    """kind.load(path) of a file made here; InputError says what to do if it is damaged."""
    try:
        return kind.load(path)
    except InputError as e:
        if not path.exists():
            raise
        words = str(e).removesuffix(".")
        raise InputError(f"{words}; delete it and run the same command to remake it.") from e


def scene_of(seed):
    """The Scene of a seed, as defined by its split."""
    enclosed = seed % 2 == 1 and seed < BASE_SEED["test"]
    return enclosed_scene(seed) if enclosed else random_scene(seed)


def make_record(settings, split, i):
    """Render scene i of a split -> Record."""
    return of_seed(lambda seed: _render(settings, seed), split, i)


def of_seed(make, split, i):
    """make(seed) of scene i of a split.

    A scene that cannot be rendered, because rays leak from its room, is replaced by the one
    MAX_SCENES seeds on, still within the split's own range. None is all sky: the camera of
    `random_scene` never looks up so far as to lose the ground.
    """
    for attempt in range(MAX_TRIES):
        try:
            return make(BASE_SEED[split] + i + MAX_SCENES * attempt)
        except InputError as e:
            error = e
    raise error


def _render(settings, seed):
    rng = np.random.default_rng([seed, 707])  # a separate stream, which does not affect the scene
    library = MaterialLibrary.starter()
    if rng.random() < 0.5:
        library = vary(library, rng)
    w, fwhm = equidistant_bands(settings.bands)
    cube, truth = simulate(
        scene_of(seed), wavelength_um=w, fwhm_um=fwhm, size=(settings.size,) * 2,
        spp=settings.spp, netd_k=0, seed=seed, library=library,
    )  # fmt: skip
    return Record(
        cube.radiance, truth.texture.astype(np.float16), truth.temperature_k, truth.sky_view,
        truth.material.astype(np.uint8), library.at(w).astype(np.float32), library.names, w, seed,
    )  # fmt: skip


def _hash(settings):
    """Hash of all that determines a scene: settings, the simulator and this package's part."""
    return provenance([asdict(settings), BASE_SEED], SOURCES)


def _in_processes(scenes, missing, workers):
    """Render the missing ones of a SceneSet in processes; yield after each.

    Processes, because building meshes is serial Python; spawned, because a fork of a
    process with threads may hang. No worker outlives this generator or its process.
    """
    context, todo, free = multiprocessing.get_context("spawn"), iter(missing), {}
    try:
        with deaf_to_ctrl_c():
            for _ in range(min(workers, len(missing))):
                pipe, theirs = context.Pipe()
                process = context.Process(target=_work, args=(scenes, theirs), daemon=True)
                process.start()
                theirs.close()  # so that their end closes when they end
                free[pipe] = process
        busy = set()

        def hand(pipe, i):
            with suppress(ConnectionError):  # it died, which is reported where it is awaited
                pipe.send(i)
            busy.add(pipe)

        for pipe, i in zip(free, todo, strict=False):
            hand(pipe, i)
        while busy:
            for pipe in wait(list(busy)):
                busy.remove(pipe)
                try:
                    error = pipe.recv()
                except (EOFError, ConnectionError) as e:
                    raise InputError(
                        "scenes: a worker died; is there enough memory, and does a script that "
                        'makes scenes guard its code by if __name__ == "__main__"?'
                    ) from e
                if error is not None:
                    raise error
                i = next(todo, None)
                if i is not None:
                    hand(pipe, i)
                yield
    finally:
        for pipe, process in free.items():
            process.terminate()
            pipe.close()
        for process in free.values():
            process.join()


def _work(scenes, pipe):
    """A worker: receives scene numbers, sends None or an exception, until the other end closes."""
    # Exits by exception, which removes an unfinished file.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    with suppress(EOFError, ConnectionError):
        while True:
            i = pipe.recv()
            try:
                scenes.render(i).save(scenes.path(i))
            except Exception as error:
                pipe.send(error)
            else:
                pipe.send(None)
