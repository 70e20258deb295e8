"""Warnings of the package."""


class PsfieldWarning(UserWarning):
    """A warning about a result that may be wrong, or about input that was skipped.

    For example, stars between pixels or galaxies are drawn from stamps that are not oversampled.

    Examples
    --------
    Turn these warnings into errors:

    >>> import warnings
    >>> import psfield
    >>> plan = psfield.PsfModel.from_samples([[1, 2, 1]], (0, 0)).plan((4, 5))
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("error", psfield.PsfieldWarning)
    ...     plan.simulate(catalog={"x": [2.5], "y": [1], "flux": 10})
    Traceback (most recent call last):
        ...
    psfield._errors.PsfieldWarning: the PSF stamps are too coarse...
    """
