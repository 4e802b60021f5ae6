"""Minus the log evidence of pixels, by what may be wrong with the camera before them.

A search asks for it again and again, and for that of many cameras at once.
"""

import numpy as np

from physics.machinery.threads import in_threads


class Nats:
    """of(what) by what, remembered: nats of pixels, (P,) or (height, width), infinite where nothing
    looks like that; what is hashable, mostly a Calibration. As many at_once as `methods.Look` says,
    but one by one until one is answered, with which it compares all others."""

    def __init__(self, of, at_once=1):
        self._of, self._at_once, self._known, self._answered = of, at_once, {}, False

    def __call__(self, what):
        return self.each([what])[what]

    def each(self, some):
        """{what: nats} of some."""
        new = [what for what in dict.fromkeys(some) if what not in self._known]
        while new and not self._answered:
            what = new.pop(0)
            self._known[what] = self._of(what)
            self._answered = np.isfinite(self._known[what]).any()
        if new:
            at_once = min(self._at_once, len(new))
            self._known.update(zip(new, in_threads(self._of, new, at_once), strict=True))
        return {what: self._known[what] for what in some}
