from collections.abc import Callable, Mapping
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "DEFAULTS",
    "Detector",
    "Plan",
    "PsfModel",
    "RealFrame",
    "Series",
    "Sources",
    "Survey",
    "__version__",
    "adaptive_moments",
    "catalog_columns",
    "compare",
    "fit_gaussian",
    "image_cards",
    "knows_sky",
    "measure_image",
    "measure_stamps",
    "plan_settings",
    "quadrupole_moments",
    "sample_function",
    "sample_telescope",
    "set_threads",
    "threads",
]

__version__: str
DEFAULTS: dict[str, dict[str, Any]]

_Column = NDArray[np.float64]
_Cube = NDArray[np.float64]
#: Mean stamp, components and coefficients.
_Basis = tuple[NDArray[np.float64] | None, _Cube, NDArray[np.float64]]
_Callback = Callable[[int, int], object] | None
_Shape = tuple[int, int]
#: The images of a scene and the names of their spectra.
_Images = list[tuple[str | None, NDArray[Any]]]
#: Bandpass, dispersion and spectrum of a plan in colour.
_Curve = str | tuple[list[float], list[float]]
_Colour = tuple[_Curve, str | None, str | None] | None
_States = tuple[str, list[float]] | None

def set_threads(count: int) -> None: ...
def threads() -> int: ...
def image_cards(cards: str, first: tuple[float, float], oversample: int) -> str: ...
def catalog_columns(
    names: list[str], spectra: bool, velocities: bool, wcs_cards: str | None
) -> tuple[list[tuple[str, str, str | None]], list[str]]: ...
def knows_sky(cards: str) -> bool: ...
def plan_settings(given: Mapping[str, Any]) -> dict[str, Any]: ...
def sample_function(
    function: Callable[[float, float], NDArray[np.float64]],
    stamp_shape: _Shape,
    field: _Shape,
    grid: dict[str, Any],
    sampling: dict[str, Any],
    fit: dict[str, Any],
    progress: _Callback,
) -> tuple[PsfModel, dict[str, Any]]: ...
def sample_telescope(settings: dict[str, Any], fit: dict[str, Any]) -> PsfModel: ...

@final
class PsfModel:
    @staticmethod
    def from_samples(
        stamps: _Cube,
        x: _Column,
        y: _Column,
        states: _States,
        field: _Shape | None,
        grid: dict[str, Any],
        fit: dict[str, Any],
        gridded_library: bool,
        basis: PsfModel | tuple[NDArray[np.float64] | None, _Cube] | None,
        weights: _Cube | None,
    ) -> PsfModel: ...
    @staticmethod
    def from_basis(
        mean: NDArray[np.float64] | None,
        components: _Cube,
        coefficients: NDArray[np.float64],
        x: _Column,
        y: _Column,
        states: _States,
        field: _Shape | None,
        grid: dict[str, Any],
        choices: tuple[str, str, str, str | None],
        wings: tuple[NDArray[np.float32], NDArray[np.float64], dict[str, Any]] | None = None,
    ) -> PsfModel: ...
    @staticmethod
    def read(path: str, file: dict[str, Any], fit: dict[str, Any]) -> PsfModel: ...
    def notes(self) -> list[str]: ...
    def state(self) -> tuple[str, tuple[Any, ...]]: ...
    def has_samples(self) -> bool: ...
    def grid(self) -> dict[str, Any]: ...
    def stamp_shape(self) -> _Shape: ...
    def positions(self) -> tuple[_Column, _Column]: ...
    def states(self) -> _States: ...
    def at_state(self, value: float) -> PsfModel: ...
    def for_spectrum(
        self,
        bandpass: str | tuple[list[float], list[float]],
        spectrum: str | tuple[list[float], list[float]],
    ) -> PsfModel: ...
    def field(self) -> _Shape | None: ...
    def field_shape(self) -> _Shape | None: ...
    def choices(self) -> tuple[str, str, str, str | None]: ...
    def interpolated_by(
        self,
        name: str,
        evaluate: Callable[[_Column, _Column], NDArray[np.float64]],
        predictions: tuple[NDArray[np.float64], int],
        table_error: float,
    ) -> PsfModel: ...
    def parameters(self) -> _Basis: ...
    def given_parameters(self) -> _Basis | None: ...
    def with_parameters(
        self,
        mean: NDArray[np.float64] | None,
        components: _Cube | None,
        coefficients: NDArray[np.float64] | None,
    ) -> PsfModel: ...
    def rank_if_fitted(self) -> int | None: ...
    def fit_report(self) -> str | None: ...
    def evaluate(
        self, x: _Column, y: _Column, native: bool, size: int | None, sub_pixel: bool
    ) -> tuple[_Cube, str | None]: ...
    def gridded(
        self, at: _Shape | None
    ) -> tuple[_Cube, tuple[_Column, _Column], float, float | None]: ...
    def write(self, path: str, settings: dict[str, Any]) -> list[str]: ...

@final
class Sources:
    def __new__(
        cls,
        columns: list[tuple[str, _Column | list[str]]],
        rows: list[int] | None = None,
        wcs_cards: str | None = None,
    ) -> Sources: ...
    @staticmethod
    def read(path: str, settings: dict[str, Any]) -> Sources: ...
    def left_out(self) -> tuple[int, int, list[str]]: ...
    def columns(self) -> dict[str, Any]: ...
    def __len__(self) -> int: ...

