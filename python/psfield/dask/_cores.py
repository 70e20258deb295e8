"""The cores that workers on one machine share."""

from __future__ import annotations

import os
import sys
from typing import Any

from psfield._threads import set_threads

#: The process that has been seen to.
_seen_to: int | None = None


def share_cores() -> None:
    """Give this process as many of psfield's threads as Dask gave its worker, once; no effect outside a worker.

    ``RAYON_NUM_THREADS`` in the worker's environment, and workers that are threads of the client, are left as they are.
    """
    if _seen_to == os.getpid():
        return
    # Dask's schedulers of one machine need no distributed.
    distributed = sys.modules.get("distributed")
    if distributed is None:
        return
    try:
        worker = distributed.get_worker()
    except ValueError:
        return
    set_threads_of(worker, None)


def set_threads_of(worker: Any, count: int | None) -> None:
    """Set the threads of a worker's process: so many, or as many as Dask gave it."""
    global _seen_to
    _seen_to = os.getpid()
    if worker.address.startswith("inproc://"):
        return
    if count is not None:
        set_threads(count)
    elif "RAYON_NUM_THREADS" not in os.environ:
        set_threads(worker.state.nthreads)
