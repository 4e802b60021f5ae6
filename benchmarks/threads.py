"""How many threads a benchmark runs on: two, as a small machine has them."""

import numba
import torch
from threadpoolctl import threadpool_limits

THREADS = min(2, numba.config.NUMBA_NUM_THREADS)


def on_two_threads():
    """From now on numba, torch and BLAS use THREADS in this process; ONNX Runtime is told apart."""
    numba.set_num_threads(THREADS)
    torch.set_num_threads(THREADS)
    threadpool_limits(THREADS)
