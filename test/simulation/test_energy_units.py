# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Energies have the unit of H that follows from the coordinates, wherever they are printed."""

from types import SimpleNamespace

from hnn_vi_ros import Scene, simulate
from hnn_vi_ros.commands.cost import _lines
from hnn_vi_ros.commands.scene_tool import explain
from hnn_vi_ros.errors import AlarmWarning
from hnn_vi_ros.phase_space import energy_unit
from hnn_vi_ros.recording.viewer.rerun_blueprint import series_of
from hnn_vi_ros.run.monitor import EnergyRecord
from hnn_vi_ros.simulation import build, Choice, Tolerance
import pytest

UNIT = '(kg m/s) mm/s'


@pytest.fixture
def scene() -> Scene:
    return Scene.build(
        hamiltonian={'kind': 'formula', 'H': 'p_a^2/2 - cos(a)', 'coordinates': [
            {'name': 'a', 'q_unit': 'mm', 'p_unit': 'kg m/s'}]},
        effects=[{'kind': 'damping', 'rate': 0.1}],
        integrator='variational_euler', step_size=0.9, initial_state=([1.5], [0.0]))


def test_alarms_energies_by_cause_and_records_have_the_unit_of_h(scene):
    with pytest.warns(AlarmWarning):
        run = simulate(scene, 90.0, energy_by_cause=True)
    assert {alarm.unit for alarm in run.alarms} <= {UNIT, '1'}
    assert {alarm.unit for alarm in run.alarms if 'energy' in alarm.message} == {UNIT}
    assert run.energy_by_cause.units['error'] == run.units['H'] == UNIT
    assert EnergyRecord(build(scene), 0.9).energy_unit == UNIT


def test_labels_and_lines_have_the_unit_of_h(scene):
    hamiltonian = build(scene).hamiltonian
    assert energy_unit(hamiltonian.coordinates) == UNIT
    rows = series_of(hamiltonian, False, False, True, causes=('work/a',))
    lines = [*(one for row in rows if row.path.startswith('/energy') for one in row.names),
             next(line for line in explain(scene) if ', moves ' in line),
             next(_lines(scene, SimpleNamespace(
                 no_path='chaotic', known=SimpleNamespace(energy_scale=2.0),
                 reference=SimpleNamespace(horizon=1.0),
                 problem=SimpleNamespace(hamiltonian=build(scene).hamiltonian)), None)),
             Choice('rk4', 0.1, 1e-4, 1.0, 1e-3, 1.0, {}, 0.5, energy_unit=UNIT).explain(
                 Tolerance('energy_error', 1e-3, 1.0))]
    for line in lines:
        assert UNIT in line
