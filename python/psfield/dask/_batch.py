"""Data sets of many frames."""

from __future__ import annotations

import os
import pickle
import uuid
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence, Sized
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any, Literal

import dask
import dask.system
from dask.base import tokenize

from psfield._arrays import shape_or_none
from psfield._choices import whole, whole_or_none
from psfield._defaults import DEFAULTS
from psfield._errors import PsfieldWarning
from psfield._model import PsfModel
from psfield._progress import Progress, as_callback
from psfield.dask._checks import checked_for_workers
from psfield.dask._fits import FitsFiles
from psfield.dask._job import Job, JobResult
from psfield.dask._targets import Files, ZarrGroup, frames_of
from psfield.dask._zarr import ZarrLedger
from psfield.detector import Detector

if TYPE_CHECKING:
    from distributed import Client


def batch(
    jobs: Iterable[Job],
    model: PsfModel,
    output: str | os.PathLike[str] | None = None,
    tolerance: float = DEFAULTS.tolerance,
    precision: Literal["f32", "f64"] = DEFAULTS.precision,
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
    anchor: Literal["source", "output"] = DEFAULTS.anchor,
    method: Literal["auto", "lowrank"] = DEFAULTS.method,
    memory: int = DEFAULTS.memory,
    oversample: int = DEFAULTS.oversample,
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
        ``"frames/{index:06d}.fits"``, is one FITS file a frame. A name that ends in ``.zarr`` is one Zarr group: its array ``image`` is
        ``[job, y, x]`` with one frame a chunk, and ``done`` says which frames are finished. Without it, each job names its own FITS file.
        Relative names count from the client's working directory; workers and the client must see the same files.
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

    Jobs that were on a worker each time that one was lost, more often than Dask's ``distributed.scheduler.allowed-failures`` (3), are run
    by themselves at the end: the one that kills workers fails, and no other.
    """
    words = checked_for_workers(
        model,
        tolerance=tolerance,
        precision=precision,
        device=device,
        frame=frame,
        anchor=anchor,
        method=method,
        memory=memory,
        oversample=oversample,
        stamp_size=stamp_size,
    )
    if isinstance(jobs, (str, bytes, Mapping)):
        raise TypeError(f"jobs must be a list or another iterable of jobs, got {type(jobs).__name__}")
    if isinstance(keep, str):
        raise TypeError(f"keep must be a list, as in ['scene'], got {keep!r}")
    if detector is not None and not isinstance(detector, Detector):
        raise TypeError(f"detector must be a psfield.detector.Detector, got {type(detector).__name__}")
    if unknown := set(keep) - {"scene", "truth"}:
        raise ValueError(f"keep may hold 'scene' and 'truth', got {min(unknown)!r}")
    if "truth" in keep and detector is None:
        raise ValueError("keep: without a detector the image is the truth itself")
    threads, retries = whole_or_none(threads, "threads", 1), whole(retries, "retries")
    scenes = shape_or_none(shape, "shape")
    name = f"psfield-{uuid.uuid4().hex[:12]}"
    total = len(jobs) if isinstance(jobs, Sized) else None
    target: Files | ZarrGroup
    if output is not None and os.fspath(output).rstrip("/").endswith(".zarr"):
        counted, frames = frames_of(jobs, scenes, words, detector, keep)
        path = os.path.abspath(output)
        settings = {
            **{key: list(value) if isinstance(value, tuple) else value for key, value in words.items() if key not in ("device", "memory")},
            "model": tokenize(model),
            "detector": None if detector is None else tokenize(detector),
        }
        jobs = counted
        target = ZarrGroup(ZarrLedger(path, len(counted), frames, settings, overwrite))
    else:
        target = Files(FitsFiles(name, words), None if output is None else os.fspath(output), overwrite)

    from psfield.dask._run import Run
    from psfield.dask._worker import BatchSettings, ModelOnWorker

    shared = BatchSettings(name, pickle.dumps(model), words, scenes, detector, tuple(keep), target.writer, threads)
    with ExitStack() as stack:
        stack.callback(target.close)
        client = stack.enter_context(_client(client, total))
        client.register_plugin(ModelOnWorker(shared), name=name)
        stack.callback(client.unregister_worker_plugin, name)
        run = Run(client, shared, target, retries, total, as_callback(progress))
        results = run.all(jobs)
    failed = [result for result in results if result.status == "failed"]
    if failed:
        first = f"job {failed[0].index}: {failed[0].error}"
        warnings.warn(f"{len(failed)} of {len(results)} jobs failed, the first of them {first}", PsfieldWarning, stacklevel=2)
    return results


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
