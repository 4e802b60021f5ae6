"""Ctrl-C while packages load."""

import signal
from contextlib import contextmanager


@contextmanager
def loading():
    """Puts it off: a package that is interrupted while it loads may swallow it, or break."""
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
