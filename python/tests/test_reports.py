"""Reports have attributes. Their former keys still work, with a warning."""

from __future__ import annotations

import dataclasses

import pytest

import psfield
from psfield.detector import Detector


def test_former_keys_of_reports_still_work(model):
    plan = model.plan((96, 128))
    drawn = psfield.PsfModel.from_function(lambda x, y: [[0, 1, 0], [1, 4, 1]], (5, 8))
    exposure = Detector(full_well_e=50.0).expose([[1.0, 60.0]], seed=1)
    fit = model.fit_report()
    for report in (plan.summary, drawn.sampling, exposure.report, fit, fit.leave_one_out):
        for field in dataclasses.fields(report):
            with pytest.warns(DeprecationWarning, match=rf"\.{field.name} in place of"):
                assert report[field.name] == getattr(report, field.name)
        with pytest.raises(KeyError):
            report["nothing"]
