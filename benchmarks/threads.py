"""Benchmarks run on two threads, as on a small machine."""

import numba
import torch
from threadpoolctl import threadpool_limits

THREADS = min(2, numba.config.NUMBA_NUM_THREADS)


def on_two_threads():
    """Set numba, torch and BLAS to THREADS in this process; ONNX Runtime is set separately."""
    numba.set_num_threads(THREADS)
    torch.set_num_threads(THREADS)
    threadpool_limits(THREADS)
