# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Measure accuracy and cost of rotating bodies and of peers; write tables and pictures."""

from collections.abc import Iterator, Mapping, Sequence
import csv
from pathlib import Path
import time
from typing import Any, NamedTuple

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.files import Parser
from hnn_vi_ros.hamiltonians.heavy_top import HeavyTop
from hnn_vi_ros.hamiltonians.quadrotor import Quadrotor
from hnn_vi_ros.integrators import Integrator, INTEGRATORS
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import InitialValueProblem, Simulation
import numpy as np
from scipy.spatial.transform import Rotation
from studies.explore_page import write_explorer
from studies.measuring import measure_rows, Peer, StudyRow
from studies.pages import render
from studies.references import floor_of
from studies.results import commit, keep_results, machine, read_results, Results
from studies.turning_peers import turning_peers

# Initial momenta of a thrown body: p in space [kg m/s], L in its frame [kg m^2/s].
THROWN = (0.8, 0.0, 2.4, 0.012, -0.02, 0.04)
HORIZON = 100.0
# The largest error that the table is made for.
GOOD = 1e-8
BEGIN, END = '<!-- turning_costs -->', '<!-- end of turning_costs -->'
# File of the rows of long runs, in the folder of the scenes' rows.
PAGE, FOLDER, DRIFTS = 'evidence/fits.md', 'evidence/accuracy', 'heavy_top_drifts.csv'
_DRIFT_COLUMNS = ('method', 'setting', 'energy_error_first_tenth', 'energy_error',
                  'vertical_momentum', 'norm', 'milliseconds', 'duration')
# A long run, how often its invariants are looked at, and methods with step size or tolerance.
LONG, _LOOKS = 10_000.0, 100
_LONG = {'lie_leapfrog': 0.01, 'lie_stormer_verlet': 0.01, 'kahan_li8': 0.1,
         'RK4 on quaternions': 0.01, 'scipy RK45': 1e-7}


class Case(NamedTuple):
    """A scene's Hamiltonian, and the state that it starts from."""

    scene: str
    hamiltonian: HeavyTop | Quadrotor
    q: np.ndarray
    p: np.ndarray


def cases() -> list[Case]:
    """Return the heavy top of its scene, and the quadrotor, thrown without a command or drag."""
    found = []
    for name, kind, p in (('heavy_top', HeavyTop, None), ('quadrotor', Quadrotor, THROWN)):
        scene = load_scene(name)
        hamiltonian = scene.create_hamiltonian()
        assert isinstance(hamiltonian, kind), 'the scene of its name'
        found.append(Case(name, hamiltonian, np.array(scene.initial_state.q),
                          np.array(scene.initial_state.p if p is None else p)))
    return found


def method_of(name: str) -> Integrator:
    """Return a method; compositions compose lie_stormer_verlet."""
    composed = name in ('kahan_li8', 'suzuki4')
    return INTEGRATORS[name](base='lie_stormer_verlet') if composed else INTEGRATORS[name]()


def measure(case: Case, horizon: float, seconds: float) -> Results:
    """Return the rows of a case, our methods within a budget of processor time [s]."""
    problem = InitialValueProblem(case.hamiltonian, (), case.q, case.p)
    rows, reference = measure_rows(problem, turning_peers(case.hamiltonian), horizon, seconds)
    floor = floor_of(reference, case.hamiltonian, case.q, case.p)
    return Results({'machine': machine()}, [commit()], {reference.horizon: floor}, rows)


def states(case: Case, name: str, setting: float, horizon: float, peers: Sequence[Peer]
           ) -> Iterator[np.ndarray]:
    """Yield (q, p) at even instants of a run: of one of our methods, or of a peer's."""
    duration = horizon / _LOOKS
    if name in INTEGRATORS:
        run = Simulation(case.hamiltonian, method_of(name), setting, case.q, case.p)
        for _ in range(_LOOKS):
            run.advance(round(duration / setting))
            yield np.concatenate([run.q, run.p])
        return
    (peer,) = (one for one in peers if one.name == name)
    z = np.concatenate([case.q, case.p])
    for _ in range(_LOOKS):
        z, _ = peer.solve(z, duration, setting)
        yield z


