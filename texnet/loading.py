"""Packages load undisturbed: by Ctrl-C, and by the garbage collector."""

import gc
import signal
from contextlib import contextmanager


@contextmanager
def loading():
    """Puts Ctrl-C off: a package that is interrupted while it loads may swallow it, or break. What
    loads stays until the end, so that to look through it for garbage, then and there, is in vain.
    """
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        gc.freeze()
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
