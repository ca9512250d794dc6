# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rows 13: freely swinging arms compared with MuJoCo; forward dynamics with Pinocchio."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import compress

from benchmarks.choosing import (
    accurate_ways, cheapest, first_good, GAUSS, largest_error, problem_of, reference_path)
from benchmarks.measurement import (
    assert_close, compare, interleave, race, Row, Settings, summarise)
from benchmarks.mujoco_arm import INTEGRATORS as PEERS, MujocoArm
from benchmarks.real_time import real_time_row
from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.hamiltonians import RigidBodyTree
from hnn_vi_ros.simulation import Simulation
import numpy as np
import pinocchio

SEED = 1
# Arms from the side, at rest. That of six joints is shipped with a fall from upright, which
# forgets six digits in 10 s: nothing could be wanted of a path there.
_ARMS = {'six_joint_arm': [0.3, 2.0, 0.6, 0.4, 0.4, 0.2], 'seven_joint_arm': None}
_DURATION, _WANTED, _SAMPLES = 10.0, 1e-6, 10
# Steps of MuJoCo: of RK4 in ratios of 2^(1/8), of its methods of first order of 1 ms to 10 us.
_COUNTS = {'RK4': [_SAMPLES * round(1000 * 2 ** (k / 8)) for k in range(35)]}
_FIRST_ORDER = [10_000, 100_000, 1_000_000]
_STEPS = 0.1 / np.array([1.0, 1.2, 1.5, 2.0, 2.7, 3.5, 5.0])
# Step of the run that checks the reference, which has half this step [s].
_REFERENCE_STEP = 0.02
# MuJoCo's own step, duration of the energy record, and its sample interval [s].
_MUJOCO_STEP, _LONG, _EVERY = 0.002, 1000.0, 0.1
# Durations of a choice and of a timed run [s], and number of repetitions.
_SHORT, _TIMED, _TURNS = 50.0, 3.0, 9
_STATES = 1000


