"""Minus the log evidence of pixels, by what may be wrong with the camera before them.

A search asks for it again and again, and for that of many cameras at once.
"""

from physics.machinery.threads import in_threads


class Nats:
    """of(what) by what, remembered: (P,) nats of pixels, infinite where nothing looks like that,
    what being hashable, mostly a Calibration. As many at_once as `methods.Look` says; the first
    alone, as all others are compared with it."""

    def __init__(self, of, at_once=1):
        self._of, self._at_once, self._known = of, at_once, {}

    def __call__(self, what):
        return self.each([what])[what]

    def each(self, some):
        """{what: nats} of some."""
        new = [what for what in dict.fromkeys(some) if what not in self._known]
        if new and not self._known:
            first = new.pop(0)
            self._known[first] = self._of(first)
        if new:
            self._known.update(zip(new, in_threads(self._of, new, self._at_once), strict=True))
        return {what: self._known[what] for what in some}
