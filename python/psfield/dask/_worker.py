"""The jobs of a batch on a worker."""

from __future__ import annotations

import pickle
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from distributed import Worker, WorkerPlugin

from psfield._colour import first_image, is_images
from psfield._model import PsfModel
from psfield._plan import Plan
from psfield.dask._cores import set_threads_of
from psfield.dask._fits import FitsFiles
from psfield.dask._job import JobResult, Task, catalog_of, psf_of, scene_of
from psfield.dask._kept import Kept
from psfield.dask._zarr import ZarrFrames

#: The batches that this process works on.
_BATCHES: dict[str, BatchSettings] = {}
_MODELS: Kept[PsfModel] = Kept(4)
#: Plans, by batch and shape of the scene.
_PLANS: Kept[Plan] = Kept(4)


@dataclass(frozen=True)
class BatchSettings:
    """The settings that all jobs of a batch share."""

    name: str
    #: Pickled. It is loaded on a thread that runs jobs, because loading may take long.
    model: bytes
    plan_settings: dict[str, Any]
    #: Shape of the scenes, for jobs with only a catalogue.
    shape: tuple[int, int] | None
    detector: Any
    keep: tuple[str, ...]
    output: FitsFiles | ZarrFrames
    threads: int | None


class ModelOnWorker(WorkerPlugin):  # type: ignore[misc]
    """Sends the settings of a batch to each worker once, also to workers that join later."""

    def __init__(self, settings: BatchSettings) -> None:
        self.settings = settings
        self.name = settings.name

    def setup(self, worker: Worker) -> None:
        """Keep the settings of the batch."""
        set_threads_of(worker, self.settings.threads)
        _BATCHES[self.settings.name] = self.settings

    def teardown(self, worker: Worker) -> None:
        """Remove the settings of the batch."""
        name = self.settings.name
        _BATCHES.pop(name, None)
        _MODELS.drop(lambda key: key == name)
        _PLANS.drop(lambda key: key[0] == name)


def run_jobs(batch: str, tasks: Sequence[Task]) -> list[tuple[JobResult, bool]]:
    """Make frames one after the other and write them.

    The second value of each result says whether the job failed to read or write files and may run
    again.
    """
    settings = _BATCHES[batch]
    return [_run(settings, task) for task in tasks]


def _run(settings: BatchSettings, task: Task) -> tuple[JobResult, bool]:
    start = time.perf_counter()
    try:
        _make(settings, task.index, task.job, task.output)
    except (Exception, SystemExit) as error:
        # A function that exits would end its worker, and then the next worker that runs the job.
        text = f"{type(error).__name__}: {error}"
        again = isinstance(error, OSError) and not isinstance(error, FileNotFoundError)
        seconds = time.perf_counter() - start
        return JobResult(task.index, "failed", task.output, seconds, text), again
    return JobResult(task.index, "written", task.output, time.perf_counter() - start), False


def _make(settings: BatchSettings, index: int, job: Mapping[str, Any], target: str) -> None:
    """Simulate the frame of a job and write it."""
    scene, header = scene_of(job)
    shape = settings.shape if scene is None else np.shape(first_image(scene))
    if shape is None:
        raise ValueError(
            "shape is not known: a job with only a catalog needs batch(..., shape=(ny, nx))"
        )
    plan = _PLANS.get(
        (settings.name, tuple(shape)),
        lambda: _model(settings).plan(tuple(shape), **settings.plan_settings),
    )
    psf = psf_of(job)
    if psf is not None:
        plan = plan.with_psf(psf)
    image = plan.simulate(scene, catalog_of(job))
    frames = {"image": image}
    detector = job.get("detector", settings.detector)
    if detector is not None:
        exposure = detector.expose(image, int(job["seed"]))
        frames = {"image": exposure.counts, "flags": exposure.flags}
        if "truth" in settings.keep:
            frames["truth"] = image
    if "scene" in settings.keep:
        lights = [] if scene is None else list(scene.values()) if is_images(scene) else [scene]
        frames["scene"] = np.asarray(sum(lights, np.zeros(plan.shape)), plan.dtype)
    if isinstance(settings.output, ZarrFrames):
        settings.output.write(index, frames)
    else:
        settings.output.write(target, frames, job, header)


def _model(settings: BatchSettings) -> PsfModel:
    return _MODELS.get(settings.name, lambda: _loaded(settings.model))


def _loaded(model: bytes) -> PsfModel:
    loaded: PsfModel = pickle.loads(model)
    return loaded
