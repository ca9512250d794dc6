# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Cost of accuracy in a scene: a table, a picture, and what to take for an error."""

from collections.abc import Iterator, Sequence
import csv
from functools import partial
from itertools import pairwise
import math
from pathlib import Path
import sys
from textwrap import fill
from typing import NamedTuple

from hnn_vi_ros.accuracy.automatic_choice import problem_of
from hnn_vi_ros.accuracy.cost import Cost, CostStudy, measure_costs
from hnn_vi_ros.accuracy.trials import Method
from hnn_vi_ros.command_line import called
from hnn_vi_ros.commands import arguments
from hnn_vi_ros.commands.run import check_outputs, write_outputs
from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.files.standard_streams import ProgressLine
from hnn_vi_ros.files.yaml_text import dump_yaml
from hnn_vi_ros.scene import load_scene, Parts, Scene
from hnn_vi_ros.scene.choices import AutoChoice
from hnn_vi_ros.simulation.build import build
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.transforms import Bbox
import numpy as np
from numpy.typing import ArrayLike

_FONT = 7.5
# Offsets from a point to the near corner of its label [points], the preferred ones first.
_OFFSETS = ((6, 0), (6, 6), (6, -6), (-6, 0), (-6, 6), (-6, -6), (0, 9), (0, -9))


class Label(NamedTuple):
    """A text, its colour, and the point that it belongs to, in data coordinates."""

    text: str
    color: str
    point: np.ndarray


def place_labels(ax: Axes, labels: Sequence[Label], lines: Sequence[np.ndarray]) -> int:
    """
    Write texts next to their points.

    Of all places next to the point, the label takes the one where it covers the fewest points and
    lines. A label that would overlap another one, or leave the axes, everywhere is left out.

    Parameters
    ----------
    ax : Axes
        Whose limits, scales and layout are final: drawn once.
    labels : sequence of Label
        The first ones find a place first.
    lines : sequence of np.ndarray, shape (n, 2)
        The lines of the figure.

    Returns
    -------
    int
        How many were written.

    """
    figure = ax.figure
    pixels = figure.dpi / 72.0
    obstacles = np.vstack([_along(ax.transData.transform(points)) for points in lines]
                          or [np.empty((0, 2))])
    inside = ax.get_window_extent()
    taken: list[Bbox] = []
    for label in labels:
        x, y = label.point
        text = ax.annotate(label.text, (x, y), (0, 0), fontsize=_FONT, color=label.color,
                           zorder=6, textcoords='offset points',
                           path_effects=[withStroke(linewidth=1.5, foreground='white')])
        box = text.get_window_extent()
        places = [place for place in _candidates(ax.transData.transform(label.point), box, pixels)
                  if _is_free(place[1], taken, inside)]
        if not places:
            text.remove()
            continue
        offset, place, _ = min(places, key=lambda entry: entry[2] + 1.5 * _covered(
            entry[1], obstacles))
        taken.append(place)
        text.xyann = offset[:2]
        text.set(ha=offset[2], va='center')
    return len(taken)


def _along(points: np.ndarray) -> np.ndarray:
    """Return places along a line through points, in pixels."""
    if len(points) < 2:
        return points
    shares = np.linspace(0.0, 1.0, 12)[:, None]
    return np.vstack([a + shares * (b - a) for a, b in pairwise(points)])


def _candidates(point: np.ndarray, box: Bbox, pixels: float
                ) -> Iterator[tuple[tuple[int, int, str], Bbox, float]]:
    """Yield offset with alignment, extent and reluctance of each place for a label."""
    for rank, (dx, dy) in enumerate(_OFFSETS):
        x, y = point + np.array([dx, dy]) * pixels
        align = 'left' if dx > 0 else 'right' if dx < 0 else 'center'
        left = x - {'left': 0.0, 'right': box.width, 'center': 0.5 * box.width}[align]
        yield (dx, dy, align), Bbox.from_bounds(
            left, y - 0.5 * box.height, box.width, box.height), 0.3 * rank


def _is_free(place: Bbox, taken: list[Bbox], inside: Bbox) -> bool:
    within = (place.x0 >= inside.x0 and place.x1 <= inside.x1
              and place.y0 >= inside.y0 and place.y1 <= inside.y1)
    return within and not any(place.overlaps(other) for other in taken)


def _covered(place: Bbox, obstacles: np.ndarray) -> int:
    low, high = np.array([place.min, place.max])
    return int(((obstacles > low - 2.0) & (obstacles < high + 2.0)).all(axis=1).sum())


