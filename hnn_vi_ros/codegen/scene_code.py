# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Object code of a scene: its compiled step, and the memory that it needs."""

from collections.abc import Callable, Iterator, Sequence
from hashlib import sha256
import math
import re
from typing import NamedTuple

from hnn_vi_ros.codegen.arguments import HOST
from hnn_vi_ros.codegen.entries import (
    CommandTable, EFFORTS, EventTable, INTERNAL, Machine, OutputTable, POSITIONS, symbols,
    VELOCITIES)
from hnn_vi_ros.codegen.image import Image, image_of
from hnn_vi_ros.codegen.parameters import Parameter, parameters_of
from hnn_vi_ros.effects import (
    EFFORT, Force, LARGEST, LINK_WRENCH, NUMBERS, OBSERVATION, POSITION, VELOCITY)
from hnn_vi_ros.errors import UnsupportedSystem
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.integrators import PhasePoint
from hnn_vi_ros.kernels import Block, block, object_code, type_of
from hnn_vi_ros.models import domain_of
from hnn_vi_ros.phase_space import column_units, columns, energy_unit
from hnn_vi_ros.scene import Condition, Scene
from hnn_vi_ros.simulation import build, resolve, Simulation
import numpy as np


_EFFORT_UNITS = {'rad': 'N m', 'm': 'N'}
# Place of the digest in object files.
_DIGEST = sha256(b'digest').digest()[:8]


class Variable(NamedTuple):
    """Name, unit and description of a number that goes in or out."""

    name: str
    unit: str
    text: str


class SceneCode(NamedTuple):
    """
    Object code of a scene.

    Parameters
    ----------
    scene : Scene
        The scene, with a method and a step size.
    code : bytes
        Object file.
    image : Image
        Initial contents of a state.
    inputs, outputs : list of Variable
        Numbers of a command, and outputs, in order.
    starts : list of (Variable, float)
        Initial q and p; empty if they cannot be chosen one by one.
    parameters : list of Parameter
        Numbers of the scene, those that can be changed first.
    machine : Machine
        The memory that the image copies.
    target : str
        System that runs the code.

    """

    scene: Scene
    code: bytes
    image: Image
    inputs: list[Variable]
    outputs: list[Variable]
    starts: list[tuple[Variable, float]]
    parameters: list[Parameter]
    machine: Machine
    target: str


def compile_scene(scene: Scene, name: str, target: str = HOST,
                  begin: Callable[[], None] = lambda: None) -> SceneCode:
    """
    Return the object code of a scene.

    Parameters
    ----------
    scene : Scene
        Scene of one trajectory.
    name : str
        Prefix of the exported functions, an identifier of C.
    target : str, optional
        System that runs the code; see object_code.
    begin : callable, optional
        Called when nothing is refused, before the code is compiled.

    Raises
    ------
    UnsupportedSystem
        The scene contains what has no compiled step; the message names it.

    """
    parts = resolve(scene)
    simulation = build(parts)
    _check(parts.scene, simulation)
    start = [*simulation.q.tolist(), *simulation.p.tolist()]
    conditions = [Condition(event.when) for event in parts.scene.events]
    events = _events(simulation, parts.scene, conditions)
    begin()
    inputs, wanted = _inputs(simulation)
    shared = simulation.shared()
    z, z1 = shared[4:6]
    outputs, given, motors = _outputs(simulation, z, z1, events, conditions)
    names = distinct([one.name for one in given])
    given = [one._replace(name=name) for one, name in zip(given, names, strict=True)]
    machine = Machine._make([*shared, np.empty((0, z.q.size)), inputs, outputs, events])
    words = block(machine)
    found = symbols(type_of(machine), machine.fallbacks, motors, [
        condition.function(simulation.hamiltonian) for condition in conditions])
    image = image_of(Block.of(words))
    parameters = parameters_of(parts, simulation, Block.of(words), image)
    text = '\n'.join(_assembly(name, image, found, [one for one in parameters if one.powers]))
    code = object_code(text, [*found.values(), *image.entries.values()],
                       target.split('-')[0])
    # Saved states are those of this code: H of the same numbers may differ in it alone.
    code = code.replace(_DIGEST, sha256(code).digest()[:len(_DIGEST)])
    bound = simulation.system.constraints is not None or simulation.hamiltonian.rotations
    starts = [] if bound else [
        (Variable(f'initial_{one.name}', one.unit, f'initial {one.text}'), value)
        for one, value in zip(given, start, strict=False)]
    return SceneCode(parts.scene, code, image, wanted, given, starts, parameters, machine,
                     target)


