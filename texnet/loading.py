"""Packages load undisturbed: by Ctrl-C, and by the garbage collector."""

import gc
import signal
from contextlib import contextmanager


@contextmanager
def loading():
    """Puts Ctrl-C off: a package that is interrupted while it loads may swallow it, or break. What
    a command loads stays until its end, so that it is never looked through for garbage: a seventh
    of a short command's time.
    """
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        if collects:
            gc.enable()
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
