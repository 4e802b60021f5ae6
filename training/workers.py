"""Processes that work for a training run leave Ctrl-C to the one that waits for them."""

import signal
from contextlib import contextmanager
from multiprocessing import resource_tracker


@contextmanager
def deaf_to_ctrl_c():
    """Processes that begin in the block never hear of Ctrl-C, which reaches the whole group."""
    resource_tracker.ensure_running()  # its start would unblock what is blocked here
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # they inherit it
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
