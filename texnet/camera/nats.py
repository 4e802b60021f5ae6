"""Minus the log evidence of pixels, given what may be wrong with the camera.

A search asks for it again and again, and for many cameras at once.
"""

import numpy as np

from physics.machinery.threads import in_threads


class NegativeLogEvidence:
    """Minus log evidence, nats, of pixels, (P,) or (height, width), infinite where nothing fits at
    all: of(what), computed once for each hashable what, mostly a Calibration.

    at_once are computed in parallel, as in `methods.Look`; but one by one until one is finite,
    since the first fixes the basis of the network's spectra, which makes all comparable with it."""

    def __init__(self, of, at_once=1):
        self._of, self._at_once, self._known, self._answered = of, at_once, {}, False

    def __call__(self, what):
        return self.each([what])[what]

    def each(self, some):
        """{what: nats} for each of some."""
        new = [what for what in dict.fromkeys(some) if what not in self._known]
        while new and not self._answered:
            what = new.pop(0)
            self._known[what] = self._of(what)
            self._answered = np.isfinite(self._known[what]).any()
        if new:
            at_once = min(self._at_once, len(new))
            self._known.update(zip(new, in_threads(self._of, new, at_once), strict=True))
        return {what: self._known[what] for what in some}
