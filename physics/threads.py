"""Work on many items, some at a time in threads: for what leaves the interpreter to others."""

from concurrent.futures import ThreadPoolExecutor

from threadpoolctl import threadpool_limits


def in_threads(work, items, threads):
    """Yield work(item) of all items in their order; where the caller stops, so does the work.

    One thread is the caller's own, to which numba's and others' settings belong. To several
    threads BLAS gives one each, since its own would be in their way."""
    if threads == 1:
        yield from map(work, items)
        return
    pool = ThreadPoolExecutor(threads)
    with threadpool_limits(1, "blas"):
        try:
            yield from pool.map(work, items)
        finally:
            pool.shutdown(cancel_futures=True)
