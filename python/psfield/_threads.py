"""The number of threads."""

from psfield import _native
from psfield._choices import integer


def set_threads(count: int | None) -> None:
    """Set the number of threads that psfield uses in this process.

    Results do not depend on this number. Processes that share a machine should share its cores:
    a worker of Dask with one thread calls ``set_threads(1)``.

    Parameters
    ----------
    count : int or None
        Number of threads, at least 1. None selects the value of the environment variable
        ``RAYON_NUM_THREADS``, or else one thread per core.

    Examples
    --------
    >>> import psfield
    >>> psfield.set_threads(1)
    >>> psfield.threads()
    1
    >>> psfield.set_threads(None)
    """
    _native.set_threads(0 if count is None else integer(count, "count", 1, 1 << 16))


def threads() -> int:
    """Return the number of threads that psfield uses in this process.

    Returns
    -------
    int
        Number of threads that share the work of one call.

    Examples
    --------
    >>> import psfield
    >>> psfield.threads() >= 1
    True
    """
    return _native.threads()
