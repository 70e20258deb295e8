"""
Stars between pixels
====================

The image of a star depends on the position of the star within its pixel. psfield draws each star
with the PSF at its exact position. A star at the centre of a pixel has half of its flux in that
pixel. At the corner of four pixels, each of them holds a fifth. The red cross marks the star.
"""

import matplotlib.pyplot as plt

import psfield

model = psfield.PsfModel.from_telescope(
    "survey-2m", field_shape=(512, 768), stamp_size=32, oversampling=4
)
figure, axes = plt.subplots(1, 4, figsize=(11, 3.2), layout="constrained")
for ax, x, y in zip(axes, [400, 400.25, 400.5, 400.5], [250, 250, 250, 250.5], strict=True):
    # 13 x 13 pixels about the pixel that contains the star
    stamp = 100 * model.evaluate(x, y, pixels="frame", size=13, sub_pixel=True)
    left, bottom = int(x + 0.5) - 6.5, int(y + 0.5) - 6.5
    shown = ax.imshow(
        stamp, origin="lower", extent=(left, left + 13, bottom, bottom + 13), vmin=0, vmax=50
    )
    ax.plot(x, y, "+", color="red", markersize=12)
    ax.set(title=f"star at ({x:g}, {y:g})\nbrightest pixel {stamp.max():.1f} %")
    ax.set(xlabel="x (pixels)", xlim=(394.5, 406.5), ylim=(244.5, 256.5))
axes[0].set_ylabel("y (pixels)")
figure.colorbar(shown, ax=axes, label="flux in a pixel (%)", shrink=0.75)
plt.show()
