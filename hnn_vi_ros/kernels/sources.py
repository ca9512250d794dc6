# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Digest of the sources of this package that a function is compiled from."""

from collections.abc import Iterator
from functools import cache
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
import platform
import re
import sys
from types import CodeType, FunctionType, ModuleType

from hnn_vi_ros.exports import exported
from hnn_vi_ros.kernels.marks import is_own
from hnn_vi_ros.version import __version__
from llvmlite import binding

# torch is listed only if it is loaded.
_LIBRARIES = ('numpy', 'scipy', 'numba', 'llvmlite')


def identity() -> dict[str, str]:
    """Return the versions that two runs must share to agree bit by bit, by name."""
    torch = {'torch': version('torch')} if 'torch' in sys.modules else {}
    return _fixed() | torch


@cache
def _fixed() -> dict[str, str]:
    features = sha256(binding.get_host_cpu_features().flatten().encode()).hexdigest()
    return {
        'hnn_vi_ros': __version__, 'sources': sources(), 'python': platform.python_version(),
        **{name: version(name) for name in _LIBRARIES},
        'machine': platform.machine(), 'processor': binding.get_host_cpu_name(),
        'processor_features': features[:16]}


_PACKAGE = __name__.partition('.')[0]
_ROOT = Path(__file__).parents[1]
# Rooms with the sources of compiled code and of its composition.
_ROOMS = ('effects', 'hamiltonians', 'integrators', 'kernels', 'models', 'simulation')
_IMPORT = re.compile(rf'^[ \t]*from ({_PACKAGE}[\w.]*) import (\([^)]*\)|[^\n]*)', re.M)


@cache
def sources() -> str:
    """Return a digest of all possible sources of a step of any simulation."""
    return _digest(path for room in _ROOMS for path in (_ROOT / room).rglob('*.py'))


def digest_of(modules: frozenset[str]) -> str:
    """
    Return a digest of modules of this package and of all their imports from it.

    Other modules are ignored, because code compiled from them is not cached.
    """
    return _digest_of(frozenset(module for module in modules if is_own(module)))


@cache
def _digest_of(modules: frozenset[str]) -> str:
    # The sources of the compilation itself are part of each digest.
    rest = [*modules, *(f'{_PACKAGE}.kernels.{path.stem}'
                        for path in (_ROOT / 'kernels').glob('*.py'))]
    found: set[Path] = set()
    while rest:
        path = _path(rest.pop())
        if path is not None and path not in found:
            found.add(path)
            rest.extend(_imports(path))
    return _digest(found)


@cache
def _imports(path: Path) -> tuple[str, ...]:
    """Return the imports of a file from this package, names of modules and of their content."""
    def names() -> Iterator[str]:
        for match in _IMPORT.finditer(path.read_text(encoding='utf-8')):
            place = _path(match[1])
            # Only packages contain modules and export names.
            if place is None or place.stem != '__init__':
                yield match[1]
                continue
            for name in re.findall(r'\w+(?= as |\s*[,)\n]|$)', match[2]):
                full = f'{match[1]}.{name}'
                yield full if _path(full) else exported(place).get(name, match[1])
    return tuple(names())


@cache
def _path(module: str) -> Path | None:
    """Return the file of a module, None if there is none."""
    path = _ROOT.joinpath(*module.split('.')[1:])
    return next((file for file in (path.with_suffix('.py'), path / '__init__.py')
                 if file.is_file()), None)


def _digest(paths: Iterator[Path] | set[Path]) -> str:
    return sha256(b''.join(sorted(map(_named_digest, paths)))).hexdigest()


@cache
def _named_digest(path: Path) -> bytes:
    """Return the name of a file and the digest of its content: many digests contain it."""
    return path.relative_to(_ROOT).as_posix().encode() + sha256(path.read_bytes()).digest()


def reached(*values: object) -> set[FunctionType]:
    """Return the Python functions among values, at any depth of tuples, and all they call."""
    return set().union(*map(_reached_by, _functions(values)))


def _functions(value: object) -> Iterator[FunctionType]:
    """Yield the functions in a value, at any depth of tuples."""
    value = getattr(value, 'py_func', value)
    if isinstance(value, tuple):
        for part in value:
            yield from _functions(part)
    elif isinstance(value, FunctionType):
        yield value


@cache
def _reached_by(function: FunctionType) -> frozenset[FunctionType]:
    """Return a function and all it calls in compiled form, from the globals at the first call."""
    rest, found = [function], set()
    while rest:
        own = rest.pop()
        if own not in found:
            found.add(own)
            rest.extend(_functions(tuple(cell.cell_contents for cell in own.__closure__ or ())))
            rest.extend(_functions(tuple(_named(own))))
    return frozenset(found)


def names_in(code: CodeType) -> set[str]:
    """Return the global and attribute names in code, including nested functions."""
    inner = [names_in(part) for part in code.co_consts if isinstance(part, CodeType)]
    return set(code.co_names).union(*inner)


def _named(function: FunctionType) -> Iterator[object]:
    """Yield the objects of this package or its user that a function refers to by global names."""
    names = names_in(function.__code__)
    for name in names & function.__globals__.keys():
        value = function.__globals__[name]
        if isinstance(value, ModuleType):
            values = [getattr(value, part, None) for part in names]
        else:
            values = [value]
        yield from (part for part in values if not _is_of_numba(part))


def _is_of_numba(value: object) -> bool:
    return str(getattr(value, '__module__', '')).partition('.')[0] in ('numba', 'numpy', 'math')
