# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Cost of accuracy in a scene: a table, a plot, and a recommendation for an error."""

from collections.abc import Iterator
import csv
from functools import partial
from io import BufferedWriter, StringIO
import math

from hnn_vi_ros.commands import arguments
from hnn_vi_ros.commands.run import check_outputs, write_outputs
from hnn_vi_ros.errors import CalibrationError, ParameterError
from hnn_vi_ros.files import dump_yaml, ProgressLine
from hnn_vi_ros.phase_space import energy_unit
from hnn_vi_ros.scene import AutoChoice, load_scene, Parts, Scene
from hnn_vi_ros.simulation import (
    build, Choice, choose, CostStudy, measure_costs, Method, MethodCost, problem_of, Tolerance)
import numpy as np

# Candidate errors for the columns of the table, and its maximum number of columns.
_CANDIDATE_ERRORS, _MAX_COLUMNS = [10.0 ** -k for k in range(1, 15)], 4
_CELL_WIDTH = 18
_FIELDS = ('method', 'step_size', 'path_error', 'energy_error', 'seconds_per_simulated_second',
           'gradients_per_simulated_second', 'status')


def main(argv: list[str]) -> int:
    """Measure, print the table, and write the requested files."""
    options = arguments.cost().parse_args(argv)
    for name in ('error', 'duration', 'seconds', 'rate'):
        value = getattr(options, name)
        if value is not None and not 0.0 < value < math.inf:
            raise ParameterError(f'--{name} {value:g}: must be a positive number')
    paths = {'--csv': options.csv, '--plot': options.plot}
    check_outputs(paths, options.force)
    if options.plot is not None:
        # Import now, so that a missing package is reported before a minute of work.
        from hnn_vi_ros.commands.cost_figure import draw
    scene = load_scene(options.scene)
    duration = scene.duration if options.duration is None else options.duration
    base = None if options.rate is None else 1.0 / options.rate
    study = _measure(scene, duration, options.seconds, base)
    for line in _lines(scene, study, options.error):
        print(line)
    chosen, problem = None, None
    if options.error is not None:
        kind = 'energy_error' if study.no_path else 'path_error'
        try:
            # The same question has the same answer from `integrator: auto`.
            _, chosen = choose(scene.changed({'step_size': None, 'integrator': {
                'kind': 'auto', kind: options.error, 'horizon': study.reference.horizon}}), base)
        except CalibrationError as refusal:
            problem = refusal
    write_outputs(paths, {'--csv': partial(_write_csv, study)} | (
        {'--plot': lambda stream: draw(stream, scene.name, study, chosen)}
        if options.plot is not None else {}), options.force)
    if problem is not None:
        raise problem
    if chosen is not None:
        _recommend(*chosen)
        if options.rate is None:
            print('# gives samples at its step size; --rate HZ: at another rate')
    return 0


def _measure(scene: Scene, duration: float, seconds: float, base: float | None) -> CostStudy:
    own, problem = None, problem_of(scene)
    if not isinstance(scene.integrator, AutoChoice):
        # Errors in the scene itself are reported with their place in the file.
        build(Parts(scene, problem.hamiltonian, scene.create_integrator(), list(problem.effects)))
        given = scene.integrator.model_dump(exclude={'kind'}, exclude_defaults=True)
        own = Method(scene.integrator.kind, given)
    line = ProgressLine()
    try:
        return measure_costs(problem, duration, seconds, own, base, line.show)
    finally:
        line.close()


def _lines(scene: Scene, study: CostStudy, error: float | None) -> Iterator[str]:
    """Yield lines on the error measurement, the table, and the methods not in it."""
    what = 'path errors' if not study.no_path else (
        f'energy errors, relative to {study.known.energy_scale:.3g} '
        f'{energy_unit(study.problem.hamiltonian.coordinates)}')
    yield f'{scene.name}: {what} up to {study.reference.horizon:g} s, and run times'
    yield f'no reference: {study.no_path}' if study.no_path else (
        f'reference: {study.reference.how}, accurate to {study.floor:.1e}')
    yield from _errors_of_model(study)
    if scene.events:
        yield 'events of the scene are not detected'
    yield from ('', *_table(study, error), '')
    for reason, kinds in study.left_out.items():
        yield f'omitted, because each {reason}: {", ".join(kinds)}'
    if study.unreached:
        yield (f'no time for: {", ".join(study.unreached)}; run it again, now that more is '
               'compiled, or increase --seconds')


