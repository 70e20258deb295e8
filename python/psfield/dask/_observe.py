"""Surveys on a cluster."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dask.base import tokenize

from psfield._choices import integer
from psfield._progress import Progress, as_callback
from psfield._survey import FrameReport, Survey
from psfield.dask._batch import _client
from psfield.dask._kept import Kept

if TYPE_CHECKING:
    from distributed import Client

#: The surveys that this process works on.
_SURVEYS: Kept[Survey] = Kept(2)


def observe(
    survey: Survey,
    *,
    overwrite: bool = False,
    client: Client | None = None,
    retries: int = 2,
    progress: Progress | None = None,
) -> list[FrameReport]:
    """Make the frames of a survey on the workers of a Dask cluster, which write the files.

    A task is a frame. Each worker reads the catalogue once for each band. The files are those of
    `Survey.observe`. The frame of a lost worker is made by another one, and a second call makes
    only the frames that are missing.

    Parameters
    ----------
    survey : Survey
        The survey. The workers and the client must see its files under the same names. A large
        catalogue should be a file: a table in memory is sent with each frame.
    overwrite : bool
        Make all frames again and replace files that exist.
    client : distributed.Client, optional
        The cluster. Default: the current client. If there is none, one worker process with one
        thread for each core of this machine.
    retries : int
        Number of times that a frame is tried again after an error of its worker.
    progress : callable or tqdm bar, optional
        ``progress(done, total)``, called after each frame.

    Returns
    -------
    list of FrameReport
        In the order of `Survey.frames`.

    Warns
    -----
    PsfieldWarning
        Some frames failed, or there are warnings about frames.

    Examples
    --------
    >>> import dask, distributed
    >>> import psfield, psfield.dask
    >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
    >>> _ = model.write("psf.fits", overwrite=True)
    >>> detector = {"name": "N", "shape": [41, 31], "psf": "psf.fits"}
    >>> detector["geometry"] = {"pixel_scale_arcsec": 0.5}
    >>> sky = {"ra": [10.0], "dec": [20.0], "flux": [100.0]}
    >>> survey = psfield.Survey(sky, [detector], [{"ra": 10, "dec": 20}], "{exposure}.fits")
    >>> with distributed.Client(processes=False, dashboard_address=None) as client:
    ...     reports = psfield.dask.observe(survey, client=client, overwrite=True)
    >>> reports[0].status
    'done'
    """
    from distributed import as_completed

    if not isinstance(survey, Survey):
        raise TypeError(f"survey must be a psfield.Survey, got {type(survey).__name__}")
    retries, callback = integer(retries, "retries"), as_callback(progress)
    count = len(survey._handle)
    reports: list[FrameReport | None] = [None] * count
    token = tokenize(survey.__reduce__()[1])
    with _client(client, count) as client:
        # A later call with `overwrite` makes the frames again, although its tasks are the same.
        futures = [
            client.submit(_observed, survey, token, number, overwrite, pure=False, retries=retries)
            for number in range(count)
        ]
        numbers = {future.key: number for number, future in enumerate(futures)}
        for done, future in enumerate(as_completed(futures), 1):
            reports[numbers[future.key]] = future.result()
            if callback is not None:
                callback(done, count)
    made = [report for report in reports if report is not None]
    survey._finish(made, overwrite, 3)
    return made


def _observed(survey: Survey, token: str, number: int, overwrite: bool) -> FrameReport:
    """Make a frame on a worker, with the catalogue and the plan of its frame before."""
    kept = _SURVEYS.get(token, lambda: survey)
    return kept._observe(number, overwrite)
