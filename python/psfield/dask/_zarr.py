"""Frames in one Zarr group."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from psfield._native import __version__
from psfield.dask._kept import Kept

#: Groups that are open in this process.
_OPEN: Kept[Any] = Kept(4)

#: Seconds between two updates of the list of finished frames.
_BETWEEN_NOTES = 1.0
#: Frames per chunk of that list.
_NOTED_TOGETHER = 1 << 16


@dataclass(frozen=True)
class ZarrFrames:
    """Arrays ``[job, y, x]`` with one frame per chunk, which workers write in parallel."""

    path: str

    def write(self, index: int, frames: Mapping[str, Any]) -> None:
        """Write the frames of a job, and replace existing ones."""
        group = _OPEN.get(self.path, self._open)
        for name, array in frames.items():
            if name not in group:
                raise ValueError(
                    f"{self.path} has no array {name!r}: give the detector to the batch, not to the"
                    " job"
                )
            shape = group[name].shape[1:]
            if np.shape(array) != shape:
                raise ValueError(
                    f"{name}: the frames of {self.path} have the shape {shape}, but this one has"
                    f" {np.shape(array)}"
                )
        for name, array in frames.items():
            group[name][index] = array

    def _open(self) -> Any:
        import zarr

        return zarr.open_group(self.path, mode="r+")


class ZarrLedger:
    """The group on the client, with the list of finished frames.

    It creates or opens the group. Only the client writes the list.
    """

    def __init__(
        self,
        path: str,
        count: int,
        arrays: Mapping[str, tuple[tuple[int, int], np.dtype[Any]]],
        settings: dict[str, Any],
        overwrite: bool,
    ) -> None:
        import zarr

        self.path = path
        settings = {"psfield": __version__, **settings}
        if overwrite:
            _check_own(path)
        group: Any = zarr.open_group(path, mode="w" if overwrite else "a")
        if "done" in group:
            _check_same(path, group, arrays, settings)
            held = group["done"].shape[0]
            if held > count:
                raise ValueError(
                    f"{path}: it has {held} frames, but there are only {count} jobs: use another"
                    " output, or overwrite=True"
                )
            for name in (*arrays, "done"):
                group[name].resize((count, *group[name].shape[1:]))
        elif list(group.members()):
            raise ValueError(
                f"{path}: it was not made by a batch: use another output, or overwrite=True"
            )
        else:
            group.attrs.update({"psfield": settings})
            for name, (shape, dtype) in arrays.items():
                empty = np.nan if dtype.kind == "f" else 0
                group.create_array(
                    name,
                    shape=(count, *shape),
                    chunks=(1, *shape),
                    dtype=dtype,
                    fill_value=empty,
                    dimension_names=("job", "y", "x"),
                )
            # This array is created last, so that the other arrays exist if it does.
            group.create_array(
                "done",
                shape=(count,),
                chunks=(_NOTED_TOGETHER,),
                dtype=np.dtype(bool),
                fill_value=False,
            )
        self._noted = group["done"]
        self.done = np.asarray(self._noted[:])
        self._unnoted: set[int] = set()
        self._at = time.monotonic()

    def note(self, index: int) -> None:
        """Mark a frame as finished."""
        self.done[index] = True
        self._unnoted.add(index // _NOTED_TOGETHER)
        if time.monotonic() - self._at > _BETWEEN_NOTES:
            self.flush()

    def flush(self) -> None:
        """Write the list of finished frames."""
        for chunk in sorted(self._unnoted):
            part = slice(chunk * _NOTED_TOGETHER, (chunk + 1) * _NOTED_TOGETHER)
            self._noted[part] = self.done[part]
        self._unnoted.clear()
        self._at = time.monotonic()


def _check_own(path: str) -> None:
    """Refuse to replace anything but a group of a batch."""
    import zarr

    if not os.path.exists(path) or (os.path.isdir(path) and not os.listdir(path)):
        return
    try:
        own = "psfield" in zarr.open_group(path, mode="r").attrs
    except (OSError, ValueError):
        own = False
    if not own:
        raise ValueError(
            f"{path}: it was not made by a batch and is not replaced: use another output"
        )


def _check_same(path: str, group: Any, arrays: Mapping[str, Any], settings: dict[str, Any]) -> None:
    """Refuse to continue with frames that were made with other settings."""
    held = group.attrs.get("psfield", {})
    for name, value in settings.items():
        if held.get(name) != value:
            raise ValueError(
                f"{path}: its frames were made with {name} = {held.get(name)}, not {value}:"
                " use another output, or overwrite=True"
            )
    for name, (shape, dtype) in arrays.items():
        if name not in group or group[name].shape[1:] != tuple(shape) or group[name].dtype != dtype:
            got = "no frames"
            if name in group:
                got = f"frames {group[name].shape[1:]} of {group[name].dtype}"
            raise ValueError(
                f"{path}: its array {name!r} holds {got}, not {tuple(shape)} of {dtype}:"
                " use another output, or overwrite=True"
            )
