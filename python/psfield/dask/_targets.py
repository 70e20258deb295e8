"""Where the frames of a batch go, as the client sees it."""

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
    """One FITS file a job."""

    def __init__(self, writer: FitsFiles, template: str | None, overwrite: bool) -> None:
        self.writer = writer
        self._template = template
        self._overwrite = overwrite
        #: The outputs so far, and whose they are.
        self._taken: dict[str, int] = {}
        if template is not None and "{index" not in template and "{seed" not in template:
            raise ValueError(
                f"output must have {{index}} or {{seed}} in its name (frames/{{index:06d}}.fits), or end in .zarr, got {template!r}"
            )
        try:
            str(template).format(index=0, seed=0)
        except (IndexError, KeyError, ValueError) as error:
            raise ValueError(f"output: {template!r} may have {{index}} and {{seed}} in its name, as Python formats them: {error}") from None

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
        return path

    def is_done(self, index: int, path: str) -> bool:
        return not self._overwrite and os.path.exists(path)

    def note(self, index: int) -> None:
        """Files speak for themselves."""

    def close(self) -> None:
        self.writer.remove_unfinished(self._taken)


class ZarrGroup:
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


def frames_of(
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
