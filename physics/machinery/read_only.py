"""Values whose arrays stay read-only when they are copied and sent to other processes."""

import numpy as np


class ReadOnly:
    """A frozen dataclass whose arrays are read-only; pickle and copy forget that they are."""

    def _set(self, **fields):
        """Give fields these values, to be checked and converted in __post_init__."""
        for value in fields.values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
        self.__dict__.update(fields)

    def __setstate__(self, state):
        self._set(**state)
