# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Exact systems as priors of the family mechanical: which there are, and how they are fitted."""

from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.hamiltonians import Formula, HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.learning import EvenMotion
from hnn_vi_ros.learning.data.motions import smoothed
from hnn_vi_ros.learning.families.priors import ExactPrior
from hnn_vi_ros.learning.fit.config import MachineConfig
from hnn_vi_ros.learning.fit.model_files import describe_machine
from hnn_vi_ros.learning.tasks.machine import learn
from hnn_vi_ros.models import check_prior, exact_systems
from hnn_vi_ros.models.mechanical import MechanicalHamiltonian
from hnn_vi_ros.simulation import Simulation
from machines import driven, machine_config
from messages import misfit, refused
import numpy as np
import pytest
import torch


def test_all_exact_systems_are_priors():
    # Rigid links take the place of the first two, by parameters that motions tell. What turns in
    # space has no coordinates that a velocity is the derivative of.
    assert {'pendulum', 'double_pendulum', *exact_systems()} == {
        kind for kind, system in HAMILTONIANS.items() if not system().rotations}


@pytest.mark.parametrize('kind', exact_systems())
def test_torch_runs_the_formulas_of_the_compiled_kernel(kind):
    hamiltonian, prior = HAMILTONIANS[kind](), ExactPrior(kind)
    d = hamiltonian.dimension
    q, v = np.random.default_rng(0).uniform(0.5, 1.5, (2, 6, d))
    with torch.no_grad():
        values = prior.values()
        mass = prior.mass(torch.tensor(q), values).numpy()
        turned, slope = (part.numpy() for part in prior.slopes(*map(torch.tensor, (q, v)),
                                                               values))
    assert values.tolist() == list(prior.system.defaults.values())
    p = (mass @ v[:, :, None])[:, :, 0]
    dH_dq, dH_dp = hamiltonian.gradient(q, p)
    # H_q of the stiff springs is 2500 q.
    size = max(1.0, np.abs(dH_dq).max())
    assert np.abs(dH_dp - v).max() < 1e-13 and np.abs(dH_dq + slope).max() < 1e-13 * size
    # H_p(q, M v) = v does not change with q.
    change = hamiltonian.hessian_vector(q, p, v, turned)[1]
    assert np.abs(change).max() < 1e-12


class Quartic(Formula):
    """H = stiffness q^2 / 2 + p^4 / 4."""

    def __init__(self, stiffness: float = 1.0):
        super().__init__(['x'], 'k*x^2/2 + p_x^4/4', {'k': stiffness})


def config(prior: str, names: str = 'x', **changes) -> MachineConfig:
    return machine_config(names, 'prismatic', {'hidden': [4], 'loss': {
        'kind': 'trajectory', 'batch': 32, 'windows': [{'duration': 0.1, 'steps': 10}]}},
        **{'prior': prior, 'friction': {'coulomb': 0}} | changes)


def test_systems_that_are_not_mechanical_are_refused_in_one_line(monkeypatch):
    monkeypatch.setitem(HAMILTONIANS, 'quartic', Quartic)
    for name in ('quartic', 'nothing'):
        with misfit():
            config(name)
    with refused(ValueError):
        check_prior('nothing', ['prismatic'], [[1.0]])
    with misfit():
        config('kepler')
    with misfit():
        config('kepler', 'xy', input_map='learned')


def oscillator(seed: int) -> EvenMotion:
    """Return a driven oscillator of 1.7 kg, 12 N/m and 0.4 N s/m, every 10 ms."""
    simulation = Simulation(
        HAMILTONIANS['harmonic_oscillator'](1.7, 12.0), INTEGRATORS['implicit_midpoint'](),
        0.0025, [0.5], [0.0], [EFFECTS['external_force'](['x'], timeout=100.0),
                               EFFECTS['damping'](0.4 / 1.7)])
    t = 0.01 * np.arange(400)
    tau = 3.0 * np.sin((1.0 + seed) * t)[:, None]
    return smoothed(f'run{seed}', t, *driven(simulation, tau, 4), tau, 40.0)


@pytest.mark.parametrize('residual', [False, True])
def test_parameters_of_an_oscillator_are_found(residual):
    motions = [oscillator(seed) for seed in (1, 2)]
    settings = config('harmonic_oscillator', residual=residual)
    fitted = learn(settings, motions)
    network, losses = fitted.module, fitted.losses
    assert [*losses][:2] == ['rigid_body_forward', 'rigid_body_0.1']
    checkpoint = describe_machine(network, settings, motions, name='oscillator')
    found = checkpoint.card.mechanical.prior.values
    # The midpoint rule at 10 ms is off by (0.01 omega)^2 / 12, and the filter by more.
    assert found == pytest.approx({'mass': 1.7, 'stiffness': 12.0}, rel=0.01)
    if not residual:
        assert checkpoint.card.mechanical.friction.viscous == pytest.approx([0.4], rel=0.02)
    # The compiled model is what was fitted.
    hamiltonian = MechanicalHamiltonian(checkpoint)
    q, p = np.array([[0.3]]), np.array([[0.8]])
    with torch.no_grad():
        mass = network.masses(torch.tensor(q)).numpy()
    assert hamiltonian.gradient(q, p)[1] == pytest.approx(p / mass[0], rel=1e-13)
    expected = found['stiffness'] * q
    assert hamiltonian.gradient(q, p)[0] == pytest.approx(
        expected, rel=0.05 if residual else 1e-13)
