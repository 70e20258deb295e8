"""Jobs that differ in length, spread over threads that keep to their own part of the image while they can."""

from collections import deque
from concurrent.futures import ThreadPoolExecutor
from threading import Lock


class Pool:
    """Threads that outlive the runs, since starting them would count."""

    def __init__(self, threads):
        self.threads = threads
        self._executor = ThreadPoolExecutor(threads)

    def each(self, jobs, work):
        """Calls `work(thread, job)` for all jobs; each thread begins with its own stretch of the list, then helps the others."""
        share = -(-len(jobs) // self.threads)
        queues = [deque(jobs[k * share : (k + 1) * share]) for k in range(self.threads)]

        def run(thread):
            while True:
                try:
                    job = queues[thread].popleft()
                except IndexError:
                    other = max(queues, key=len)
                    try:
                        job = other.pop()
                    except IndexError:
                        return
                work(thread, job)

        list(self._executor.map(run, range(self.threads)))


class RowLocks:
    """Locks on stripes of an image, so that patches which overlap can be added by several threads."""

    def __init__(self, rows, stripe=64):
        self._stripe = stripe
        self._locks = [Lock() for _ in range(-(-rows // stripe))]

    def hold(self, first, last):
        """The lock of the rows `first .. last`, a context."""
        first = max(0, first) // self._stripe
        last = min(max(0, last - 1) // self._stripe, len(self._locks) - 1)
        return _Held(self._locks[first : last + 1])


class _Held:
    """Locks taken in order, which excludes a deadlock."""

    def __init__(self, locks):
        self._locks = locks

    def __enter__(self):
        for lock in self._locks:
            lock.acquire()

    def __exit__(self, *_):
        for lock in reversed(self._locks):
            lock.release()
