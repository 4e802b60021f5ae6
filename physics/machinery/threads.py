"""Many items, some at a time, in threads: for work that releases the interpreter."""

import os
from concurrent.futures import ThreadPoolExecutor, as_completed


def usual_threads():
    """As many as there are cores that this process may use, or OMP_NUM_THREADS if that is less, as
    other packages have it."""
    able = hasattr(os, "sched_getaffinity")
    cores = len(os.sched_getaffinity(0)) if able else os.cpu_count()
    most = os.environ.get("OMP_NUM_THREADS", "").partition(",")[0]
    return min(cores, int(most)) if most.isdecimal() and int(most) else cores


def in_threads(work, items, threads, progress=None):
    """(work(item) of all items), in their order; progress is called here, as
    progress(done, total), after each. Whatever is raised here or there ends the work.

    One thread is the caller's own, to which numba's and others' settings belong."""
    items = list(items)
    if threads == 1:
        results = []
        for item in items:
            results.append(work(item))
            if progress is not None:
                progress(len(results), len(items))
        return results
    with ThreadPoolExecutor(threads) as pool:
        jobs = [pool.submit(work, item) for item in items]
        try:
            for done, job in enumerate(as_completed(jobs), 1):
                job.result()
                if progress is not None:
                    progress(done, len(items))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return [job.result() for job in jobs]