@final
class RealFrame:
    def __new__(cls, path: str, extension: str | None) -> RealFrame: ...
    def unit(self) -> str | None: ...
    def cards(self) -> str: ...
    def inject(
        self, model: PsfModel | None, sources: Sources, output: str, settings: dict[str, Any]
    ) -> tuple[str, list[str]]: ...

@final
class Survey:
    def __new__(
        cls, json: str, folder: str, columns: list[tuple[str, _Column | list[str], str]] | None
    ) -> Survey: ...
    @staticmethod
    def read(path: str) -> Survey: ...
    def __len__(self) -> int: ...
    def frames(self) -> list[dict[str, Any]]: ...
    def observe(self, number: int, overwrite: bool) -> str: ...
    def join(self, exposure: str) -> bool: ...
    def write_list(self, overwrite: bool) -> None: ...

@final
class Plan:
    def __new__(
        cls,
        model: PsfModel,
        shape: _Shape,
        precision: str,
        settings: Mapping[str, Any],
        colour: _Colour,
    ) -> Plan: ...
    def for_region(self, at: tuple[int, int, int, int]) -> Plan: ...
    def with_psf(self, model: PsfModel) -> Plan: ...
    def light_region(self) -> tuple[int, int, int, int]: ...
    def frame_shape(self) -> _Shape: ...
    def blocks(self) -> list[tuple[int, int, int, int, int]]: ...
    def arrays(
        self,
    ) -> tuple[
        tuple[int, int],
        tuple[int, int],
        list[tuple[tuple[int, int], NDArray[Any], NDArray[Any]]],
    ]: ...
    def summary(self) -> dict[str, Any]: ...
    def simulate(
        self,
        images: _Images,
        sources: Sources | None,
        out: NDArray[Any] | None,
        progress: _Callback,
    ) -> tuple[NDArray[Any] | None, list[str]]: ...
    def simulate_many(
        self, scenes: NDArray[Any], out: NDArray[Any] | None, progress: _Callback
    ) -> tuple[NDArray[Any] | None, list[str]]: ...
    def adjoint(
        self, image: NDArray[Any], spectra: list[str], progress: _Callback
    ) -> list[NDArray[Any]]: ...
    def adjoint_many(
        self, images: NDArray[Any], spectrum: str | None, progress: _Callback
    ) -> NDArray[Any]: ...
    def gradients(
        self,
        lights: NDArray[Any],
        images: NDArray[Any],
        light: bool,
        coefficients: bool,
        stamps: bool,
    ) -> tuple[NDArray[Any] | None, _Basis | None]: ...
    def draw_sources(self, columns: NDArray[np.float64]) -> NDArray[Any]: ...
    def source_gradients(
        self, columns: NDArray[np.float64], image: NDArray[Any]
    ) -> NDArray[np.float64]: ...
    def expose(
        self,
        images: _Images,
        sources: Sources | None,
        detector: Detector,
        seed: int,
        shoot_below: float,
        bad_pixels: NDArray[np.float64] | None,
    ) -> tuple[tuple[NDArray[Any], NDArray[np.uint8], str], list[str]]: ...
    def truth_table(
        self, sources: Sources, wcs_cards: str | None, flags: NDArray[np.uint8] | None
    ) -> dict[str, NDArray[Any]]: ...
    def dropped_light(self, sources: Sources) -> tuple[float, float]: ...
    def spot_check(
        self,
        image: NDArray[Any],
        images: _Images,
        sources: Sources | None,
        count: int,
        seed: int,
    ) -> str: ...

@final
class Series:
    def __new__(
        cls,
        model: PsfModel,
        shape: _Shape,
        precision: str,
        settings: Mapping[str, Any],
        colour: _Colour,
        images: _Images,
        sources: Sources | None,
        changes: dict[str, Any],
    ) -> Series: ...
    def exposure(
        self, number: int, progress: _Callback
    ) -> tuple[NDArray[Any], list[float], list[_Column], list[str]]: ...

@final
class Detector:
    def __new__(cls, params: Mapping[str, Any]) -> Detector: ...
    @staticmethod
    def from_toml(path: str) -> Detector: ...
    def params(self) -> str: ...
    def unit(self) -> str: ...
    def noise(self) -> float: ...
    def saturation(self) -> float | None: ...
    def expose(
        self, image: NDArray[Any], seed: int, bad_pixels: NDArray[np.float64] | None
    ) -> tuple[NDArray[Any], NDArray[np.uint8], str]: ...

def fit_gaussian(
    stamp: NDArray[np.float64],
    size: int | None,
    about: _Shape | None,
    background: bool,
    round: bool,
) -> dict[str, Any]: ...
def adaptive_moments(
    stamp: NDArray[np.float64],
    size: int | None,
    about: _Shape | None,
    start: tuple[float, float, float] | None,
) -> dict[str, Any]: ...
def quadrupole_moments(
    stamp: NDArray[np.float64], size: int | None, about: _Shape | None
) -> dict[str, Any]: ...
def compare(result: NDArray[np.float64], reference: NDArray[np.float64]) -> dict[str, Any]: ...
def measure_stamps(stamps: _Cube, size: int | None, background: bool) -> str: ...
def measure_image(
    image: NDArray[np.float64], x: _Column, y: _Column, size: int | None, background: bool
) -> str: ...