def distinct(names: list[str]) -> list[str]:
    """Return names, those that occur again later with a number."""
    # The last ones, such as time and energy, keep theirs whatever coordinates are called.
    return [f'{name}_{names[k:].count(name)}' if name in names[k + 1:] else name
            for k, name in enumerate(names)]


def _check(scene: Scene, simulation: Simulation) -> None:
    """Raise UnsupportedSystem for parts that the compiled step lacks."""
    system, motors = simulation.system, simulation.motors
    compiled = system.kernel.compiled and system.integrator.compiled
    for key, refused, what, remedy in (
            ('measurements', scene.measurements, 'measurements are', 'remove them'),
            ('energy_by_cause', scene.energy_by_cause, 'the energy by cause is', 'remove it'),
            ('integrator', not compiled, f'{scene.integrator.kind} with this H is',
             'use another integrator, or a compiled H'),
            ('effects', any(getattr(effect, 'delay', 0.0)
                            or getattr(effect, 'rate_limit', math.inf) < math.inf
                            for effect, _ in motors.effects),
             'commands with a delay or a rate limit are', 'remove it'),
            ('effects', OBSERVATION in motors.takes, 'observations are', 'remove the observer'),
            ('effects', LINK_WRENCH in motors.takes, 'commands of link_wrench are', 'remove it')):
        if refused:
            raise UnsupportedSystem(f'{scene.place(key)}: {what} not part of the compiled step, '
                                    f'and cannot be exported; {remedy}')


def _events(simulation: Simulation, scene: Scene, conditions: Sequence[Condition]) -> EventTable:
    """Return the events of a scene at its initial state, or raise SceneError."""
    for k, condition in enumerate(conditions):
        with scene.placed('events', k):
            condition.check(simulation.hamiltonian)
    directions = [('down', 'both', 'up').index(event.direction) - 1 for event in scene.events]
    before = [float(condition.values(simulation.hamiltonian, simulation.q, simulation.p, 0.0))
              for condition in conditions]
    return EventTable(np.array(directions, dtype=np.int64), np.array(before),
                      *np.zeros((2, len(before))))


def _inputs(simulation: Simulation) -> tuple[CommandTable, list[Variable]]:
    """Return the numbers of a command; see Simulation.set_command."""
    rows: list[tuple[int, int, float, float]] = []
    names, timeout, state = list[Variable](), np.inf, simulation.system.effect_state
    coordinates = simulation.hamiltonian.coordinates
    units = dict(zip(columns(coordinates)[0], column_units(coordinates)[0], strict=True))
    for effect, own in simulation.motors.effects:
        for k, column in enumerate(own.columns.tolist()):
            label = effect.names[k] if effect.names else str(k + 1)
            unit = units.get(label, '1')
            if NUMBERS in effect.takes:
                timeout = effect.timeout
                rows.append((EFFORTS, column, -LARGEST, LARGEST))
                names.append(Variable(f'{EFFORT}_{label}', _EFFORT_UNITS.get(unit, '1'),
                                      f'commanded effort of {label}'))
            else:
                low, high = simulation.motors.limits(label)
                rows += [(POSITIONS, column, max(low, -LARGEST), min(high, LARGEST)),
                         (VELOCITIES, column, -LARGEST, LARGEST)]
                names += [Variable(f'{POSITION}_{label}', unit, f'commanded position of {label}'),
                          Variable(f'{VELOCITY}_{label}', f'{unit}/s',
                                   f'commanded velocity of {label}')]
    table = np.array(rows, dtype=np.float64).reshape(-1, 4).T
    kinds, places = table[:2].astype(np.int64)
    return CommandTable(
        kinds, places, table[2].copy(), table[3].copy(), float(timeout), state), names


