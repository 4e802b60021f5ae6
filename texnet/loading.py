"""Ctrl-C and garbage collection wait while packages load."""

import gc
import signal
import threading
from contextlib import contextmanager


@contextmanager
def loading():
    """Puts Ctrl-C off to the block's end: a package that is interrupted while it loads may swallow
    it, or break. (To block the signal is not enough: a thread that a package starts may take it.)
    What a command loads stays until its end, so that it is never looked through for garbage: a
    seventh of a short command's time.
    """
    came, handler = [], None
    if threading.current_thread() is threading.main_thread():  # the others hear of no Ctrl-C
        handler = signal.signal(signal.SIGINT, lambda *what: came.append(what))
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        if collects:
            gc.enable()
        if handler is not None:
            signal.signal(signal.SIGINT, handler)
            if came:
                signal.raise_signal(signal.SIGINT)