def _errors_of_model(study: CostStudy) -> Iterator[str]:
    """Yield a line on the errors of a learned model itself."""
    model = getattr(study.problem.hamiltonian, 'checkpoint', None)
    if model is None:
        return
    card, found = model.card, list[str]()
    if card.prediction_error is not None:
        found += [f'coordinates by {max(errors):.2g} after {horizon} s (RMS of held-out motions)'
                  for horizon, errors in card.prediction_error.horizons.items()
                  if None not in errors]
    if card.energy_error is not None:
        unit = energy_unit(card.coordinates)
        found.append(f'H by {card.energy_error.rms:.2g} {unit} (RMS in its box), of a spread of '
                     f'{card.energy_error.spread:.2g} {unit}')
    yield (f'error of the model {card.name} itself, which no method reduces: '
           f'{", ".join(found) or "not on its card"}')


def _table(study: CostStudy, wanted: float | None) -> Iterator[str]:
    names = list(dict.fromkeys(cost.method.family for cost in study.costs))
    reached = min((study.error(cost) for cost in study.costs), default=math.inf)
    errors = [error for error in _CANDIDATE_ERRORS if reached <= error <= study.lost]
    if len(errors) > _MAX_COLUMNS:
        places = np.linspace(0, len(errors) - 1, _MAX_COLUMNS).round().astype(int)
        errors = [errors[place] for place in places]
    if wanted is not None and reached <= wanted <= study.lost:
        errors = sorted({*errors, wanted}, reverse=True)
    if not errors:
        yield f'no run has an error below {study.lost:.2g}'
        return
    width = max(map(len, names))
    best = {error: study.cheapest(error) for error in errors}
    yield f'{"error":{width}}' + ''.join(f'{error:>{_CELL_WIDTH}.0e}' for error in errors)
    yield f'{"method":{width}}' + ''.join(f'{"h [s]    us ":>{_CELL_WIDTH}}' for _ in errors)
    for name in names:
        cells = (_cell(study.cheapest(error, name), best[error]) for error in errors)
        yield f'{name:{width}}' + ''.join(f'{cell:>{_CELL_WIDTH}}' for cell in cells)
    yield ('us: processor time [us per simulated second]; *: fastest; -: no measured step reaches '
           'it; tol: the tolerance of an adaptive method, whose steps of the clock are of '
           f'{study.reference.instants.base:.3g} s')


def _cell(cost: MethodCost | None, best: MethodCost | None) -> str:
    if cost is None:
        return '- '
    time, tolerance = 1e6 * cost.seconds, cost.method.tolerance
    setting = f'{cost.step_size:.3g}' if tolerance is None else f'tol {tolerance:.0e}'
    return f'{setting}  {time:{".0f" if time >= 100.0 else ".3g"}}' + (
        '*' if cost is best else ' ')


def _recommend(tolerance: Tolerance, choice: Choice) -> None:
    """Print the choice of `integrator: auto` for an error."""
    time = 1e6 * choice.seconds_per_simulated_second
    print(f'\nRecommended for {tolerance.kind} {tolerance.error:g} up to {tolerance.horizon:g} s, '
          f'by the number of gradients and steps, which does not depend on other load (error '
          f'{choice.error:.2g}, measured again: {time:.3g} us per simulated second):\n')
    print(dump_yaml({'integrator': {'kind': choice.method, **choice.arguments},
                     'step_size': choice.step_size}), end='')


def _write_csv(study: CostStudy, stream: BufferedWriter) -> None:
    """Write a row for each method and step size; missing values are empty."""
    text = StringIO()
    writer = csv.writer(text, lineterminator='\n')
    writer.writerow(_FIELDS)
    for cost in study.costs:
        numbers = (cost.step_size, cost.path_error, cost.energy_error, cost.seconds,
                   cost.gradients)
        writer.writerow([str(cost.method), *('' if math.isnan(value) else repr(value)
                                             for value in numbers), cost.failure or 'ok'])
    stream.write(text.getvalue().encode())