# Colour and marker; families share a colour, from light to dark with the order.
STYLES = {
    'variational_euler': ('#d1495b', 'o'), 'lie_variational_euler': ('#d1495b', 'P'),
    'symplectic_euler': ('#e07a5f', '<'), 'symplectic_euler_adjoint': ('#e07a5f', '>'),
    'lie_symplectic_euler': ('#e07a5f', 'v'), 'lie_symplectic_euler_adjoint': ('#e07a5f', '^'),
    'explicit_euler': ('#8d99ae', 'x'), 'rk4': ('#2f2f2f', 'X'), 'dop853': ('#1b7f5c', 'o'),
    'generalized_leapfrog': ('#edae49', 's'), 'lie_leapfrog': ('#edae49', '<'),
    'stormer_verlet': ('#c17c1b', 'D'), 'lie_stormer_verlet': ('#b5651d', 'P'),
    'implicit_midpoint': ('#c9a227', '^'), 'variational_midpoint': ('#c9a227', 'p'),
    'discrete_gradient': ('#7f6a93', 'p'), 'discrete_euler_lagrange': ('#7f6a93', 'h'),
    'time_transformed': ('#2a9d8f', '*'),
    'yoshida4': ('#8f5fa8', 'v'), 'suzuki4': ('#6b3f8a', 'd'), 'kahan_li8': ('#4a2566', '>'),
    'gauss4': ('#7fb7d6', 'o'), 'gauss6': ('#66a5cc', 's'), 'gauss8': ('#3d87ba', 's'),
    'gauss10': ('#2f76a8', '^'), 'gauss12': ('#236496', 'v'), 'gauss14': ('#175383', 'D'),
    'gauss16': ('#0b3c6f', 'D'),
    'lie_gauss4': ('#7fb7d6', 'P'), 'lie_gauss6': ('#66a5cc', 'P'), 'lie_gauss8': ('#3d87ba', 'd'),
    'lie_gauss10': ('#2f76a8', 'P'), 'lie_gauss12': ('#236496', 'o'),
    'lie_gauss14': ('#175383', 'P'), 'lie_gauss16': ('#0b3c6f', 's'),
}
INK, FAINT = '#222222', '#8a8a8a'
_SIZE, _DPI = (10.4, 6.4), 150


def draw(path: Path, name: str, study: CostStudy, error: float | None) -> None:
    """
    Draw error against time, and mark what is cheapest.

    Parameters
    ----------
    path : Path
        Where to write; its suffix says the kind of file.
    name : str
        Of the scene.
    study : CostStudy
        The costs.
    error : float or None
        For which what to take is circled.

    """
    figure = Figure(figsize=_SIZE, dpi=_DPI, facecolor='white')
    FigureCanvasAgg(figure)
    ax = figure.add_axes((0.08, 0.1, 0.65, 0.74))
    good = [cost for cost in study.costs if study.error(cost) <= study.lost]
    # Left out: steps so long that solving their equations takes more time than shorter steps do.
    kinds = dict.fromkeys(cost.method.kind for cost in good)
    lines = [_draw_line(ax, study, _front(
        study, [cost for cost in good if cost.method.kind == kind], 1.0)) for kind in kinds]
    _dress(ax, study, good)
    handles = [*lines, *_draw_levels(ax, study, error)]
    figure.text(0.08, 0.955, f'{name}: what accuracy costs over {study.reference.horizon:g} s',
                fontsize=14, color=INK, va='center')
    told = study.no_path if study.no_path else f'reference: {study.reference.how}'
    figure.text(0.08, 0.918, told[:120], fontsize=8.5, color=FAINT, va='center')
    figure.legend(handles=handles, loc='upper left', bbox_to_anchor=(0.735, 0.855), fontsize=8.5,
                  frameon=False, labelspacing=0.55, handlelength=2.2)
    # The layout is final only now.
    figure.draw_without_rendering()
    front = _front(study, good, 0.5)
    place_labels(ax, [Label(f'{cost.step_size:.2g} s', STYLES[cost.method.kind][0], _point(
        study, cost)) for cost in front], [np.array(line.get_xydata()) for line in lines])
    figure.savefig(path)


def _point(study: CostStudy, cost: Cost) -> np.ndarray:
    return np.array([cost.seconds, study.error(cost)])


