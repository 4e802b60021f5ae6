"""Values whose arrays stay read-only when they are copied and sent to other processes."""

import numpy as np


class ReadOnly:
    """A frozen dataclass that sets its arrays read-only: pickle and copy forget that they are."""

    def __setstate__(self, state):
        for value in state.values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
        self.__dict__.update(state)
