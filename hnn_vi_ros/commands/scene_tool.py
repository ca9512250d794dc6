# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Write, check, explain and compile scenes, and print their JSON schema."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice, product
import math
import sys
from typing import Any, TYPE_CHECKING
import warnings

from hnn_vi_ros.commands import arguments
from hnn_vi_ros.effects import Commanded
from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.files import json_schema, shipped_names
from hnn_vi_ros.phase_space import column_units, columns, Coordinate, energy_unit
from hnn_vi_ros.scene import AutoChoice, lacks_a_model, load_scene, Scene
import numpy as np

if TYPE_CHECKING:
    from hnn_vi_ros.run import EffectCosts
    from hnn_vi_ros.simulation import Simulation, Trajectory

# What learned H of one and of more coordinates without effects need, whatever their networks are;
# one Gauss method needs what all others do.
_NETWORKS = 'pendulum', 'double_pendulum'
_METHODS = 'generalized_leapfrog', 'gauss4', 'dop853', 'rk4'
# Share of the time of a step by which one without an effect may seem longer.
_DIFFERS = 0.1
# Turns from which an angle at the start is told: it may have been meant in degrees.
_MOST_TURNS = 2.0

# The simulation is imported lazily, so that lists and schemas are shown immediately.

# Number of steps over which neighbouring trajectories are followed; fewer if H is plain Python.
_LYAPUNOV_STEPS, _PLAIN_LYAPUNOV_STEPS = 2 ** 16, 2 ** 12


def main(argv: list[str]) -> int:
    """Run the selected option; return 1 if a scene is not valid."""
    parser = arguments.scene()
    options = parser.parse_args(argv)
    if options.new:
        from hnn_vi_ros.commands.new_scene import write_new
        return write_new(options, parser)
    if options.file is not None:
        parser.error(f'choose an action for {options.file}: --explain, --check, --compile or '
                     '--new')
    if options.no_rescue and options.compile is None:
        parser.error('--no-rescue needs --compile')
    for name in ('like', 'formula', 'robot', 'force'):
        if getattr(options, name):
            parser.error(f'--{name} needs --new')
    if options.check:
        return check(options.check)
    if options.compile is not None:
        return compile_all(options.compile, not options.no_rescue)
    lines: Iterable[str]
    if options.schema:
        lines = [json_schema(Scene, 'A scene of hnn_vi_ros')]
    elif options.explain is not None:
        lines = explain(load_scene(options.explain))
    else:
        parser.error('choose an action: --explain, --check, --compile, --schema or --new')
    for line in lines:
        print(line, flush=True)
    return 0


def check(names: Sequence[str]) -> int:
    """Print one line per scene: a summary, or on standard error the problem."""
    from hnn_vi_ros.run import ensemble_card, joint_sensor
    from hnn_vi_ros.simulation import build, resolve, watched
    status = 0
    for name in names:
        try:
            parts = resolve(load_scene(name))
            scene = parts.scene
            if scene.uncertainty is not None:
                ensemble_card(parts)
            simulation = watched(build(parts), scene)
            # Samples are at least a step apart, so a rate that does not fit steps fits no samples.
            joint_sensor(scene, simulation, 1)
            print(_in_a_line(scene, simulation))
        except HnnViRosError as problem:
            for line in problem.lines:
                print(f'hnn scene: {line}', file=sys.stderr)
            status = 1
    return status


def compile_all(names: Sequence[str], rescue: bool) -> int:
    """Compile scenes, all shipped ones by default, and print a line for each."""
    from hnn_vi_ros.run import compile_scenes
    status = 0
    for scene in compile_scenes(names or [
            *(name for name in shipped_names('scene') if not lacks_a_model(load_scene(name))),
            *product(_NETWORKS, _METHODS)], rescue):
        if scene.problem:
            print(f'hnn scene: {scene.problem}', file=sys.stderr)
            status = 1
        else:
            print(f'{scene.name}: compiled in {scene.seconds:.1f} s', flush=True)
    return status


def explain(scene: Scene) -> Iterator[str]:
    """
    Yield lines on the parts of a scene, its Lyapunov time, and the time of a step.

    Raises
    ------
    HnnViRosError
        The scene cannot be built or fails.

    """
    from hnn_vi_ros.run import measure_effects
    from hnn_vi_ros.simulation import build, choose, simulate, watched
    if isinstance(scene.integrator, AutoChoice):
        print('selecting a method ...', file=sys.stderr)
    scene, chosen = choose(scene)
    parts = scene.parts()
    simulation = watched(build(parts), scene)
    hamiltonian, integrator = simulation.hamiltonian, simulation.integrator
    yield f'{scene.name}: {scene.description}'
    yield f'file: {scene.source}'
    yield from _choice('hamiltonian', scene.hamiltonian)
    yield from (f'  {name}: {value}' for name, value in hamiltonian.provenance.items())
    yield from _coordinates(hamiltonian.coordinates, scene)
    for choice, effect in zip(scene.effects, parts.effects, strict=False):
        yield from _choice('effect', choice)
        yield (f'  {"conservative" if effect.conservative else "does work"}'
               f'{", here without commands" * isinstance(effect, Commanded)}')
    yield from _choice('integrator', scene.integrator)
    yield f'  order {integrator.order}, step_size = {scene.step_size:g} [s]'
    if chosen is not None:
        yield f'  {chosen.choice.explain(chosen.tolerance)}'
    for event in scene.events:
        yield f'event {event.when} ({event.direction}): {event.then}'
    yield f'conservative: {"yes" if simulation.conservative else "no"}'
    print('measuring ...', file=sys.stderr)
    yield lyapunov_line(scene, _LYAPUNOV_STEPS if hamiltonian.kernel.compiled else
                        _PLAIN_LYAPUNOV_STEPS)
    costs = measure_effects(parts)
    with warnings.catch_warnings():
        # Alarms of the run are not about its parts.
        warnings.simplefilter('ignore')
        moved = energy_moved(simulate(parts, energy_by_cause=True), costs.added)
    yield from _times(costs, scene, moved, energy_unit(hamiltonian.coordinates))


