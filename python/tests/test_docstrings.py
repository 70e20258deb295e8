"""The examples in the docstrings run, and every public name has one."""

from __future__ import annotations

import doctest
import importlib
import importlib.util
import inspect
import pkgutil
import re
from collections.abc import Iterator
from typing import Any

import pytest

import psfield
from psfield import detector, metrics, plot

#: An example is skipped if it imports one of these packages and the package is not installed.
OPTIONAL = ("astropy", "dask", "distributed", "jax", "matplotlib", "photutils", "scipy", "torch")
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def is_installed(package: str) -> bool:
    """Return whether a package can be imported."""
    return importlib.util.find_spec(package) is not None


def modules() -> Iterator[Any]:
    """Yield the modules of the package that can be imported here."""
    yield psfield
    for found in pkgutil.walk_packages(psfield.__path__, "psfield."):
        # Importing the package of Dask itself needs Dask.
        if found.name.endswith("_native") or (".dask" in found.name and not is_installed("dask")):
            continue
        try:
            yield importlib.import_module(found.name)
        except ImportError as error:
            if error.name not in (*OPTIONAL, "zarr"):
                raise


def docstrings() -> list[doctest.DocTest]:
    """Return the docstrings with examples."""
    finder = doctest.DocTestFinder(exclude_empty=True)
    found = (test for module in modules() for test in finder.find(module))
    return [test for test in found if test.examples]


def public() -> Iterator[tuple[str, Any]]:
    """Yield the public functions, classes, methods and properties by name."""
    namespaces = [psfield, detector, metrics, plot]
    for package in ("dask", "jax", "torch"):
        if is_installed(package):
            namespaces.append(importlib.import_module(f"psfield.{package}"))
    for namespace in namespaces:
        for name in namespace.__all__:
            value = getattr(namespace, name)
            if not inspect.isclass(value) and not inspect.isfunction(value):
                continue
            yield f"{namespace.__name__}.{name}", value
            for member, of_class in vars(value).items() if inspect.isclass(value) else ():
                function = getattr(of_class, "__func__", of_class)
                documented = isinstance(function, property) or inspect.isfunction(function)
                if documented and not member.startswith("_"):
                    yield f"{namespace.__name__}.{name}.{member}", function


@pytest.mark.parametrize("test", docstrings(), ids=lambda test: test.name)
def test_examples_run(test, tmp_path, monkeypatch):
    source = "".join(example.source for example in test.examples)
    for package in OPTIONAL:
        if re.search(rf"^(import|from) .*\b{package}\b", source, re.MULTILINE):
            pytest.importorskip(package)
    monkeypatch.chdir(tmp_path)
    threads = psfield.threads()
    report: list[str] = []
    runner = doctest.DocTestRunner(optionflags=FLAGS)
    failed, _ = runner.run(test, out=report.append, clear_globs=False)
    psfield.set_threads(threads)
    assert not failed, "".join(report)


@pytest.mark.parametrize(
    ("name", "value"), [pytest.param(*found, id=found[0]) for found in public()]
)
def test_public_names_have_examples(name, value):
    text = inspect.cleandoc(value.__doc__ or "")
    _, found, examples = text.partition("\nExamples\n--------\n")
    assert found and ">>>" in examples, f"{name} has no examples"
    arguments = inspect.signature(value).parameters if inspect.isfunction(value) else ()
    undocumented = [
        member
        for member in arguments
        if member not in ("self", "cls") and not re.search(rf"\b{member}\b", text)
    ]
    assert not undocumented, f"{name} does not describe {undocumented}"


def test_a_wrong_example_fails():
    test = doctest.DocTestParser().get_doctest(">>> 1 + 1\n3\n", {}, "wrong", None, None)
    assert doctest.DocTestRunner().run(test, out=lambda text: None).failed == 1
