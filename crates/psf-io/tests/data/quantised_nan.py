"""Makes quantised_nan.fits.gz with astropy: a float image with NaN, quantised and in tiles.

The file is then compressed by gzip.
"""

import gzip

import numpy as np
from astropy.io import fits

data = np.random.default_rng(1).normal(100, 5, (12, 40)).astype(np.float32)
data[3, 4] = np.nan
data[7] = np.nan
hdus = [fits.PrimaryHDU(), fits.CompImageHDU(data, compression_type="RICE_1", quantize_level=16, dither_seed=7)]
fits.HDUList(hdus).writeto("quantised_nan.fits", checksum=False, overwrite=True)
with open("quantised_nan.fits", "rb") as plain, open("quantised_nan.fits.gz", "wb") as packed:
    packed.write(gzip.compress(plain.read(), mtime=0))
