"""The outputs of a batch, on the client."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence, Sized
from typing import Any

import numpy as np

from psfield._arrays import DTYPES
from psfield.dask._fits import FitsFiles
from psfield.dask._job import Job, shape_without_reading
from psfield.dask._zarr import ZarrFrames, ZarrLedger


class Files:
    """One FITS file per job."""

    def __init__(self, writer: FitsFiles, template: str | None, overwrite: bool) -> None:
        self.writer = writer
        self._template = template
        self._overwrite = overwrite
        #: The outputs so far, each with the index of its job.
        self._taken: dict[str, int] = {}
        if template is not None and "{index" not in template and "{seed" not in template:
            raise ValueError(
                "output must have {index} or {seed} in its name (frames/{index:06d}.fits), or end"
                f" in .zarr, got {template!r}"
            )
        try:
            str(template).format(index=0, seed=0)
        except (IndexError, KeyError, ValueError) as error:
            raise ValueError(
                f"output: {template!r} is not a template with {{index}} or {{seed}}: {error}"
            ) from None

    def of(self, index: int, job: Mapping[str, Any]) -> str:
        """Return the file of a job."""
        named = job.get("output")
        if named is None and self._template is None:
            raise ValueError("there is no output: give one to the batch or to the job")
        if named is None and "{seed" in str(self._template) and job.get("seed") is None:
            raise ValueError("output has {seed} in its name, and the job has no seed")
        if named is None:
            named = str(self._template).format(index=index, seed=job.get("seed"))
        path = os.path.abspath(named)
        if (first := self._taken.setdefault(path, index)) != index:
            raise ValueError(f"{path} is already the output of job {first}")
        return path

    def is_done(self, index: int, path: str) -> bool:
        return not self._overwrite and os.path.exists(path)

    def note(self, index: int) -> None:
        """Do nothing: a file that exists is finished."""

    def close(self) -> None:
        self.writer.remove_unfinished(self._taken)


class ZarrGroup:
    """One frame of a Zarr group per job."""

    def __init__(self, ledger: ZarrLedger) -> None:
        self.writer = ZarrFrames(ledger.path)
        self._ledger = ledger

    def of(self, index: int, job: Mapping[str, Any]) -> str:
        if job.get("output") is not None:
            raise ValueError("output: the frames of this batch are written to one Zarr group")
        return f"{self.writer.path}[{index}]"

    def is_done(self, index: int, path: str) -> bool:
        return bool(self._ledger.done[index])

    def note(self, index: int) -> None:
        self._ledger.note(index)

    def close(self) -> None:
        self._ledger.flush()


def frames_of(
    jobs: Iterable[Job],
    shape: tuple[int, int] | None,
    settings: dict[str, Any],
    detector: Any,
    keep: Sequence[str],
) -> tuple[Sequence[Job], dict[str, tuple[tuple[int, int], np.dtype[Any]]]]:
    """Return the jobs as a sequence, and the shapes and types of the arrays that hold frames."""
    if not isinstance(jobs, Sequence):
        if not isinstance(jobs, Sized):
            raise TypeError("jobs: the number of frames in a Zarr array must be known: give a list")
        jobs = list(jobs)
    if shape is None:
        first = jobs[0] if len(jobs) else {}
        shape = shape_without_reading(first) if isinstance(first, Mapping) else None
    if shape is None:
        raise ValueError(
            "shape is not known from the first job: give the rows and columns of the scenes"
        )
    finer = settings["oversample"]
    image = (shape[0] // finer, shape[1] // finer)
    if settings["frame"] is not None:
        _, _, columns, rows = settings["frame"]
        image = (rows, columns)
    dtype: np.dtype[Any] = DTYPES[settings["precision"]]
    frames: dict[str, tuple[tuple[int, int], np.dtype[Any]]] = {"image": (image, dtype)}
    if detector is not None:
        # An exposure of one pixel tells the types of counts and flags.
        exposure = detector.expose(np.zeros((1, 1), dtype), 0)
        frames = {"image": (image, exposure.counts.dtype), "flags": (image, exposure.flags.dtype)}
        if "truth" in keep:
            frames["truth"] = (image, dtype)
    if "scene" in keep:
        frames["scene"] = (shape, dtype)
    return jobs, frames