def drifts(case: Case, horizon: float) -> Iterator[list[str]]:
    """Yield the drift of H, L_z and the quaternion's norm in long runs of a top; see DRIFTS."""
    z0, peers = np.concatenate([case.q, case.p]), turning_peers(case.hamiltonian)
    for name, setting in _LONG.items():
        for _ in states(case, name, setting, _LOOKS * setting, peers):
            pass  # compile
        start = time.process_time()
        z = np.array([z0, *states(case, name, setting, horizon, peers)])
        taken = time.process_time() - start
        energy, vertical, norm = invariants(case, z)
        error = np.abs(energy - energy[0])
        numbers = (error[:_LOOKS // 10 + 1].max(), error.max(),
                   np.abs(vertical / vertical[0] - 1.0).max(), np.abs(norm - 1.0).max(),
                   1e3 * taken, horizon)
        yield [name, f'{setting:g}', *(f'{number:.6g}' for number in numbers)]


def invariants(case: Case, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return H, the vertical angular momentum and the norm of the quaternion, of a top."""
    q, p = z[:, :4], z[:, 4:]
    norm = np.linalg.norm(q, axis=1)
    # The energy of the attitude, whatever the norm of its quaternion.
    energy = case.hamiltonian.energy(q / norm[:, None], p)
    return energy, Rotation.from_quat(q).apply(p)[:, 2], norm


def best_rows(rows: Sequence[StudyRow]) -> list[StudyRow]:
    """Return the cheapest row of each method within 1e-8, or else its most accurate."""
    best = []
    for name in dict.fromkeys(row.family for row in rows):
        own = [row for row in rows if row.finished and row.family == name]
        good = [row for row in own if row.path_error <= GOOD]
        if own:
            best.append(min(good, key=lambda row: row.seconds_per_simulated_second) if good
                        else min(own, key=lambda row: row.path_error))
    return sorted(best, key=lambda row: (
        row.path_error > GOOD, row.seconds_per_simulated_second))


def _shown(name: str) -> str:
    """Return a name as a page has it: ours as code."""
    return name if ' ' in name else f'`{name}`'


def section(scene: str, results: Results) -> dict[str, Any]:
    """Return the template's values of a scene."""
    best = best_rows(results.rows)
    ours, theirs = (next((row for row in best if row.path_error <= GOOD
                          and row.is_peer == is_peer), None) for is_peer in (False, True))
    (horizon, floor), = results.floors.items()
    cells = [[_shown(row.family),
              row.method.partition('=')[2] if np.isnan(row.step_size)
              else f'{row.step_size:g} s', f'{row.path_error:.1e}', f'{row.energy_band:.1e}',
              f'{1e3 * row.horizon * row.seconds_per_simulated_second:.3g}']
             for row in best if row.path_error <= GOOD]
    return {'scene': scene, 'horizon': horizon, 'floor': floor, 'rows': cells,
            'others': [_shown(row.family) for row in best if row.path_error > GOOD],
            'faster': None if ours is None or theirs is None else {
                'ours': ours.method, 'theirs': theirs.family,
                'share': ours.seconds_per_simulated_second / theirs.seconds_per_simulated_second}}


def page_part(folder: Path) -> str:
    """Return the part of the page on accuracy and cost, from the results in a folder."""
    results = read_results(folder)
    sections = [section(case.scene, results[case.scene]) for case in cases()]
    with (folder / DRIFTS).open(encoding='utf-8') as file:
        rows = list(csv.DictReader(file))
    long = [[_shown(row['method']), f'{row["setting"]} s' if float(row['setting']) > 1e-4
             else row['setting'],
             *(f'{float(row[name]):.1e}' for name in _DRIFT_COLUMNS[2:6]),
             f'{float(row["milliseconds"]):.3g}'] for row in rows]
    return render('turning_costs.md', sections=sections, good=GOOD, looks=_LOOKS, long=long,
                  duration=float(rows[0]['duration']))


def write(docs: Path, found: Mapping[str, Results], long: Sequence[Sequence[str]]) -> None:
    """Write rows, cards, pictures, the page to explore, and the part of the page."""
    # Imported here: matplotlib takes a second, and errors should appear at once.
    from studies.accuracy_page import draw_pictures
    page, folder = docs / PAGE, docs / FOLDER
    before, begin, rest = page.read_text(encoding='utf-8').partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ParameterError(f'{page}: has no lines {BEGIN} and {END}, between which the table '
                             'goes; put them back')
    keep_results(folder, found)
    with (folder / DRIFTS).open('w', newline='', encoding='utf-8') as file:
        csv.writer(file, lineterminator='\n').writerows([_DRIFT_COLUMNS, *long])
    page.write_text(f'{before}{BEGIN}\n\n{page_part(folder)}\n{END}{after}', encoding='utf-8')
    for scene, results in found.items():
        draw_pictures(folder, scene, results)
    write_explorer(folder)


def main(argv: Sequence[str]) -> None:
    """Measure, and write into the folder of the documentation."""
    arguments = parser().parse_args(argv)
    horizon, budget = (1.0, 20.0) if arguments.quick else (HORIZON, 600.0)
    found = {case.scene: measure(case, horizon, budget) for case in cases()}
    write(arguments.docs, found, list(drifts(cases()[0], 100.0 if arguments.quick else LONG)))


def parser() -> Parser:
    """Return the parser of the command line."""
    found = Parser('turning_costs', __doc__, [
        'make study NAME=turning_costs ARGS="--quick"'])
    found.add_argument('--docs', type=Path, default=Path('docs'), help=(
        f'folder of {PAGE} and of {FOLDER}/ (default: docs)'))
    found.add_argument('--quick', action='store_true', help='test run: few rows of one second')
    return found
