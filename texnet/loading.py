"""Signals and garbage collection wait while packages load."""

import gc
import signal
import threading
from contextlib import contextmanager


@contextmanager
def loading():
    """Puts Ctrl-C off to the block's end, and what else Python is to hear of: a package that is
    interrupted while it loads may swallow it, or break. (To block the signals is not enough: a
    thread that a package starts may take them.)
    What a command loads stays until its end, so that it is never looked through for garbage: a
    seventh of a short command's time.
    """
    came, handlers = [], {}
    if threading.current_thread() is threading.main_thread():  # the others hear of no signal
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):  # Windows has no SIGHUP
            number = getattr(signal, name, signal.SIGINT)
            # of None, which is a handler of C's, it is not Python that hears
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
