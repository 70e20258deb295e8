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
from numpy.typing import ArrayLike

from psfield._arrays import Precision, shape_or_none
from psfield._choices import integer, integer_or_none
from psfield._colour import PathLike
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
    precision: Precision = DEFAULTS.precision,
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
    tolerance_on: Literal["l2", "aperture"] = DEFAULTS.tolerance_on,
    floor: float = DEFAULTS.floor,
    anchor: Literal["source", "output"] = DEFAULTS.anchor,
    method: Literal["auto", "lowrank"] = DEFAULTS.method,
    memory: int | None = DEFAULTS.memory,
    oversample: int = DEFAULTS.oversample,
    scene_pixels: Literal["point", "integrated"] = DEFAULTS.scene_pixels,
    stamp_size: int | None = None,
    bandpass: PathLike | tuple[ArrayLike, ArrayLike] | None = None,
    sed: PathLike | None = None,
    dispersion: Mapping[str, float] | str | None = None,
) -> list[JobResult]:
    """Simulate many frames on the workers of a Dask cluster, which write them to files.

    The PSF is sent to each worker once, and a worker makes one plan for each shape of scenes. Each
    frame is written as soon as it is finished. No partial file is left if that fails. The jobs of a
    lost worker run again on others, and a job that fails does not stop the rest. A second run makes
    only the frames that are missing.

    Parameters
    ----------
    jobs : iterable of dict
        The frames: see `Job`. It may be a generator, from which only a few jobs per thread of the
        workers are taken in advance. Prefer scenes and catalogues that are files or functions:
        workers read and call them, and arrays need not be sent.
    model : PsfModel
        The PSF.
    output : path, optional
        Where frames are written. A name with ``{index}`` (from 0, ``{index:06d}`` with leading
        zeros) or ``{seed}``, such as ``"frames/{index:06d}.fits"``, makes one FITS file per frame.
        A name that ends in ``.zarr`` makes one Zarr group. Its array ``image`` is ``[job, y, x]``
        with one frame per chunk, and ``done`` tells which frames are finished. Without ``output``
        each job names its own FITS file. Relative names start at the working directory of the
        client. The workers and the client must see the same files.
    tolerance, precision, device
        As for `PsfModel.plan`.
    shape : (int, int), optional
        Rows and columns of the scenes. Needed for jobs with only a catalogue, and for Zarr if the
        shape is not known from the first job.
    detector : psfield.detector.Detector, optional
        Detector that exposes the images. Each job then needs a seed. The output is the counts and
        the ``flags`` of the pixels.
    keep : sequence of {'scene', 'truth'}
        Additional output for each frame: the pixels of the scene (``scene``), the image without
        noise (``truth``). They are extensions of the FITS file, or arrays of the Zarr group.
    overwrite : bool
        Make all frames and replace existing output. By default finished frames are kept.
    client : distributed.Client, optional
        The cluster. Default: the current client. If there is none, one worker process with one
        thread for each core of this machine.
    retries : int
        Number of times that a job runs again if its files cannot be read or written.
    threads : int, optional
        Threads of psfield in each worker process. Default: the number of threads that Dask gave the
        worker, or ``RAYON_NUM_THREADS`` in its environment.
    progress : callable or tqdm bar, optional
        ``progress(done, total)``. For a generator, the total is the number of jobs taken so far.
    frame, tolerance_on, floor, anchor, method, memory, oversample, scene_pixels, stamp_size
        As for `PsfModel.plan`.
    bandpass, sed, dispersion
        As for `PsfModel.plan`. Each plan keeps up to ``memory`` bytes, and a worker keeps the four
        plans that it used last.

    Returns
    -------
    list of JobResult
        In the order of the jobs.

    Raises
    ------
    ValueError
        An argument is invalid, or the Zarr group holds other frames.

    Warns
    -----
    PsfieldWarning
        Some jobs failed. The results say which and why.

    Notes
    -----
    Without a client, new worker processes are started, and each imports the script of the caller.
    The script therefore needs ``if __name__ == "__main__":``.

    Dask gives up a job if its worker was lost more often than the setting
    ``distributed.scheduler.allowed-failures`` (3) allows. Such jobs run one at a time at the end,
    so that only the job that kills workers fails.

    Examples
    --------
    >>> import numpy as np
    >>> import psfield
    >>> import astropy, dask, distributed
    >>> import psfield.dask
    >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
    >>> jobs = [{"scene": np.full((4, 6), brightness)} for brightness in (1.0, 2.0)]
    >>> with distributed.Client(processes=False, dashboard_address=None) as client:
    ...     results = psfield.dask.batch(
    ...         jobs, model, "frame{index}.fits", client=client, overwrite=True
    ...     )
    >>> [result.status for result in results]
    ['written', 'written']
    """
    settings = checked_for_workers(model, locals())
    if isinstance(jobs, (str, bytes, Mapping)):
        raise TypeError(
            f"jobs must be a list or another iterable of jobs, got {type(jobs).__name__}"
        )
    if isinstance(keep, str):
        raise TypeError(f"keep must be a list, as in ['scene'], got {keep!r}")
    if detector is not None and not isinstance(detector, Detector):
        raise TypeError(
            f"detector must be a psfield.detector.Detector, got {type(detector).__name__}"
        )
    if unknown := set(keep) - {"scene", "truth"}:
        raise ValueError(f"keep may hold 'scene' and 'truth', got {min(unknown)!r}")
    if "truth" in keep and detector is None:
        raise ValueError(
            "keep: 'truth' needs a detector: without one the image itself is the truth"
        )
    threads, retries = integer_or_none(threads, "threads", 1), integer(retries, "retries")
    scenes = shape_or_none(shape, "shape")
    name = f"psfield-{uuid.uuid4().hex[:12]}"
    total = len(jobs) if isinstance(jobs, Sized) else None
    target: Files | ZarrGroup
    if output is not None and os.fspath(output).rstrip("/").endswith(".zarr"):
        counted, frames = frames_of(jobs, scenes, settings, detector, keep)
        path = os.path.abspath(output)
        recorded = {
            **{
                key: list(value) if isinstance(value, tuple) else value
                for key, value in settings.items()
                if key not in ("device", "memory")
            },
            "model": tokenize(model),
            "detector": None if detector is None else tokenize(detector),
        }
        jobs = counted
        target = ZarrGroup(ZarrLedger(path, len(counted), frames, recorded, overwrite))
    else:
        target = Files(
            FitsFiles(name, settings), None if output is None else os.fspath(output), overwrite
        )

    from psfield.dask._run import Run
    from psfield.dask._worker import BatchSettings, ModelOnWorker

    shared = BatchSettings(
        name, pickle.dumps(model), settings, scenes, detector, tuple(keep), target.writer, threads
    )
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
        text = f"{len(failed)} of {len(results)} jobs failed, the first of them {first}"
        warnings.warn(text, PsfieldWarning, stacklevel=2)
    return results


@contextmanager
def _client(client: Client | None, total: int | None) -> Iterator[Client]:
    """Yield the given client, the current one, or a new one on this machine."""
    import distributed

    if client is None:
        try:
            client = distributed.default_client()
        except ValueError:
            workers = min(dask.system.CPU_COUNT, total or dask.system.CPU_COUNT)
            with (
                distributed.LocalCluster(
                    n_workers=workers, threads_per_worker=1, dashboard_address="127.0.0.1:0"
                ) as cluster,
                distributed.Client(cluster) as client,
            ):
                yield client
            return
    if client.asynchronous:
        raise ValueError("client must not be asynchronous: make it without asynchronous=True")
    yield client
