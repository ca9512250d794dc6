# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Hamiltonians: analytic ones by name, learned ones from a checkpoint."""

from hnn_vi_ros.hamiltonians.double_pendulum import DoublePendulum
from hnn_vi_ros.hamiltonians.fput_chain import FputChain
from hnn_vi_ros.hamiltonians.free_particle import FreeParticle
from hnn_vi_ros.hamiltonians.harmonic_oscillator import HarmonicOscillator
from hnn_vi_ros.hamiltonians.henon_heiles import HenonHeiles
from hnn_vi_ros.hamiltonians.kepler import Kepler
from hnn_vi_ros.hamiltonians.pendulum import Pendulum
from hnn_vi_ros.hamiltonians.tao import Tao

HAMILTONIANS = {
    'double_pendulum': DoublePendulum,
    'fput_chain': FputChain,
    'free_particle': FreeParticle,
    'harmonic_oscillator': HarmonicOscillator,
    'henon_heiles': HenonHeiles,
    'kepler': Kepler,
    'pendulum': Pendulum,
    'tao': Tao,
}
