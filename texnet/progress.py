"""Progress on a terminal: report(done, total, what) drawn as one bar on stderr; and the duration of
stages."""

import sys
import time
from contextlib import contextmanager

COMPILING = "compiling (first run only)"


class Laps:
    """seconds is {stage: s}; each call adds the time since the previous one, or since creation."""

    def __init__(self):
        self.seconds, self._clock = {}, time.perf_counter()

    def __call__(self, stage):
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._clock
        self._clock = now


@contextmanager
def compiling(report):
    """Report COMPILING while numba compiles, which takes half a minute before it is cached."""
    if report is None:
        yield
        return
    from numba.core import event

    class Compiling(event.Listener):
        def on_start(self, _):
            report(0, 1, COMPILING)

        def on_end(self, _):
            pass

    with event.install_listener("numba:compile", Compiling()):
        yield


@contextmanager
def progress_bar():
    """Yield report(done, total, what); a new bar for each what and total, silent off a terminal."""
    from tqdm import tqdm

    bar, current = None, None

    def report(done, total, what):
        nonlocal bar, current
        if (what, total) != current:
            if bar is not None:
                bar.close()
            # disable=None: tqdm stays silent where stderr is not a terminal
            silent = True if sys.stderr is None else None
            bar = tqdm(total=total, desc=what, disable=silent, leave=False)
            current = what, total
        bar.update(done - bar.n)

    try:
        yield report
    finally:
        if bar is not None:
            bar.close()
