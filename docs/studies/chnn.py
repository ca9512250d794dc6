# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Chains of point masses, rigid bodies and a pendulum over magnets, as in the tables of CHNN.

M. Finzi, K. Wang, A. Wilson, Simplifying Hamiltonian and Lagrangian neural networks via explicit
constraints, NeurIPS 2020. The published model knows which bodies are joined and learns masses and
a potential. Ours is a URDF of rigid links of known length, or the formula of the system, with
unknown numbers. Bodies turn in Euler angles; the even motion of their centre of mass is left out.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from hnn_vi_ros.files import Parser
from matplotlib.figure import Figure
import numpy as np
from studies.known_tables import CSV, keep, OWN, parser_of, save
from studies.published_page import read_results, ResultTable
from studies.short_motions import chain_acceleration, followed, Mechanism

TABLE, MODEL = 'chnn', 'rigid bodies'
TRAIN, TEST, TRAIN_SAMPLES, TEST_SAMPLES = 20, 100, 21, 101
# Chains of three and five links take most of the time.
SEEDS, FEWER = 5, {'3 links': 3, '5 links': 3}
# The public code adds this to each relative error.
_LEAST = 1e-8
# Steps of the derivative by a complex number, which has no round-off.
_TINY = 1e-30
_LINK = """<link name="l{0}"><inertial><origin xyz="0 0 -1"/><mass value="1"/>
  <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001"/></inertial></link>
<joint name="j{0}" type="continuous"><parent link="{1}"/><child link="l{0}"/>
  <origin xyz="0 0 {2}"/><axis xyz="0 1 0"/></joint>
"""
# Euler angles z, x, z.
_BODY = """
  kind: formula
  coordinates: [{{name: a, q_unit: rad}}, {{name: b, q_unit: rad}}, {{name: c, q_unit: rad}}]
  H: >-
    ((p_a - p_c*cos(b))*sin(c)/sin(b) + p_b*cos(c))^2/(2*I) + p_c^2/(2*K)
    + ((p_a - p_c*cos(b))*cos(c)/sin(b) - p_b*sin(c))^2/(2*J) + G*cos(b)
  parameters: {{{}}}"""
_MAGNET = """ + Q*(
    ((d {0} sin(a)*cos(b))^2 + sin(b)^2 + (h - cos(a)*cos(b))^2)*cos(a)*cos(b)
    - 3*(h*cos(a)*cos(b) {1} d*sin(a)*cos(b) - 1)*(cos(a)*cos(b) - h))
    /((d {0} sin(a)*cos(b))^2 + sin(b)^2 + (h - cos(a)*cos(b))^2)^2.5"""
_MAGNETS = f"""
  kind: formula
  coordinates: [{{name: a, q_unit: rad}}, {{name: b, q_unit: rad}}]
  H: >-
    (p_b^2 + p_a^2/cos(b)^2)/(2*J) - G*cos(a)*cos(b){_MAGNET.format('-', '+')}
    {_MAGNET.format('+', '-')}
  parameters: {{J: 3.0, G: 25.0, Q: 0.006, d: 0.11, h: 1.06}}"""


@dataclass(frozen=True)
class System:
    """
    A system of the table.

    Parameters
    ----------
    mechanism : Mechanism
        True and fitted system.
    starts : np.ndarray, shape (m, 2 d)
        Initial (q, v).
    seen : callable
        Cartesian positions and velocities of states (..., 2 d).
    interval, known : float
        Between the samples of the test, and of the training [s].
    step_size : float
        Step size of our method [s].

    """

    mechanism: Mechanism
    starts: np.ndarray
    seen: Callable[[np.ndarray], np.ndarray]
    interval: float
    known: float
    step_size: float


