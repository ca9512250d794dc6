# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Gravity compensation: motors that bear the weight that a model predicts."""

from collections.abc import Sequence
from typing import Any, Literal

from hnn_vi_ros.effects.base import EffectState
from hnn_vi_ros.hamiltonians import Hamiltonian

GravityModelKind = Literal['model', 'unloaded', 'urdf']


class Compensated:
    """
    A force of motors with an option to add V'(q); the parameters have a field ``gravity``.

    Parameters
    ----------
    gravity_compensation : str or None
        Model of V': that of H, that of H without a payload, or that of a URDF; None for none.
    file : str or None
        The URDF.

    Raises
    ------
    ValueError
        A file is given without ``urdf``, or the reverse.

    """

    resolve: Any
    names: Sequence[str]

    def __init__(self, gravity_compensation: GravityModelKind | None, file: str | None):
        if (gravity_compensation == 'urdf') != bool(file):
            raise ValueError('give gravity_compensation: urdf and file, the URDF, together')
        self.gravity_compensation, self.file = gravity_compensation, file

    def resolve_on(self, hamiltonian: Hamiltonian, state: EffectState) -> Any:
        """Return the result of ``resolve``, with the compensation of gravity."""
        own = self.resolve(hamiltonian.coordinates, state)
        if self.gravity_compensation is None:
            return own
        # Imported lazily: reading a scene needs no compiler.
        from hnn_vi_ros.effects.gravity_forces import compensation_of
        model = hamiltonian.gravity_model(self.gravity_compensation, self.file)
        return own._replace(gravity=compensation_of(model, self.names))
