"""Galaxies by GalSim: Sersic profiles through the PSF at their position, drawn one by one."""

import galsim
import numpy as np

INDEX_STEP = 0.05
"""Sersic indices are rounded to this step, so that GalSim uses its tables of each index again."""


class GalSim:
    """One `Sersic` and one `InterpolatedImage` per galaxy, with GalSim's default parameters.

    GalSim chooses the size of each stamp. With `lanczos3` and the scales for drawing in Fourier
    space computed, an `InterpolatedImage` is fastest here. The stamps include the response of the
    pixel.
    """

    name = "galsim"

    def __init__(self, inputs, count, seed):
        rng = np.random.default_rng(seed)
        self.inputs = inputs
        self.image = galsim.ImageF(np.zeros_like(inputs.scene), xmin=0, ymin=0)
        self.y, self.x = rng.uniform(0, inputs.size - 1, (2, count))
        self.flux = 10 ** rng.uniform(2, 5, count)
        self.radius = np.clip(1.5 * np.exp(0.5 * rng.normal(size=count)), 0.3, 8)
        self.index = np.round(rng.uniform(0.5, 4, count) / INDEX_STEP) * INDEX_STEP
        self.ratio = rng.uniform(0.2, 1, count)
        self.angle = rng.uniform(0, 180, count)

    def run(self):
        stamps = self.inputs.psf_at(self.y, self.x)
        for galaxy, stamp in enumerate(stamps):
            psf = galsim.InterpolatedImage(
                galsim.ImageF(stamp),
                scale=1.0,
                x_interpolant="lanczos3",
                normalization="flux",
                use_true_center=False,
            )
            # GalSim's half-light radius is that of the round profile of equal area.
            ratio = self.ratio[galaxy]
            radius = self.radius[galaxy] * np.sqrt(ratio)
            light = galsim.Sersic(
                self.index[galaxy], half_light_radius=radius, flux=self.flux[galaxy]
            )
            light = light.shear(q=ratio, beta=self.angle[galaxy] * galsim.degrees)
            centre = galsim.PositionD(self.x[galaxy], self.y[galaxy])
            convolved = galsim.Convolve(light, psf)
            drawn = convolved.drawImage(
                scale=1.0, method="no_pixel", dtype=np.float32, center=centre
            )
            bounds = drawn.bounds & self.image.bounds
            if bounds.isDefined():
                self.image[bounds] += drawn[bounds]
        return self.image.array
