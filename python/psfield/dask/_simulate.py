"""Scenes as chunked arrays."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import dask.array as da
import numpy as np
from dask.base import tokenize
from dask.delayed import delayed
from numpy.typing import NDArray

from psfield._arrays import DTYPES, check_real
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
    precision: Literal["f32", "f64"] = DEFAULTS.precision,
    device: Literal["auto", "cpu", "gpu"] = "cpu",
    *,
    catalog: Any = None,
    frame: tuple[int, int, int, int] | None = None,
    anchor: Literal["source", "output"] = DEFAULTS.anchor,
    method: Literal["auto", "lowrank"] = DEFAULTS.method,
    memory: int = DEFAULTS.memory,
    oversample: int = DEFAULTS.oversample,
    stamp_size: int | None = None,
) -> da.Array:
    """Return the image of a scene that is a chunked Dask array, as a lazy array with the same chunks.

    It equals the image that one plan gives for the whole scene to the rounding of the precision, at any tolerance and however the scene
    is chunked: each chunk gets the light around it as far as the stamps reach, and is convolved by the tiles and the modes of the whole.
    Chunks that no light reaches cost nothing. The PSF is sent to each worker once.

    Parameters
    ----------
    scene : dask.array.Array
        Flux in each pixel, ``[y, x]``; finite. Chunks of any sizes, which must be known; those that are smaller than the stamps reach are
        computed together with their neighbours. Best are chunks that are much larger than the stamps: 2048 x 2048 or more.
    model : PsfModel
        The PSF.
    tolerance, precision
        As for `PsfModel.plan`.
    device : {'cpu', 'auto', 'gpu'}
        Where the workers convolve. Those that share a GPU share its memory.
    catalog : table, optional
        Stars and galaxies, as for `Plan.simulate`; positions count from the frame's first pixel.
    frame : (int, int, int, int), optional
        The part of the scene that the image shows, as for `PsfModel.plan`; the image's chunks are those of the scene, cut at its edges.
    anchor, method
        As for `PsfModel.plan`.
    memory : int
        Bytes that each plan keeps, at most; a worker keeps the four plans that it used last.
    oversample : int
        Scenes are finer than the image. Edges of chunks between two pixels of the image move to one of them.
    stamp_size : int, optional
        As for `PsfModel.plan`.

    Returns
    -------
    dask.array.Array
        ``[y, x]``, float32 or float64 as ``precision`` says. Nothing is computed yet.

    Raises
    ------
    TypeError
        A scene that is no Dask array, or not of real numbers.
    ValueError
        Chunks of unknown size, an empty scene, options that cannot be. What is wrong with pixels (NaN, masked) comes from `compute`.
    """
    _check_scene(scene)
    words = checked_for_workers(
        model,
        tolerance=tolerance,
        precision=precision,
        device=device,
        frame=frame,
        anchor=anchor,
        method=method,
        memory=memory,
        oversample=oversample,
        stamp_size=stamp_size,
    )
    rows, columns = words["shape"] = scene.shape
    x0, y0, nx, ny = _frame_of(words["frame"], (rows, columns), words["oversample"])
    of_rows, of_columns = reach(model, words["oversample"], words["stamp_size"])
    along_y = _Axis.of(rows, scene.chunks[0], (y0, ny), words["oversample"], of_rows)
    along_x = _Axis.of(columns, scene.chunks[1], (x0, nx), words["oversample"], of_columns)
    found = columns_of(catalog)
    sources = None if found is None else {name: column for name, column in found.items() if column is not None}
    token = tokenize(model)
    parts = scene[along_y.lit, along_x.lit].rechunk((along_y.light_chunks, along_x.light_chunks))
    parts = da.overlap.overlap(parts, {0: along_y.depth, 1: along_x.depth}, {0: "none", 1: "none"}, allow_rechunk=False)
    image = parts.map_blocks(
        _chunk,
        # One key of the graph each, so that a worker gets them once.
        model=delayed(model, name=f"psfield-model-{token}", traverse=False),
        catalog=None if sources is None else delayed(sources, name=f"psfield-catalog-{tokenize(sources)}", traverse=False),
        mark=token,
        words=words,
        rows=along_y.pieces,
        columns=along_x.pieces,
        chunks=(along_y.image_chunks, along_x.image_chunks),
        dtype=DTYPES[precision],
        meta=np.empty((0, 0), DTYPES[precision]),
        name=f"psfield-{tokenize(parts.name, token, words, sources, along_y, along_x)}",
    )
    chunked: da.Array = image.rechunk((along_y.wanted_chunks, along_x.wanted_chunks))
    return chunked


class _Piece(NamedTuple):
    """One chunk along one axis."""

    #: First pixel of the image, and how many.
    first: int
    pixels: int
    #: Where its light begins, in pixels of the scene.
    origin: int


class _Axis(NamedTuple):
    """How one axis of a scene is cut."""

    #: The part of the scene whose light reaches the frame.
    lit: slice
    #: Its chunks, without those pixels of their neighbours that reach them.
    light_chunks: tuple[int, ...]
    depth: Depth
    pieces: tuple[_Piece, ...]
    image_chunks: tuple[int, ...]
    #: The chunks of the image that the caller gets.
    wanted_chunks: tuple[int, ...]

    @classmethod
    def of(cls, size: int, chunks: Sequence[int], frame: tuple[int, int], finer: int, depth: Depth) -> _Axis:
        start, pixels = frame
        below, above = depth
        first, end = start * finer, (start + pixels) * finer
        lit = slice(max(first - below, 0), min(end + above, size))
        edges = np.cumsum(chunks)
        # In pixels of the image, from the frame's first on.
        inner = sorted({int(edge) // finer - start for edge in edges if 0 < int(edge) // finer - start < pixels})
        wanted = [0, *inner, pixels]
        # Each must hold all that its neighbours need of it.
        least = -(-max(below, above) // finer)
        merged = [0]
        for edge in inner:
            if edge - merged[-1] >= least and pixels - edge >= least:
                merged.append(edge)
        merged.append(pixels)
        cuts = [lit.start, *((start + edge) * finer for edge in merged[1:-1]), lit.stop]
        alone = len(merged) == 2
        pieces = tuple(_Piece(a, b - a, cut if a == 0 else cut - below) for (a, b), cut in zip(pairwise(merged), cuts[:-1], strict=True))
        return cls(lit, _sizes(cuts), (0, 0) if alone else depth, pieces, _sizes(merged), _sizes(wanted))


def _sizes(edges: Sequence[int]) -> tuple[int, ...]:
    return tuple(b - a for a, b in pairwise(edges))


def _chunk(
    part: Any,
    *,
    model: PsfModel,
    catalog: Columns | None,
    mark: str,
    words: dict[str, Any],
    rows: tuple[_Piece, ...],
    columns: tuple[_Piece, ...],
    block_id: tuple[int, int],
) -> NDArray[Any]:
    """Return the image of one chunk from the light that reaches it."""
    share_cores()
    row, column = rows[block_id[0]], columns[block_id[1]]
    region = (column.first, row.first, column.pixels, row.pixels)
    return region_image(model, mark, words, region, part, (column.origin, row.origin), catalog)


def _check_scene(scene: Any) -> None:
    if not isinstance(scene, da.Array):
        raise TypeError(f"scene must be a dask.array.Array, as dask.array.from_array makes them, got {type(scene).__name__}")
    if scene.ndim != 2:
        raise ValueError(f"scene must be an array [y, x], got one of shape {scene.shape}")
    if np.isnan(scene.shape).any():
        raise ValueError("scene: the sizes of its chunks are unknown: call its compute_chunk_sizes() first")
    if 0 in scene.shape:
        raise ValueError(f"scene is empty: its shape is {scene.shape}")
    check_real(scene, "scene")
    meta = scene._meta
    if not isinstance(meta, np.ndarray) or hasattr(meta, "unit"):
        raise TypeError(f"scene: its chunks must be NumPy arrays, got {type(meta).__name__}: convert them with map_blocks")


def _frame_of(frame: tuple[int, int, int, int] | None, shape: tuple[int, int], finer: int) -> tuple[int, int, int, int]:
    (rows, columns) = shape
    if frame is None:
        if rows % finer or columns % finer:
            raise ValueError(f"scene: its shape {shape} is no multiple of oversample={finer}: give a frame")
        return 0, 0, columns // finer, rows // finer
    x0, y0, nx, ny = frame
    if x0 < 0 or y0 < 0 or (x0 + nx) * finer > columns or (y0 + ny) * finer > rows:
        raise ValueError(f"frame {(x0, y0, nx, ny)} reaches beyond the scene of shape {shape}")
    return x0, y0, nx, ny
