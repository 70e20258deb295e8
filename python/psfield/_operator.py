"""A plan as an operator on stacks ``[..., y, x]`` and on sources, for its derivatives."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from psfield._plan import Plan, check_spectrum

#: The parameters of a PSF model, with the axes of each.
PARAMETERS = {
    "mean": "[y, x]",
    "components": "[component, y, x]",
    "coefficients": "[position, component]",
}

#: The precisions of plans by the names of their types.
PRECISIONS = {"float32": "f32", "float64": "f64"}


def checked_plan(plan: Any) -> Plan:
    """Return a plan whose scenes are arrays. Refuse everything else."""
    if not isinstance(plan, Plan):
        raise TypeError(f"plan must be a psfield.Plan, got {type(plan).__name__}")
    check_spectrum(plan._settings)
    return plan


def light_shape(plan: Plan) -> tuple[int, int]:
    """Return rows and columns of the operator's light: of the light region if there is a region."""
    return plan.shape if plan.region is None else plan._light_shape()


def result_shape(plan: Plan, shape: tuple[int, ...], transposed: bool) -> tuple[int, ...]:
    """Return the shape of the result of `applied` for pixels of a shape."""
    return (*shape[:-2], *(light_shape(plan) if transposed else plan.image_shape))


def light_index(plan: Plan, dtype: str, shape: tuple[int, ...]) -> tuple[Any, ...]:
    """Return the index of the operator's light in light of a type and a shape.

    Light of the whole scene is longer than the light region of a plan for a region. Other types and
    shapes are refused.
    """
    _check(plan, "light", dtype, shape, [light_shape(plan), plan.shape])
    if shape[-2:] == light_shape(plan):
        return (...,)
    x0, y0, columns, rows = plan.light_region
    return ..., slice(y0, y0 + rows), slice(x0, x0 + columns)


def check_image(plan: Plan, dtype: str, shape: tuple[int, ...]) -> None:
    """Refuse images of another type or shape than those of a plan."""
    _check(plan, "image", dtype, shape, [plan.image_shape])


def _check(
    plan: Plan, name: str, dtype: str, shape: tuple[int, ...], known: list[tuple[int, int]]
) -> None:
    if dtype != plan.dtype.name:
        precision = PRECISIONS.get(dtype)
        remedy = f", or make the plan with precision={precision!r}" if precision else ""
        raise TypeError(
            f"{name} has the type {dtype}, but the plan is for {plan.dtype}: convert it{remedy}"
        )
    if shape[-2:] not in known:
        expected = " or ".join(dict.fromkeys(f"[..., {ny}, {nx}]" for ny, nx in known))
        raise ValueError(f"{name} must have the shape {expected}, got {list(shape)}")


def applied(plan: Plan, pixels: NDArray[Any], transposed: bool) -> NDArray[Any]:
    """Return the images of a stack of light or, if ``transposed``, the adjoint of images."""
    if pixels.size == 0:
        return np.zeros(result_shape(plan, pixels.shape, transposed), plan.dtype)
    found: NDArray[Any] = plan.adjoint(pixels) if transposed else plan.simulate(pixels)
    return found


def with_own_parameters(plan: Plan) -> Plan:
    """Return a plan for the model of a plan, from which plans for other parameters are made."""
    if plan._settings["bandpass"] is not None:
        raise ValueError(
            "a plan in colour has no derivatives with respect to the PSF: take the PSF of a"
            " spectrum (PsfModel.for_spectrum), and its plan"
        )
    *_, table_of = plan.model._handle.choices()
    if table_of is not None:
        raise ValueError(
            f"the PSF has an interpolation of your own ({table_of}), which has no derivatives with"
            " respect to the samples: take an interpolation of psfield"
        )
    return plan.with_psf(plan.model.with_parameters())


class PsfPlans:
    """Plans for other parameters of the PSF of a plan, with its settings and its tiles.

    The latest plan is kept: the gradient of an image needs the plan of the image.
    """

    def __init__(self, plan: Plan) -> None:
        self.own = with_own_parameters(plan)
        self._latest: tuple[dict[str, NDArray[np.float64]], Plan] | None = None

    def plan(self, parameters: Mapping[str, NDArray[Any] | None]) -> Plan:
        """Return the plan for parameters by their names. None stands for those of the model."""
        given = {
            name: np.array(values, np.float64)
            for name, values in parameters.items()
            if values is not None
        }
        # Another thread may replace it.
        latest = self._latest
        if latest is not None and _are_equal(latest[0], given):
            return latest[1]
        plan = self.own.with_psf(self.own.model.with_parameters(**given))
        self._latest = given, plan
        return plan


def _are_equal(some: dict[str, NDArray[Any]], others: dict[str, NDArray[Any]]) -> bool:
    """Return whether two sets of arrays have equal names and values."""
    return some.keys() == others.keys() and all(
        np.array_equal(some[name], others[name]) for name in some
    )


def check_parameter(name: str, dtype: str) -> None:
    """Refuse parameters of the PSF, and columns, that are not real numbers."""
    if not dtype.startswith(("float", "bfloat", "int", "uint")):
        raise TypeError(f"{name} must be real numbers, got {dtype}")


def gradients(
    plan: Plan, light: NDArray[Any], image: NDArray[Any], wanted: Collection[str]
) -> dict[str, NDArray[Any]]:
    """Return the wanted derivatives of ``sum(image * A light)``, by the names of the inputs.

    ``wanted`` names some of `PARAMETERS` and ``light``. Stacks are ``[..., y, x]``.
    """
    lights, images = (pixels.reshape(-1, *pixels.shape[-2:]) for pixels in (light, image))
    stamps = "mean" in wanted or "components" in wanted
    made, of_psf = plan._handle.gradients(
        lights, images, "light" in wanted, "coefficients" in wanted, stamps
    )
    found = {} if made is None else {"light": made.reshape(*light.shape[:-2], *made.shape[-2:])}
    for name, derivative in zip(PARAMETERS, of_psf or (), strict=False):
        if name in wanted and derivative is not None:
            found[name] = derivative
    return found


def drawn(plan: Plan, columns: NDArray[Any]) -> NDArray[Any]:
    """Return the images of sources, given by their columns ``[..., column, source]``."""
    images = [plan._handle.draw_sources(each) for each in _stack_of(columns)]
    made = images[0] if len(images) == 1 else np.array(images, plan.dtype)
    return made.reshape(*columns.shape[:-2], *plan.image_shape)


def source_gradients(plan: Plan, columns: NDArray[Any], images: NDArray[Any]) -> NDArray[Any]:
    """Return the derivatives of ``sum(images * drawn(plan, columns))`` with respect to columns."""
    stack = _stack_of(columns)
    of_stack = zip(stack, images.reshape(len(stack), *images.shape[-2:]), strict=True)
    found = [plan._handle.source_gradients(each, image) for each, image in of_stack]
    return np.array(found, np.float64).reshape(columns.shape)


def _stack_of(columns: NDArray[Any]) -> NDArray[np.float64]:
    count = int(np.prod(columns.shape[:-2]))
    return np.ascontiguousarray(columns, np.float64).reshape(count, *columns.shape[-2:])
