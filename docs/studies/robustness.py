# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Count the starts from which control tasks succeed although the machine is not the model.

The axes are from RealAIGym (F. Wiebe et al., Open source dual-purpose acrobot and pendubot
platform, 2023): noise and delay of measurements, late torques, and pushes. Simulated time waits
for plans. A start is a success if all angles stay upright in the last two seconds.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

from hnn_vi_ros.control import assign, momentum
from hnn_vi_ros.files import Parser
from hnn_vi_ros.run import joint_sensor, JointReading
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import build
import numpy as np

TASKS = 'swing_up', 'cart_pole', 'acrobot', 'pendubot'
# Upright within [rad], through the end of a run [s]; duration of pushes, mean time between [s].
CLOSE, END, PUSH, BETWEEN = 0.1, 2.0, 0.1, 1.0


class Axis(NamedTuple):
    """Differences from the model: keys of the sensor, a lag [s], pushes as share of the limit."""

    name: str
    sensor: dict[str, float] = {}
    lag: float = 0.0
    push: float = 0.0


AXES = (
    Axis('none'),
    Axis('noise 2 mrad, 20 mrad/s', {'noise': 0.002, 'velocity_noise': 0.02}),
    Axis('noise 10 mrad, 100 mrad/s', {'noise': 0.01, 'velocity_noise': 0.1}),
    Axis('delay 10 ms', {'delay': 0.01}), Axis('delay 30 ms', {'delay': 0.03}),
    Axis('torque late by 10 ms', lag=0.01), Axis('torque late by 50 ms', lag=0.05),
    Axis('pushes of half the limit', push=0.5), Axis('pushes of twice the limit', push=2.0),
)


def succeeds(task: str, axis: Axis, seed: int, duration: float) -> bool:
    """Run a task from a start that chance chooses; return True if it ends upright."""
    ready, rng = assign(task, lockstep=True), np.random.default_rng(seed)
    (driven, limit), = ready.task.inputs.items()
    effects: list[dict[str, Any]] = [{
        'kind': 'external_force', 'coordinates': [driven], 'timeout': 1.0}]
    scene = load_scene(ready.task.scene)
    effects = [one for one in scene.model_dump(by_alias=True)['effects']
               if one['kind'] != 'external_force'] + effects
    if axis.lag:
        effects.append({'kind': 'motor', 'coordinate': driven, 'time_constant': axis.lag})
    scene = scene.changed({
        'effects': effects, 'integrator': {'kind': 'implicit_midpoint'},
        'measurements': {'joint_states': axis.sensor | {'seed': seed}}})
    d = len(ready.hamiltonian.coordinates)
    q = rng.uniform(-np.pi, np.pi, d) * [one.q_unit == 'rad' for one in (
        ready.hamiltonian.coordinates)]
    simulation = build(scene)
    simulation.restart(q, momentum(ready.scene, q, rng.uniform(-1.0, 1.0, d)))
    every = round(ready.task.period / scene.known_step_size)
    sensor = joint_sensor(scene, simulation, every)
    samples = round(duration / ready.task.period)
    # Pushes end before the time in which the angles are judged.
    pushes = np.cumsum(rng.exponential(BETWEEN, samples))
    sizes = axis.push * limit * rng.choice([-1.0, 1.0], samples)
    command, worst = np.zeros(1), 0.0
    upright = np.array([np.pi, *np.zeros(d - 1)]) if driven != 'cart' else np.array([0.0, np.pi])
    for _ in range(samples):
        t = simulation.time
        reading = sensor.measure(simulation.steps, JointReading(
            simulation.q.copy(), simulation.dH_dp.copy(), np.zeros(d)))
        if reading is not None:
            command = ready.controller(reading.position, reading.velocity, t)
        last = np.searchsorted(pushes, t, 'right') - 1
        pushed = 0 <= last and t < min(pushes[last] + PUSH, duration - 2.0 * END)
        simulation.set_command(command + sizes[last] * pushed)
        simulation.advance(every)
        if t > duration - END:
            off = (simulation.q - upright + np.pi) % (2.0 * np.pi) - np.pi
            worst = max(worst, float(np.abs(off).max()))
    return worst < CLOSE


def main(argv: Sequence[str]) -> None:
    """Print a row for each axis, and a column for each task."""
    options = parser().parse_args(argv)
    print(f'| differs from the model | {" | ".join(options.task)} |')
    print('|---|' + '---:|' * len(options.task))
    for axis in AXES:
        found = [sum(succeeds(task, axis, seed, options.duration)
                     for seed in range(options.starts)) for task in options.task]
        print(f'| {axis.name} | '
              + ' | '.join(f'{one} of {options.starts}' for one in found) + ' |', flush=True)


def parser() -> Parser:
    """Return the parser of the command line."""
    found = Parser('robustness', __doc__, [
        "make study NAME=robustness ARGS='--task swing_up acrobot --starts 20'"])
    found.add_argument('--task', nargs='+', default=['swing_up', 'cart_pole'], choices=TASKS,
                       help='tasks to start (default: swing_up cart_pole)')
    found.add_argument('--starts', type=int, default=20, help='starts of each task (default: 20)')
    found.add_argument('--duration', type=float, default=10.0,
                       help='simulated time of a start [s] (default: 10)')
    return found
