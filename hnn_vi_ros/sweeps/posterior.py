# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Posterior of an identification: values of the numbers of a model, and their covariance."""

from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

from hnn_vi_ros.errors import DataError, did_you_mean, listed
from hnn_vi_ros.files.limits import parse_json, read_limited
from hnn_vi_ros.files.yaml_text import one_line
import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

_LARGEST_FILE = 2**25
# Relative to the standard deviations: how far from symmetric and how negative rounding may make
# a covariance.
_ROUNDING = 1e-8
_REMEDY = 'give what identify writes with --posterior'


class Posterior(NamedTuple):
    """
    A normal distribution of the values of some keys.

    Parameters
    ----------
    keys : list of str
        Of the scene.
    mean : np.ndarray, shape (n,)
        The values found.
    root : np.ndarray, shape (n, n)
        A matrix R whose R R^T is their covariance.
    digest : str
        Of the file.

    """

    keys: list[str]
    mean: np.ndarray
    root: np.ndarray
    digest: str


class _Parameter(BaseModel):
    model_config = ConfigDict(extra='ignore', strict=True, allow_inf_nan=False)
    value: float


class _Covariance(BaseModel):
    model_config = ConfigDict(extra='forbid', strict=True, allow_inf_nan=False)
    names: list[str] = Field(min_length=1, max_length=1000)
    matrix: list[list[float]]


class _File(BaseModel):
    model_config = ConfigDict(extra='ignore')
    parameters: dict[str, _Parameter]
    covariance: _Covariance


def read_posterior(path: Path, place: str, keys: Mapping[str, str] | None = None) -> Posterior:
    """
    Read the file of an identification.

    It is JSON: ``{"parameters": {NAME: {"value": ...}}, "covariance": {"names": [NAME, ...],
    "matrix": [[...]]}}``; what else it holds is not read.

    Parameters
    ----------
    path : Path
        The file.
    place : str
        Where it is asked for, for errors.
    keys : mapping of str to str, optional
        The key of a scene for each name that is wanted; without it, all names unchanged.

    Raises
    ------
    DataError
        It cannot be read, or is no such file; one line.

    """
    where = f'{place}: {path}'
    try:
        raw = read_limited(path, _LARGEST_FILE)
        found = _File.model_validate(parse_json(raw))
    except OSError as problem:
        raise DataError(f'{where}: {problem.strerror or problem}; {_REMEDY}') from problem
    except ValidationError as problem:
        first = problem.errors()[0]
        key = '.'.join(map(str, first['loc']))
        raise DataError(f'{where}: {key}: {first["msg"]}; {_REMEDY}') from problem
    except ValueError as problem:
        raise DataError(f'{where}: {one_line(problem)}; {_REMEDY}') from problem
    names, n = found.covariance.names, len(found.covariance.names)
    if any(len(row) != n for row in found.covariance.matrix) or len(
            found.covariance.matrix) != n or len(set(names)) != n:
        raise DataError(f'{where}: covariance: {n} names take as many rows and columns, and each '
                        f'name once; {_REMEDY}')
    wanted = {name: name for name in names} if keys is None else dict(keys)
    for name in wanted:
        if name not in names or name not in found.parameters:
            raise DataError(one_line(
                f'{where}: no {name!r} among its parameters and its covariance'
                f'{did_you_mean(name, names)}; there are: {listed(names)}'))
    chosen = [names.index(name) for name in wanted]
    covariance = np.array(found.covariance.matrix)[np.ix_(chosen, chosen)]
    return Posterior([*wanted.values()],
                     np.array([found.parameters[name].value for name in wanted]),
                     _root(covariance, where), sha256(raw).hexdigest())


def _root(covariance: np.ndarray, where: str) -> np.ndarray:
    """Return R with R R^T the covariance, which need not be regular."""
    spread = np.sqrt(np.abs(np.diag(covariance)))
    units = np.where(spread > 0.0, spread, 1.0)
    correlation = covariance / units / units[:, None]
    if not np.abs(correlation - correlation.T).max() <= _ROUNDING:
        raise DataError(f'{where}: covariance: the matrix is not symmetric; {_REMEDY}')
    squares, vectors = np.linalg.eigh(0.5 * (correlation + correlation.T))
    if not squares[0] >= -_ROUNDING * len(squares):
        raise DataError(f'{where}: covariance: the matrix is not positive semidefinite; {_REMEDY}')
    # Eigenvectors are determined up to sign; fixing it makes draws the same everywhere.
    signs = np.sign(vectors[np.abs(vectors).argmax(axis=0), np.arange(len(squares))])
    return units[:, None] * vectors * signs * np.sqrt(np.maximum(squares, 0.0))
