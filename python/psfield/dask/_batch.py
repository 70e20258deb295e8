"""Data sets of many frames."""

from __future__ import annotations

import os
import pickle
import time
import uuid
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Sized
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any, Literal

import dask
import dask.system
import numpy as np
from dask.base import tokenize

from psfield._arrays import DTYPES, shape_of
from psfield._errors import PsfieldWarning
from psfield._model import PsfModel
from psfield._plan import DEFAULT_MEMORY
from psfield._progress import Progress, as_callback
from psfield.dask._checks import check_choices
from psfield.dask._fits import FitsFiles
from psfield.dask._job import Job, JobResult, checked, shape_without_reading
from psfield.dask._zarr import ZarrFrames, ZarrLedger

if TYPE_CHECKING:
    from distributed import Client, Future

    from psfield.dask._worker import BatchSettings

#: Jobs that wait on the scheduler for each thread of the workers, so that none of them is idle, while scenes do not pile up.
_WAITING = 4
#: Seconds after which the workers are counted again: they come and go.
_BETWEEN_COUNTS = 2.0


def batch(
    jobs: Iterable[Job],
    model: PsfModel,
    output: str | os.PathLike[str] | None = None,
    tolerance: float = 1e-4,
    precision: Literal["f32", "f64"] = "f32",
    device: Literal["auto", "cpu", "gpu"] = "cpu",
    *,
    shape: tuple[int, int] | None = None,
    detector: Any = None,
    keep: Sequence[Literal["scene", "truth"]] = (),
    overwrite: bool = False,
    client: Client | None = None,
    retries: int = 2,
    threads: int | None = None,
    progress: Progress | None = None,
    frame: tuple[int, int, int, int] | None = None,
    anchor: Literal["source", "output"] = "source",
    method: Literal["auto", "lowrank"] = "auto",
    memory: int = DEFAULT_MEMORY,
    oversample: int = 1,
    stamp_size: int | None = None,
) -> list[JobResult]:
    """Make many frames on the workers of a Dask cluster, which write them themselves.

    The PSF is sent to each worker once, and a worker plans once for each shape of scenes. Frames are written as they are finished, each
    whole or not at all. Jobs of a worker that is lost are run again on others; a job that fails does not stop the rest; and a second run
    makes what the first left undone.

    Parameters
    ----------
    jobs : iterable of dict
        The frames: see `Job`. It may be a generator: only a few jobs for each worker's thread are taken from it ahead of time. Scenes and
        catalogues that are files, or functions that draw them, are read and called on the workers, which is better than sending arrays.
    model : PsfModel
        The PSF.
    output : path, optional
        Where frames go. A name with ``{index}`` (from 0; ``{index:06d}`` with leading zeros) or ``{seed}``, such as
        ``"frames/{index:06d}.fits"``, is one FITS file a frame. A name that ends in ``.zarr`` is one Zarr group: its array ``image`` is ``[job,
        y, x]`` with one frame a chunk, and ``done`` says which frames are finished. Without it, each job names its own FITS file. Relative
        names count from the client's working directory; workers and the client must see the same files.
    tolerance, precision, device
        As for `PsfModel.plan`.
    shape : (int, int), optional
        Rows and columns of the scenes: for jobs that are a catalogue alone, and for Zarr where the first job does not tell.
    detector : psfield.detector.Detector, optional
        What takes the images; each job then needs a seed. The result is its counts, with the pixels' ``flags`` beside them.
    keep : sequence of {'scene', 'truth'}
        What else is written for each frame: the scene's pixels, the noise-free image. As extensions of the FITS file, or as arrays of the
        Zarr group.
    overwrite : bool
        Make and replace what is there. Otherwise finished frames are kept.
    client : distributed.Client, optional
        The cluster. Default: the current client; where there is none, one worker process for each core of this machine, with one thread.
    retries : int
        How often a job is tried again when its files cannot be read or written.
    threads : int, optional
        Threads of psfield in each worker process. Default: as many as Dask gave the worker, or as ``RAYON_NUM_THREADS`` says there.
    progress : callable or tqdm bar, optional
        ``progress(done, total)``; of a generator, the total is what has been taken from it so far.
    frame, anchor, method, memory, oversample, stamp_size
        As for `PsfModel.plan`. Each plan keeps up to ``memory`` bytes, and a worker keeps the four plans that it used last.

    Returns
    -------
    list of JobResult
        In the order of the jobs.

    Raises
    ------
    ValueError
        Options that cannot be, or a Zarr group of other frames.

    Warns
    -----
    PsfieldWarning
        Some jobs failed: the results say which and why.

    Notes
    -----
    Without a client worker processes are started, which import the script that started them: it needs ``if __name__ == "__main__":``.

    A job that has lost more workers than Dask's ``distributed.scheduler.allowed-failures`` (3) counts as failed: it may be what kills them.
    """
    check_choices(model, tolerance, precision, device, anchor, method, oversample, stamp_size)
    if unknown := set(keep) - {"scene", "truth"}:
        raise ValueError(f"keep may hold 'scene' and 'truth', got {min(unknown)!r}")
    if "truth" in keep and detector is None:
        raise ValueError("keep: without a detector the image is the truth itself")
    words = {
        "tolerance": float(tolerance),
        "precision": precision,
        "device": device,
        "frame": None if frame is None else tuple(int(n) for n in frame),
        "anchor": anchor,
        "method": method,
        "memory": memory,
        "oversample": oversample,
        "stamp_size": stamp_size,
    }
    scenes = None if shape is None else shape_of(shape, "shape")
    name = f"psfield-{uuid.uuid4().hex[:12]}"
    total = len(jobs) if isinstance(jobs, Sized) else None
    target: _Files | _Zarr
    if output is not None and os.fspath(output).rstrip("/").endswith(".zarr"):
        jobs, frames = _frames_of(jobs, scenes, words, detector, keep)
        path = os.path.abspath(output)
        settings = {
            **{key: list(value) if isinstance(value, tuple) else value for key, value in words.items() if key not in ("device", "memory")},
            "model": tokenize(model),
            "detector": None if detector is None else tokenize(detector),
        }
        count = len(jobs)
        target = _Zarr(ZarrLedger(path, count, frames, settings, overwrite))
    else:
        target = _Files(FitsFiles(name, words), None if output is None else os.fspath(output), overwrite)

    from psfield.dask._worker import BatchSettings, ModelOnWorker

    shared = BatchSettings(
        name, pickle.dumps(model), words, scenes, detector, tuple(keep), target.writer, threads
    )
    with ExitStack() as stack:
        stack.callback(target.close)
        client = stack.enter_context(_client(client, total))
        client.register_plugin(ModelOnWorker(shared), name=name)
        stack.callback(client.unregister_worker_plugin, name)
        run = _Run(client, shared, target, retries, total, as_callback(progress))
        results = run.all(jobs)
    failed = [result for result in results if result.status == "failed"]
    if failed:
        first = f"job {failed[0].index}: {failed[0].error}"
        warnings.warn(f"{len(failed)} of {len(results)} jobs failed, the first of them {first}", PsfieldWarning, stacklevel=2)
    return results


