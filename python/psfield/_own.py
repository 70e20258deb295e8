"""Interpolations and bases of the caller's own."""

from __future__ import annotations

import copy
import functools
from collections.abc import Callable
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from psfield import _native
from psfield._arrays import reals, stack
from psfield._choices import real

_Array: TypeAlias = NDArray[np.float64]


@runtime_checkable
class Regressor(Protocol):
    """An object with the methods ``fit`` and ``predict`` of scikit-learn.

    It is fitted to positions ``[sample, (x, y)]`` and coefficients ``[sample, component]``.
    """

    def fit(self, X: Any, y: Any, /) -> Any:
        """Fit the object to positions and coefficients."""

    def predict(self, X: Any, /) -> Any:
        """Return coefficients ``[position, component]``."""


@runtime_checkable
class Decomposition(Protocol):
    """An object with ``fit_transform`` and ``components_``, as in scikit-learn.

    It is fitted to the pixels of the stamps, ``[sample, pixel]``. If it has an array ``mean_``,
    this is the mean stamp.
    """

    components_: Any

    def fit_transform(self, X: Any, /) -> Any:
        """Fit the object to the stamps."""


#: An interpolation: a name, or a regressor, or a function ``f(positions, values)`` that returns a
#: function ``g(positions)``.
Interpolation: TypeAlias = str | Regressor | Callable[[_Array, _Array], Callable[[_Array], Any]]

#: The largest number of parts into which samples are divided to predict each part from the others.
FOLDS = 10


def split(interpolation: Interpolation | None) -> tuple[str | None, Interpolation | None]:
    """Return the name of an interpolation and the caller's own. One of them is None."""
    if interpolation is None or isinstance(interpolation, str):
        return interpolation, None
    if not isinstance(interpolation, Regressor) and not callable(interpolation):
        raise TypeError(
            "interpolation must be a name, an object with fit and predict, or a function"
            f" f(positions, values) that returns a function of positions, got {interpolation!r}"
        )
    return None, interpolation


def interpolated(
    model: _native.PsfModel, interpolation: Interpolation | None, table_error: float
) -> _native.PsfModel:
    """Return a model with an interpolation of the caller's own, if there is one."""
    error = real(table_error, "table_error")
    if interpolation is None:
        return model
    positions, values = np.column_stack(model.positions()), model.parameters()[2]
    states = model.states()
    each = np.zeros(len(positions)) if states is None else np.asarray(states[1])
    groups = [np.flatnonzero(each == value) for value in np.unique(each)]
    fitted = [_fitted(interpolation, positions[group], values[group]) for group in groups]

    def evaluate(x: _Array, y: _Array) -> _Array:
        at = np.column_stack([x, y])
        return np.concatenate([predict(at) for predict in fitted], axis=1)

    folds = min(FOLDS, *(len(group) for group in groups))
    predictions = np.full_like(values, np.nan)
    for group in groups if folds > 1 else ():
        fold_of = np.random.default_rng(0).permutation(len(group)) % folds
        for fold in range(folds):
            left_out, others = group[fold_of == fold], group[fold_of != fold]
            try:
                predict = _fitted(interpolation, positions[others], values[others])
                predictions[left_out] = predict(positions[left_out])
            except (ValueError, ArithmeticError, np.linalg.LinAlgError):
                # The others do not suit the method. These samples count as unpredictable.
                continue
    return model.interpolated_by(_name(interpolation), evaluate, (predictions, folds), error)


def _fitted(
    interpolation: Interpolation, positions: _Array, values: _Array
) -> Callable[[_Array], _Array]:
    """Fit an interpolation. Return a function of positions that checks its results."""
    own: Any
    if isinstance(interpolation, Regressor) and not isinstance(interpolation, type):
        regressor = copy.deepcopy(interpolation)
        regressor.fit(positions, values)
        own = regressor.predict
    else:
        own = interpolation(positions, values)  # type: ignore[operator]
        if not callable(own):
            raise TypeError(f"interpolation must return a function of positions, got {own!r}")

    def predict(at: _Array) -> _Array:
        found = reals(own(at), "the result of interpolation")
        expected = (len(at), values.shape[1])
        if found.ndim == 1 and expected[1] == 1:
            found = found[:, np.newaxis]
        if found.shape != expected:
            raise ValueError(
                "interpolation must return coefficients [position, component] of shape"
                f" {expected}, got {found.shape}"
            )
        finite = np.isfinite(found).all(axis=1)
        if not finite.all():
            x, y = at[np.argmin(finite)]
            raise ValueError(f"interpolation returned a value that is not finite at ({x:g}, {y:g})")
        return found

    return predict


def _name(interpolation: Interpolation) -> str:
    """Return the name of an interpolation, for files and reports."""
    if isinstance(interpolation, functools.partial):
        return _name(interpolation.func)
    name = getattr(interpolation, "__name__", None)
    if name is not None:
        return str(name)
    text = repr(interpolation)
    short = len(text) <= 60 and "\n" not in text and not text.startswith("<")
    return text if short else type(interpolation).__name__


def basis_stamps(
    basis: Decomposition | ArrayLike, stamps: _Array, oversampling: float, normalise: str | None
) -> tuple[_Array | None, _Array]:
    """Return the mean stamp, if there is one, and the components of a basis of the caller's own."""
    if not hasattr(basis, "fit_transform"):
        return None, stack(basis, "basis", "[component, y, x]")
    count, ny, nx = stamps.shape
    pixels = stamps.reshape(count, ny * nx)
    if normalise != "keep":
        flux = pixels.sum(axis=1, keepdims=True) / oversampling**2
        if not (flux > 0).all():
            raise ValueError(f"stamp {np.argmin(flux > 0)} has no positive flux")
        pixels = pixels / flux
    decomposition: Any = copy.deepcopy(basis)
    decomposition.fit_transform(pixels)
    if not hasattr(decomposition, "components_"):
        name = type(basis).__name__
        raise TypeError(f"basis: {name} has no components_ after fit_transform")
    components = reals(decomposition.components_, "basis.components_").reshape(-1, ny, nx)
    mean = getattr(decomposition, "mean_", None)
    return None if mean is None else reals(mean, "basis.mean_").reshape(ny, nx), components
