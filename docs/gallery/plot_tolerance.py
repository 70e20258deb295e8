"""
Tolerance and measured error
============================

The tolerance is a promise: the largest relative L2 error of the image of any single point of light.
Here 60 points are simulated at eight tolerances, and each is compared with the exact sum. The
largest error stays below the dashed line. In single precision, rounding takes over near 1e-7.
"""

import matplotlib.pyplot as plt
import numpy as np

import psfield

shape, step = (420, 700), 70
model = psfield.PsfModel.from_telescope("survey-2m", field_shape=shape, stamp_size=32)
scene = np.zeros(shape)
scene[step // 2 :: step, step // 2 :: step] = 1.0
exact = model.plan(shape, tolerance=0, precision="f64").simulate(scene)


def tiles(image):
    """Cut an image into one tile per point."""
    rows, columns = shape[0] // step, shape[1] // step
    return image.reshape(rows, step, columns, step).swapaxes(1, 2).reshape(-1, step * step)


tolerances = 10.0 ** -np.arange(1, 9)
figure, ax = plt.subplots(figsize=(6, 4.5), layout="constrained")
for precision, marker in [("f32", "o"), ("f64", "s")]:
    worst = []
    for tolerance in tolerances:
        image = model.plan(shape, tolerance, precision, device="cpu").simulate(scene)
        error = np.linalg.norm(tiles(image - exact), axis=1) / np.linalg.norm(tiles(exact), axis=1)
        worst.append(error.max())
    ax.loglog(tolerances, worst, marker=marker, label=f"largest of 60 points, {precision}")
    if precision == "f64":
        assert (worst <= tolerances).all()
ax.loglog(tolerances, tolerances, "k--", label="promised")
ax.set(xlabel="tolerance", ylabel="relative L2 error of a point's image")
ax.invert_xaxis()
ax.legend()
plt.show()