class _Files:
    """One FITS file a job."""

    def __init__(self, writer: FitsFiles, template: str | None, overwrite: bool) -> None:
        self.writer = writer
        self._template = template
        self._overwrite = overwrite
        self._taken: dict[str, int] = {}
        self._folders: set[str] = set()
        if template is not None and "{index" not in template and "{seed" not in template:
            raise ValueError(
                f"output must have {{index}} or {{seed}} in its name (frames/{{index:06d}}.fits), or end in .zarr, got {template!r}"
            )

    def of(self, index: int, job: Mapping[str, Any]) -> str:
        """Return the file of a job."""
        named = job.get("output")
        if named is None and self._template is None:
            raise ValueError("there is no output: give it to the batch or to the job")
        if named is None and "{seed" in str(self._template) and job.get("seed") is None:
            raise ValueError("output has {seed} in its name, and the job has no seed")
        path = os.path.abspath(str(self._template).format(index=index, seed=job.get("seed")) if named is None else named)
        if (first := self._taken.setdefault(path, index)) != index:
            raise ValueError(f"{path} is already the output of job {first}")
        self._folders.add(os.path.dirname(path))
        return path

    def is_done(self, index: int, path: str) -> bool:
        return not self._overwrite and os.path.exists(path)

    def note(self, index: int) -> None:
        """Files speak for themselves."""

    def close(self) -> None:
        self.writer.remove_unfinished(self._folders)


