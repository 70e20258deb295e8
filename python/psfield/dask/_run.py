"""The jobs of a batch on a cluster."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Any

import dask
from distributed import Client, as_completed

from psfield.dask._job import Job, JobResult, Task, checked
from psfield.dask._targets import Files, ZarrGroup
from psfield.dask._worker import BatchSettings, run_jobs

#: Number of parcels (groups of jobs that run as one task) on the scheduler for each thread of the
#: workers. Fewer would leave threads idle. More would fill the scheduler's memory with scenes.
_WAITING = 4
#: Seconds between two counts of the workers, whose number may change.
_BETWEEN_COUNTS = 2.0
#: Duration of a parcel of small frames in seconds, and its largest number of frames. Longer parcels
#: are better, because the scheduler needs some milliseconds for each.
_PARCEL_SECONDS = 0.25
_PARCEL_MOST = 64


class Run:
    """The jobs of one batch on a cluster."""

    def __init__(
        self,
        client: Client,
        settings: BatchSettings,
        target: Files | ZarrGroup,
        retries: int,
        total: int | None,
        progress: Callable[[int, int], object] | None,
    ) -> None:
        self._client = client
        self._settings = settings
        self._target = target
        self._retries = retries
        self._total = total
        self._progress = progress
        self._results: dict[int, JobResult] = {}
        self._running: dict[Any, tuple[Any, list[Task]]] = {}
        #: Jobs to run again, each in a parcel of its own.
        self._again: deque[Task] = deque()
        #: Jobs whose workers were lost too often. Each runs while no other job does, so that only
        #: the job that kills workers fails.
        self._suspects: deque[Task] = deque()
        self._alone = False
        self._taken = 0
        self._parcels = 0
        self._seconds: float | None = None
        self._threads = 0
        self._counted_at = 0.0

    def all(self, jobs: Iterable[Job]) -> list[JobResult]:
        """Run all jobs and return their results."""
        source = enumerate(jobs)
        finished = as_completed(loop=self._client.loop)
        try:
            self._submit(source, finished)
            for future in finished:
                _, tasks = self._running.pop(future.key)
                self._receive(future, tasks)
                self._submit(source, finished)
        finally:
            if self._running:
                self._client.cancel([future for future, _ in self._running.values()])
        return [self._results[index] for index in sorted(self._results)]

    def _submit(self, source: Iterator[tuple[int, Any]], finished: Any) -> None:
        """Submit jobs to the scheduler until enough of them wait there."""
        while len(self._running) < self._room():
            tasks = [self._again.popleft()] if self._again else self._parcel(source)
            if not tasks:
                if self._running or not self._suspects:
                    return
                tasks, self._alone = [self._suspects.popleft()], True
            key = f"{self._settings.name}-{self._parcels}"
            self._parcels += 1
            # Scenes that are arrays are sent with their jobs, so that no worker can lose them.
            with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 PB"}):
                future = self._client.submit(
                    run_jobs, self._settings.name, tasks, key=key, pure=False
                )
            self._running[key] = (future, tasks)
            finished.add(future)

    def _parcel(self, source: Iterator[tuple[int, Any]]) -> list[Task]:
        """Take the jobs of the next parcel. It is empty if no jobs are left."""
        tasks: list[Task] = []
        most = self._parcel_size()
        for index, job in source:
            self._taken = index + 1
            output = ""
            try:
                checked(job, self._settings.detector is not None)
                output = self._target.of(index, job)
            except (TypeError, ValueError) as error:
                text = f"{type(error).__name__}: {error}"
                self._record(JobResult(index, "failed", output, error=text))
                continue
            if self._target.is_done(index, output):
                self._record(JobResult(index, "kept", output))
                continue
            tasks.append(Task(index, dict(job), output))
            if len(tasks) >= most or hasattr(job.get("scene"), "__array__"):
                break
        return tasks

    def _parcel_size(self) -> int:
        """Return the largest number of jobs in a parcel."""
        if self._seconds is None:
            return 1
        most = min(int(_PARCEL_SECONDS / max(self._seconds, 1e-6)), _PARCEL_MOST)
        if self._total is not None:
            # The last jobs are shared by all threads.
            most = min(most, (self._total - self._taken) // (2 * self._threads))
        return max(most, 1)

    def _room(self) -> int:
        """Return the largest number of parcels on the scheduler."""
        if time.monotonic() - self._counted_at > _BETWEEN_COUNTS or not self._threads:
            # There may be no workers yet while a batch system starts them.
            self._threads = max(sum(self._client.nthreads().values()), 4)
            self._counted_at = time.monotonic()
        return _WAITING * self._threads

    def _receive(self, future: Any, tasks: list[Task]) -> None:
        """Take the results of a finished parcel."""
        if future.status == "finished":
            for task, (result, again) in zip(tasks, future.result(), strict=True):
                if again and task.failures < self._retries:
                    self._again.append(replace(task, failures=task.failures + 1))
                    continue
                last = result.seconds if self._seconds is None else self._seconds
                self._seconds = 0.9 * last + 0.1 * result.seconds
                self._record(result)
        elif not self._alone and not future.cancelled():
            self._suspects.extend(tasks)
        else:
            for task in tasks:
                self._record(JobResult(task.index, "failed", task.output, error=_why(future)))

    def _record(self, result: JobResult) -> None:
        self._results[result.index] = result
        if result.status == "written":
            self._target.note(result.index)
        if self._progress is not None:
            total = self._taken if self._total is None else self._total
            self._progress(len(self._results), total)


def _why(future: Any) -> str:
    """Return the reason why a parcel has no results."""
    if future.cancelled():
        return "the scheduler was lost, or it cancelled the job"
    error = future.exception()
    return f"{type(error).__name__}: {error}"
