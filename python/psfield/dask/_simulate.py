"""Simulation of scenes that are chunked arrays."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import dask.array as da
import numpy as np
from dask.base import tokenize
from dask.delayed import delayed
from numpy.typing import NDArray

from psfield._arrays import DTYPES, Precision, check_real
from psfield._catalog import columns_of
from psfield._defaults import DEFAULTS
from psfield._model import PsfModel
from psfield.dask._checks import checked_for_workers
from psfield.dask._cores import share_cores
from psfield.dask._reach import Depth, reach
from psfield.dask._region import Columns, region_image


def simulate(
    scene: da.Array,
    model: PsfModel,
    tolerance: float = DEFAULTS.tolerance,
    precision: Precision = DEFAULTS.precision,
    device: Literal["auto", "cpu", "gpu"] = "cpu",
    *,
    catalog: Any = None,
    frame: tuple[int, int, int, int] | None = None,
    tolerance_on: Literal["l2", "aperture"] = DEFAULTS.tolerance_on,
    floor: float = DEFAULTS.floor,
    anchor: Literal["source", "output"] = DEFAULTS.anchor,
    method: Literal["auto", "lowrank"] = DEFAULTS.method,
    memory: int | None = DEFAULTS.memory,
    oversample: int = DEFAULTS.oversample,
    scene_pixels: Literal["point", "integrated"] = DEFAULTS.scene_pixels,
    stamp_size: int | None = None,
) -> da.Array:
    """Return the image of a scene that is a chunked Dask array, as a lazy array with its chunks.

    The image equals that of one plan for the whole scene up to rounding, at any tolerance and for
    any chunks. Each chunk is convolved with the light around it, as far as the stamps reach, by the
    tiles and modes of the whole scene. Chunks that no light reaches cost nothing. The PSF is sent
    to each worker once.

    In colour, add lazy images: one for each spectrum, through ``model.for_spectrum(...)``.

    Parameters
    ----------
    scene : dask.array.Array
        Flux in each pixel, ``[y, x]``, finite. Chunks may have any known sizes. Chunks that are
        smaller than the reach of the stamps are computed together with their neighbours. Chunks
        should be much larger than the stamps: 2048 x 2048 or more.
    model : PsfModel
        The PSF.
    tolerance, precision
        As for `PsfModel.plan`.
    device : {'cpu', 'auto', 'gpu'}
        Device on which the workers convolve. Workers that share a GPU share its memory.
    catalog : table or path, optional
        Stars and galaxies, as for `Plan.simulate`. Positions count from the first pixel of the
        frame.
    frame : (int, int, int, int), optional
        Part of the scene that the image shows, as for `PsfModel.plan`. The chunks of the image are
        those of the scene, cut at its edges.
    tolerance_on, floor, anchor, method
        As for `PsfModel.plan`.
    memory : int
        Largest number of bytes that each plan keeps. A worker keeps the four plans that it used
        last.
    oversample : int
        Scene pixels along each side of a pixel of the image. An edge of a chunk inside a pixel of
        the image moves to an edge of that pixel.
    scene_pixels, stamp_size
        As for `PsfModel.plan`.

    Returns
    -------
    dask.array.Array
        ``[y, x]``, float32 or float64 as ``precision`` says. Nothing is computed yet.

    Raises
    ------
    TypeError
        The scene is not a Dask array, or not of real numbers.
    ValueError
        The size of a chunk is unknown, the scene is empty, or an argument is invalid. Errors of
        pixels (NaN, masked) are raised by `compute`.

    Examples
    --------
    >>> import psfield
    >>> import dask.array
    >>> import psfield.dask
    >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
    >>> scene = dask.array.ones((40, 60), chunks=(20, 30))
    >>> image = psfield.dask.simulate(scene, model, tolerance=1e-3)
    >>> image.chunks
    ((20, 20), (30, 30))
    >>> image.compute()[20, 30].round(2).item()
    1.0
    """
    _check_scene(scene)
    settings = checked_for_workers(model, locals())
    rows, columns = settings["shape"] = scene.shape
    x0, y0, nx, ny = _frame_of(settings["frame"], (rows, columns), settings["oversample"])
    of_rows, of_columns = reach(
        model,
        settings["oversample"],
        settings["stamp_size"],
        integrated=settings["scene_pixels"] == "integrated",
    )
    along_y = _Axis.of(rows, scene.chunks[0], (y0, ny), settings["oversample"], of_rows)
    along_x = _Axis.of(columns, scene.chunks[1], (x0, nx), settings["oversample"], of_columns)
    sources = columns_of(catalog)
    token, dtype = tokenize(model), DTYPES[settings["precision"]]
    parts = scene[along_y.lit, along_x.lit].rechunk((along_y.light_chunks, along_x.light_chunks))
    depth, boundary = {0: along_y.depth, 1: along_x.depth}, {0: "none", 1: "none"}
    parts = da.overlap.overlap(parts, depth, boundary, allow_rechunk=False)
    image = parts.map_blocks(
        _chunk,
        # Model and catalogue are single keys of the graph, so that a worker receives each once.
        model=delayed(model, name=f"psfield-model-{token}", traverse=False),
        catalog=None
        if sources is None
        else delayed(sources, name=f"psfield-catalog-{tokenize(sources)}", traverse=False),
        mark=token,
        settings=settings,
        rows=along_y.pieces,
        columns=along_x.pieces,
        chunks=(along_y.image_chunks, along_x.image_chunks),
        dtype=dtype,
        meta=np.empty((0, 0), dtype),
        name=f"psfield-{tokenize(parts.name, token, settings, sources, along_y, along_x)}",
    )
    chunked: da.Array = image.rechunk((along_y.wanted_chunks, along_x.wanted_chunks))
    return chunked


class _Piece(NamedTuple):
    """One chunk along one axis."""

    #: First pixel of the image, and number of pixels.
    first: int
    pixels: int
    #: First pixel of the scene whose light reaches the chunk.
    origin: int


class _Axis(NamedTuple):
    """The pieces of one axis of a scene."""

    #: The part of the scene whose light reaches the frame.
    lit: slice
    #: Its chunks, without the overlap with their neighbours.
    light_chunks: tuple[int, ...]
    depth: Depth
    pieces: tuple[_Piece, ...]
    image_chunks: tuple[int, ...]
    #: The chunks of the image that the caller receives.
    wanted_chunks: tuple[int, ...]

    @classmethod
    def of(
        cls, size: int, chunks: Sequence[int], frame: tuple[int, int], finer: int, depth: Depth
    ) -> _Axis:
        start, pixels = frame
        below, above = depth
        first, end = start * finer, (start + pixels) * finer
        lit = slice(max(first - below, 0), min(end + above, size))
        edges = np.cumsum(chunks)
        # In pixels of the image, from the first pixel of the frame.
        inside = {int(edge) // finer - start for edge in edges}
        inner = sorted(edge for edge in inside if 0 < edge < pixels)
        wanted = [0, *inner, pixels]
        # A chunk must hold all the light that its neighbours need of it.
        least = -(-max(below, above) // finer)
        merged = [0]
        for edge in inner:
            if edge - merged[-1] >= least and pixels - edge >= least:
                merged.append(edge)
        merged.append(pixels)
        cuts = [lit.start, *((start + edge) * finer for edge in merged[1:-1]), lit.stop]
        alone = len(merged) == 2
        pieces = tuple(
            _Piece(a, b - a, cut if a == 0 else cut - below)
            for (a, b), cut in zip(pairwise(merged), cuts[:-1], strict=True)
        )
        overlap = (0, 0) if alone else depth
        return cls(lit, _sizes(cuts), overlap, pieces, _sizes(merged), _sizes(wanted))


def _sizes(edges: Sequence[int]) -> tuple[int, ...]:
    return tuple(b - a for a, b in pairwise(edges))


def _chunk(
    part: Any,
    *,
    model: PsfModel,
    catalog: Columns | None,
    mark: str,
    settings: dict[str, Any],
    rows: tuple[_Piece, ...],
    columns: tuple[_Piece, ...],
    block_id: tuple[int, int],
) -> NDArray[Any]:
    """Return the image of one chunk from the light that reaches it."""
    share_cores()
    row, column = rows[block_id[0]], columns[block_id[1]]
    region = (column.first, row.first, column.pixels, row.pixels)
    return region_image(model, mark, settings, region, part, (column.origin, row.origin), catalog)


def _check_scene(scene: Any) -> None:
    if not isinstance(scene, da.Array):
        kind = type(scene).__name__
        raise TypeError(
            f"scene must be a dask.array.Array, made by dask.array.from_array, got {kind}"
        )
    if scene.ndim != 2:
        raise ValueError(f"scene must be an array [y, x], got one of shape {scene.shape}")
    if np.isnan(scene.shape).any():
        raise ValueError(
            "scene: the sizes of its chunks are unknown: call scene.compute_chunk_sizes() first"
        )
    if 0 in scene.shape:
        raise ValueError(f"scene is empty: its shape is {scene.shape}")
    check_real(scene, "scene")
    meta = scene._meta
    if not isinstance(meta, np.ndarray) or hasattr(meta, "unit"):
        raise TypeError(
            f"scene: its chunks must be NumPy arrays, got {type(meta).__name__}:"
            " convert them with map_blocks"
        )


def _frame_of(
    frame: tuple[int, int, int, int] | None, shape: tuple[int, int], finer: int
) -> tuple[int, int, int, int]:
    """Return the frame, or the whole scene, in pixels of the image."""
    (rows, columns) = shape
    if frame is None:
        if rows % finer or columns % finer:
            raise ValueError(
                f"scene: its shape {shape} must be a multiple of oversample={finer}: cut it or give"
                " a frame"
            )
        return 0, 0, columns // finer, rows // finer
    x0, y0, nx, ny = frame
    if x0 < 0 or y0 < 0 or (x0 + nx) * finer > columns or (y0 + ny) * finer > rows:
        raise ValueError(f"frame {(x0, y0, nx, ny)} reaches beyond the scene of shape {shape}")
    return x0, y0, nx, ny
