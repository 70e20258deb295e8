"""Simulations on Dask: scenes larger than the memory of a machine, and data sets of many frames.

`simulate` turns a scene that is a chunked Dask array into its image, also a chunked array. `batch`
simulates many frames on the workers of a cluster, which write them to FITS files or to Zarr.
`observe` makes the frames of a survey.

The module needs ``dask[array]``, `batch` and `observe` need ``distributed``: ``pip install
'psfield[dask]'``. FITS files need astropy, Zarr needs zarr.
"""

from psfield.dask._batch import batch
from psfield.dask._job import Job, JobResult
from psfield.dask._observe import observe
from psfield.dask._simulate import simulate

__all__ = ["Job", "JobResult", "batch", "observe", "simulate"]