def _outputs(simulation: Simulation, z: PhasePoint, z1: PhasePoint, events: EventTable,
             conditions: Sequence[Condition]) -> tuple[OutputTable, list[Variable], list[type]]:
    """Return the sources of the outputs, their names, and the classes of the motors' effects."""
    coordinates, system = simulation.hamiltonian.coordinates, simulation.system
    (q_names, p_names), (q_units, p_units) = columns(coordinates), column_units(coordinates)
    units = dict(zip(q_names, q_units, strict=True))
    rows: list[tuple[Variable, int, int, float, float]] = []

    def add(source: int, index: int, *words: str, factor: float = 1.0, offset: float = -0.0
            ) -> None:
        # -0.0 + x is x for all x.
        rows.append((Variable(*words), source, index, factor, offset))
    for k, name in enumerate(q_names):
        add(0, k, name, units[name], f'coordinate {name}')
    for k, name in enumerate(p_names):
        add(1, k, f'{name}_momentum', p_units[k], f'conjugate momentum of {name}')
    for k, name in enumerate(p_names):
        unit = units.get(name, 'rad')
        add(2, k, f'{name}_velocity', f'{unit}/s', f'velocity of {name}')
        add(3, k, f'{name}_effort', _EFFORT_UNITS.get(unit, '1'), f'force of commands on {name}')
    for leader, one in ((c.name, one) for c in coordinates for one in c.followers):
        k = q_names.index(leader)
        add(0, k, one.name, units[leader], f'follows {leader}', factor=one.multiplier,
            offset=one.offset)
        add(2, k, f'{one.name}_velocity', f'{units[leader]}/s', f'follows {leader}',
            factor=one.multiplier)
    unit = energy_unit(coordinates)
    totals = [('gradients', '1', "gradients of H and products with H'' so far"),
              ('residual', '1', 'residual of the last implicit step'),
              ('energy', unit, 'H(q, p)'),
              ('initial_energy', unit, 'H at the start'),
              ('energy_error', unit, 'H minus its initial value and all works'),
              ('outside_domain', '1', 'distance from the domain of the training data in its '
                                      'half-widths, 0 inside or without one'),
              ('rescued_steps', '1', 'steps so far that on_failure has taken'),
              *((f'work_{label}', unit, f'work of {label}') for label in system.labels)]
    add(4, 0, 'time', 's', 'simulated time', factor=simulation.step_size)
    for k, words in enumerate(totals, 1):
        add(4, k, *words)
    for k, condition in enumerate(conditions):
        add(5, k, f'event_{k + 1}', '1', f'number of events so far: {condition.text}')
    forces = [(type(effect), own) for effect, own in simulation.motors.effects
              if isinstance(effect, Force)]
    table = np.array([row[1:] for row in rows])
    keeps, space, total = system.integrator.keeps_gradient, np.zeros((2, len(q_names))), np.zeros(
        len(totals) + 1)
    total[4] = simulation.energy
    domain, source = _domain(simulation.hamiltonian)
    return OutputTable(
        len(q_names), len(p_names), (
            z.q, z.p, (z if keeps else z1).dH_dp, space[1], total, events.counts),
        table[:, :2].astype(np.int64), table[:, 2:].copy(), total, domain, source,
        (*(own for _, own in forces), (), ())[:2], space, int(keeps)), [row[0] for row in rows], [
            kind for kind, _ in forces]


def _domain(hamiltonian: Hamiltonian) -> tuple[np.ndarray, int]:
    """Return the domain of a model, and what its second half is about; see OutputTable."""
    known = domain_of(hamiltonian)
    if known is not None:
        return np.array(known.bounds), 2
    if hamiltonian.box is None or hamiltonian.gauge is not None:
        return np.empty((4, 0)), 1
    low, high = np.concatenate(hamiltonian.box).T
    return np.array([low, high, 0.5 * (high - low), np.zeros(low.size)]), 1


