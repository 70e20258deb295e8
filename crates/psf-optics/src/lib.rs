//! PSF sources: physical optics (pupil, Zernike wavefront over the field, seeing) and analytic profiles
