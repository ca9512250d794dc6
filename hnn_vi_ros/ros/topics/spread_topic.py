# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The spread of an ensemble on ~/uncertainty, in the bag and in /diagnostics."""

from hnn_vi_ros.bags.cdr import MOMENTUM
from hnn_vi_ros.companions.members import Members
from hnn_vi_ros.guards.spread import SpreadGuard
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.phase_space import columns
from hnn_vi_ros.ros.topics.diagnostics_publisher import OK, Status, WARN
from hnn_vi_ros.ros.topics.messages import named_numbers
from hnn_vi_ros.simulation.sample import Sample


class SpreadTopic:
    """
    Topic on how far the members of an ensemble come apart.

    The positions of ~/uncertainty are the half-widths of the bands around q and p, by the names
    that ~/state gives these.

    Parameters
    ----------
    members : Members
        What comes apart.
    hamiltonian : Hamiltonian
        The mean, with the box of its training.
    limit : float
        Spread that is allowed, in half-widths of the box.

    """

    def __init__(self, members: Members, hamiltonian: Hamiltonian, limit: float):
        self._members = members
        names, momenta = columns(hamiltonian.coordinates)
        labels = [*names, *(f'{MOMENTUM}{name}' for name in momenta)]
        self._labels = labels
        self._template = named_numbers(labels)
        assert hamiltonian.box is not None, 'of a learned Hamiltonian there is one'
        self._box, self._limit = hamiltonian.box, limit
        self.guard = self.make_guard()

    def make_guard(self) -> SpreadGuard:
        """Return what watches a run from its start on."""
        self.guard = SpreadGuard(lambda: self._members.spread, self._box, self._limit)
        return self.guard

    def encode(self, sample: Sample) -> list[bytes]:
        """Return the message of a sample, if it tells the spread."""
        if sample.spread is None:
            return []
        self._template.numbers[0][:] = sample.spread
        self._template.set_stamp(sample.stamp)
        return [self._template.serialized()]

    def status(self) -> Status:
        """Return how far the members are apart."""
        members, value = self._members, self.guard.value
        level, message = OK, 'the members of the ensemble agree'
        if value > self._limit:
            level, message = WARN, 'the members of the ensemble have come apart'
        if members.factors is None:
            message += '; their spread is not calibrated'
        return Status('uncertainty', level, message, {
            'spread [half-widths]': value, 'limit [half-widths]': self._limit,
            **{f'spread of {name}': float(one) for name, one in zip(
                self._labels, members.spread, strict=True)},
            'members [1]': members.count, 'failed members [1]': members.failed,
            'factors [1]': 'none' if members.factors is None else ' '.join(
                f'{factor:.4g}' for factor in members.factors),
            'covered by the band [1]': 'unknown' if members.level is None else members.level})
