"""Threads for numba kernels: how many, and one pool for chunks of a kernel.

Kernels are ``nogil`` and single-threaded; parallel work is chunks of one kernel on our own pool.
``parallel=True`` is never used: numba's workqueue layer aborts the process when two Python threads
enter it, and the window renders, sorts and associates from several.
"""

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache


def n_threads() -> int:
    """Threads that this process may use (honours CPU affinity and GAGA_THREADS)."""
    wanted = os.environ.get("GAGA_THREADS", "")
    if wanted.isdigit() and int(wanted) > 0:
        return int(wanted)
    if hasattr(os, "sched_getaffinity"):
        return max(1, len(os.sched_getaffinity(0)))
    return max(1, os.cpu_count() or 1)


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(n_threads(), thread_name_prefix="gaga-kernel")


def run_chunks(work: Callable[[int, int], None], n: int, chunk: int) -> None:
    """Call ``work(start, stop)`` over ``range(n)`` in pieces of ``chunk``, on all threads.

    Pieces are taken dynamically, so uneven ones balance. ``work`` must release the GIL (a kernel)
    and write disjoint output, so the result does not depend on the number of threads. The calling
    thread works too. The first exception of a piece is raised here.
    """
    n_pieces = (n + chunk - 1) // chunk
    threads = min(n_threads(), n_pieces)
    if threads <= 1:
        for start in range(0, n, chunk):
            work(start, min(start + chunk, n))
        return
    lock = threading.Lock()
    pieces = iter(range(0, n, chunk))

    def drain() -> None:
        while True:
            with lock:
                start = next(pieces, None)
            if start is None:
                return
            work(start, min(start + chunk, n))

    helpers = [_pool().submit(drain) for _ in range(threads - 1)]
    drain()
    for helper in helpers:
        helper.result()


def run_kernel(kernel: Callable[..., None], n: int, chunk: int, *arguments: object) -> None:
    """Call ``kernel(*arguments, start, stop)`` over ``range(n)`` as `run_chunks` does."""
    run_chunks(lambda start, stop: kernel(*arguments, start, stop), n, chunk)
