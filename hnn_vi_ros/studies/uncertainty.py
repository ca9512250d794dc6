# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Study of ensemble spread: ``python -m hnn_vi_ros.studies.uncertainty CONFIG MODEL ...``.

Pairs of a training configuration of exact data and the ensemble that it made. The coverage of the
bands is counted on motions that neither training nor calibration has seen. States outside of the
training domain are told from those inside by the deviation of the gradient over the members;
AUROC is the probability that one outside has the larger one.
"""

from collections.abc import Sequence
from pathlib import Path
import sys

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.learning.config import find_config, load_config
from hnn_vi_ros.learning.ensemble import held_exact, scores_of
from hnn_vi_ros.models.checkpoint import Checkpoint, load_checkpoint
from hnn_vi_ros.models.ensemble import EnsembleHamiltonian
from hnn_vi_ros.run.spread import deviation
import numpy as np
from scipy.stats import rankdata

# States of either kind, and motions.
_STATES, _MOTIONS = 4000, 500
# How much wider the box is that states outside are drawn from.
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


def detection(checkpoint: Checkpoint, seed: int = 0) -> float:
    """Return the AUROC for states in the training box, and in one twice as wide around it."""
    hamiltonian = EnsembleHamiltonian(checkpoint)
    low, high = np.concatenate(hamiltonian.box).T
    centre, half, d = 0.5 * (low + high), 0.5 * (high - low), hamiltonian.dimension
    rng = np.random.default_rng(seed)
    inside = rng.uniform(-1.0, 1.0, (_STATES, 2 * d))
    outside = rng.uniform(-_WIDER, _WIDER, (8 * _STATES, 2 * d))
    outside = outside[(np.abs(outside) > 1.0).any(axis=1)][:_STATES]
    scores = [gradient_spread(hamiltonian, *np.hsplit(centre + half * part, 2))
              for part in (inside, outside)]
    return auroc(*scores)


def main(argv: Sequence[str]) -> None:
    """Print a row of a table for each pair of a configuration and its ensemble."""
    if not argv or len(argv) % 2:
        raise ParameterError('expected pairs: a training configuration, and the ensemble of it')
    print('| ensemble | members | factor | coverage of 90 % bands, by coordinate | AUROC |\n'
          '|---|---|---|---|---|')
    for name, model in zip(argv[::2], argv[1::2], strict=True):
        config, checkpoint = load_config(find_config(name)), load_checkpoint(model, ensembles=True)
        ensemble = checkpoint.card.ensemble
        held = held_exact(checkpoint, config, _MOTIONS, config.seed + 3)
        if ensemble is None or ensemble.factor is None or held is None:
            raise ParameterError(f'{model}: no ensemble that was calibrated on exact data')
        covered = scores_of(checkpoint, held)[held.inside[1:]] <= ensemble.factor
        each = ', '.join(f'{100.0 * part:.1f}' for part in covered.mean(axis=0))
        print(f'| {Path(model).stem} | {len(ensemble.members)} | {ensemble.factor:.3g} | '
              f'{100.0 * covered.mean():.1f} % ({each}) | {detection(checkpoint):.3f} |',
              flush=True)


if __name__ == '__main__':
    main(sys.argv[1:])
