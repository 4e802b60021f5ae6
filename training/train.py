"""Training: random scenes in, weights out, with Lightning for bookkeeping.

Draw i of a run comes from a generator seeded by (seed, i), so the same command gives the same
weights, and a stopped run resumes from its last epoch with the same result. A batch is one scene,
because libraries and bands differ in size; the gradients of a few scenes are averaged.
"""

import atexit
import logging
import os
import re
import signal
import threading
import time
import warnings
from importlib.metadata import version
from io import BytesIO
from pathlib import Path

import numpy as np
import pytorch_lightning as lightning
import torch
from pytorch_lightning.callbacks import Callback, ModelCheckpoint
from pytorch_lightning.plugins import TorchCheckpointIO
from threadpoolctl import threadpool_limits
from torch.utils.data import DataLoader, Dataset, Sampler

import physics
import texnet
from physics.errors import InputError
from physics.machinery.provenance import provenance
from physics.machinery.threads import usual_threads
from physics.machinery.whole_file import whole_file
from texnet.files.weights import save_network
from texnet.learned import check_device
from texnet.network import TeXNet

from .losses import PHYSICS_WEIGHT, cross_entropy, eq1_loss, supervised_loss
from .samples import draw, expected_by, features
from .scenes import SceneSet
from .workers import deaf_to_ctrl_c

LEARNING_RATE = 2e-3
WARM_UP = 0.1  # share of the steps before the learning rate falls
SIDE = 64  # pixels; larger parts of a scene teach less than more scenes
TOGETHER = 4  # scenes whose gradients are averaged
PER_EPOCH = 320  # draws between two checkpoints
SCENES, VALIDATION_SCENES, EPOCHS = 1600, 40, 60
VALIDATION_SEED = 7
WORKERS = usual_threads()  # processes that make draws
FAREWELL_S = 5.0  # for their threads to end


