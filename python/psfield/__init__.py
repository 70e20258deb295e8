"""Astronomical images with a point spread function (PSF) that varies over the field.

A `PsfModel` describes the PSF at every position of a field. Make it from samples, from a file, from
a photutils model or from a function that draws the PSF. Its `plan` for images of one shape
simulates any number of scenes. Each pixel is convolved with the PSF at its own position, within an
error that you set:

>>> import numpy as np
>>> import psfield
>>> y, x = np.mgrid[-8:9, -8:9]
>>> def gaussian(sigma):
...     stamp = np.exp(-(x**2 + y**2) / (2 * sigma**2))
...     return stamp / stamp.sum()
>>> positions = [(0, 0), (99, 0), (0, 79), (99, 79)]
>>> stamps = [gaussian(sigma) for sigma in (1.2, 1.5, 1.3, 1.8)]
>>> model = psfield.PsfModel.from_samples(stamps, positions)
>>> plan = model.plan((80, 100), tolerance=1e-3)
>>> scene = np.zeros((80, 100))
>>> scene[40, 50] = 1000.0
>>> image = plan.simulate(scene)
>>> round(float(image.sum()), 2)
1000.0

Arrays are ``[y, x]``. Positions are 0-based pixels ``(x, y)``, where an integer is the centre of a
pixel.
"""

from psfield import detector, metrics, plot
from psfield._catalog import read_catalog
from psfield._errors import PsfieldWarning
from psfield._inject import InjectReport, inject
from psfield._model import PsfModel
from psfield._native import __version__
from psfield._plan import DroppedLight, Plan, SpotCheck
from psfield._radial import RadialProfile
from psfield._reports import (
    FitReport,
    LeaveOneOutReport,
    PlanSummary,
    SamplingReport,
    VerificationReport,
    WingsReport,
)
from psfield._series import Series, SeriesExposure, series
from psfield._simulate import example, simulate
from psfield._survey import FrameReport, Survey, SurveyFrame, observe
from psfield._threads import set_threads, threads

__all__ = [
    "DroppedLight",
    "FitReport",
    "FrameReport",
    "InjectReport",
    "LeaveOneOutReport",
    "Plan",
    "PlanSummary",
    "PsfModel",
    "PsfieldWarning",
    "RadialProfile",
    "SamplingReport",
    "Series",
    "SeriesExposure",
    "SpotCheck",
    "Survey",
    "SurveyFrame",
    "VerificationReport",
    "WingsReport",
    "__version__",
    "detector",
    "example",
    "inject",
    "metrics",
    "observe",
    "plot",
    "read_catalog",
    "series",
    "set_threads",
    "simulate",
    "threads",
]
