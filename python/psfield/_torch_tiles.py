"""Plans executed by PyTorch, on the device of the light."""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from psfield._plan import Plan

#: Pixels that are transformed together, for each thread of a CPU. More exceed its caches.
_PIXELS_PER_THREAD = 1 << 18
#: Pixels that other devices transform together. It is chosen, not measured: enough to keep them
#: busy, with about 300 MB of intermediate results in f32.
_PIXELS_AT_ONCE = 1 << 22
#: Blocks are divided into parts of at most so many rows and columns, or twice those of the stamps,
#: so that intermediate results stay small.
_LARGEST_PART = 1024
#: The sizes of transforms are a power of 2 times one of these. Few sizes let many parts be
#: transformed together.
_SIZES = (8, 9, 10, 12, 15)


class TilesInTorch(torch.nn.Module):
    """A plan that PyTorch executes, with gradients with respect to the light.

    The module holds the stamps and the coefficients of the plan's blocks as buffers. Move it to a
    device with ``.to(device)``. Its images differ from those of `Plan.simulate` by rounding only:
    in f32 by at most about 1e-6 of the image's brightest pixel, in f64 by 1e-14. In f32,
    `Plan.simulate` is more accurate for faint light near very bright pixels, because it convolves
    these pixels one by one.

    Gradients of any order, ``torch.func.jvp`` and ``torch.func.vmap`` work, and keep no
    intermediate results. The buffers take about 10 bytes for each pixel and mode in f32, such as
    50 MB for 1024 x 1024 pixels and 5 modes per block. They are not in the ``state_dict``, because
    the plan gives them again.

    The module is tested on the CPU. It consists of sums, products and FFTs, which PyTorch has for
    CUDA, ROCm and MPS (f32 only), but it is not tested there.

    Parameters
    ----------
    plan : Plan
        The plan, for scenes without a catalogue.

    Raises
    ------
    ValueError
        The plan needs the native engine: its PSF has several states or wings, or it is in colour.
        Or a pixel has no PSF, even if no light needs it.

    Examples
    --------
    >>> import psfield
    >>> import torch
    >>> from psfield._torch_tiles import TilesInTorch
    >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
    >>> blur = TilesInTorch(model.plan((3, 4), tolerance=1e-4, precision="f64"))
    >>> light = torch.zeros(3, 4, dtype=torch.float64, requires_grad=True)
    >>> blur(light)[1, 1].backward()
    >>> ((8 * light.grad).round(decimals=2) + 0.0).tolist()  # + 0.0 turns -0.0 into 0.0
    [[0.0, 1.0, 0.0, 0.0], [1.0, 4.0, 1.0, 0.0], [0.0, 1.0, 0.0, 0.0]]
    """

    def __init__(self, plan: Plan) -> None:
        super().__init__()
        (left, top), (first, step), blocks = plan._handle.arrays()
        x0, y0, columns, rows = plan.light_region
        self._description = repr(plan)
        self._shape, self._light_shape = plan.shape, (rows, columns)
        self._light_part = (..., slice(y0, y0 + rows), slice(x0, x0 + columns))
        self._sampled, self._area = (
            (..., slice(first, None, step), slice(first, None, step)),
            step**2,
        )
        # PSFs belong to the pixels of the weighted side: the light or the image.
        self._scatters = plan.summary.anchor == "source"
        fine = (plan.image_shape[0] * step, plan.image_shape[1] * step)
        weighted, other = (self._light_shape, fine) if self._scatters else (fine, self._light_shape)
        groups: dict[tuple[int, int], list[_Part]] = defaultdict(list)
        for (x, y), kernels, weights in blocks:
            for part in _parts(y, x, kernels, weights):
                groups[part.transform_shape()].append(part)
        self._groups = torch.nn.ModuleList(_Group(*group) for group in groups.items())
        self._dtype = self._groups[0].weights.dtype
        # The parts of a group are padded to one shape. So both sides are padded, too.
        padded = _largest(group.end() for group in self._groups)
        ny, nx = blocks[0][1].shape[1:]
        self._weighted = _Side(weighted, (0, 0), padded)
        self._other = _Side(other, (-top, -left), (padded[0] + ny - 1, padded[1] + nx - 1))

    def forward(self, light: Any) -> Any:
        """Return the images of light.

        Parameters
        ----------
        light : torch.Tensor
            ``[..., y, x]``, flux per pixel, with the plan's `Plan.shape` or that of its
            `Plan.light_region`, and with the plan's type. Values are not checked.

        Returns
        -------
        torch.Tensor
            ``[..., y, x]`` with the plan's `Plan.image_shape`.
        """
        buffer = self._groups[0].weights
        if buffer.dtype != self._dtype:
            raise TypeError(
                f"the plan is in {self._dtype}, and its buffers must not be converted to"
                f" {buffer.dtype}: make a plan with another precision"
            )
        if light.dtype != buffer.dtype:
            raise TypeError(
                f"light must be {buffer.dtype}, the type of the plan, got {light.dtype}"
            )
        if light.device != buffer.device:
            raise ValueError(
                f"light is on {light.device}, but the plan's buffers on {buffer.device}"
            )
        shape = tuple(light.shape[-2:])
        if shape != self._light_shape:
            if shape != self._shape:
                raise ValueError(
                    f"light: the plan is for scenes of shape {self._shape}, or {self._light_shape}"
                    f" for the part that reaches the image, got {tuple(light.shape)}"
                )
            light = light[self._light_part]
        images = _Execution.apply(light.reshape(-1, *self._light_shape), self, self._scatters)
        images = images.reshape(*light.shape[:-2], *images.shape[-2:])
        return images if self._area == 1 else images[self._sampled] * self._area

    def _execute(self, values: Any, scatters: bool) -> Any:
        """Pass values ``[frame, y, x]`` from the weighted side to the other one, or back."""
        source, target = self._weighted, self._other
        if not scatters:
            source, target = target, source
        values = source.pad(values)
        results = values.new_zeros((len(values), *target.padded))
        for group in self._groups:
            if scatters:
                group.scatter(values, results)
            else:
                group.gather(values, results)
        return target.cut(results).contiguous()

    def extra_repr(self) -> str:
        return self._description


