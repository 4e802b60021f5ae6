"""Progress on a terminal: report(done, total, what) drawn as one bar on stderr."""

from contextlib import contextmanager

COMPILING = "compiling, for the first time only"


@contextmanager
def compiling(report):
    """Report COMPILING where numba does so, which takes half a minute before it is kept on disk."""
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
    """Yield report(done, total, what); a new bar for each `what`, silent off a terminal."""
    from tqdm import tqdm

    bar, current = None, None

    def report(done, total, what):
        nonlocal bar, current
        if what != current:
            if bar is not None:
                bar.close()
            # disable=None: tqdm stays silent where stderr is not a terminal.
            bar, current = tqdm(total=total, desc=what, disable=None, leave=False), what
        bar.update(done - bar.n)

    try:
        yield report
    finally:
        if bar is not None:
            bar.close()
