# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rows 6: cost of effects in a scene without effects, and processor time of each effect."""

from collections.abc import Callable, Iterator

from benchmarks.measurement import assert_close, Contestant, race, Row, Settings
from hnn_vi_ros.effects import (
    Effect, EFFECTS, gear_effects, LINK_WRENCH, LinkWrench, OBSERVATION, Observation)
from hnn_vi_ros.files import share_folder, shipped_file
from hnn_vi_ros.hamiltonians import DESCRIBED, ElasticDrive, Hamiltonian, HAMILTONIANS
from hnn_vi_ros.integrators import Integrator, INTEGRATORS, PhasePoint
from hnn_vi_ros.kernels import (
    by_address, compiled, compiled_loop, compiled_options, entry_point, provide_for)
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import build, Simulation
from hnn_vi_ros.simulation.assembly import advance
import numpy as np

_H = 0.01
# Long enough for the 2 % that the target resolves.
_STEPS = {'exact_pendulum': 200_000, 'pendulum': 40_000}
_ADDED_STEPS = 5_000
# Each effect with the smallest suitable system, its state and YAML options.
_SYSTEMS = {
    'line': ('free_particle', {'names': ['z']}, [1.0], [0.0]),
    'plane': ('free_particle', {'names': ['x', 'z']}, [1.0, 0.0], [0.0, 0.5]),
    'pendulum': ('pendulum', {}, [2.0], [0.0]),
    # Heavy, so that the friction of a machine of 96 kg does not stop it.
    'heavy': ('pendulum', {'mass': 10_000.0}, [2.0], [0.0]),
    'forearm': ('urdf', {'file': str(share_folder() / 'config/robots/two_joint_arm.urdf'),
                         'locked': {'shoulder': 0.0}}, [1.2], [0.0]),
}
_EFFECTS = {
    'gravity': ('plane', {'coordinate': 'z'}),
    'spring': ('plane', {'point': ['x', 'z'], 'anchor': [0.0, 0.0]}),
    'magnetic_field': ('plane', {'plane': ['x', 'z']}),
    'soft_wall': ('pendulum', {'coordinate': 'angle', 'position': -1.0}),
    'potential': ('pendulum', {'formula': 'k*angle^2/2', 'parameters': {'k': 2.0}}),
    'damping': ('pendulum', {'rate': 0.1}),
    'dry_friction': ('pendulum', {'coordinate': 'angle', 'force': 0.1}),
    'joint_friction': ('pendulum', {'damping': {'angle': 0.01}, 'friction': {'angle': 0.01}}),
    'lugre_friction': ('pendulum', {'coordinate': 'angle', 'stiffness': 10.0, 'friction': 0.1}),
    'quadratic_drag': ('pendulum', {'coordinates': ['angle'], 'coefficient': 0.1}),
    'periodic_drive': ('pendulum', {'coordinate': 'angle', 'amplitude': 0.5, 'frequency': 0.5}),
    'external_force': ('pendulum', {'coordinates': ['angle']}),
    'link_wrench': ('forearm', {'timeout': 1e9}),
    'motor': ('pendulum', {'coordinate': 'angle', 'time_constant': 0.05, 'torque_limit': 1.0,
                           'no_load_speed': 10.0}),
    'servo': ('pendulum', {'coordinates': ['angle'], 'stiffness': 20.0, 'damping': 0.1,
                           'effort_limit': 100.0, 'position': [1.0]}),
    'observer': ('pendulum', {'coordinates': ['angle'], 'gain': 1.0, 'damping': 1.0,
                              'timeout': 1e9}),
    'learned_dissipation': (
        'pendulum', {'model': str(shipped_file('model', 'harmonic_oscillator'))}),
    'learned_friction': ('heavy', {'model': str(shipped_file('model', 'emps_drive'))}),
    'thermostat': ('pendulum', {'temperature': 0.1, 'rate': 1.0}),
    'holonomic_constraint': ('plane', {'point': ['x', 'z'], 'anchor': [0.0, 0.0]}),
    'impact': ('pendulum', {'coordinate': 'angle', 'position': -1.0}),
    'joint_limits': ('pendulum', {'lower': {'angle': -1.0}, 'upper': {'angle': 2.5},
                                  'restitution': 1.0}),
}
# A motor changes the command of this effect, which is on both sides.
_BESIDE = {'motor': 'external_force'}
_SEEN = Observation(['angle'], 0.0, np.array([1.9]), np.array([0.0]))
_PUSH = LinkWrench('tool', [0.1, 0.0, 0.0], [0.0, 0.0, 0.0])
# These need this method; others are measured with the method of the paper.
_LEAPFROG = ('thermostat', 'holonomic_constraint', 'impact', 'joint_limits')


