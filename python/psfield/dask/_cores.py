"""Sharing of the cores of a machine between workers."""

from __future__ import annotations

import os
import sys
from typing import Any

from psfield._threads import set_threads

#: The process whose threads have been set.
_process: int | None = None


def share_cores() -> None:
    """Set the threads of psfield to the number that Dask gave the worker of this process.

    Only the first call in a process has an effect, and only in a worker. Nothing is changed if
    ``RAYON_NUM_THREADS`` is set, or if the workers are threads of the client.
    """
    if _process == os.getpid():
        return
    # The schedulers of Dask for one machine do not import distributed.
    distributed = sys.modules.get("distributed")
    if distributed is None:
        return
    try:
        worker = distributed.get_worker()
    except ValueError:
        return
    set_threads_of(worker, None)


def set_threads_of(worker: Any, count: int | None) -> None:
    """Set the threads of the process of a worker: ``count``, or as many as Dask gave it."""
    global _process
    _process = os.getpid()
    if worker.address.startswith("inproc://"):
        return
    if count is not None:
        set_threads(count)
    elif "RAYON_NUM_THREADS" not in os.environ:
        set_threads(worker.state.nthreads)
