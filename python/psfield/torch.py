"""PSFs that vary over the field as differentiable operators of PyTorch.

`SpatiallyVaryingBlur` is a module that applies a `psfield.Plan` to tensors. It has derivatives with
respect to light of any order, in backward and in forward mode, and with respect to the parameters
of the PSF and to sources, once, in backward mode. It works with ``torch.func`` and in workers of
data loaders.

The module needs PyTorch: ``pip install torch``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, NoReturn

from psfield._catalog import source_columns
from psfield._choices import choice
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
    import torch
except ImportError as error:
    message = "psfield.torch needs PyTorch: pip install torch"
    raise ImportError(message, name=error.name) from error

__all__ = ["SpatiallyVaryingBlur"]


class SpatiallyVaryingBlur(torch.nn.Module):
    """Convolution of light with a PSF that varies over the field.

    A plan is a linear operator: ``image = A light``. `forward` applies ``A``, `adjoint` its
    transpose ``A^T``. The backward pass of each is the other, so a gradient costs about as much as
    an image. The module has no parameters.

    The native engine works on the CPU. It reads tensors there without a copy if the pixels of a row
    are adjacent and the leading axes can be merged, checks that pixels are finite, and uses
    `psfield.threads` threads. Results are equal, bit for bit, to those of `Plan.simulate` and
    `Plan.adjoint`.

    Parameters
    ----------
    plan : psfield.Plan
        The plan. In colour, it needs a spectrum (``sed``).
    engine : {'auto', 'native', 'torch'}
        ``native`` is the engine of the plan, for tensors on the CPU. ``torch`` uses operations of
        PyTorch, on the device of the tensor. ``auto``: native for tensors on the CPU, else torch.

    Attributes
    ----------
    plan : psfield.Plan
        The plan.
    engine : str
        The engine.

    Notes
    -----
    Copies of the module share its plan. Loading a pickle makes the plan again, for example in a
    worker that ``spawn`` starts. Workers that share a machine should call
    ``psfield.set_threads(1)``.

    deepinv takes the module as ``deepinv.physics.LinearPhysics(A=blur, A_adjoint=blur.adjoint)``.

    Examples
    --------
    >>> import torch
    >>> import psfield
    >>> from psfield.torch import SpatiallyVaryingBlur
    >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
    >>> blur = SpatiallyVaryingBlur(model.plan((3, 4), tolerance=1e-4))
    >>> light = torch.zeros(2, 1, 3, 4, requires_grad=True)
    >>> image = blur(light)
    >>> image[..., 1, 1].sum().backward()
    >>> (8 * light.grad[0, 0]).round().tolist()
    [[0.0, 1.0, 0.0, 0.0], [1.0, 4.0, 1.0, 0.0], [0.0, 1.0, 0.0, 0.0]]
    """

    def __init__(self, plan: Plan, *, engine: Literal["auto", "native", "torch"] = "auto") -> None:
        super().__init__()
        self.plan = checked_plan(plan)
        self.engine = choice(engine, "engine", ("auto", "native", "torch"))
        # They are no submodules: `to` with a type would make their complex numbers real, and the
        # state would depend on the devices used so far. They follow from the plan.
        self._tiles: dict[torch.device, torch.nn.Module] = {}
        self._psf_plans: PsfPlans | None = None

    def forward(
        self,
        light: torch.Tensor,
        *,
        mean: torch.Tensor | None = None,
        components: torch.Tensor | None = None,
        coefficients: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """Return the images of light.

        With any of ``mean``, ``components`` and ``coefficients``, the PSF is the plan's model with
        these parameters (`PsfModel.with_parameters`), and gradients pass to them, too. They are
        derivatives of the model, not of the modes of the plan, and keep its tolerance. They can be
        taken once, in reverse mode. ``vmap`` calls the engine for each example if parameters are
        mapped, or their gradients. For the sum of the gradients, a call with a stack of light is
        faster.

        Parameters
        ----------
        light : torch.Tensor
            ``[..., y, x]`` with the shape of the plan, finite, of its type. For a plan of a region
            also its `~psfield.Plan.light_region` alone.
        mean : torch.Tensor, optional
            Mean stamp ``[y, x]``, on the CPU, as `PsfModel.mean`.
        components : torch.Tensor, optional
            Stamps ``[component, y, x]``, on the CPU, as `PsfModel.components`. They need not be
            orthonormal.
        coefficients : torch.Tensor, optional
            Coefficients ``[position, component]``, on the CPU, as `PsfModel.coefficients`.

        Returns
        -------
        torch.Tensor
            ``[..., y, x]`` with the `~psfield.Plan.image_shape` of the plan.

        Raises
        ------
        TypeError
            The light is of another type than the plan, or an argument is not a tensor of real
            numbers.
        ValueError
            The tensor has another shape, a pixel is not finite, or the tensor is not on the CPU and
            the engine is ``native``. Or there are parameters, and the PSF has wings, is that of a
            plan in colour, or has an interpolation of your own.

        Examples
        --------
        >>> import torch
        >>> import psfield
        >>> from psfield.torch import SpatiallyVaryingBlur
        >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
        >>> blur = SpatiallyVaryingBlur(model.plan((20, 30)))
        >>> blur(torch.ones(5, 20, 30)).shape
        torch.Size([5, 20, 30])

        The gradient of a pixel with respect to the coefficients:

        >>> stamps = [[[1, 2, 1]], [[2, 3, 2]]]
        >>> model = psfield.PsfModel.from_samples(stamps, [(0, 0), (29, 0)], noise=0)
        >>> blur = SpatiallyVaryingBlur(model.plan((1, 30), 0, precision="f64"))
        >>> coefficients = torch.tensor(model.coefficients, requires_grad=True)
        >>> light = torch.rand(1, 30, dtype=torch.float64)
        >>> blur(light, coefficients=coefficients)[0, 10].backward()
        >>> coefficients.grad.shape
        torch.Size([2, 1])
        """
        light = light[light_index(self.plan, *_type_and_shape(light, "light"))]
        given = dict(zip(PARAMETERS, (mean, components, coefficients), strict=True))
        if any(parameter is not None for parameter in given.values()):
            return _WithPsf.apply(light, *given.values(), self._plans_of(light, given))
        if self._is_native(light, "light"):
            return _Native.apply(light, self.plan, False)
        return self._tiles_on(light.device)(light)

    def adjoint(self, image: torch.Tensor) -> torch.Tensor:
        """Return the transpose of `forward`, applied to images.

        Parameters
        ----------
        image : torch.Tensor
            ``[..., y, x]`` with the `~psfield.Plan.image_shape` of the plan, finite, of its type.

        Returns
        -------
        torch.Tensor
            ``[..., y, x]`` with the shape of the plan, or of its `~psfield.Plan.light_region` for a
            plan of a region.

        Examples
        --------
        >>> import torch
        >>> import psfield
        >>> from psfield.torch import SpatiallyVaryingBlur
        >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 2], [0, 0, 0]], (0, 0))
        >>> blur = SpatiallyVaryingBlur(model.plan((3, 4), 1e-6, precision="f64"))
        >>> f, g = torch.rand(2, 3, 4, dtype=torch.float64)
        >>> torch.allclose((blur(f) * g).sum(), (f * blur.adjoint(g)).sum())
        True
        """
        check_image(self.plan, *_type_and_shape(image, "image"))
        if self._is_native(image, "image"):
            return _Native.apply(image, self.plan, True)
        light = image.new_zeros(result_shape(self.plan, image.shape, True))
        _, transpose = torch.func.vjp(self._tiles_on(image.device), light)
        return transpose(image)[0]

    def draw(self, catalog: Mapping[str, Any]) -> torch.Tensor:
        """Draw stars and galaxies, with derivatives with respect to each number of the catalogue.

        The image is that of `Plan.simulate` for these sources. Derivatives include the change of
        the PSF with the position, and keep the tolerance of the plan. They leave out its
        ``floor``: sources without flux have a derivative with respect to it, too. They can be
        taken once, in reverse mode. The warnings of `Plan.simulate` are not repeated.

        Parameters
        ----------
        catalog : dict of str to torch.Tensor
            Columns ``x``, ``y`` (pixels, counted from the first pixel of the scene) and ``flux``
            and, for galaxies, ``re`` (half-light radius along the major axis in pixels, 0 for a
            star), ``n`` (Sersic index), ``q`` (axis ratio) and ``angle`` (degrees from +x towards
            +y). Each is ``[source]``, or a number for all sources, on the CPU. With more axes,
            ``[..., source]``, each catalogue has an image.

        Returns
        -------
        torch.Tensor
            ``[..., y, x]`` with the `~psfield.Plan.image_shape` of the plan.

        Raises
        ------
        TypeError
            The catalogue is not a dict, or a column does not hold real numbers.
        ValueError
            A column is missing or unknown, or not on the CPU. A source is not valid. The PSF has
            wings (in the backward pass).

        Examples
        --------
        >>> import torch
        >>> import psfield
        >>> from psfield.torch import SpatiallyVaryingBlur
        >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
        >>> blur = SpatiallyVaryingBlur(model.plan((20, 30), 1e-6, precision="f64"))
        >>> x = torch.tensor([12.0, 20.5], requires_grad=True)
        >>> image = blur.draw({"x": x, "y": 9.0, "flux": torch.tensor([80.0, 40.0])})
        >>> round(float(image[9, 12].detach()), 6)
        40.0
        >>> image[9, 13].backward()
        >>> bool(x.grad[0] > 0)
        True
        """
        columns = []
        for name, values in source_columns(catalog, torch.Tensor).items():
            column = torch.as_tensor(values)
            check_parameter(name, str(column.dtype).removeprefix("torch."))
            if column.device.type != "cpu":
                raise ValueError(
                    f"{name} is on the device {column.device}, but sources need the native engine,"
                    f" which works on the CPU: use {name}.cpu()"
                )
            columns.append(torch.atleast_1d(column).to(torch.float64))
        columns = torch.broadcast_tensors(*columns)
        return _Sources.apply(torch.stack(columns, dim=-2), self.plan)

    def extra_repr(self) -> str:
        """Return the plan and the engine in words, for the text of the module.

        Examples
        --------
        >>> import psfield
        >>> from psfield.torch import SpatiallyVaryingBlur
        >>> plan = psfield.PsfModel.from_samples([[1, 2, 1]], (0, 0)).plan((4, 6), device="cpu")
        >>> SpatiallyVaryingBlur(plan)
        SpatiallyVaryingBlur(<Plan: scenes 4 x 6, ..., on the CPU>, engine='auto')
        """
        return f"{self.plan!r}, engine={self.engine!r}"

    def _plans_of(self, light: torch.Tensor, given: dict[str, torch.Tensor | None]) -> PsfPlans:
        """Return plans for parameters of the PSF, after a check of the tensors."""
        tensors = {"light": light, **given}
        for name, tensor in tensors.items():
            if tensor is None:
                continue
            check_parameter(name, _type_and_shape(tensor, name)[0])
            if tensor.device.type != "cpu":
                raise ValueError(
                    f"{name} is on the device {tensor.device}, but parameters of the PSF need the"
                    f" native engine, which works on the CPU: use {name}.cpu()"
                )
        if self._psf_plans is None:
            self._psf_plans = PsfPlans(self.plan)
        return self._psf_plans

    def _is_native(self, pixels: torch.Tensor, name: str) -> bool:
        """Return whether the native engine is to apply the plan to a tensor."""
        if self.engine == "native" and pixels.device.type != "cpu":
            raise ValueError(
                f"{name} is on the device {pixels.device}, but the native engine works on the CPU:"
                f" use {name}.cpu(), or engine='auto'"
            )
        # Without pixels, there is no work for either engine.
        on_cpu = pixels.device.type == "cpu" and self.engine != "torch"
        return on_cpu or not pixels.numel()

    def _tiles_on(self, device: torch.device) -> torch.nn.Module:
        """Return the operations of PyTorch on a device, made when they are first needed."""
        if device not in self._tiles:
            from psfield._torch_tiles import TilesInTorch

            self._tiles[device] = TilesInTorch(self.plan).to(device)
        return self._tiles[device]

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_tiles": {}, "_psf_plans": None}


class _Native(torch.autograd.Function):
    """A plan or, if ``transposed``, its adjoint, by the native engine on tensors of the CPU."""

    @staticmethod
    def forward(pixels: torch.Tensor, plan: Plan, transposed: bool) -> torch.Tensor:
        if not pixels.numel():
            return pixels.new_zeros(result_shape(plan, pixels.shape, transposed))
        return torch.from_numpy(applied(plan, pixels.numpy(force=True), transposed))

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: torch.Tensor) -> None:
        _, ctx.plan, ctx.transposed = inputs
        ctx.set_materialize_grads(False)

    @staticmethod
    def backward(ctx: Any, gradient: torch.Tensor | None) -> tuple[torch.Tensor | None, None, None]:
        if gradient is None or not ctx.needs_input_grad[0]:
            return None, None, None
        return _Native.apply(gradient, ctx.plan, not ctx.transposed), None, None

    @staticmethod
    def jvp(ctx: Any, tangent: torch.Tensor, *of_others: None) -> torch.Tensor:
        return _Native.apply(tangent, ctx.plan, ctx.transposed)

    @staticmethod
    def vmap(
        info: Any,
        in_dims: tuple[int | None, ...],
        pixels: torch.Tensor,
        plan: Plan,
        transposed: bool,
    ) -> tuple[torch.Tensor, int]:
        return _Native.apply(pixels.movedim(in_dims[0], 0), plan, transposed), 0


class _WithPsf(torch.autograd.Function):
    """Images for parameters of the PSF, with derivatives with respect to light and parameters."""

    @staticmethod
    def forward(light: torch.Tensor, *others: Any) -> torch.Tensor:
        *parameters, plans = others
        plan = _plan(plans, parameters)
        if not light.numel():
            return light.new_zeros(result_shape(plan, light.shape, False))
        return torch.from_numpy(applied(plan, light.numpy(force=True), False))

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: torch.Tensor) -> None:
        *tensors, ctx.plans = inputs
        ctx.save_for_backward(*tensors)
        ctx.set_materialize_grads(False)

    @staticmethod
    def backward(ctx: Any, gradient: torch.Tensor | None) -> tuple[torch.Tensor | None, ...]:
        if gradient is None:
            return (None,) * len(ctx.needs_input_grad)
        wanted = tuple(ctx.needs_input_grad[:-1])
        found = iter(_PsfGradients.apply(gradient, *ctx.saved_tensors, ctx.plans, wanted))
        return (*(next(found) if is_wanted else None for is_wanted in wanted), None)

    @staticmethod
    def vmap(info: Any, in_dims: tuple[int | None, ...], *inputs: Any) -> tuple[torch.Tensor, int]:
        light, *parameters, plans = inputs
        if all(axis is None for axis in in_dims[1:]):
            return _WithPsf.apply(light.movedim(in_dims[0], 0), *parameters, plans), 0
        examples = _examples(info, in_dims, inputs)
        return torch.stack([_WithPsf.apply(*example) for example in examples]), 0


class _PsfGradients(torch.autograd.Function):
    """The wanted derivatives of ``sum(image * A light)`` with respect to light and parameters."""

    @staticmethod
    def forward(image: torch.Tensor, light: torch.Tensor, *others: Any) -> tuple[torch.Tensor, ...]:
        *parameters, plans, flags = others
        tensors = dict(zip(("light", *PARAMETERS), (light, *parameters), strict=True))
        wanted = [name for name, flag in zip(tensors, flags, strict=True) if flag]
        arrays = light.numpy(force=True), image.numpy(force=True)
        found = gradients(_plan(plans, parameters), *arrays, wanted)
        return tuple(torch.from_numpy(found[name]).to(tensors[name].dtype) for name in wanted)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: tuple[torch.Tensor, ...]) -> None:
        """Keep nothing for `backward`."""

    @staticmethod
    def backward(ctx: Any, *cotangents: torch.Tensor | None) -> NoReturn:
        # `once_differentiable` does not refuse it under `torch.func`: there, the result is 0.
        raise RuntimeError(
            "derivatives of images with parameters of the PSF can be taken only once"
        )

    @staticmethod
    def vmap(
        info: Any, in_dims: tuple[Any, ...], *inputs: Any
    ) -> tuple[tuple[torch.Tensor, ...], tuple[int, ...]]:
        # The engine adds the derivatives of all images of a call.
        of_examples = [_PsfGradients.apply(*one) for one in _examples(info, in_dims, inputs)]
        stacks = tuple(torch.stack(results) for results in zip(*of_examples, strict=True))
        return stacks, (0,) * len(stacks)


class _Sources(torch.autograd.Function):
    """The images of sources, given by their columns ``[..., column, source]``."""

    @staticmethod
    def forward(columns: torch.Tensor, plan: Plan) -> torch.Tensor:
        return torch.from_numpy(drawn(plan, columns.numpy(force=True)))

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: torch.Tensor) -> None:
        columns, ctx.plan = inputs
        ctx.save_for_backward(columns)
        ctx.set_materialize_grads(False)

    @staticmethod
    def backward(ctx: Any, gradient: torch.Tensor | None) -> tuple[torch.Tensor | None, None]:
        if gradient is None:
            return None, None
        return _SourceGradients.apply(gradient, *ctx.saved_tensors, ctx.plan), None

    @staticmethod
    def vmap(
        info: Any, in_dims: tuple[int | None, ...], columns: torch.Tensor, plan: Plan
    ) -> tuple[torch.Tensor, int]:
        return _Sources.apply(columns.movedim(in_dims[0], 0), plan), 0


class _SourceGradients(torch.autograd.Function):
    """The derivatives of ``sum(image * sources)`` with respect to the columns of sources."""

    @staticmethod
    def forward(image: torch.Tensor, columns: torch.Tensor, plan: Plan) -> torch.Tensor:
        arrays = columns.numpy(force=True), image.numpy(force=True)
        return torch.from_numpy(source_gradients(plan, *arrays))

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: torch.Tensor) -> None:
        """Keep nothing for `backward`."""

    @staticmethod
    def backward(ctx: Any, *cotangents: torch.Tensor | None) -> NoReturn:
        # `once_differentiable` does not refuse it under `torch.func`: there, the result is 0.
        raise RuntimeError("derivatives of images with respect to sources can be taken only once")

    @staticmethod
    def vmap(info: Any, in_dims: tuple[Any, ...], *inputs: Any) -> tuple[torch.Tensor, int]:
        image, columns, plan = inputs
        stacked = (
            tensor.expand(info.batch_size, *tensor.shape)
            if axis is None
            else tensor.movedim(axis, 0)
            for tensor, axis in zip((image, columns), in_dims[:2], strict=True)
        )
        return _SourceGradients.apply(*stacked, plan), 0


def _plan(plans: PsfPlans, parameters: list[torch.Tensor | None]) -> Plan:
    """Return the plan for parameters of the PSF."""
    arrays = (
        None if tensor is None else tensor.to(torch.float64).numpy(force=True)
        for tensor in parameters
    )
    return plans.plan(dict(zip(PARAMETERS, arrays, strict=True)))


def _examples(info: Any, in_dims: tuple[Any, ...], inputs: tuple[Any, ...]) -> list[list[Any]]:
    """Return the inputs of a function for each example of a batch."""
    return [
        [
            value.select(axis, n) if isinstance(axis, int) else value
            for value, axis in zip(inputs, in_dims, strict=True)
        ]
        for n in range(info.batch_size)
    ]


def _type_and_shape(pixels: Any, name: str) -> tuple[str, tuple[int, ...]]:
    """Return the name of the type of a tensor, and its shape."""
    if not isinstance(pixels, torch.Tensor):
        raise TypeError(f"{name} must be a torch.Tensor, got {type(pixels).__name__}")
    return str(pixels.dtype).removeprefix("torch."), tuple(pixels.shape)
