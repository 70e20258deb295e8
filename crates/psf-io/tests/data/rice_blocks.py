"""Makes rice_blocks.fits.gz with astropy: images of 1, 2 and 4 bytes per pixel.

Each image is stored plain and in tiles of RICE_1, with blocks of 16 and 32 pixels.
"""

import gzip

import numpy as np
from astropy.io import fits
from astropy.io.fits.hdu.compressed import header

rng = np.random.default_rng(2)
hdus = [fits.PrimaryHDU()]
for block in (16, 32):
    # astropy has no argument for the block size.
    header.DEFAULT_BLOCK_SIZE = block
    for dtype in (np.uint8, np.int16, np.int32):
        limits = np.iinfo(dtype)
        # Rows of equal pixels, of noise of a few bits, and of all possible numbers.
        image = np.full((24, 50), 9, dtype)
        image[6:18] = rng.integers(20, 40, (12, 50))
        image[15:] = rng.integers(limits.min, limits.max, (9, 50), endpoint=True)
        hdus.append(fits.ImageHDU(image))
        hdus.append(fits.CompImageHDU(image, compression_type="RICE_1", tile_shape=(5, 33)))
fits.HDUList(hdus).writeto("rice_blocks.fits", checksum=False, overwrite=True)
with open("rice_blocks.fits", "rb") as plain, open("rice_blocks.fits.gz", "wb") as packed:
    packed.write(gzip.compress(plain.read(), mtime=0))
