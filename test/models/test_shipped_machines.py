# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Shipped models of real machines: whose data they know, how they predict, and that they rest."""

import json
from pathlib import Path

from hnn_vi_ros import load_scene
from hnn_vi_ros.learning.families.choices import AUTO
from hnn_vi_ros.learning.fit.config import find_config, load_machine
from hnn_vi_ros.models.planar_chain import PLANAR_CHAIN
from hnn_vi_ros.simulation.construction import build
import numpy as np
import pytest
from studies.machine_tables import CASES, DEFAULT

ROOT = Path(__file__).resolve().parents[2]
# The case of each in the tables, the licence of its data, and where it hangs.
MACHINES = {
    'dfki_double_pendulum': ('real actuated double pendulum', 'BSD-3', [0.0, 0.0]),
    'multiarm_double_pendulum': ('real free double pendulum', 'MIT', [np.pi, np.pi])}


@pytest.mark.parametrize('name', MACHINES)
def test_card_tells_source_licence_and_how_it_was_made(name: str):
    card, config = load_scene(name).create_hamiltonian().checkpoint.card, \
        load_machine(find_config(name))
    assert (card.family, card.name, card.seed) == ('mechanical', name, config.seed)
    assert card.dataset.startswith(config.description) and MACHINES[name][1] in card.dataset
    assert card.training_command.startswith(f'ros2 run hnn_vi_ros train --config {name} --data ')
    assert [c.name for c in card.coordinates] == [c.name for c in config.coordinates]
    assert config.family.prior == AUTO and card.mechanical.prior.kind == PLANAR_CHAIN
    assert card.selection.chosen in [one.name for one in card.selection.candidates]
    # By the stages that the configuration has by now.
    assert card.losses.keys() >= {
        f'rigid_body_{stage.duration:g}' for stage in config.windows.windows}


@pytest.mark.parametrize('name', MACHINES)
def test_machine_is_followed_as_well_as_by_others(name: str):
    found = load_scene(name).create_hamiltonian().checkpoint.card.prediction_error
    case = MACHINES[name][0]
    references = CASES[case].references
    for horizon, rms in found.horizons.items():
        reference = references.get(f'RMS error [rad] after {horizon} s, test')
        assert reference is None or (np.array(rms) <= reference).all()
    assert found.failed == 0
    # The measure of the longest horizon that others were measured by.
    measure = next(key for key in [*references][::-1] if 'later' not in key)
    seed = load_scene(name).create_hamiltonian().checkpoint.card.seed
    runs = ROOT / 'docs' / 'evidence' / 'learning' / 'machine_runs.json'
    rows = json.loads(runs.read_text('utf-8'))
    ours = next(row['measures'][measure] for row in rows if (
        row['case'], row['model'], row['seed']) == (case, DEFAULT, seed))
    assert (np.array(ours) <= references[measure]).all()


def test_drive_is_the_physical_model_that_its_page_tells():
    scene, config = load_scene('emps_drive'), load_machine(find_config('emps_drive'))
    card = scene.create_hamiltonian().checkpoint.card
    assert card.dataset.startswith(config.description) and card.name == 'emps_drive'
    assert card.training_command.startswith(
        'ros2 run hnn_vi_ros train --config emps_drive --data emps.npz')
    assert card.mechanical.prior.kind == config.family.prior == 'free_particle'
    assert not card.mechanical.prior.alone and card.mechanical.fade[0] > 0.0
    # Half a second adds up less than the 24.8 s of the page's table, 2.82 mm.
    assert max(rms for rms, in card.prediction_error.horizons.values()) < 2.82e-3
    assert card.prediction_error.failed == 0


def test_drive_creeps_one_way_and_friction_takes_what_its_motor_gives():
    scene = load_scene('emps_drive')
    simulation = build(scene)
    places = []
    for _ in range(4):
        simulation.advance(round(2.0 / scene.step_size))
        places.append(simulation.q[0])
    # After the first period, the same way in each: the drive repeats every 2 s.
    ways = np.diff(places)
    assert (ways > 5e-3).all() and np.ptp(ways) < 1e-3
    # H is quadratic, whose change a step of implicit midpoint is the work: 8000 steps of 0.1 J
    # are rounded.
    assert abs(simulation.energy_balance) < 8000 * 0.1 * np.finfo(float).eps


@pytest.mark.parametrize('name', MACHINES)
def test_machine_swings_and_comes_to_rest_hanging(name: str):
    scene = load_scene(name)
    simulation = build(scene)
    start, fastest = simulation.energy, 0.0
    for _ in range(1000):
        simulation.advance(round(0.5 / scene.step_size))
        fastest = max(fastest, np.abs(simulation.dH_dp).max())
    # Friction that is tanh(v / w) creeps to rest, and holds no link beside its place.
    assert fastest > 0.5 and np.abs(simulation.dH_dp).max() <= 1e-3
    assert np.abs(simulation.q - MACHINES[name][2]).max() <= 0.05
    # What H lost is what friction took: the method is of order 2, with h omega of some 0.02.
    assert simulation.work < 0.0
    assert abs(simulation.energy_balance) <= 1e-3 * (start - simulation.energy)
