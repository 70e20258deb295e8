"""The threads that do the work."""

from psfield import _native
from psfield._choices import whole


def set_threads(count: int | None) -> None:
    """Set the number of threads of this process.

    Results do not depend on it. Workers that share a machine should share its cores: a Dask worker with one thread calls
    ``set_threads(1)``.

    Parameters
    ----------
    count : int or None
        Threads, at least 1. None: as the environment variable ``RAYON_NUM_THREADS`` says, or one a core.
    """
    _native.set_threads(0 if count is None else whole(count, "count", 1, 1 << 16))


def threads() -> int:
    """Return the number of threads of this process.

    Returns
    -------
    int
        Threads that share the work of a call.
    """
    return _native.threads()