class _Execution(torch.autograd.Function):
    """The linear operator of a plan. Its derivative needs no intermediate results."""

    @staticmethod
    def forward(values: Any, tiles: TilesInTorch, scatters: bool) -> Any:
        return tiles._execute(values, scatters)

    @staticmethod
    def setup_context(ctx: Any, inputs: Any, output: Any) -> None:
        _, ctx.tiles, ctx.scatters = inputs

    @staticmethod
    def backward(ctx: Any, gradient: Any) -> Any:
        return _Execution.apply(gradient, ctx.tiles, not ctx.scatters), None, None

    @staticmethod
    def jvp(ctx: Any, tangent: Any, *others: Any) -> Any:
        return _Execution.apply(tangent, ctx.tiles, ctx.scatters)

    @staticmethod
    def vmap(info: Any, in_dims: Any, values: Any, tiles: TilesInTorch, scatters: bool) -> Any:
        values = values.movedim(in_dims[0], 0)
        results = _Execution.apply(values.flatten(0, 1), tiles, scatters)
        return results.unflatten(0, values.shape[:2]), 0


class _Side(NamedTuple):
    """The light or the image, and its place in a larger array."""

    shape: tuple[int, int]
    first: tuple[int, int]
    padded: tuple[int, int]

    def pad(self, values: Any) -> Any:
        (rows, columns), (y, x), (ny, nx) = self
        return torch.nn.functional.pad(values, (x, nx - x - columns, y, ny - y - rows))

    def cut(self, padded: Any) -> Any:
        (rows, columns), (y, x), _ = self
        return padded[:, y : y + rows, x : x + columns]


def _largest(shapes: Iterable[tuple[int, int]]) -> tuple[int, int]:
    """Return the largest length along each axis."""
    rows, columns = zip(*shapes, strict=True)
    return max(rows), max(columns)


class _Part(NamedTuple):
    """A part of a block. Kernels and weights are ``[kernel, y, x]``."""

    y: int
    x: int
    kernels: NDArray[Any]
    weights: NDArray[Any]

    def shape(self) -> tuple[int, int]:
        _, rows, columns = self.weights.shape
        return rows, columns

    def reach(self) -> tuple[int, int]:
        """Return the rows and the columns that the part reaches on the other side."""
        (rows, columns), (_, ny, nx) = self.shape(), self.kernels.shape
        return rows + ny - 1, columns + nx - 1

    def transform_shape(self) -> tuple[int, int]:
        rows, columns = self.reach()
        return _transform_size(rows), _transform_size(columns)