def _draw_line(ax: Axes, study: CostStudy, costs: list[Cost]) -> Line2D:
    color, marker = STYLES[costs[0].method.kind]
    points = np.array([_point(study, cost) for cost in costs])
    line, = ax.plot(*points.T, color=color, marker=marker, markersize=5.0, linewidth=1.2,
                    label=fill(str(costs[0].method), 34, subsequent_indent='    '), zorder=3)
    return line


def _dress(ax: Axes, study: CostStudy, good: list[Cost]) -> None:
    """Give the axes their scales, limits and labels."""
    ax.set(xscale='log', yscale='log')
    if good:
        x, y = np.array([_point(study, cost) for cost in good]).T
        low = min([*y[y > 0.0], study.floor or 1.0])
        ax.set(xlim=(x.min() / 1.6, x.max() * 1.6),
               ylim=(10.0 ** math.floor(math.log10(low) - 0.1), 1.5 * study.lost))
    else:
        ax.text(0.5, 0.5, 'every run is lost', ha='center', transform=ax.transAxes, color=FAINT)
    ax.set_xlabel('processor time of a simulated second [s]', fontsize=10)
    ax.set_ylabel('energy error, largest |H - H0 - W| over the energy scale [1]'
                  if study.no_path else
                  'path error, largest deviation of a coordinate or momentum [SI units]',
                  fontsize=10)
    top = ax.secondary_xaxis('top', functions=(_inverse, _inverse))
    top.set_xlabel('times real time', fontsize=10)
    for axis in (ax, top):
        axis.tick_params(labelsize=9, colors=INK)
    ax.grid(which='major', color='#e6e6e6', linewidth=0.7)
    ax.set_axisbelow(True)
    ax.spines['right'].set_visible(False)


def _inverse(x: ArrayLike) -> np.ndarray:
    with np.errstate(divide='ignore'):
        return 1.0 / np.asarray(x)


def _draw_levels(ax: Axes, study: CostStudy, error: float | None) -> list[Line2D | Patch]:
    """Draw what is known and what is asked for; return the entries of the legend."""
    handles: list[Line2D | Patch] = []
    if study.floor > 0.0:
        ax.axhspan(ax.get_ylim()[0], study.floor, color='#ececec', zorder=0.5)
        handles.append(Patch(color='#ececec', label=f'not known: below {study.floor:.0e}'))
    if error is not None:
        handles.append(ax.axhline(error, color=INK, linewidth=1.0, linestyle=(0, (6, 3)), zorder=2,
                                  label=f'asked for: {error:g}'))
        best = study.recommended(error)
        if best is not None:
            point = _point(study, best)
            mark, = ax.plot(*point, marker='o', markersize=13.0, markerfacecolor='none',
                            markeredgecolor=INK, markeredgewidth=1.6, linestyle='', zorder=5,
                            label=f'take {best.method.kind}, h = {best.step_size:.3g} s')
            handles.append(mark)
    return handles


def _front(study: CostStudy, good: list[Cost], share: float) -> list[Cost]:
    """Return what nothing cheaper comes near in error, to a share of it; the cheapest first."""
    front: list[Cost] = []
    for cost in sorted(good, key=lambda cost: cost.seconds):
        if not front or study.error(cost) < share * study.error(front[-1]):
            front.append(cost)
    return front


# Candidates for the columns of the table, and how many columns it has at most.
_ERRORS, _COLUMNS = [10.0 ** -k for k in range(1, 15)], 4
_CELL = 18
_FIELDS = ('method', 'step_size', 'path_error', 'energy_error', 'seconds_per_simulated_second',
           'gradients_per_simulated_second', 'status')


def main(argv: list[str]) -> int:
    """Measure, print the table, and write the files that were asked for."""
    options = arguments.cost().parse_args(argv)
    for name in ('error', 'duration', 'seconds'):
        value = getattr(options, name)
        if value is not None and not 0.0 < value < math.inf:
            raise ParameterError(f'--{name} {value:g}: must be a positive number')
    paths = {'--csv': options.csv, '--plot': options.plot}
    check_outputs(paths)
    scene = load_scene(options.scene)
    study = _measured(scene, options.duration, options.seconds, options.error)
    for line in _lines(scene, study):
        print(line)
    write_outputs(paths, {'--csv': partial(_write_csv, study)} | (
        {'--plot': lambda path: draw(path, scene.name, study, options.error)}
        if options.plot is not None else {}))
    return 0 if options.error is None else _recommend(study, options.error)