def _assembly(name: str, image: Image, found: dict[str, str], tuned: list[Parameter]
              ) -> Iterator[str]:
    """Yield LLVM's assembly of the exported functions, which call the entries by symbol."""
    called = list(image.entries.items())
    powers = sorted((word, k) for k, one in enumerate(tuned) for word in one.powers)
    rows = [(word, image.words[word:word + 1].view(np.float64)[0], k, tuned[k].value,
             tuned[k].powers[word]) for word, k in powers]
    tables = {'image': _words(image.packed()),
              'pointers': _words(image.pointers.astype(np.int32).tobytes()),
              'places': [place for place, _ in called],
              'lows': np.array([one.low for one in tuned]).view(np.int64).tolist(),
              'powers': np.array(rows, dtype=np.float64).ravel().view(np.int64).tolist(),
              'digest': np.frombuffer(_DIGEST, dtype=np.int64).tolist(),
              'entries': [f'ptrtoint (ptr @"{symbol}" to i64)' for _, symbol in called]}
    for table, words in tables.items():
        listed = ', '.join(f'i64 {word}' for word in words)
        yield f'@{table} = internal constant [{len(words)} x i64] [{listed}], align 64'
    for symbol in dict.fromkeys(image.entries.values()):
        yield f'declare i32 @"{symbol}"()'
    place = {table: f'ptrtoint (ptr @{table} to i64)' for table in tables}
    size, start = image.words.size, '%start'
    for function, *arguments in (
            ('init', '%0', place['image'], size, place['pointers'], image.pointers.size,
             place['places'], place['entries'], len(called)),
            ('save', '%0', '%1', image.changing, size, place['digest']),
            ('restore', '%0', '%1', image.changing, size, place['digest']),
            ('step', start, '%1', '%n'), ('start', start, '%1', '%2'), ('energy', start),
            ('tune', '%0', size, start, '%1', place['lows'], len(tuned), place['powers'],
             len(rows)),
            ('outputs', start, '%1')):
        yield _function(f'{name}_{function}', found[function], 8 * image.start,
                        [str(argument) for argument in arguments],
                        'double' if function == 'energy' else 'i64')


def _words(content: bytes) -> list[int]:
    """Return bytes as words of 64 bits, the last with zeros at its end."""
    return [*np.frombuffer(content + bytes(-len(content) % 8), dtype=np.int64).tolist()]


def _function(name: str, symbol: str, start: int, arguments: list[str], result: str) -> str:
    """Return a function of C, with pointers as arguments, that calls a compiled function."""
    pointers = [k for k in range(3) if f'%{k}' in arguments or (k == 0 and '%start' in arguments)]
    taken = [f'ptr %p{k}' for k in pointers] + ['i64 %n'] * ('%n' in arguments)
    passed = ', '.join('i64 ' + re.sub(r'^%(\d)$', r'%i\1', one) for one in arguments)
    numbers = [f'  %i{k} = ptrtoint ptr %p{k} to i64' for k in pointers]
    # The result, or what a failed call gives instead.
    shown, end, failed = ('double', '', '0x7FF8000000000000') if result == 'double' else (
        'i32', 'trunc i64 %value to i32', str(INTERNAL))
    end = f'  %out = {end or "fadd double %value, -0.0"}'
    return '\n'.join([
        f'declare i32 @"{symbol}"(ptr, ptr{", i64" * len(arguments)})',
        f'define {shown} @{name}({", ".join(taken)}) {{',
        f'  %result = alloca {result}', '  %problem = alloca ptr', *numbers,
        f'  %start = add i64 %i0, {start}',
        f'  %status = call i32 @"{symbol}"(ptr %result, ptr %problem, {passed})',
        f'  %value = load {result}, ptr %result', end, '  %ok = icmp eq i32 %status, 0',
        f'  %shown = select i1 %ok, {shown} %out, {shown} {failed}', f'  ret {shown} %shown',
        '}'])
