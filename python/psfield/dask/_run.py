"""The jobs of a batch on their way."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import dask
from distributed import Client, Future, as_completed

from psfield.dask._job import Job, JobResult, checked
from psfield.dask._targets import Files, ZarrGroup
from psfield.dask._worker import BatchSettings, run_job

#: Jobs that wait on the scheduler for each thread of the workers, so that none of them is idle, while scenes do not pile up.
_WAITING = 4
#: Seconds after which the workers are counted again: they come and go.
_BETWEEN_COUNTS = 2.0


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
        self._running: dict[Any, tuple[int, str, Future[JobResult]]] = {}
        self._taken = 0
        self._most = 0
        self._counted_at = 0.0

    def all(self, jobs: Iterable[Job]) -> list[JobResult]:
        source = enumerate(jobs)
        finished = as_completed(loop=self._client.loop)
        try:
            self._submit(source, finished)
            for future in finished:
                index, output, _ = self._running.pop(future.key)
                self._record(_outcome(index, output, future))
                self._submit(source, finished)
        finally:
            if self._running:
                self._client.cancel([future for _, _, future in self._running.values()])
        return [self._results[index] for index in sorted(self._results)]

    def _submit(self, source: Iterator[tuple[int, Any]], finished: Any) -> None:
        """Hand jobs to the scheduler until enough of them wait."""
        while len(self._running) < self._room():
            taken = next(source, None)
            if taken is None:
                return
            index, job = taken
            self._taken = index + 1
            output = ""
            try:
                checked(job, self._settings.detector is not None)
                output = self._target.of(index, job)
            except (TypeError, ValueError) as error:
                self._record(JobResult(index, "failed", output, error=f"{type(error).__name__}: {error}"))
                continue
            if self._target.is_done(index, output):
                self._record(JobResult(index, "kept", output))
                continue
            name = self._settings.name
            # Scenes that are arrays travel with their jobs: they must not be lost with a worker.
            with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 PB"}):
                future = self._client.submit(
                    run_job, name, index, dict(job), output, key=f"{name}-{index}", pure=False, retries=self._retries
                )
            self._running[future.key] = (index, output, future)
            finished.add(future)

    def _room(self) -> int:
        if time.monotonic() - self._counted_at > _BETWEEN_COUNTS or not self._most:
            self._most = _WAITING * max(sum(self._client.nthreads().values()), 4)
            self._counted_at = time.monotonic()
        return self._most

    def _record(self, result: JobResult) -> None:
        self._results[result.index] = result
        if result.status == "written":
            self._target.note(result.index)
        if self._progress is not None:
            self._progress(len(self._results), self._taken if self._total is None else self._total)


def _outcome(index: int, output: str, future: Future[JobResult]) -> JobResult:
    """Return what became of a job whose future is finished."""
    if future.status == "finished":
        return future.result()
    if future.cancelled():
        return JobResult(index, "failed", output, error="the scheduler was lost, or the job was cancelled there")
    error = future.exception()
    return JobResult(index, "failed", output, error=f"{type(error).__name__}: {error}")