def train(out, cache, *, scenes=SCENES, epochs=EPOCHS, seed=0, device="cpu", progress=None):
    """Make scenes, train a network on them and write it to `out` (safetensors) -> its history.

    cache     folder for scenes and checkpoints; existing ones are used, so a stopped run resumes
    scenes    number to train on; 40 others are for validation
    epochs    of 320 draws each
    device    "cpu" or "cuda", for the network; scenes are made on the CPU
    progress  called as progress(done, total, what) after each scene and each draw
    """
    check_device(device)
    sets = [SceneSet(cache, "train", scenes), SceneSet(cache, "validation", VALIDATION_SCENES)]
    start = time.perf_counter()
    for s in sets:
        s.make(progress=lambda n, of: progress and progress(n, of, "scenes"))
    seconds = time.perf_counter() - start
    lightning.seed_everything(seed, verbose=False)
    settings = dict(
        scenes=scenes, data=sets[0].folder.name, epochs=epochs, seed=seed, device=device
    )  # fmt: skip
    module = Training(TeXNet(), epochs * PER_EPOCH // TOGETHER)
    metrics = fit(
        module, Draws(sets[0], seed, SIDE), Draws(sets[1], VALIDATION_SEED),
        Path(cache) / "runs" / run_name(settings), epochs=epochs, device=device,
        progress=progress,
    )  # fmt: skip
    history = settings | {
        "version": version("texnet"), "torch": torch.__version__, "validation": metrics,
        "minutes": {"scenes": round(seconds / 60, 1), "training": round(module.seconds / 60, 1)},
    }  # fmt: skip
    save_network(module.network, out, history)
    return history


def run_name(settings):
    """A folder name for a run, determined by its settings (plain values), the code and data of
    physics, and the numerical packages."""
    packages = [Path(package.__file__).parent for package in (physics, texnet)]
    data = sorted((packages[0] / "data").iterdir())
    of = settings, {name: version(name) for name in ("torch", "numpy", "scipy", "scikit-learn")}
    return provenance(of, [*packages, Path(__file__).parent, *data])


class Draws(Dataset):
    """Draw number i from a set of scenes: each scene once per round, in a new order.

    side   pixels of a random square of the scene that the draw shows; all of it if None
    """

    def __init__(self, scenes, seed, side=None):
        self.scenes, self.seed, self.side = scenes, seed, side

    def __len__(self):
        return len(self.scenes)

    def __getitem__(self, i):
        turn, at = divmod(i, len(self.scenes))
        order = np.random.default_rng([self.seed, turn]).permutation(len(self.scenes))
        rng = np.random.default_rng([self.seed, 1, i])
        sample = draw(self.scenes[int(order[at])], rng, self.side)
        return sample, features(sample.known, sample.radiance)


class Epoch(Sampler):
    """The draws of one epoch, whose number Lightning sets."""

    def __init__(self, length):
        self.length, self.epoch = length, 0

    def set_epoch(self, epoch):
        self.epoch = epoch

    def __iter__(self):
        return iter(range(self.epoch * self.length, (self.epoch + 1) * self.length))

    def __len__(self):
        return self.length


class Training(lightning.LightningModule):
    """A network with its losses. steps: of the optimiser in all; terms: "both", "supervised" or
    "physics" of `losses`. Keeps the seconds spent in epochs and the metrics of the last one."""

    def __init__(self, network, steps, terms="both", learning_rate=LEARNING_RATE):
        super().__init__()
        self.network, self.steps, self.terms = network, steps, terms
        self.learning_rate, self.seconds, self.metrics = learning_rate, 0.0, {}

    def on_train_epoch_start(self):
        self._start = time.perf_counter()

    def on_train_epoch_end(self):
        self.seconds += time.perf_counter() - self._start

    def on_save_checkpoint(self, checkpoint):
        self.metrics = {n: float(v) for n, v in self.trainer.callback_metrics.items()}
        checkpoint.update(seconds=self.seconds, metrics=self.metrics)

    def on_load_checkpoint(self, checkpoint):
        self.seconds, self.metrics = checkpoint["seconds"], checkpoint["metrics"]

    def training_step(self, batch, _):
        return self.loss(*batch)

    def predict(self, sample, s):
        """The network's Prediction for a Sample, whose Stem is s."""
        expected = expected_by(self.network, sample)
        return self.network(sample.known, s, expected, sample.radiance.shape[1:])

    def loss(self, sample, s):
        """The scalar to minimise, for a Sample and its Stem."""
        prediction = self.predict(sample, s)
        loss = 0.0
        if self.terms != "physics":
            loss = supervised_loss(prediction, sample)
        if self.terms != "supervised":
            loss = loss + PHYSICS_WEIGHT * eq1_loss(prediction, sample.known, sample.radiance)
        return loss

    def validation_step(self, batch, _):
        self.log_dict(self.measures(*batch), batch_size=1)

    def measures(self, sample, s):
        """The network's measures on a Sample and its Stem: a dict of scalars."""
        prediction = self.predict(sample, s)
        right = (prediction.log_material.argmax(0) == sample.material).float().mean()
        entropy = cross_entropy(prediction, sample)
        error = (prediction.temperature_k - sample.temperature_k)[sample.ground]
        rmse = (error**2).mean().sqrt() if len(error) else torch.tensor(0.0)
        return {
            "accuracy": right,
            "cross_entropy": entropy,
            "temperature_rmse_k": rmse,
            "supervised": supervised_loss(prediction, sample),
        }

    def configure_optimizers(self):
        optimiser = torch.optim.AdamW(self.parameters(), self.learning_rate, weight_decay=1e-3)
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            optimiser, self.learning_rate, total_steps=self.steps, pct_start=WARM_UP
        )
        return [optimiser], [{"scheduler": schedule, "interval": "step"}]


class Report(Callback):
    """Calls progress(done, total, "training") after each draw."""

    def __init__(self, progress):
        self.progress = progress

    def on_train_batch_end(self, trainer, module, outputs, batch, i):
        per_epoch = trainer.num_training_batches
        done = trainer.current_epoch * per_epoch + i + 1
        self.progress(done, trainer.max_epochs * per_epoch, "training")


class WholeCheckpoints(TorchCheckpointIO):
    """Checkpoints in files that are written whole or not at all."""

    def save_checkpoint(self, checkpoint, path, storage_options=None):
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        whole = BytesIO()  # on a full disk torch would not raise an OSError
        torch.save(checkpoint, whole)
        with whole_file(path) as part:
            part.write_bytes(whole.getbuffer())