def _measured(scene: Scene, duration: float, seconds: float, error: float | None) -> CostStudy:
    own, problem = None, problem_of(scene)
    if not isinstance(scene.integrator, AutoChoice):
        # Whatever is wrong with the scene itself is said by its place in the file.
        build(Parts(
            scene, problem.hamiltonian, scene.create_integrator(), list(problem.effects)))
        given = scene.integrator.model_dump(exclude={'kind'}, exclude_defaults=True)
        own = Method(scene.integrator.kind, given)
    line = ProgressLine()
    try:
        return measure_costs(problem, duration, seconds, own, error, line.show)
    finally:
        line.close()


def _lines(scene: Scene, study: CostStudy) -> Iterator[str]:
    """Yield how errors were measured, the table, and the methods that are not in it."""
    what = 'path errors' if not study.no_path else (
        f'energy errors, over {study.known.energy_scale:.3g} J')
    yield f'{scene.name}: {what} up to {study.reference.horizon:g} s, and the time they take'
    yield f'no path: {study.no_path}' if study.no_path else (
        f'reference: {study.reference.how}, known to {study.floor:.1e}')
    if scene.events:
        yield 'events of the scene are not looked for'
    yield from ('', *_table(study), '')
    for reason, kinds in study.left_out.items():
        yield f'left out, since each {reason}: {", ".join(kinds)}'
    if study.unreached:
        yield (f'no time for: {", ".join(study.unreached)}; repeat it, now that more is compiled, '
               'or give it more --seconds')


def _table(study: CostStudy) -> Iterator[str]:
    kinds = {cost.method.kind: str(cost.method) for cost in study.costs}
    reached = min((study.error(cost) for cost in study.costs), default=math.inf)
    errors = [error for error in _ERRORS if reached <= error <= study.lost]
    if len(errors) > _COLUMNS:
        places = np.linspace(0, len(errors) - 1, _COLUMNS).round().astype(int)
        errors = [errors[place] for place in places]
    if not errors:
        yield f'no run errs by less than {study.lost:.2g}'
        return
    width = max(map(len, kinds.values()))
    best = {error: study.cheapest(error) for error in errors}
    yield f'{"error":{width}}' + ''.join(f'{error:>{_CELL}.0e}' for error in errors)
    yield f'{"method":{width}}' + ''.join(f'{"h [s]  us/s":>{_CELL}}' for _ in errors)
    for kind, name in kinds.items():
        cells = (_cell(study.cheapest(error, kind), best[error]) for error in errors)
        yield f'{name:{width}}' + ''.join(f'{cell:>{_CELL}}' for cell in cells)
    yield ('us/s: microseconds of the processor for a simulated second; *: the least; '
           '-: not reached')


def _cell(cost: Cost | None, best: Cost | None) -> str:
    if cost is None:
        return '- '
    time = 1e6 * cost.seconds
    return f'{cost.step_size:.3g}  {time:{".0f" if time >= 100.0 else ".3g"}}' + (
        '*' if cost is best else ' ')


def _recommend(study: CostStudy, error: float) -> int:
    """Print what to take for an error; return 1 where nothing holds it."""
    best = study.recommended(error)
    if best is None:
        nearest = min(study.costs, key=study.error)
        print(f'{called("cost")}: --error {error:g}: nothing that was measured holds it; the '
              f'nearest is {nearest.method} with h = {nearest.step_size:.3g} s, which errs by '
              f'{study.error(nearest):.2g}, where no less than {study.floor:.1e} is known; allow '
              'a larger error, a shorter --duration or more --seconds', file=sys.stderr)
        return 1
    print(f'\nfor an error of {error:g} take this, which errs by {study.error(best):.2g} (energy: '
          f'{best.energy_error:.1e}), at {1e6 * best.seconds:.3g} us for a simulated second:\n')
    chosen = {'kind': best.method.kind, **best.method.arguments}
    print(dump_yaml({'integrator': chosen, 'step_size': best.step_size}), end='')
    return 0


def _write_csv(study: CostStudy, path: Path) -> None:
    """Write a line for each method and step size; what there is none of is empty."""
    with path.open('w', newline='', encoding='utf-8') as file:
        writer = csv.writer(file, lineterminator='\n')
        writer.writerow(_FIELDS)
        for cost in study.costs:
            numbers = (cost.step_size, cost.path_error, cost.energy_error, cost.seconds,
                       cost.gradients)
            writer.writerow([str(cost.method), *('' if math.isnan(value) else repr(value)
                                                 for value in numbers), cost.failure or 'ok'])
