# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Train models of machines on slow, small or weak motions, test on the others, and reversed."""

from collections.abc import Mapping, Sequence
import json
from pathlib import Path
import tempfile
import time
from typing import Any, NamedTuple

from hnn_vi_ros.files import Parser
from hnn_vi_ros.learning import EvenMotion, ExcitationData, load_machine, read_motions
from hnn_vi_ros.learning.data.arrays import Archive
from hnn_vi_ros.learning.data.motions import train_and_test
from hnn_vi_ros.learning.families.mechanical import PlainNetwork
from hnn_vi_ros.learning.fit.config import find_config, MachineConfig
from hnn_vi_ros.learning.fit.machine import fit_network, scales_of
from hnn_vi_ros.learning.fit.machine_fit import fit_machine
from hnn_vi_ros.learning.fit.model_files import describe_machine
from hnn_vi_ros.learning.judging.evaluation import score
from hnn_vi_ros.learning.judging.predictors import Predict, predicted_by
from hnn_vi_ros.learning.tasks.selection import RIGID, selected
from hnn_vi_ros.models import PLANAR_CHAIN, save_checkpoint
import numpy as np
from studies.machine_tables import CASES, predicted

# Simulated machines: samples and substeps [s], runs of each speed and how long they are [s].
_INTERVAL, _SUBSTEPS, _RUNS, _DURATION = 0.004, 4, 4, 8.0
# Noise of positions [rad] and of velocities [rad/s].
_Q_NOISE, _V_NOISE = 3e-4, 0.02
# Friction changes its sign over this speed [rad/s].
_WIDTH = 0.03
_FALL = 9.81
# Predictions begin so often, and are followed for this long at most [s].
_EVERY, _LONGEST = 0.25, 4.0
SIMULATED, REAL = 'simulated geared arm', 'real actuated double pendulum'
# Arrays whose peaks order the runs of the real machine. The half with the smaller ones is trained
# on, or the other half.
_PEAKS = {'speed': 'dq', 'range': 'q', 'force': 'tau'}
_RISING, _BACK = 'rising', 'falling'
SPLITS = [f'{REAL}, {way} {name}' for name in _PEAKS for way in (_RISING, _BACK)] + [
    f'{SIMULATED} {k}' for k in range(3)]
MODELS: dict[str, dict[str, object] | None] = {
    'default': {'prior': 'auto'},
    'rigid body': {'prior': 'planar_chain', 'residual': False},
    'rigid body and networks, without fading': {
        'prior': 'planar_chain', 'residual': True, 'fade_weight': 1e-6},
    'rigid body and networks that fade at once': {
        'prior': 'planar_chain', 'residual': True, 'fade_weight': 0.1},
    'rigid body and networks': {'prior': 'planar_chain', 'residual': True},
    'rigid body and a network of V': {'prior': 'planar_chain', 'residual': ['potential']},
    'networks alone': {'prior': None},
    'plain network': None}
# As the shipped configuration of the simulated arm trains.
_LOSS = {'kind': 'trajectory', 'forward_lbfgs_steps': 0, 'method': 'rk4', 'batch': 64,
         'windows': [{'duration': 0.1, 'steps': 120},
                     {'duration': 0.25, 'steps': 50, 'learning_rate': 0.003}]}