def rows(settings: Settings) -> Iterator[Row]:
    """Measure a row for each of two scenes, and one for each effect."""
    for name, steps in _STEPS.items():
        settings.say(name)
        yield _conservative(name, steps, settings)
    for kind in _EFFECTS:
        settings.say(kind)
        yield _added(kind, settings)
    settings.say('drives')
    yield _drives(settings)


def _conservative(name: str, steps: int, settings: Settings) -> Row:
    """Compare the scene, all effects installed, with its method compiled over H by hand."""
    scene = load_scene(name)
    simulation = build(scene)
    hamiltonian, method = scene.create_hamiltonian(), scene.create_integrator()
    step_bare, z = bare(hamiltonian, method, scene.step_size, simulation.q, simulation.p, steps)
    simulation.advance(steps)
    step_bare()
    assert_close(name, np.concatenate([simulation.q, simulation.p]), np.concatenate([z.q, z.p]),
                 0.0)
    return race(f'{name}, no effect listed: time per step', {
        'ours': lambda: lambda: simulation.advance(steps)}, {
        'the method alone': lambda: step_bare}, settings, target=1.02, scale=1e6 / steps,
        of_processor=True,
        note='bit-identical steps; the peer is the loop over the method and H, without scene, '
             'system or effects', miss='other work shared the processors, and repetitions differ '
             'by 0.02.')


def bare(hamiltonian: Hamiltonian, method: Integrator, h: float, q: np.ndarray, p: np.ndarray,
         steps: int) -> tuple[Callable[[], None], PhasePoint]:
    """Return a function that takes steps of a method on H without effects, and its state."""
    kernel, n = by_address(hamiltonian.kernel), q.size
    z, z1, memory = PhasePoint.empty(n), PhasePoint.empty(n), method.memory(n)
    z.q[:], z.p[:] = q, p
    kernel.gradient(kernel.parameters, z.q, z.p, z.dH_dq, z.dH_dp)
    provide_for(kernel, method.step, method.options(0, kernel.dimension))
    arguments = (compiled(method.step, method.kernel_name), kernel, h,
                 compiled_options(method.options(0, kernel.dimension)), 0, steps, z, z1, memory,
                 *np.empty((2, 1, n)), steps)
    loop = entry_point(compiled_loop(advance, kernel, method.kernel_name), *arguments)
    return lambda: loop(*arguments), z


def _added(kind: str, settings: Settings) -> Row:
    """Compare a system with one effect and the same system without."""
    both = [_BESIDE[kind]] if kind in _BESIDE else []
    return _race(_EFFECTS[kind][0], kind, [*map(_effect, both), _effect(kind)],
                 [*map(_effect, both)], settings,
                 note='; '.join(f'both sides with {name}' for name in both))


def _drives(settings: Settings) -> Row:
    """Compare a robot's joint with and without an elastic gear."""
    elbow = ElasticDrive(stiffness=30.0, rotor_inertia=2e-5, gear=50.0, damping=0.1)
    return _race('forearm', 'drives', gear_effects({'elbow': elbow}), [], settings,
                 drives={'elbow': elbow})


def _race(system: str, what: str, effects: list[Effect], others: list[Effect],
          settings: Settings, note: str = '', **constants: object) -> Row:
    """Compare a system with some effects, and constants of its H, and with others."""
    method = 'generalized_leapfrog' if what in _LEAPFROG else 'variational_euler'
    name, known, q, p = _SYSTEMS[system]

    def contestant(effects: list[Effect], constants: dict[str, object]) -> Contestant:
        hamiltonian = (HAMILTONIANS | DESCRIBED)[name](**known | constants)
        # The rotor of a gear starts with its joint.
        start = [part * (hamiltonian.dimension // len(q)) for part in (q, p)]
        simulation = Simulation(hamiltonian, INTEGRATORS[method](), _H, *start, effects)
        simulation.compile()

        def prepare() -> Callable[[], None]:
            simulation.restart(*start)
            if simulation.takes_commands:
                simulation.set_command([0.1])
            if OBSERVATION in simulation.motors.takes:
                simulation.set_command(_SEEN)
            if LINK_WRENCH in simulation.motors.takes:
                simulation.set_command(_PUSH)
            return lambda: simulation.advance(_ADDED_STEPS)
        return prepare

    return race(f'{method} on {name} with {what}: time per step', {
        'with': contestant(effects, constants)}, {'without': contestant(others, {})}, settings,
        target=None, scale=1e6 / _ADDED_STEPS, note=note, of_processor=True)


def _effect(kind: str) -> Effect:
    return EFFECTS[kind](**_EFFECTS[kind][1])