class _Zarr:
    """One frame of a Zarr group a job."""

    def __init__(self, ledger: ZarrLedger) -> None:
        self.writer = ZarrFrames(ledger.path)
        self._ledger = ledger

    def of(self, index: int, job: Mapping[str, Any]) -> str:
        if job.get("output") is not None:
            raise ValueError("output: the frames of this batch go to one Zarr group")
        return f"{self.writer.path}[{index}]"

    def is_done(self, index: int, path: str) -> bool:
        return bool(self._ledger.done[index])

    def note(self, index: int) -> None:
        self._ledger.note(index)

    def close(self) -> None:
        self._ledger.flush()


class _Run:
    """The jobs of one batch on a cluster."""

    def __init__(
        self,
        client: Client,
        settings: BatchSettings,
        target: _Files | _Zarr,
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
        from distributed import as_completed

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
        from psfield.dask._worker import run_job

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


@contextmanager
def _client(client: Client | None, total: int | None) -> Iterator[Client]:
    """Give the cluster that is to be used, or one of this machine."""
    import distributed

    if client is None:
        try:
            client = distributed.default_client()
        except ValueError:
            workers = min(dask.system.CPU_COUNT, total or dask.system.CPU_COUNT)
            with (
                distributed.LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address="127.0.0.1:0") as cluster,
                distributed.Client(cluster) as client,
            ):
                yield client
            return
    if client.asynchronous:
        raise ValueError("client must not be asynchronous")
    yield client


def _frames_of(
    jobs: Iterable[Job], shape: tuple[int, int] | None, words: dict[str, Any], detector: Any, keep: Sequence[str]
) -> tuple[Sequence[Job], dict[str, tuple[tuple[int, int], np.dtype[Any]]]]:
    """Return the jobs, which must be countable, and the shapes and types of the arrays that hold their frames."""
    if not isinstance(jobs, Sequence):
        if not isinstance(jobs, Sized):
            raise TypeError("jobs: a Zarr array needs to know how many there are: give them as a list, or as a sequence of your own")
        jobs = list(jobs)
    if shape is None:
        first = jobs[0] if len(jobs) else {}
        shape = shape_without_reading(first) if isinstance(first, Mapping) else None
    if shape is None:
        raise ValueError("shape is not known from the first job: give the rows and columns of the scenes")
    finer = words["oversample"]
    image = (shape[0] // finer, shape[1] // finer) if words["frame"] is None else (words["frame"][3], words["frame"][2])
    dtype: np.dtype[Any] = DTYPES[words["precision"]]
    frames: dict[str, tuple[tuple[int, int], np.dtype[Any]]] = {"image": (image, dtype)}
    if detector is not None:
        # The types of its pixels.
        exposure = detector.expose(np.zeros((1, 1), dtype), 0)
        frames = {"image": (image, exposure.counts.dtype), "flags": (image, exposure.flags.dtype)}
        if "truth" in keep:
            frames["truth"] = (image, dtype)
    if "scene" in keep:
        frames["scene"] = (shape, dtype)
    return jobs, frames