class Machine(NamedTuple):
    """
    An arm of two links with a geared motor at each joint; angles are relative, and it hangs.

    Parameters
    ----------
    inertia : np.ndarray, shape (2,)
        J1 + m1 c1^2 + m2 l1^2 and J2 + m2 c2^2 [kg m2].
    coupling : float
        m2 l1 c2 [kg m2].
    gravity : np.ndarray, shape (2,)
        m1 c1 + m2 l1 and m2 c2, times g [N m].
    rotor, gear : float
        Inertia of the rotor of the elbow [kg m2], and the ratio of its gear.
    viscous, coulomb : np.ndarray, shape (2, 2)
        Friction of each joint, in the first row where it goes ahead, in the second where back.
    ripple : float
        Amplitude of the torque by which the gear of the elbow ripples, 12 times a turn [N m].

    """

    inertia: np.ndarray
    coupling: float
    gravity: np.ndarray
    rotor: float
    gear: float
    viscous: np.ndarray
    coulomb: np.ndarray
    ripple: float

    @classmethod
    def of(cls, number: int) -> 'Machine':
        """Return one of the machines."""
        rng = np.random.default_rng(100 + number)
        m1, m2, l1, l2 = rng.uniform([0.8, 0.4, 0.3, 0.25], [1.6, 0.8, 0.45, 0.4])
        c1, c2 = 0.5 * l1, 0.5 * l2
        inertia = np.array([m1 * l1**2 / 3.0 + m2 * l1**2, m2 * l2**2 / 3.0])
        sides = rng.uniform(0.7, 1.3, size=(2, 2, 2))
        return cls(inertia, m2 * l1 * c2, _FALL * np.array([m1 * c1 + m2 * l1, m2 * c2]),
                   rng.uniform(0.5e-5, 2e-5), rng.uniform(20.0, 40.0),
                   np.array([0.15, 0.06]) * sides[0], np.array([0.25, 0.12]) * sides[1],
                   rng.uniform(0.02, 0.06))

    def accelerations(self, q: np.ndarray, v: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """Return dv/dt, of the shape (N, 2) of all that it depends on."""
        (I1, I2), c, (g1, g2), J, n = (
            self.inertia, self.coupling, self.gravity, self.rotor, self.gear)
        bend, slope = c * np.cos(q[:, 1]), c * np.sin(q[:, 1])
        a, b, d = I1 + I2 + 2.0 * bend + J, I2 + bend + n * J, I2 + n**2 * J
        low = g2 * np.sin(q.sum(axis=1))
        ahead = 0.5 * (1.0 + np.tanh(v / _WIDTH))
        rubs = (ahead * self.viscous[0] + (1.0 - ahead) * self.viscous[1]) * v + (
            ahead * self.coulomb[0] + (1.0 - ahead) * self.coulomb[1]) * np.tanh(v / _WIDTH)
        force = tau - rubs
        f = force[:, 0] + slope * v[:, 1] * (2.0 * v[:, 0] + v[:, 1]) - g1 * np.sin(q[:, 0]) - low
        h = force[:, 1] - slope * v[:, 0]**2 - low - self.ripple * np.sin(12.0 * q[:, 1])
        return np.stack([d * f - b * h, a * h - b * f], axis=1) / (a * d - b * b)[:, None]


def write_machine(path: Path, number: int) -> None:
    """
    Write motions of a machine to an .npz file: runs slow_0, ..., and fast_0, ... twice as fast.

    Its motors follow sums of sines. Each torque acts one sample later than it is logged,
    and is held; positions and velocities have noise.
    """
    machine, rng = Machine.of(number), np.random.default_rng(number)
    speed = np.repeat([1.0, 2.0], _RUNS)[:, None]
    size = rng.uniform(0.2, 0.6, size=(3, 2 * _RUNS, 2))
    rate = 2.0 * np.pi * rng.uniform(0.2, 0.9, size=(3, 2 * _RUNS, 2)) * speed
    phase = rng.uniform(0.0, 2.0 * np.pi, size=(3, 2 * _RUNS, 2))
    stiff = 60.0 * np.array([machine.inertia.sum(), machine.inertia[1] + machine.gear**2
                             * machine.rotor])
    q, v = np.zeros((2, 2 * _RUNS, 2))
    acts, found = np.zeros_like(q), []
    h = _INTERVAL / _SUBSTEPS
    for t in _INTERVAL * np.arange(round(_DURATION / _INTERVAL)):
        angle = rate * t + phase
        wanted, rates = (size * np.sin(angle)).sum(axis=0), (size * rate * np.cos(angle)).sum(0)
        tau = stiff * (wanted - q) + 0.15 * stiff * (rates - v)
        found.append(np.stack([q, v, tau]))
        for _ in range(_SUBSTEPS):
            q, v = step(machine, q, v, acts, h)
        acts = tau
    t = _INTERVAL * np.arange(len(found))
    every = np.array(found)
    every[:, 0] += _Q_NOISE * rng.normal(size=every[:, 0].shape)
    every[:, 1] += _V_NOISE * rng.normal(size=every[:, 1].shape)
    runs: dict[str, Any] = {}
    for k in range(2 * _RUNS):
        name = f'{"slow" if k < _RUNS else "fast"}_{k % _RUNS}'
        runs |= {f'{name}/t': t} | {f'{name}/{key}': every[:, j, k]
                                    for j, key in enumerate(('q', 'dq', 'tau'))}
    np.savez(path, **runs)


def step(machine: Machine, q: np.ndarray, v: np.ndarray, tau: np.ndarray, h: float
         ) -> tuple[np.ndarray, np.ndarray]:
    """Return q and v after a step of the classical method of order 4."""
    a1 = machine.accelerations(q, v, tau)
    a2 = machine.accelerations(q + 0.5 * h * v, v + 0.5 * h * a1, tau)
    a3 = machine.accelerations(q + 0.5 * h * v + 0.25 * h**2 * a1, v + 0.5 * h * a2, tau)
    a4 = machine.accelerations(q + h * v + 0.5 * h**2 * a2, v + h * a3, tau)
    return q + h * v + h**2 / 6.0 * (a1 + a2 + a3), v + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)


