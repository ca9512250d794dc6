# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Measure the coverage of ensemble bands, and how well the spread detects unknown states.

Pairs of a training configuration and the ensemble that it made. The coverage of the bands is
counted on motions that neither training nor calibration has seen: of exact data, on new ones; of
machines, on ``--runs``. Its standard error takes motions as the independent units. States outside
of the training domain are distinguished from states inside by the
deviation over the members of the gradient of H, or of a machine of its acceleration at the same
q and q'; AUROC is the probability that one outside has the larger one.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

from hnn_vi_ros.effects import EffectState, LearnedFriction
from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.files import Parser
from hnn_vi_ros.hamiltonians import momentum
from hnn_vi_ros.learning import load_machine, read_motions
from hnn_vi_ros.learning.fit.config import find_config, load_config, MachineConfig
from hnn_vi_ros.learning.judging.ensemble import held_exact, machine_scores, scores_of
from hnn_vi_ros.models import Checkpoint, load_checkpoint, load_learned, load_member
from hnn_vi_ros.models.ensemble import EnsembleHamiltonian
from hnn_vi_ros.run import deviation
import numpy as np
from scipy.stats import rankdata

# States of either kind, and motions.
_STATES, _MOTIONS = 4000, 3000
# Width of the box for states outside, relative to the training domain.
_WIDER = 2.0


def gradient_spread(hamiltonian: EnsembleHamiltonian, q: np.ndarray, p: np.ndarray) -> np.ndarray:
    """
    Return the deviation of (H_q, H_p) over the members, in units of its RMS, at each state.

    Parameters
    ----------
    hamiltonian : EnsembleHamiltonian
        The mean, with its members.
    q, p : np.ndarray, shape (m, d)
        States.

    Returns
    -------
    np.ndarray, shape (m,)
        The root mean square over the components [1].

    """
    gradients = np.array([np.hstack(member.gradient(q, p)) for member in hamiltonian.members])
    low, high = np.concatenate(hamiltonian.box).T
    z = np.random.default_rng(0).uniform(low, high, (1000, low.size))
    d = hamiltonian.dimension
    inside = np.hstack(hamiltonian.gradient(z[:, :d], z[:, d:]))
    unit = np.sqrt(np.mean(inside**2, axis=0))
    return np.sqrt(np.mean((deviation(gradients) / unit)**2, axis=1))


def auroc(inside: np.ndarray, outside: np.ndarray) -> float:
    """Return the probability that a score outside is larger than one inside (Mann-Whitney)."""
    ranks = rankdata(np.concatenate([inside, outside]))[len(inside):]
    m, n = len(inside), len(outside)
    return float((ranks.sum() - n * (n + 1) / 2.0) / (m * n))


def detection(checkpoint: Checkpoint, spread: Callable[[np.ndarray, np.ndarray], np.ndarray],
              seed: int = 0) -> float:
    """
    Return the AUROC for states in the training domain, and in a box twice as wide around it.

    Parameters
    ----------
    checkpoint : Checkpoint
        The ensemble; an angle that turns over is inside if it is so less whole turns.
    spread : callable
        Returns the deviation over the members at states q and p of the mean, shape (m, d) each.
    seed : int
        Seed of the states.

    """
    card = checkpoint.card
    low, high = np.concatenate([card.box.q, card.box.p]).T
    centre, half = 0.5 * (low + high), 0.5 * (high - low)
    kinds = [] if card.mechanical is None else card.mechanical.kinds
    turns = [i for i, kind in enumerate(kinds) if kind == 'continuous']
    rng = np.random.default_rng(seed)
    inside = rng.uniform(-1.0, 1.0, (_STATES, low.size))
    outside = rng.uniform(-_WIDER, _WIDER, (8 * _STATES, low.size))
    wrapped = outside.copy()
    wrapped[:, turns] = np.abs((half * outside + np.pi) % (2.0 * np.pi) - np.pi)[:, turns] \
        / half[turns]
    outside = outside[(np.abs(wrapped) > 1.0).any(axis=1)][:_STATES]
    return auroc(*(spread(*np.hsplit(centre + half * part, 2)) for part in (inside, outside)))


def acceleration_spread(model: str, checkpoint: Checkpoint, q: np.ndarray, p: np.ndarray
                        ) -> np.ndarray:
    """
    Return the deviation of q'' over the members of a machine, in units of its RMS, shape (m,).

    Parameters
    ----------
    model : str
        The file of the ensemble.
    checkpoint : Checkpoint
        Its content.
    q, p : np.ndarray, shape (m, d)
        States of the mean. Each member has the same q' there, and no command.

    """
    v = load_member(checkpoint, None).gradient(q, p)[1]
    found = np.array([accelerations(model, k, q, v)
                      for k in range(1, len(checkpoint.members) + 1)])
    unit = np.sqrt(np.mean(found.mean(axis=0)**2, axis=0))
    return np.sqrt(np.mean((deviation(found) / unit)**2, axis=1))


