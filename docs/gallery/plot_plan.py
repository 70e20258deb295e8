"""
The blocks of a plan
====================

A plan divides the frame into blocks. In each block a few modes describe the PSF to the tolerance,
and each mode costs a convolution. A block where the PSF changes faster needs more modes, and so
does a smaller tolerance.
"""

import matplotlib.pyplot as plt

import psfield
from psfield.plot import plot_plan

shape = (2048, 3072)
model = psfield.PsfModel.from_telescope("survey-2m", field_shape=shape)

figure, axes = plt.subplots(1, 2, figsize=(11, 3.8), layout="constrained")
for ax, tolerance in zip(axes, [1e-2, 1e-4], strict=True):
    plan = model.plan(shape, tolerance, device="cpu")
    plot_plan(plan, ax=ax)
    modes = plan.summary.mean_modes
    ax.set_title(f"tolerance {tolerance:g}: {modes:.1f} modes on average")
plt.show()