def runs_for_test(case: str, arrays: Mapping[str, np.ndarray]) -> list[str]:
    """Return the runs of a case to test on: those with the largest, or smallest, peaks."""
    *_, way, quantity = [_RISING, 'speed'] if SIMULATED in case else case.split()
    peak = {key.partition('/')[0]: float(np.abs(values).max()) for key, values in arrays.items()
            if key.endswith(f'/{_PEAKS[quantity]}')}
    return sorted(peak, key=peak.__getitem__, reverse=way == _BACK)[len(peak) // 2:]


def motions_of(case: str, data: Path
               ) -> tuple[MachineConfig, list[EvenMotion], list[EvenMotion], str]:
    """Return configuration, training motions, test motions and description of a case."""
    config = load_machine(find_config('dfki_double_pendulum'))
    names = [coordinate.name for coordinate in config.coordinates]
    with tempfile.TemporaryDirectory() as folder:
        if case.startswith(REAL):
            file = data / 'dfki_double_pendulum' / 'sysid.npz'
        else:
            file = Path(folder) / 'machine.npz'
            write_machine(file, int(case.split()[-1]))
            config = MachineConfig.model_validate(config.model_dump(exclude_unset=True) | {
                'loss': _LOSS, 'learning_rate': 0.03,
                'data': {'kind': 'arrays', 'inputs': 'held'}})
        arrays = Archive(file).arrays
        tested = runs_for_test(case, arrays)
        assert not isinstance(config.data, ExcitationData), 'they are read'
        motions, text = read_motions(file, config.data, names, [str(file)])
    return config, *train_and_test(motions, tested), text


def measure(case: str, model: str, seed: int, data: Path) -> dict[str, Any]:
    """Return the errors of a model of a case, and the minutes that it took of a processor."""
    config, train, test, text = motions_of(case, data)
    config, begin = config.model_copy(update={'seed': seed}), time.process_time()
    family = MODELS[model]
    if family is None:
        plain = PlainNetwork([coordinate.kind for coordinate in config.coordinates],
                             config.hidden, scales_of(train), seed)
        predict = predicted_by(fit_network(plain, config, train).module)
        found = _judged(predict, test)
    else:
        config = config.model_copy(update={'family': config.family.model_copy(update=family)})
        config, selection = selected(config, train)
        found = _trained(config, train, test, text)
        if selection is not None:
            found['chosen'] = selection.chosen
            found['rigid body with its friction'] = found['rms'] if selection.chosen == RIGID \
                else _trained(config.model_copy(update={'family': config.family.model_copy(
                    update={'prior': PLANAR_CHAIN, 'residual': False})}), train, test, text)['rms']
    return {'case': case, 'model': model, 'seed': seed, **found,
            'minutes': (time.process_time() - begin) / 60.0}


def _trained(config: MachineConfig, train: Sequence[EvenMotion], test: Sequence[EvenMotion],
             text: str) -> dict[str, Any]:
    """Return the errors of a model that is trained on these motions."""
    fitted = fit_machine(config, train)
    checkpoint = describe_machine(
        fitted.module, config, train, text, fitted.losses, 'beyond_data')
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / 'model.safetensors'
        save_checkpoint(file, checkpoint)
        return _judged(predicted(CASES[REAL], file, checkpoint, train), test)


def _judged(predict: Predict, test: Sequence[EvenMotion]) -> dict[str, Any]:
    found = score(predict, test, [0.1, 0.5], _EVERY, _LONGEST)
    return {'rms': {f'{horizon:g}': rms.tolist() for horizon, rms in found.horizons.items()},
            'followed': found.valid_prediction_time}


def parser() -> Parser:
    """Return the parser of the command line."""
    found = Parser('beyond_data', __doc__, [
        "make study NAME=beyond_data ARGS='--data ../data --seeds 0'"])
    found.add_argument('--data', type=Path, default=Path(), metavar='DIR',
                       help='folder of the data sets')
    found.add_argument('--cases', nargs='+', default=SPLITS, choices=SPLITS,
                       help='data sets to learn (default: all)')
    found.add_argument('--models', nargs='+', default=[*MODELS], choices=[*MODELS],
                       help='models to train (default: all)')
    found.add_argument('--seeds', nargs='+', type=int, default=[0, 1, 2],
                       help='seeds of the networks (default: 0 1 2)')
    found.add_argument('--out', type=Path, default=Path('beyond_data.jsonl'), metavar='FILE',
                       help='results; a line is added for each missing model')
    return found


def main(argv: Sequence[str]) -> None:
    """Measure the selected models, and print a line for each model and seed."""
    given = parser().parse_args(argv)
    done = [json.loads(line) for line in given.out.read_text('utf-8').splitlines()] \
        if given.out.is_file() else []
    known = {(run['case'], run['model'], run['seed']) for run in done}
    for seed in given.seeds:
        for case in given.cases:
            for model in given.models:
                # Least squares know no seed.
                if (case, model, seed) in known or (model == 'rigid body'
                                                    and seed != given.seeds[0]):
                    continue
                run = measure(case, model, seed, given.data)
                with given.out.open('a', encoding='utf-8') as file:
                    file.write(json.dumps(run) + '\n')
                print(json.dumps(run), flush=True)