def accelerations(model: str, member: int, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return q'' of a member of a machine under its friction, by H_pq q' + H_pp p', (m, d)."""
    hamiltonian = load_learned(Path(model), confine=False, member=member)
    friction = LearnedFriction(model, member)
    own = friction.resolve(hamiltonian.coordinates, EffectState.empty(1, hamiltonian.dimension))
    p = momentum(hamiltonian, q, v, np.zeros_like(v))
    force = -hamiltonian.gradient(q, p)[0]
    for k in range(len(q)):
        friction.add_force(own, 0.0, q[k], p[k], v[k], np.zeros_like(v[k]), force[k])
    return hamiltonian.hessian_vector(q, p, v, force)[1]


def coverage(covered: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the share that is covered, and its standard error.

    Parameters
    ----------
    covered : sequence of np.ndarray, shape (k, 2 d)
        For each motion, which errors are in the band; errors of one motion are dependent.

    Returns
    -------
    tuple of np.ndarray, shape (1 + 2 d,)
        Coverage of all, then by coordinate and momentum. With m motions of n_i errors, c_i of them
        covered, the standard error of sum c_i / sum n_i = r is
        (sum (c_i - r n_i)^2)^(1/2) / sum n_i
        (W. G. Cochran, Sampling Techniques, 1977, section 2.9).

    """
    counts = np.array([[part.mean(axis=1).sum(), *part.sum(axis=0)] for part in covered])
    sizes = np.array([len(part) for part in covered])
    share = counts.sum(axis=0) / sizes.sum()
    errors = np.sqrt(np.sum((counts - share * sizes[:, None])**2, axis=0)) / sizes.sum()
    return share, errors


def exact_row(config: Path, model: str) -> tuple[list[np.ndarray], float]:
    """Return a mask of the errors of new exact motions inside the band, and the AUROC."""
    settings, checkpoint = load_config(config), load_checkpoint(model, ensembles=True)
    held = held_exact(checkpoint, settings, _MOTIONS, settings.seed + 3)
    if held is None or checkpoint.card.ensemble is None:
        raise ParameterError(f'{model}: no ensemble of exact data')
    covered = scores_of(checkpoint, held) <= _factors(model, checkpoint)
    inside = held.inside[1:]
    mean = EnsembleHamiltonian(checkpoint)
    return ([covered[inside[:, k], k] for k in range(inside.shape[1]) if inside[:, k].any()],
            detection(checkpoint, lambda q, p: gradient_spread(mean, q, p)))


def machine_row(config: Path, model: str, runs: Sequence[str]) -> tuple[list[np.ndarray], float]:
    """Return a mask of the errors of measured runs inside the band, and the AUROC."""
    settings, checkpoint = load_machine(config), load_checkpoint(model, ensembles=True)
    motions, _ = read_motions(
        config, settings.data, [one.name for one in checkpoint.card.coordinates], runs)
    factors = _factors(model, checkpoint)
    found = [np.concatenate(one) <= factors
             for one in machine_scores(checkpoint, motions, most=None) if one]
    return found, detection(
        checkpoint, lambda q, p: acceleration_spread(model, checkpoint, q, p))


def _factors(model: str, checkpoint: Checkpoint) -> np.ndarray:
    ensemble = checkpoint.card.ensemble
    if ensemble is None or ensemble.factors is None:
        raise ParameterError(f'{model}: no ensemble that was calibrated')
    return np.array(ensemble.factors)


def main(argv: Sequence[str]) -> None:
    """Print a row of a table for each pair of a configuration and its ensemble."""
    arguments = parser().parse_args(argv)
    if len(arguments.pairs) % 2:
        raise ParameterError('expected pairs: a training configuration, and the ensemble of it')
    print('| ensemble | members | factors | coverage of 90 % bands | by coordinate and momentum '
          '| motions | AUROC |\n|---|---|---|---|---|---|---|')
    for name, model in zip(arguments.pairs[::2], arguments.pairs[1::2], strict=True):
        config = find_config(name)
        covered, detected = machine_row(config, model, arguments.runs) \
            if isinstance(load_config(config), MachineConfig) else exact_row(config, model)
        shares, errors = (100.0 * part for part in coverage(covered))
        checkpoint = load_checkpoint(model, ensembles=True)
        factors = ' '.join(f'{factor:.3g}' for factor in _factors(model, checkpoint))
        each = ', '.join(f'{share:.1f} +- {error:.1f}' for share, error in zip(
            shares[1:], errors[1:], strict=True))
        print(f'| {Path(model).stem} | {len(checkpoint.members)} | {factors} | '
              f'{shares[0]:.1f} +- {errors[0]:.1f} % | {each} | {len(covered)} | {detected:.3f} |',
              flush=True)


def parser() -> Parser:
    """Return the parser of the command line."""
    found = Parser('uncertainty', __doc__, [
        'make study NAME=uncertainty ARGS="CONFIG.yaml MODEL.safetensors"'])
    found.add_argument('pairs', nargs='+', metavar='CONFIG MODEL', help=(
        'a training configuration and its ensemble'))
    found.add_argument('--runs', nargs='+', default=[], metavar='FILE', help=(
        'for machines: motions to count the coverage on'))
    return found
