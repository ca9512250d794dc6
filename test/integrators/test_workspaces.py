# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Workspaces of steps: what is forgotten, what outlives a step, and what is not allocated."""

from typing import NamedTuple

from effect_table import EFFECT_ROWS
from helpers import Uncompiled
from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.integrators.base import Point, PointWork
from hnn_vi_ros.integrators.step_addresses import memory_by_address
from hnn_vi_ros.integrators.workspaces import arrays_of, forget
from hnn_vi_ros.run.held_state import restore_state, state_file
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.assembly import compile_forget
import numba
import numpy as np
import pytest
import safetensors.numpy

pytestmark = pytest.mark.filterwarnings('ignore:Uncompiled is not a tanh network')
# Bags of before kept arrays of these shapes for N unknowns, whatever stood in them.
GENERAL = {'slow_start': (1,), 'increments': (3, 0), 'scale': (0,), 'unknowns': (0,),
           'newton': (0,), 'values': (4, 0), 'residuals': (4, 0), 'triangle': (4, 4)}
# Where in them stood what outlives a step, by its name today.
POINT = {'q': ('values', 0), 'p': ('values', 1), 'q_carry': ('values', 2),
         'p_carry': ('values', 3), 'dH_dq': ('residuals', 0), 'dH_dp': ('residuals', 1)}
PLACES = {'increments': ('increments', ...), 'slopes': ('increments', 0),
          'multipliers': ('newton', ...), 'clock': ('triangle', 0), 'wanted': ('triangle', 0),
          'v_q': ('values', 0), 'v_p': ('values', 1),
          **{f'state.{field}': place for field, place in POINT.items()}}


class Keeping(NamedTuple):
    """A workspace that keeps what no count goes with."""

    kept: Point


def plain(memory: tuple) -> None:
    forget(memory)


_forget = numba.njit(plain)


def by_address(memory: tuple) -> None:
    # As a step by address finds it, and one of those around it.
    _forget((memory_by_address((memory_by_address(memory[:1]), *memory[1:])),))


@pytest.mark.parametrize('run', [plain, _forget, by_address],
                         ids=['plain', 'compiled', 'by address'])
def test_forget_takes_every_count_to_zero_and_nothing_else(run):
    assert compile_forget
    for name in ('generalized_leapfrog', 'time_transformed'):
        # As wrappers leave it: with a point of their own, one that they keep, or nothing.
        point = Point.empty(2)
        memory = (*INTEGRATORS[name]().memory(2), PointWork(point), Keeping(point), ())
        for workspace in memory:
            for _, array in arrays_of('', workspace) if workspace else ():
                array[...] = 3
        run(memory)
        left = {label: array for k, workspace in enumerate(memory) if workspace
                for label, array in arrays_of(str(k), workspace)}
        counts = {label for label in left if label.endswith('.count')}
        assert len(counts) == {'generalized_leapfrog': 2, 'time_transformed': 3}[name]
        assert all((array == (0 if label in counts else 3)).all()
                   for label, array in left.items())


@pytest.mark.parametrize('name', [
    # The series of taylor are heyoka's.
    name for name, method in INTEGRATORS.items() if method.explicit and name != 'taylor'])
def test_explicit_method_allocates_nothing_for_equations(name):
    """At most four numbers a coordinate: a stage and a sum."""
    method, n = INTEGRATORS[name](), 100
    assert sum(array.size for workspace in method.memory(n) for array in workspace) <= 4 * n
    assert method.unknowns(n) == ()


def earlier(state: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return a state as bags of before kept it, with numbers of no meaning where it says none."""
    kept = {name for name in state if name.startswith('memory')}
    former = {name: array for name, array in state.items() if name not in kept}
    rng = np.random.default_rng(0)
    for place in {'.'.join(name.split('.')[:2]) for name in kept}:
        fields = {name.removeprefix(f'{place}.'): state[name]
                  for name in kept if name.startswith(f'{place}.')}
        n = max(array.shape[-1] for field, array in fields.items() if field != 'clock')
        for name, shape in GENERAL.items():
            former[f'{place}.{name}'] = rng.normal(size=[size or n for size in shape])
        former[f'{place}.count'] = fields.pop('count', np.zeros(1, dtype=np.int64))
        for field, array in fields.items():
            name, row = PLACES[field]
            former[f'{place}.{name}'][row][..., :array.shape[-1]] = array
    return former


def simulations() -> dict:
    """Return makers of a simulation for each kind of what outlives a step."""
    def plain(method: str, system: str, q: list, p: list, arguments: tuple = ()):
        return lambda _: Simulation(Uncompiled(HAMILTONIANS[system]()),
                                    INTEGRATORS[method](*arguments), 0.03, q, p,
                                    on_failure='implicit')
    rod = next(row for row in EFFECT_ROWS if 'constraint' in row.name)
    orbit = 'kepler', [1.0, 0.0], [0.0, 0.7]
    return {
        'history': plain('variational_euler', 'tao', [-3.0], [0.0]),
        'slopes': plain('gauss4', 'pendulum', [0.7], [-1.2]),
        'watch': plain('stormer_verlet', 'pendulum', [0.7], [-1.2]),
        'ahead': plain('time_transformed', *orbit),
        'controlled': plain('time_transformed', *orbit, ('stormer_verlet', 2.0, 0.75,
                                                         'integrating')),
        'multipliers': lambda folder: Simulation(
            rod.uncompiled, INTEGRATORS['implicit_midpoint'](), 0.03, rod.q, rod.p,
            rod.create(folder))}


@pytest.mark.parametrize('kind', simulations())
def test_state_of_a_bag_of_before_is_restored_to_the_bit(kind: str, tmp_path):
    make = simulations()[kind]
    whole, resumed = make(tmp_path), make(tmp_path)
    whole.advance(5)
    former = earlier(safetensors.numpy.load(state_file(whole)))
    assert any('.triangle' in name for name in former)
    restore_state(resumed, safetensors.numpy.save(
        {name: array.copy() for name, array in former.items()}), 'bag')
    assert np.array_equal(whole.record(5, 1), resumed.record(5, 1))


def test_state_of_a_bag_of_before_that_lacks_an_array_is_refused(tmp_path):
    simulation = simulations()['slopes'](tmp_path)
    former = earlier(safetensors.numpy.load(state_file(simulation)))
    del former['memory0.0.increments']
    with pytest.raises(RecordingError, match='of another simulation'):
        restore_state(simulation, safetensors.numpy.save(former), 'bag')
