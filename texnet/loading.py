"""Signals and garbage collection wait while packages load."""

import gc
import signal
import threading
from contextlib import contextmanager


@contextmanager
def loading():
    """Postpone Ctrl-C, and other signals that Python handles, to the end of the block: a package
    interrupted while loading may swallow the exception, or break. (Blocking the signals is not
    enough: a thread started by a package may receive them.)
    What a command loads stays until it ends, so garbage collection skips it: a seventh of a short
    command's time.
    """
    came, handlers = [], {}
    if threading.current_thread() is threading.main_thread():  # others receive no signals
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):  # Windows has no SIGHUP
            number = getattr(signal, name, signal.SIGINT)
            # None is a handler installed from C, not from Python
            if number not in handlers and signal.getsignal(number) is not None:
                handlers[number] = signal.signal(number, lambda n, _: came.append(n))
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        if collects:
            gc.enable()
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for number in came[:1]:
            signal.raise_signal(number)
