"""PSFs that vary over the field as differentiable functions of JAX.

`SpatiallyVaryingBlur` applies a `psfield.Plan` to arrays of JAX. It works under ``jit``, ``vmap``,
``grad``, ``jvp`` and ``linear_transpose``, in any combination. Gradients also pass to the
parameters of the PSF and to sources, once, in reverse mode.

The module needs JAX: ``pip install jax``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from psfield._catalog import source_columns
from psfield._operator import (
    PARAMETERS,
    PsfPlans,
    applied,
    check_image,
    check_parameter,
    checked_plan,
    drawn,
    gradients,
    light_index,
    result_shape,
    source_gradients,
)
from psfield._plan import Plan

try:
    import jax
    from jax.custom_derivatives import SymbolicZero
    from jax.extend.core import Primitive
    from jax.interpreters import ad, batching, mlir
except ImportError as error:
    message = "psfield.jax needs JAX: pip install jax"
    raise ImportError(message, name=error.name) from error

__all__ = ["SpatiallyVaryingBlur"]

#: A function from arrays of NumPy to arrays of NumPy, with settings by name.
_Native: TypeAlias = Callable[..., Sequence[NDArray[Any]]]


class SpatiallyVaryingBlur:
    """Convolution of light with a PSF that varies over the field.

    A plan is a linear operator: ``image = A light``. A call applies ``A``, `adjoint` its transpose
    ``A^T``. The reverse mode of each is the other, so a gradient costs about as much as an image.

    The native engine works on the CPU. It reads arrays there without a copy, checks that pixels are
    finite, and uses `psfield.threads` threads. JAX copies arrays of other devices to the CPU, and
    the results back. Results are equal, bit for bit, to those of `Plan.simulate` and
    `Plan.adjoint`. ``vmap`` adds a leading axis, so the engine gets all images in one call.

    Parameters
    ----------
    plan : psfield.Plan
        The plan. In colour, it needs a spectrum (``sed``). Double precision needs
        ``jax.config.update("jax_enable_x64", True)``.

    Attributes
    ----------
    plan : psfield.Plan
        The plan.

    Notes
    -----
    Under ``jit``, an error of the engine, such as that of a pixel that is not finite, reaches the
    caller as ``jax.errors.JaxRuntimeError`` with the message of the engine in its text.

    Examples
    --------
    >>> import jax
    >>> import psfield
    >>> from psfield.jax import SpatiallyVaryingBlur
    >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
    >>> blur = SpatiallyVaryingBlur(model.plan((3, 4), tolerance=1e-4))
    >>> gradient = jax.jit(jax.grad(lambda light: blur(light)[1, 1]))
    >>> (8 * gradient(jax.numpy.zeros((3, 4)))).round().tolist()
    [[0.0, 1.0, 0.0, 0.0], [1.0, 4.0, 1.0, 0.0], [0.0, 1.0, 0.0, 0.0]]
    """

    def __init__(self, plan: Plan) -> None:
        self.plan = checked_plan(plan)
        self._psf_plans: PsfPlans | None = None

    def __call__(
        self,
        light: Any,
        *,
        mean: Any = None,
        components: Any = None,
        coefficients: Any = None,
    ) -> jax.Array:
        """Return the images of light.

        With any of ``mean``, ``components`` and ``coefficients``, the PSF is the plan's model with
        these parameters (`PsfModel.with_parameters`), and gradients pass to them, too. They are
        derivatives of the model, not of the modes of the plan, and keep its tolerance. They can be
        taken once, in reverse mode. ``vmap`` calls the engine for each example if parameters are
        mapped, or their gradients. For the sum of the gradients, a call with a stack of light is
        faster.

        Parameters
        ----------
        light : array_like
            ``[..., y, x]`` with the shape of the plan, finite, of its type. For a plan of a region
            also its `~psfield.Plan.light_region` alone.
        mean : array_like, optional
            Mean stamp ``[y, x]``, as `PsfModel.mean`.
        components : array_like, optional
            Stamps ``[component, y, x]``, as `PsfModel.components`. They need not be orthonormal.
        coefficients : array_like, optional
            Coefficients ``[position, component]``, as `PsfModel.coefficients`.

        Returns
        -------
        jax.Array
            ``[..., y, x]`` with the `~psfield.Plan.image_shape` of the plan.

        Raises
        ------
        TypeError
            The light is of another type than the plan, a parameter is not real, or the plan is for
            double precision and ``jax_enable_x64`` is off.
        ValueError
            The light has another shape, or a pixel is not finite. Or there are parameters, and the
            PSF has wings, is that of a plan in colour, or has an interpolation of your own.

        Examples
        --------
        >>> import jax
        >>> import psfield
        >>> from psfield.jax import SpatiallyVaryingBlur
        >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
        >>> blur = SpatiallyVaryingBlur(model.plan((20, 30)))
        >>> blur(jax.numpy.ones((5, 20, 30))).shape
        (5, 20, 30)

        The gradient of a pixel with respect to the coefficients:

        >>> stamps = [[[1, 2, 1]], [[2, 3, 2]]]
        >>> model = psfield.PsfModel.from_samples(stamps, [(0, 0), (29, 0)], noise=0)
        >>> blur = SpatiallyVaryingBlur(model.plan((1, 30), 1e-5))
        >>> light = jax.numpy.ones((1, 30))
        >>> pixel = jax.jit(lambda coefficients: blur(light, coefficients=coefficients)[0, 10])
        >>> jax.grad(pixel)(model.coefficients).shape
        (2, 1)
        """
        light = self._array(light)
        reaching = light[light_index(self.plan, light.dtype.name, light.shape)]
        given = {
            name: _parameter(values, name)
            for name, values in zip(PARAMETERS, (mean, components, coefficients), strict=True)
            if values is not None
        }
        if not given:
            return _operator.bind(reaching, plan=self.plan, transposed=False)[0]
        if self._psf_plans is None:
            self._psf_plans = PsfPlans(self.plan)
        return _image(self._psf_plans, tuple(given), reaching, *given.values())

    def adjoint(self, image: Any) -> jax.Array:
        """Return the transpose of a call, applied to images.

        Parameters
        ----------
        image : array_like
            ``[..., y, x]`` with the `~psfield.Plan.image_shape` of the plan, finite, of its type.

        Returns
        -------
        jax.Array
            ``[..., y, x]`` with the shape of the plan, or of its `~psfield.Plan.light_region` for a
            plan of a region.

        Examples
        --------
        >>> import jax
        >>> import psfield
        >>> from psfield.jax import SpatiallyVaryingBlur
        >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 2], [0, 0, 0]], (0, 0))
        >>> blur = SpatiallyVaryingBlur(model.plan((3, 4), 1e-6))
        >>> f, g = jax.random.uniform(jax.random.key(1), (2, 3, 4))
        >>> bool(jax.numpy.allclose((blur(f) * g).sum(), (f * blur.adjoint(g)).sum()))
        True
        """
        image = self._array(image)
        check_image(self.plan, image.dtype.name, image.shape)
        return _operator.bind(image, plan=self.plan, transposed=True)[0]

    def draw(self, catalog: Mapping[str, Any]) -> jax.Array:
        """Draw stars and galaxies, with derivatives with respect to each number of the catalogue.

        The image is that of `Plan.simulate` for these sources. Derivatives include the change of
        the PSF with the position, and keep the tolerance of the plan. They leave out its
        ``floor``: sources without flux have a derivative with respect to it, too. They can be
        taken once, in reverse mode. The warnings of `Plan.simulate` are not repeated.

        Parameters
        ----------
        catalog : dict of str to array_like
            Columns ``x``, ``y`` (pixels, counted from the first pixel of the scene) and ``flux``
            and, for galaxies, ``re`` (half-light radius along the major axis in pixels, 0 for a
            star), ``n`` (Sersic index), ``q`` (axis ratio) and ``angle`` (degrees from +x towards
            +y). Each is ``[source]``, or a number for all sources. With more axes, ``[...,
            source]``, each catalogue has an image. In single precision, positions near 1000 are
            rounded to 6e-5 pixels.

        Returns
        -------
        jax.Array
            ``[..., y, x]`` with the `~psfield.Plan.image_shape` of the plan.

        Raises
        ------
        TypeError
            The catalogue is not a dict, a column does not hold real numbers, or the plan is for
            double precision and ``jax_enable_x64`` is off.
        ValueError
            A column is missing or unknown. A source is not valid. The PSF has wings (in reverse
            mode).

        Examples
        --------
        >>> import jax
        >>> import psfield
        >>> from psfield.jax import SpatiallyVaryingBlur
        >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
        >>> blur = SpatiallyVaryingBlur(model.plan((20, 30), 1e-6))
        >>> def pixel(x):
        ...     return blur.draw({"x": x, "y": 9.0, "flux": jax.numpy.array([80.0, 40.0])})[9, 13]
        >>> gradient = jax.jit(jax.grad(pixel))(jax.numpy.array([12.0, 20.5]))
        >>> bool(gradient[0] > 0)
        True
        """
        _check_precision(self.plan.dtype)
        given = source_columns(catalog, jax.Array)
        columns = [_parameter(values, name) for name, values in given.items()]
        columns = jax.numpy.broadcast_arrays(*map(jax.numpy.atleast_1d, columns))
        return _sources(self.plan, jax.numpy.stack(columns, axis=-2))

    def __repr__(self) -> str:
        return f"SpatiallyVaryingBlur({self.plan!r})"

    def _array(self, pixels: Any) -> jax.Array:
        """Return pixels as an array of JAX."""
        _check_precision(self.plan.dtype)
        return jax.numpy.asarray(pixels)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_psf_plans": None}


def _parameter(values: Any, name: str) -> jax.Array:
    """Return a parameter of the PSF, or a column, as an array of floating-point numbers."""
    array = jax.numpy.asarray(values)
    check_parameter(name, array.dtype.name)
    return array if jax.numpy.issubdtype(array.dtype, jax.numpy.floating) else array.astype(float)


def _check_precision(*dtypes: np.dtype[Any]) -> None:
    """Refuse double precision if it is off in this thread."""
    if any(jax.dtypes.canonicalize_dtype(dtype) != dtype for dtype in dtypes):
        raise TypeError(
            "the plan, a parameter or a column has double precision, which is off in JAX: call"
            " jax.config.update('jax_enable_x64', True) (under jit, the context jax.enable_x64 is"
            " not enough), or choose single precision (for a plan: precision='f32')"
        )


def _at_once(native: _Native, *arrays: Any, **settings: Any) -> list[jax.Array]:
    """Call a native function outside ``jit``. Exceptions of the engine pass through."""
    results = native(*(np.asarray(array) for array in arrays), **settings)
    # Each result lies where the input like it does. JAX passes arrays of NumPy on, for example from
    # `linear_transpose`. They have no sharding.
    places = (getattr(arrays[i], "sharding", None) for i in settings.get("wanted", (0,)))
    return [jax.device_put(*pair) for pair in zip(results, places, strict=True)]


def _by_callback(native: _Native, context: Any, *arrays: Any, **settings: Any) -> Any:
    """Lower a primitive to a callback that gets arrays of NumPy.

    `jax.pure_callback` would put them on a device first. This needs a thread of JAX, which may be
    the one that waits for the callback: on one core, it waits forever.
    """
    # The callback runs in another thread, outside the caller's contexts. There, JAX would round
    # double precision to single precision.
    dtypes = [array.dtype for array in (*context.avals_in, *context.avals_out)]
    with ThreadPoolExecutor(1) as other:
        other.submit(_check_precision, *dtypes).result()
    results, _, _ = mlir.emit_python_callback(
        context,
        lambda *arrays: native(*map(np.asarray, arrays), **settings),
        None,
        list(arrays),
        context.avals_in,
        context.avals_out,
        has_side_effect=False,
        returns_token=False,
    )
    return results


def _primitive(name: str, native: _Native, results: Callable[..., list[Any]]) -> Primitive:
    """Return a primitive that calls a native function with arrays of NumPy on the CPU.

    ``results`` returns the shapes and types of its results for those of its inputs.
    """
    primitive = Primitive(name)
    primitive.multiple_results = True
    primitive.def_impl(partial(_at_once, native))
    primitive.def_abstract_eval(results)
    mlir.register_lowering(primitive, partial(_by_callback, native), cacheable=False)
    return primitive


def _image_like(pixels: Any, plan: Plan, transposed: bool) -> list[Any]:
    """Return the shape and the type of the result of a plan or its adjoint."""
    return [jax.core.ShapedArray(result_shape(plan, pixels.shape, transposed), pixels.dtype)]


def _first_axis(array: Any, axis: int) -> Any:
    """Move the axis of a batch to the front."""
    return jax.numpy.moveaxis(array, axis, 0)


# Light or images of a plan, without parameters.
# `jax.custom_derivatives.linear_call` would do, but it has no rule for `vmap`.


def _apply(pixels: Any, *, plan: Plan, transposed: bool) -> tuple[NDArray[Any]]:
    """Apply a plan or its adjoint."""
    return (applied(plan, pixels, transposed),)


def _transpose(
    cotangents: list[Any], pixels: Any, *, plan: Plan, transposed: bool
) -> list[jax.Array]:
    found: list[jax.Array] = _operator.bind(cotangents[0], plan=plan, transposed=not transposed)
    return found


def _batch(arrays: tuple[Any], axes: tuple[int], **settings: Any) -> tuple[list[Any], list[int]]:
    return _operator.bind(_first_axis(arrays[0], axes[0]), **settings), [0]


_operator = _primitive("psfield_operator", _apply, _image_like)
ad.deflinear2(_operator, _transpose)
batching.primitive_batchers[_operator] = _batch


# The PSF with parameters: inputs are light or images, and parameters by `names`. The derivatives
# are those of `_image`, so the primitives have none.


@partial(jax.custom_vjp, nondiff_argnums=(0, 1))
def _image(plans: PsfPlans, names: tuple[str, ...], light: Any, *parameters: Any) -> jax.Array:
    """Return the images of light for parameters of the PSF."""
    return _with_psf.bind(light, *parameters, plans=plans, names=names, transposed=False)[0]


def _image_and_inputs(
    plans: PsfPlans, names: tuple[str, ...], *inputs: Any
) -> tuple[jax.Array, tuple[list[Any], list[tuple[()] | None]]]:
    """Return the image, the inputs, and a mark for each input whose derivative is wanted."""
    values = [given.value for given in inputs]
    # Their values would be traced, so the structure of the list tells which they are.
    marks: list[tuple[()] | None] = [() if given.perturbed else None for given in inputs]
    # JAX refuses to call `_image` here if `vmap` has an array of NumPy.
    (image,) = _with_psf.bind(*values, plans=plans, names=names, transposed=False)
    return image, (values, marks)


def _derivatives(
    plans: PsfPlans, names: tuple[str, ...], kept: tuple[list[Any], list[Any]], image: Any
) -> tuple[jax.Array | None, ...]:
    """Return the wanted derivatives of ``sum(image * A light)``."""
    inputs, marks = kept
    wanted = tuple(i for i, mark in enumerate(marks) if mark is not None)
    settings = {"plans": plans, "names": names}
    if isinstance(image, SymbolicZero):
        return (None,) * len(inputs)
    if wanted == (0,):
        found = _with_psf.bind(image, *inputs[1:], **settings, transposed=True)
    elif wanted:
        found = _gradients.bind(*inputs, image, **settings, wanted=wanted)
    else:
        found = []
    derivatives = dict(zip(wanted, found, strict=True))
    return tuple(derivatives.get(i) for i in range(len(inputs)))


_image.defvjp(_image_and_inputs, _derivatives, symbolic_zeros=True)


def _apply_with_psf(
    pixels: Any, *parameters: Any, plans: PsfPlans, names: tuple[str, ...], transposed: bool
) -> tuple[NDArray[Any]]:
    """Apply the plan for parameters of the PSF, or its adjoint."""
    plan = plans.plan(dict(zip(names, parameters, strict=True)))
    return (applied(plan, pixels, transposed),)


def _differentiate(
    light: Any,
    *others: Any,
    plans: PsfPlans,
    names: tuple[str, ...],
    wanted: tuple[int, ...],
) -> list[NDArray[Any]]:
    """Return the derivatives with respect to the inputs of the numbers ``wanted``."""
    *parameters, image = others
    plan = plans.plan(dict(zip(names, parameters, strict=True)))
    inputs = dict(zip(("light", *names), (light, *parameters), strict=True))
    of_wanted = {name: inputs[name].dtype for name in (list(inputs)[i] for i in wanted)}
    found = gradients(plan, light, image, of_wanted)
    return [found[name].astype(dtype, copy=False) for name, dtype in of_wanted.items()]


def _one_by_one(
    primitive: Primitive, arrays: tuple[Any, ...], axes: tuple[int | None, ...], **settings: Any
) -> tuple[list[jax.Array], list[int]]:
    """Call a primitive for each example of a batch."""

    def call(examples: list[Any]) -> Any:
        left = iter(examples)
        pairs = zip(arrays, axes, strict=True)
        return primitive.bind(
            *(array if axis is None else next(left) for array, axis in pairs), **settings
        )

    pairs = zip(arrays, axes, strict=True)
    moved = [_first_axis(array, axis) for array, axis in pairs if axis is not None]
    results = jax.lax.map(call, moved)
    return results, [0] * len(results)


def _batch_with_psf(
    arrays: tuple[Any, ...], axes: tuple[int | None, ...], **settings: Any
) -> tuple[list[jax.Array], list[int]]:
    if axes[0] is None or any(axis is not None for axis in axes[1:]):
        return _one_by_one(_with_psf, arrays, axes, **settings)
    return _with_psf.bind(_first_axis(arrays[0], axes[0]), *arrays[1:], **settings), [0]


_with_psf = _primitive(
    "psfield_with_psf",
    _apply_with_psf,
    lambda pixels, *_, plans, names, transposed: _image_like(pixels, plans.own, transposed),
)
batching.primitive_batchers[_with_psf] = _batch_with_psf
_gradients = _primitive(
    "psfield_gradients",
    _differentiate,
    lambda *arrays, wanted, **_: [
        jax.core.ShapedArray(arrays[i].shape, arrays[i].dtype) for i in wanted
    ],
)
# The engine adds the derivatives of all images of a call.
batching.primitive_batchers[_gradients] = partial(_one_by_one, _gradients)


# Sources of columns ``[..., column, source]``.


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def _sources(plan: Plan, columns: Any) -> jax.Array:
    """Return the images of sources."""
    return _draw.bind(columns, plan=plan)[0]


def _sources_and_columns(plan: Plan, columns: Any) -> tuple[jax.Array, Any]:
    return _draw.bind(columns, plan=plan)[0], columns


def _derivatives_of_sources(plan: Plan, columns: Any, image: Any) -> tuple[jax.Array]:
    return (_source_gradients.bind(columns, image, plan=plan)[0],)


_sources.defvjp(_sources_and_columns, _derivatives_of_sources)


def _apply_draw(columns: Any, *, plan: Plan) -> tuple[NDArray[Any]]:
    return (drawn(plan, columns),)


def _differentiate_sources(columns: Any, image: Any, *, plan: Plan) -> tuple[NDArray[Any]]:
    return (source_gradients(plan, columns, image).astype(columns.dtype),)


def _batch_draw(
    arrays: tuple[Any], axes: tuple[int], *, plan: Plan
) -> tuple[list[jax.Array], list[int]]:
    return _draw.bind(_first_axis(arrays[0], axes[0]), plan=plan), [0]


def _batch_source_gradients(
    arrays: tuple[Any, ...], axes: tuple[int | None, ...], *, plan: Plan
) -> tuple[list[jax.Array], list[int]]:
    pairs = list(zip(arrays, axes, strict=True))
    count = next(array.shape[axis] for array, axis in pairs if axis is not None)
    stacked = [
        jax.numpy.broadcast_to(array, (count, *array.shape))
        if axis is None
        else _first_axis(array, axis)
        for array, axis in pairs
    ]
    return _source_gradients.bind(*stacked, plan=plan), [0]


_draw = _primitive(
    "psfield_draw",
    _apply_draw,
    lambda columns, plan: [
        jax.core.ShapedArray((*columns.shape[:-2], *plan.image_shape), plan.dtype)
    ],
)
batching.primitive_batchers[_draw] = _batch_draw
_source_gradients = _primitive(
    "psfield_source_gradients",
    _differentiate_sources,
    lambda columns, image, plan: [jax.core.ShapedArray(columns.shape, columns.dtype)],
)
batching.primitive_batchers[_source_gradients] = _batch_source_gradients