def _parts(y: int, x: int, kernels: NDArray[Any], weights: NDArray[Any]) -> Iterator[_Part]:
    """Divide a block evenly into parts that are not too large."""

    def ranges(axis: int) -> list[tuple[int, int]]:
        length, stamp = weights.shape[axis], kernels.shape[axis]
        count = -(-length // max(_LARGEST_PART, 2 * stamp))
        ends = [i * length // count for i in range(count + 1)]
        return list(itertools.pairwise(ends))

    for top, bottom in ranges(1):
        for left, right in ranges(2):
            yield _Part(y + top, x + left, kernels, weights[:, top:bottom, left:right])


def _transform_size(at_least: int) -> int:
    """Return the smallest size of transforms of at least so many pixels."""
    shift = max(0, (at_least - 1).bit_length() - 4)
    return min(n << shift for n in (*_SIZES, 16) if n << shift >= at_least)


class _Group(torch.nn.Module):
    """Parts of blocks whose transforms have one shape, padded to equal shapes.

    Parts with more kernels come first. Weights and spectra are ordered by kernel, then by part. So
    all neighbouring parts that have a kernel are neighbours there.
    """

    def __init__(self, transform_shape: tuple[int, int], parts: list[_Part]) -> None:
        super().__init__()
        parts = sorted(parts, key=lambda part: -len(part.kernels))
        self.transform_shape = transform_shape
        self.places = [(part.y, part.x) for part in parts]
        self.shape = _largest(part.shape() for part in parts)
        self.reach = _largest(part.reach() for part in parts)
        kernels = range(len(parts[0].kernels))
        #: The number of parts that have a kernel, for each kernel.
        self.counts = [sum(k < len(part.kernels) for part in parts) for k in kernels]
        pairs = [(k, part) for k, count in enumerate(self.counts) for part in parts[:count]]
        weights = np.zeros((len(pairs), 1, *self.shape), parts[0].weights.dtype)
        for of_pair, (k, part) in zip(weights, pairs, strict=True):
            ny, nx = part.shape()
            of_pair[0, :ny, :nx] = part.weights[k]
        self.register_buffer("weights", torch.from_numpy(weights), persistent=False)
        ny, nx = transform_shape
        dtype = self.weights.dtype.to_complex()
        spectra = torch.empty((len(pairs), 1, ny, nx // 2 + 1), dtype=dtype, device="cpu")
        for spectrum, (k, part) in zip(spectra, pairs, strict=True):
            spectrum[0] = torch.fft.rfft2(torch.from_numpy(part.kernels[k]), s=transform_shape)
        self.register_buffer("spectra", spectra, persistent=False)

    def end(self) -> tuple[int, int]:
        """Return the row and the column at which the parts end."""
        y, x = _largest(self.places)
        return y + self.shape[0], x + self.shape[1]

    def scatter(self, light: Any, results: Any) -> None:
        """Add the light ``[frame, y, x]`` of the parts, spread by their kernels."""
        for frames, parts in self._steps(len(light)):
            tiles = self._cut(light[frames], parts, self.shape)
            spectrum = self.spectra.new_zeros((*tiles.shape[:2], *self.spectra.shape[2:]))
            for count, weights, spectra in self._kernels(parts):
                weighted = torch.fft.rfft2(tiles[:count] * weights, s=self.transform_shape)
                spectrum[:count].addcmul_(weighted, spectra)
            spread = torch.fft.irfft2(spectrum, s=self.transform_shape)
            self._add(spread, parts, self.reach, results[frames])

    def gather(self, light: Any, results: Any) -> None:
        """Add the light around the parts, collected by their kernels: `scatter` transposed."""
        ny, nx = self.shape
        for frames, parts in self._steps(len(light)):
            tiles = self._cut(light[frames], parts, self.reach)
            spectrum = torch.fft.rfft2(tiles, s=self.transform_shape)
            collected = self.weights.new_zeros((*tiles.shape[:2], *self.shape))
            for count, weights, spectra in self._kernels(parts):
                product = spectrum[:count] * spectra.conj()
                near = torch.fft.irfft2(product, s=self.transform_shape)
                collected[:count].addcmul_(near[..., :ny, :nx], weights)
            self._add(collected, parts, self.shape, results[frames])

    def _steps(self, frames: int) -> Iterator[tuple[slice, slice]]:
        """Yield the frames and the parts that are convolved together."""
        pixels = self.transform_shape[0] * self.transform_shape[1]
        on_cpu = self.weights.device.type == "cpu"
        at_once = torch.get_num_threads() * _PIXELS_PER_THREAD if on_cpu else _PIXELS_AT_ONCE
        some_frames = max(1, min(frames, at_once // pixels))
        some_parts = max(1, at_once // (some_frames * pixels))
        for part in range(0, len(self.places), some_parts):
            for frame in range(0, frames, some_frames):
                yield slice(frame, frame + some_frames), slice(part, part + some_parts)

    def _kernels(self, parts: slice) -> Iterator[tuple[int, Any, Any]]:
        """For each kernel, yield how many of the parts have it, its weights and its spectra."""
        first = 0
        for count in self.counts:
            pairs = slice(first + parts.start, first + min(parts.stop, count))
            if pairs.stop > pairs.start:
                yield pairs.stop - pairs.start, self.weights[pairs], self.spectra[pairs]
            first += count

    def _cut(self, light: Any, parts: slice, shape: tuple[int, int]) -> Any:
        """Return the light of parts or around them, ``[part, frame, y, x]``."""
        ny, nx = shape
        places = self.places[parts]
        return torch.stack([light[:, y : y + ny, x : x + nx] for y, x in places])

    def _add(self, tiles: Any, parts: slice, shape: tuple[int, int], results: Any) -> None:
        ny, nx = shape
        for (y, x), tile in zip(self.places[parts], tiles, strict=True):
            results[:, y : y + ny, x : x + nx] += tile[:, :ny, :nx]