class Arm:
    """
    An arm, ours and MuJoCo's.

    Parameters
    ----------
    name : str
        Name of its scene.

    """

    def __init__(self, name: str):
        problem = problem_of(name)
        robot = problem.hamiltonian
        assert isinstance(robot, RigidBodyTree)
        self.name, self.robot = name, robot
        self.q0 = np.array(_ARMS[name] or problem.q)
        self.problem = replace(problem, q=self.q0, p=np.zeros(self.q0.size))
        self.mujoco = MujocoArm(robot, self.q0)
        self._simulations: dict[str, Simulation] = {}

    def prepare(self, method: str, parts: int, seconds: float
                ) -> Callable[[], tuple[np.ndarray, np.ndarray]]:
        """Return a run with `parts` steps per sample; it returns q and p, shape (samples, d)."""
        h = _EVERY / parts
        if method not in self._simulations:
            self._simulations[method] = self.problem.simulation(method, h)
            self._simulations[method].compile()
        simulation = self._simulations[method]
        simulation.step_size = h
        simulation.restart(self.problem.q, self.problem.p)
        return lambda: simulation.record(round(seconds / _EVERY), parts)

    def mujoco_path(self, integrator: str, steps: int) -> Callable[[], np.ndarray]:
        """Return a run of MuJoCo's that returns q along 10 s, of shape (samples, d)."""
        run = self.mujoco.prepare(integrator, _DURATION / steps, _SAMPLES, steps // _SAMPLES)
        return lambda: run()[0]

    def band(self, q: np.ndarray, p: np.ndarray) -> float:
        """Return the largest energy error along a path [J]."""
        first = self.robot.energy(self.q0[None], np.zeros((1, self.q0.size)))
        return float(np.max(np.abs(self.robot.energy(q, p) - first)))


def rows(settings: Settings) -> Iterator[Row]:
    """Measure forward dynamics, paths and energies of each arm, and the node's speed."""
    for name in _ARMS:
        arm = Arm(name)
        settings.say(f'{name}: forward dynamics')
        yield from _dynamics_rows(arm, settings)
        settings.say(f'{name}: reference, methods and steps')
        yield _path_row(arm, settings)
        for integrator in ('Euler', 'implicitfast', 'RK4'):
            settings.say(f'{name}: energy beside {integrator}')
            yield _energy_row(arm, integrator, settings)
    settings.say('seven_joint_arm in the node')
    yield real_time_row(settings)


def _dynamics_rows(arm: Arm, settings: Settings) -> Iterator[Row]:
    """Compare q' and p' of (q, p), and q'' of them, with q'' of (q, v)."""
    d, random = arm.q0.size, np.random.default_rng(SEED)
    q, v = random.uniform(-1.0, 1.0, (2, _STATES, d))
    robot, p = arm.robot, np.einsum('mij,mj->mi', arm.robot.masses(q), v)
    model = pinocchio.buildModelFromXML(robot.robot.text)
    model.armature = robot.bodies.armature[1:].copy()
    data, nothing = model.createData(), np.zeros(d)

    def by_pinocchio() -> None:
        for one in range(_STATES):
            pinocchio.aba(model, data, q[one], v[one], nothing)

    def accelerations() -> np.ndarray:
        dH_dq, dH_dp = robot.gradient(q, p)
        # q'' = d/dt H_p along the flow.
        return robot.hessian_vector(q, p, dH_dp, -dH_dq)[1]

    ours = accelerations()
    for one in range(_STATES):
        a = pinocchio.aba(model, data, q[one], v[one], nothing)
        # Conditions of M are some 1e3.
        assert_close('accelerations', ours[one], a, 1e-10 * (1.0 + np.max(np.abs(a))))
        assert_close('accelerations of MuJoCo', arm.mujoco.acceleration(q[one], v[one]), a,
                     1e-10 * (1.0 + np.max(np.abs(a))))
    times = interleave([lambda: lambda: robot.gradient(q, p), lambda: accelerations,
                        lambda: by_pinocchio], settings.repetitions)
    told = f'{_STATES} states in one call of ours; pin.aba is called from Python for each'
    yield compare(f"{arm.name}: forward dynamics, q' and p'", times[:, 0], times[:, 2],
                  target=1.0, scale=1e6 / _STATES, peer_name='pin.aba in a loop', note=told)
    yield compare(f"{arm.name}: forward dynamics, q''", times[:, 1], times[:, 2], target=1.0,
                  scale=1e6 / _STATES, peer_name='pin.aba in a loop',
                  note=f"{told}; ours is the second derivative of H along (q', p'), which no "
                       'method needs',
                  miss='gradient and second derivative place the tree, and factorise M, one after '
                       'the other.')


def _path_row(arm: Arm, settings: Settings) -> Row:
    reference = reference_path(arm.problem, _DURATION, _SAMPLES, _REFERENCE_STEP, 0.1 * _WANTED)
    # Compare the joints only: MuJoCo has no momenta.
    reference = reference[:, :arm.q0.size]
    ways = accurate_ways(arm.problem, dict.fromkeys(GAUSS, _STEPS), reference, _DURATION, _WANTED)
    peers = {name: first_good(_COUNTS.get(name, _FIRST_ORDER), lambda steps, name=name: (
        largest_error(arm.mujoco_path(name, steps)(), reference)), _WANTED) for name in PEERS}
    return race(
        f'{arm.name}: time to a path error of {_WANTED:g} at T = {_DURATION:g}', cheapest(ways), {
            f'MuJoCo {name}': lambda name=name, steps=steps: arm.mujoco_path(name, steps)
            for name, steps in peers.items() if steps is not None},
        settings, target=0.5, scale=1e3, unit='ms', note='; '.join([
            *(f'{name}: h = {_DURATION / steps:.3g}' if steps else f'{name}: no step does'
              for name, steps in peers.items()), 'errors are the largest of all joints at each '
            'second [rad]; methods of first order are tried down to 10 us']))


def _energy_row(arm: Arm, integrator: str, settings: Settings) -> Row:
    """Compare energies at equal or smaller time per simulated second than MuJoCo's."""
    seconds = _SHORT if settings.quick else _LONG
    every = round(_EVERY / _MUJOCO_STEP)
    q, v = arm.mujoco.prepare(integrator, _MUJOCO_STEP, round(seconds / _EVERY), every)()
    theirs = arm.band(q, np.einsum('mij,mj->mi', arm.robot.masses(q), v))
    ended = '' if len(q) == round(seconds / _EVERY) else (
        f', and is unstable after {len(q) * _EVERY:g} s')
    bands: dict[tuple[str, int], float] = {}
    for key in ((method, parts) for method in GAUSS[::2] for parts in (1, 2, 3, 4, 6)):
        # The best over some seconds is also the best over more: none of these drifts.
        with suppress(StepFailure):
            bands[key] = arm.band(*arm.prepare(*key, _SHORT)())
    # In turns: all are as late as MuJoCo where the machine is.
    times = interleave([
        lambda: arm.mujoco.prepare(integrator, _MUJOCO_STEP, round(_TIMED / _EVERY), every),
        *(lambda key=key: arm.prepare(*key, _TIMED) for key in bands)], _TURNS)
    costs = 1e3 * np.median(times, axis=0) / _TIMED
    able = np.median(times[:, 1:] / times[:, :1], axis=0) <= 1.0
    key, cost = min(compress(zip(bands, costs[1:], strict=True), able), key=lambda one: bands[
        one[0]])
    band = arm.band(*arm.prepare(*key, seconds)())
    return summarise(
        f'{arm.name}: energy band over {seconds:g} s in the time of {integrator}',
        f'{band:.2g} J', f'MuJoCo {integrator} {theirs:.2g} J', band / theirs, 1.0,
        note=f'MuJoCo at its own step of {_MUJOCO_STEP:g} s takes {costs[0]:.3g} ms for '
             f'a simulated second{ended}; {key[0]} at h = {_EVERY / key[1]:.3g} {cost:.3g} ms')
