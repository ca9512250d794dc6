# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Mechanical systems of published tables: many short motions, identified and simulated."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from hnn_vi_ros.hamiltonians import momentum
from hnn_vi_ros.identify.arguments import identify as command_line
from hnn_vi_ros.identify.identify import identify
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation import build
import numpy as np
from scipy.integrate import solve_ivp

_TOLERANCE = 1e-12
_COMMANDS = '\n- {{kind: external_force, coordinates: [{}], timeout: 1e9}}'


@dataclass(frozen=True)
class Mechanism:
    """
    A mechanism without friction.

    Parameters
    ----------
    hamiltonian : str
        The YAML of our model, with the numbers from which the search begins.
    free : tuple of str
        Names of the unknown numbers.
    names : tuple of str
        Coordinates.
    acceleration : callable
        The true accelerations of q and v, shape (m, d), and of the force u, shape (m, d).
    robot : str
        The URDF of our model, where it is a robot.

    """

    hamiltonian: str
    free: tuple[str, ...]
    names: tuple[str, ...]
    acceleration: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
    robot: str = ''

    def motions(self, q: np.ndarray, v: np.ndarray, u: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Return the true states (q, v), shape (m, n, 2 d), of m motions at n times [s]."""
        shape = q.shape

        def rates(_: float, z: np.ndarray) -> np.ndarray:
            q, v = z.reshape(2, *shape)
            return np.stack([v, self.acceleration(q, v, u)]).ravel()
        path = solve_ivp(rates, (t[0], t[-1]), np.stack([q, v]).ravel(), 'DOP853', t,
                         rtol=_TOLERANCE, atol=_TOLERANCE)
        return path.y.reshape(2, *shape, len(t)).transpose(1, 3, 0, 2).reshape(
            len(q), len(t), -1)

    def identified(self, folder: Path, states: np.ndarray, u: np.ndarray, t: np.ndarray,
                   step_size: float) -> Scene:
        """
        Return the scene that ``hnn identify`` fits to motions under constant forces.

        A robot with its numbers is a file of the folder.
        """
        d, driven = len(self.names), bool(u.any())
        (folder / 'robot.urdf').write_text(self.robot, encoding='utf-8')
        (folder / 'scene.yaml').write_text(
            f'hamiltonian:{self.hamiltonian}\nintegrator: {{kind: gauss8}}\n'
            f'step_size: {step_size}\ninitial_state: {{q: {[0.1] * d}, p: {[0.0] * d}}}\n' + (
                'effects:' + _COMMANDS.format(', '.join(self.names)) if driven else ''),
            encoding='utf-8')
        runs = {}
        for k, (path, force) in enumerate(zip(states, u, strict=True)):
            runs |= {f'{k}/t': t, f'{k}/q': path[:, :d], f'{k}/dq': path[:, d:]}
            if driven:
                runs[f'{k}/tau'] = np.tile(force, (len(t), 1))
        np.savez(folder / 'log.npz', **runs)
        options = command_line().parse_args([
            str(folder / 'scene.yaml'), '--data', str(folder / 'log.npz'), '--free', *self.free])
        found = identify(load_scene(options.scene), options, folder)
        return found.free.at(found.solution.values)[0]


def followed(scene: Scene, starts: np.ndarray, u: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return simulated states (q, v), shape (m, n, 2 d), from their first states and forces."""
    simulation, d = build(scene), starts.shape[1] // 2
    hamiltonian, found = simulation.hamiltonian, []
    every = round((t[1] - t[0]) / simulation.step_size)
    p = momentum(hamiltonian, starts[:, :d], starts[:, d:], np.zeros_like(starts[:, :d]))
    for start, first, force in zip(starts, p, u, strict=True):
        simulation.restart(start[:d], first)
        if simulation.takes_commands:
            simulation.set_command(force)
        path = simulation.record(len(t) - 1, every)
        q, own = (np.concatenate([one[None], part.reshape(len(t) - 1, d)])
                  for one, part in zip((start[:d], first), path, strict=True))
        found.append(np.hstack([q, hamiltonian.gradient(q, own)[1]]))
    return np.array(found)


def chain_acceleration(masses: Sequence[float], lengths: Sequence[float], gravity: float
                       ) -> Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
    """Return the accelerations of point masses on rods, of angles from the vertical below."""
    m, length = np.asarray(masses), np.asarray(lengths)
    below = np.cumsum(m[::-1])[::-1]
    # The mass that two rods move together is that below the lower one.
    order = np.arange(len(m))
    shared = below[np.maximum.outer(order, order)] * np.outer(length, length)

    def acceleration(q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        between = q[:, :, None] - q[:, None, :]
        force = u - np.einsum('mij,mj->mi', shared * np.sin(between), v**2) - (
            gravity * below * length * np.sin(q))
        return np.linalg.solve(shared * np.cos(between), force[:, :, None])[:, :, 0]
    return acceleration