def _coordinates(coordinates: Sequence[Coordinate], scene: Scene) -> Iterator[str]:
    """Describe the coordinates and their initial values; rotations column by column."""
    q, p = (zip(names, units, values, strict=True) for names, units, values in zip(
        columns(coordinates), column_units(coordinates),
        (scene.initial_state.q, scene.initial_state.p), strict=True))
    for coordinate in coordinates:
        if coordinate.kind == 'scalar':
            (name, unit, start), (_, p_unit, p_start) = next(q), next(p)
            yield (f'  coordinate {name} [{unit}] from {start:g}, its '
                   f'momentum [{p_unit}] from {p_start:g}')
            continue
        for what, rows, own in zip(('', ', momenta'), (q, p), columns([coordinate]), strict=True):
            yield f'  {coordinate.kind} {coordinate.name}{what}: ' + ', '.join(
                f'{name} [{unit}] from {start:g}' for name, unit, start in islice(rows, len(own)))


def _choice(role: str, choice: Any) -> Iterator[str]:
    yield f'{role} {choice.kind}: {type(choice).__doc__}'
    for name, field in type(choice).model_fields.items():
        if name != 'kind':
            yield f'  {name} = {getattr(choice, name)}: {field.description}'


def lyapunov_line(scene: Scene, steps: int) -> str:
    """Return the line on the Lyapunov time, estimated over a number of steps."""
    from hnn_vi_ros.simulation import lyapunov_time
    duration = steps * scene.known_step_size
    try:
        time = lyapunov_time(scene, duration)
    except (HnnViRosError, ValueError) as problem:
        return f'Lyapunov time: not measured: {problem}'
    if math.isinf(time):
        return f'Lyapunov time: none found within {duration:.4g} s: the motion is regular so far'
    return f'Lyapunov time: {time:.3g} s: the motion is chaotic'


def energy_moved(run: 'Trajectory', labels: Iterable[str]) -> dict[str, float]:
    """Return the ranges of work and stored energy of each effect, and of the error as ''."""
    causes = run.energy_by_cause
    assert causes is not None, 'requested'
    moved = dict.fromkeys(['', *labels], 0.0)
    for name, values in causes.of('').items():
        kind, _, cause = name.partition('/')
        # A joint follows the name; joined effects have both.
        for label in cause.partition('/')[0].split('+'):
            if kind != 'heat' and label in moved:
                moved[label] += float(np.nanmax(values) - np.nanmin(values))
    return moved


def _times(costs: 'EffectCosts', scene: Scene, moved: Mapping[str, float], unit: str
           ) -> Iterator[str]:
    yield f'time per step: {1e6 * costs.total:.3f} us'
    if not math.isnan(costs.bare):
        yield f'  integrator alone: {1e6 * costs.bare:.3f} us'
    for label, added in costs.added.items():
        text = 'cannot be removed' if math.isnan(added) else f'adds {1e6 * added:.3f} us'
        if added < -_DIFFERS * costs.total:
            text += ' (steps of the motion without it take longer)'
        text += f', moves {moved[label]:.3g} {unit} in {scene.duration:g} s'
        if 0.0 < moved[label] < moved['']:
            text += (f', less than the error of the method, {moved[""]:.2g} {unit}: not called '
                     'for')
        yield f'  {label} {text}'


def _in_a_line(scene: Scene, simulation: 'Simulation') -> str:
    what = getattr(scene.hamiltonian, 'model', None) or getattr(scene.hamiltonian, 'factory', '')
    parts = [f'{scene.hamiltonian.kind} {what}'.strip(), *(e.kind for e in scene.effects)]
    kept = 'conservative' if simulation.conservative else 'not conservative'
    (names, _), (units, _) = (
        own(simulation.hamiltonian.coordinates) for own in (columns, column_units))
    turns = [f'; {name} starts at {start:g} rad, {start / (2.0 * math.pi):.3g} turns'
             for name, unit, start in zip(names, units, scene.initial_state.q, strict=True)
             if unit == 'rad' and abs(start) > _MOST_TURNS * 2.0 * math.pi]
    return (f'{scene.name}: valid: {" + ".join(parts)}, {scene.integrator.kind}, '
            f'h = {scene.step_size:g} s, {kept}{"".join(turns)}')


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
