# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Closed chains over many steps and MuJoCo's `equality`: closure, energy; writes a table."""

from collections.abc import Iterator, Sequence
from contextlib import chdir
import csv
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from hnn_vi_ros.effects import LoopManifold
from hnn_vi_ros.files import Parser
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation import build, Simulation
import numpy as np

SCENES = ('four_bar', 'five_bar', 'delta_robot')
OURS = ('generalized_leapfrog', 'implicit_midpoint')
PEERS = ('EULER', 'IMPLICITFAST', 'RK4')
FILE = 'evidence/closed_chains.csv'
_BLOCKS = 100
# Steps between looks.
_EVERY = 10


class Drift(NamedTuple):
    """
    One run.

    Parameters
    ----------
    scene, program, method : str
        The linkage and its simulator.
    steps : int
        Number of steps taken.
    closure : float
        Largest error of closure over the length of the chains [1].
    first_band, last_band : float
        Range of the energy in the first and in the last tenth, over that of the kinetic energy.
    drift : float
        Change of the mean energy from the first to the last tenth, likewise.

    """

    scene: str
    program: str
    method: str
    steps: int
    closure: float
    first_band: float
    last_band: float
    drift: float

    @classmethod
    def of(cls, names: Sequence[str], steps: int, closures: Sequence[float],
           energies: np.ndarray, kinetic: np.ndarray) -> 'Drift':
        """Return the summary of a record of the errors of closure and of the energies."""
        tenth, scale = len(energies) // 10, float(np.ptp(kinetic))
        first, last = energies[:tenth], energies[-tenth:]
        return cls(names[0], names[1], names[2], steps, max(closures),
                   float(np.ptp(first)) / scale, float(np.ptp(last)) / scale,
                   float(last.mean() - first.mean()) / scale)


def loops_of(simulation: Simulation) -> LoopManifold:
    """Return the loops of a simulation."""
    loops = simulation.system.constraints
    assert isinstance(loops, LoopManifold), 'its scene has loops'
    return loops


def ours(name: str, method: str, steps: int) -> Drift:
    """Return our run, looked at in every tenth step."""
    scene = load_scene(name).changed({'effects': [], 'integrator': {'kind': method}})
    simulation = build(scene)
    loops, hamiltonian = loops_of(simulation), simulation.hamiltonian
    closures, energies, kinetic = [], [], []
    for _ in range(_BLOCKS):
        q, p = simulation.record(steps // (_BLOCKS * _EVERY), _EVERY)
        closures.append(max(np.abs(loops.errors(one)).max() for one in q))
        energies.append(hamiltonian.energy(q, p))
        kinetic.append(energies[-1] - hamiltonian.energy(q, np.zeros_like(p)))
    return Drift.of((name, 'hnn_vi_ros', method), steps, closures, np.concatenate(energies),
                    np.concatenate(kinetic))


def peer_model(scene: Scene) -> Any:
    """Return MuJoCo's model with an `equality` for each loop; in a plane a hinge is a connect."""
    import mujoco  # installed with the peers of `make bench`
    robot = scene.create_hamiltonian().robot
    assert robot is not None, 'a URDF describes it'
    spec = mujoco.MjSpec.from_string(robot.text)
    # It takes no massless links: these move with the platform.
    spec.compiler.boundmass = spec.compiler.boundinertia = 1e-9
    for loop in scene.hamiltonian.loops:
        ends = []
        for k, (link, end) in enumerate(zip(loop.links, loop.points or loop.frames, strict=True)):
            site = next(body for body in spec.bodies if body.name == link).add_site()
            site.name, site.pos = f'{loop.links[0]}_{k}', end[:3]
            ends.append(site.name)
        equality = spec.add_equality()
        equality.type, equality.objtype = mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtObj.mjOBJ_SITE
        equality.name1, equality.name2 = ends
    model = spec.compile()
    for of_joints in (model.jnt_limited, model.dof_damping, model.dof_frictionloss):
        of_joints[:] = 0
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    model.opt.timestep = scene.known_step_size
    return model


def peer(name: str, method: str, steps: int) -> Drift:
    """Return MuJoCo's run of the same start and step, looked at in every tenth step."""
    import mujoco
    scene = load_scene(name).changed({'effects': []})
    simulation, model = build(scene), peer_model(scene)
    loops, data = loops_of(simulation), mujoco.MjData(model)
    places = [model.joint(c.name).qposadr[0] for c in simulation.hamiltonian.coordinates]
    model.opt.integrator = getattr(mujoco.mjtIntegrator, f'mjINT_{method}')
    data.qpos[places] = simulation.q
    closures, energies, kinetic = [], [], []
    # Its warnings go to a file in the working directory.
    with TemporaryDirectory() as folder, chdir(folder):
        for _ in range(steps // _EVERY):
            mujoco.mj_step(model, data, _EVERY)
            if not np.isfinite(data.qpos).all() or any(w.number for w in data.warning):
                break
            closures.append(float(np.abs(loops.errors(data.qpos[places])).max()))
            energies.append(data.energy.sum())
            kinetic.append(data.energy[1])
    return Drift.of((name, f'MuJoCo {mujoco.__version__}', method), _EVERY * len(energies),
                    closures, np.array(energies), np.array(kinetic))


def runs(steps: int) -> Iterator[Drift]:
    """Yield all runs."""
    for name in SCENES:
        yield from (ours(name, method, steps) for method in OURS)
        yield from (peer(name, method, steps) for method in PEERS)


def main(argv: Sequence[str]) -> None:
    """Measure, print and write the table."""
    arguments = parser().parse_args(argv)
    found = []
    for row in runs(arguments.steps):
        print(*(f'{value:.2g}' if isinstance(value, float) else value for value in row))
        found.append(row)
    with (arguments.docs / FILE).open('w', newline='', encoding='utf-8') as file:
        csv.writer(file, lineterminator='\n').writerows([Drift._fields, *(
            [f'{value:.3g}' if isinstance(value, float) else value for value in row]
            for row in found)])


def parser() -> Parser:
    """Return the parser of the command line."""
    found = Parser('closed_chains', __doc__, [
        'make study NAME=closed_chains ARGS="--steps 100000"'])
    found.add_argument('--steps', type=int, default=1_000_000, help=(
        'steps of each run (default: 1000000)'))
    found.add_argument('--docs', type=Path, default=Path('docs'), help=(
        f'folder of {FILE} (default: docs)'))
    return found