def chain(links: int, random: np.random.Generator, count: int) -> System:
    """Return a chain of point masses, in the angles of its joints."""
    masses, lengths = random.uniform(0.6, 1.4, (2, links))
    own = chain_acceleration(masses, lengths, 1.0)

    def acceleration(q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        absolute = own(np.cumsum(q, axis=1), np.cumsum(v, axis=1), u)
        return np.diff(absolute, axis=1, prepend=0.0)

    def seen(z: np.ndarray) -> np.ndarray:
        q, v = (np.cumsum(part, axis=-1) for part in np.split(z, 2, axis=-1))
        parts = np.sin(q), -np.cos(q), np.cos(q) * v, np.sin(q) * v
        return np.concatenate([np.cumsum(lengths * part, axis=-1) for part in parts], axis=-1)
    parts = ''.join(_LINK.format(k, f'l{k - 1}' if k else 'base', -lengths[k - 1] if k else 0.0)
                    for k in range(links))
    starts = np.diff(random.normal(size=(2, count, links)) * [[[1.0]], [[0.6]]], prepend=0.0,
                     axis=2)
    return System(Mechanism(
        ' {kind: urdf, file: robot.urdf, gravity: [0.0, 0.0, -2.0]}',
        # Without forces a factor of all masses changes no motion: one mass is fixed.
        ('gravity.2', *(f'l{k}.centre_z' for k in range(links)),
         *(f'l{k}.mass' for k in range(1, links))),
        tuple(f'j{k}' for k in range(links)), acceleration,
        f'<robot name="chain"><link name="base"/>{parts}</robot>'),
        np.hstack([*starts]), seen, 0.1, 0.05, 0.05)


def turning(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the angular velocity in the body of Euler angles z, x, z and their rates, (m, 3)."""
    (_, b, c), (da, db, dc) = q.T, v.T
    return np.stack([da * np.sin(b) * np.sin(c) + db * np.cos(c),
                     da * np.sin(b) * np.cos(c) - db * np.sin(c), da * np.cos(b) + dc], axis=-1)


def columns_of(q: np.ndarray) -> np.ndarray:
    """Return the matrices from the rates of the angles to the angular velocity, (m, 3, 3)."""
    return np.stack([turning(q, np.broadcast_to(unit, q.shape)) for unit in np.eye(3)], axis=-1)


def body(moments: Sequence[float], weight: float, numbers: str, free: str, starts: np.ndarray,
         interval: float, step_size: float) -> System:
    """Return a body about a fixed point, by Euler's equations in the body."""
    inertia = np.asarray(moments)

    def acceleration(q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        omega, (_, b, c) = turning(q, v), q.T
        up = np.stack([np.sin(b) * np.sin(c), np.sin(b) * np.cos(c), np.cos(b)], axis=-1)
        torque = np.cross(inertia * omega, omega) - weight * np.cross([0.0, 0.0, 1.0], up)
        changed = turning(q + 1j * _TINY * v, v.astype(complex)).imag / _TINY
        return np.linalg.solve(columns_of(q), (torque / inertia - changed)[:, :, None])[:, :, 0]
    return System(Mechanism(_BODY.format(numbers), tuple(f'parameters.{name}' for name in free),
                            ('a', 'b', 'c'), acceleration), starts, axes_of, interval, 0.02,
                  step_size)


def axes_of(z: np.ndarray) -> np.ndarray:
    """Return the axes of a body and their velocities, shape (..., 18)."""
    q, v = (part.reshape(-1, 3) for part in np.split(z, 2, axis=-1))
    ca, cb, cc, sa, sb, sc = *np.cos(q).T, *np.sin(q).T
    R = np.stack([ca * cc - sa * cb * sc, -ca * sc - sa * cb * cc, sa * sb,
                  sa * cc + ca * cb * sc, -sa * sc + ca * cb * cc, -ca * sb,
                  sb * sc, sb * cc, cb], axis=-1).reshape(-1, 3, 3)
    moved = R @ np.cross(turning(q, v)[:, None, :], np.eye(3)).swapaxes(1, 2)
    return np.concatenate([R.reshape(-1, 9), moved.reshape(-1, 9)], axis=-1).reshape(
        *z.shape[:-1], 18)


def gyroscope(random: np.random.Generator, count: int) -> System:
    """Return a symmetric top that spins by 10 rad/s; the published shape is not."""
    starts = np.stack([
        random.uniform(-1.5, 1.5, count), random.uniform(0.3, 1.5, count),
        random.uniform(-1.5, 1.5, count), random.uniform(-4.5, 4.5, count),
        random.uniform(-0.3, 0.3, count),
        random.choice([-1.5, 1.5], count) * (7.0 + random.normal(size=count))], axis=-1)
    return body([1.0, 1.0, 0.5], 4.0, 'I: 1.0, J: 1.2, K: 0.7, G: 2.0', 'JKG', starts, 0.02, 0.01)


def rotor(random: np.random.Generator, count: int) -> System:
    """Return a free body with moments of 1, 2 and 3 kg m2."""
    moments, omega = np.array([1.0, 2.0, 3.0]), random.normal(size=(count, 3))
    # With z along the angular momentum b is never 0, where two of the angles are not defined.
    up = moments * omega / np.linalg.norm(moments * omega, axis=1, keepdims=True)
    q = np.stack([random.uniform(-np.pi, np.pi, count), np.arccos(up[:, 2]),
                  np.arctan2(up[:, 0], up[:, 1])], axis=-1)
    v = np.linalg.solve(columns_of(q), omega[:, :, None])[:, :, 0]
    return body(moments, 0.0, 'I: 1.0, J: 1.5, K: 2.0, G: 0.0', 'JKG', np.hstack([q, v]), 0.1,
                0.01)


def magnets(random: np.random.Generator, count: int) -> System:
    """Return a dipole of 3 kg on a rod of 1 m over two others, turning about y and then x."""
    def potential(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        x, y, z = np.sin(a) * np.cos(b), np.sin(b), -np.cos(a) * np.cos(b)
        energy, strength = 3.0 * 9.81 * z, 0.3**2 / (4.0 * np.pi)
        for place in (0.1, -0.1):
            square = (place - x)**2 + y**2 + (1.05 + z)**2
            energy = energy + strength * (3.0 * (place * x - 1.05 * z - 1.0) * (1.05 + z)
                                          - square * z) / square**2.5
        return energy

    def acceleration(q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        (a, b), (va, vb) = q.T, v.T
        by_a, by_b = (potential(*one).imag / (3.0 * _TINY)
                      for one in ((a + 1j * _TINY, b), (a, b + 1j * _TINY)))
        return np.stack([2.0 * np.tan(b) * va * vb - by_a / np.cos(b)**2,
                         -np.cos(b) * np.sin(b) * va**2 - by_b], axis=-1)

    def seen(z: np.ndarray) -> np.ndarray:
        a, b, va, vb = np.moveaxis(z, -1, 0)
        ca, cb, sa, sb = np.cos(a), np.cos(b), np.sin(a), np.sin(b)
        return np.stack([sa * cb, sb, -ca * cb, ca * cb * va - sa * sb * vb, cb * vb,
                         sa * cb * va + ca * sb * vb], axis=-1)
    return System(Mechanism(_MAGNETS, tuple(f'parameters.{name}' for name in 'GQdh'), ('a', 'b'),
                            acceleration), random.normal(size=(count, 4)) * [0.3, 0.2, 0.05, 0.4],
                  seen, 0.05, 0.01, 0.01)


SYSTEMS = {
    **{f'{n} link{"s" * (n > 1)}': lambda random, count, n=n: chain(n, random, count)
       for n in (1, 2, 3, 5)},
    'gyroscope': gyroscope, 'rotor': rotor, 'magnet pendulum': magnets}


def relative_error(found: np.ndarray, true: np.ndarray) -> float:
    """Return the geometric mean over runs and times of |x - y| / |x + y|, as published."""
    errors = np.linalg.norm(found - true, axis=-1) / np.linalg.norm(found + true, axis=-1)
    return float(np.exp(np.mean(np.log(errors + _LEAST))))


def measure(names: Sequence[str], seeds: int, train: int, test: int
            ) -> Iterator[tuple[str, int, str, float]]:
    """Yield the error of each system and seed."""
    for seed in range(seeds):
        for name in names:
            if seed >= FEWER.get(name, seeds):
                continue
            system = SYSTEMS[name](np.random.default_rng(seed), train + test)
            mechanism, d = system.mechanism, len(system.mechanism.names)
            q, v, force = *np.split(system.starts, 2, axis=1), np.zeros((train + test, d))
            known, t = (spacing * np.arange(samples) for spacing, samples in (
                (system.known, TRAIN_SAMPLES), (system.interval, TEST_SAMPLES)))
            short = mechanism.motions(q[:train], v[:train], force[:train], known)
            true = mechanism.motions(q[train:], v[train:], force[train:], t)
            with TemporaryDirectory() as folder:
                scene = mechanism.identified(Path(folder), short, force[:train], known,
                                             system.step_size)
                found = followed(scene, true[:, 0], force[train:], t)
            yield name, seed, MODEL, relative_error(system.seen(found), system.seen(true))


def draw(results: ResultTable) -> Figure:
    """Draw our errors over the published ones, of this table and of that of SymODEN."""
    figure = Figure(figsize=(7.0, 3.6), layout='constrained')
    axes = figure.subplots()
    claims = [(row.table, *claim) for row in OWN if row.table in ('symoden', TABLE)
              for claim in row.claims]
    for k, (*key, published) in enumerate(claims):
        ratios = results.values(*key) / published
        axes.plot(ratios, [k] * len(ratios), 'o', color='#0072b2', markersize=4)
    axes.axvline(1.0, color='grey', linestyle=':', label='as accurate as published')
    axes.set(xscale='log', xlabel='our error over the published one, each seed',
             yticks=range(len(claims)), yticklabels=[claim[1] for claim in claims])
    axes.invert_yaxis()
    axes.grid(alpha=0.3)
    figure.legend(loc='outside upper right', fontsize=9)
    return figure


def main(argv: Sequence[str]) -> None:
    """Measure the table, and write it with its picture and the page."""
    arguments = parser().parse_args(argv)
    print(keep(arguments.out, TABLE, measure(
        arguments.systems, *(1, 5, 3) if arguments.quick else (SEEDS, TRAIN, TEST))))
    save(draw(ResultTable(read_results(arguments.out, CSV))), arguments.out, TABLE)


def parser() -> Parser:
    """Return the parser of the command line."""
    found = parser_of(TABLE, __doc__)
    found.add_argument('--systems', nargs='+', choices=SYSTEMS, default=[*SYSTEMS], metavar='NAME',
                       help='measure only these (default: all), and keep the values of others')
    found.add_argument('--quick', action='store_true', help='few motions, to test the program')
    return found
