"""Threads for jobs of unequal length. Each stays in its own part of the image while it can."""

from collections import deque
from concurrent.futures import ThreadPoolExecutor
from threading import Lock


class Pool:
    """Threads that stay alive between runs, so that their start is not timed."""

    def __init__(self, threads):
        self.threads = threads
        self._executor = ThreadPoolExecutor(threads)

    def each(self, jobs, work):
        """Calls `work(thread, job)` for all jobs.

        Each thread begins with its own part of the list, then takes jobs from the longest queue.
        """
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
    """Locks on stripes of an image, so that several threads can add patches that overlap."""

    def __init__(self, rows, stripe=64):
        self._stripe = stripe
        self._locks = [Lock() for _ in range(-(-rows // stripe))]

    def hold(self, first, last):
        """A context that locks the rows `first .. last`."""
        first = max(0, first) // self._stripe
        last = min(max(0, last - 1) // self._stripe, len(self._locks) - 1)
        return _Held(self._locks[first : last + 1])


class _Held:
    """Takes locks in order, which excludes a deadlock."""

    def __init__(self, locks):
        self._locks = locks

    def __enter__(self):
        for lock in self._locks:
            lock.acquire()

    def __exit__(self, *_):
        for lock in reversed(self._locks):
            lock.release()