class Loader(DataLoader):
    """A DataLoader of single draws by single-threaded workers, which ignore Ctrl-C; the parent ends
    them."""

    def __init__(self, data, order):
        several = dict(multiprocessing_context="spawn", persistent_workers=True) if WORKERS else {}
        super().__init__(
            data, batch_size=None, sampler=order, num_workers=WORKERS,
            worker_init_fn=_as_worker, **several,
        )  # fmt: skip
        self.threads = set(threading.enumerate())  # existing ones

    def __iter__(self):
        with deaf_to_ctrl_c():
            return super().__iter__()

    def close(self):
        """End the workers, and wait for the threads that communicated with them: one interrupted by
        the interpreter's exit while it frees a semaphore causes a warning of a leak."""
        if self._iterator is not None:
            self._iterator._shutdown_workers()
        for thread in set(threading.enumerate()) - self.threads:
            if thread.name == "QueueFeederThread":
                thread.join(FAREWELL_S)


def _as_worker(_):
    threadpool_limits(1)  # more would wait for each other
    # exit cleanly, or the waiting process reports a crash instead of ending itself
    signal.signal(signal.SIGTERM, lambda *_: os._exit(0))
    # immediately: running threads of native libraries may abort a normal exit with a message
    atexit.register(os._exit, 0)


def fit(
    module, draws, validation, folder, *, epochs, per_epoch=PER_EPOCH, device="cpu", progress=None
):
    """Train a Training module on Draws, from folder/last.ckpt if that exists -> metrics.

    validation  Draws, all of which are measured after the last epoch, or None
    device      "cpu" or "cuda": the first GPU
    progress    called as progress(done, total, "training") after each draw

    The metrics are those of the last epoch, as floats. After Ctrl-C (KeyboardInterrupt) the
    same call resumes from the last epoch.
    """
    quiet()
    orderly = torch.are_deterministic_algorithms_enabled()
    last, order = Path(folder) / "last.ckpt", Epoch(per_epoch)
    if last.exists():  # Lightning begins to draw before it announces the first epoch
        order.set_epoch(_epoch_of(last) + 1)
    trainer = lightning.Trainer(
        accelerator="cpu" if device == "cpu" else "gpu", devices=1,
        max_epochs=epochs, accumulate_grad_batches=TOGETHER, gradient_clip_val=1.0,
        default_root_dir=folder, logger=False, plugins=[WholeCheckpoints()],
        # With no metric to monitor, the best is the last; save_last alone saves nothing (2.6).
        callbacks=[
            ModelCheckpoint(folder, "last", save_top_k=1, enable_version_counter=False,
                            save_on_train_epoch_end=True),
            *([Report(progress)] if progress else []),
        ],
        check_val_every_n_epoch=epochs,
        enable_model_summary=False, enable_progress_bar=False, num_sanity_val_steps=0,
        deterministic=True,
    )  # fmt: skip
    listening, threads = signal.getsignal(signal.SIGINT), torch.get_num_threads()
    torch.set_num_threads(1)  # the cores make draws, and threads waiting for these would spin
    loaders = [Loader(draws, order)]
    loaders += [] if validation is None else [Loader(validation, range(len(validation)))]
    try:
        trainer.fit(module, *loaders, ckpt_path=last if last.exists() else None, weights_only=True)
    except InputError as e:  # a worker's, with its traceback; the message is at the end
        raise InputError(str(e).rpartition(f"{type(e).__name__}: ")[2].strip()) from e
    except torch.OutOfMemoryError as e:
        raise InputError("device: the GPU has too little memory; take --device cpu.") from e
    except RuntimeError as e:  # Lightning may fail on what a stopped worker left behind
        if not re.search(r"DataLoader worker \(pid|shared memory", f"{e} {e.__context__}"):
            raise
        raise InputError(
            "training: a worker died, or shared memory (/dev/shm) was too small for a cube; free "
            "memory and run the same command again to resume."
        ) from e
    except SystemExit as e:
        if not isinstance(e.__context__, KeyboardInterrupt):
            raise
        # Lightning turns Ctrl-C into an exit, and ignores a second one
        signal.signal(signal.SIGINT, listening)
        raise KeyboardInterrupt from None
    finally:
        torch.set_num_threads(threads)
        torch.use_deterministic_algorithms(orderly)
        for loader in loaders:
            loader.close()
    return module.metrics


def _epoch_of(checkpoint):
    """The last epoch of a checkpoint."""
    try:
        return torch.load(checkpoint, weights_only=True)["epoch"]
    except Exception as e:  # torch raises all kinds
        raise InputError(f"training: {checkpoint} is damaged; delete it to start again.") from e


def quiet():
    """Keep Lightning's advice on hardware and products off the terminal."""
    logging.getLogger("pytorch_lightning").setLevel(logging.WARNING)
    warnings.filterwarnings("ignore", module="pytorch_lightning|lightning_fabric")
