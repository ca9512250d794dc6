# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Identification: numbers of a scene fitted to measured motions, with confidence intervals.

Used by the command ``hnn identify``. It simulates the scene; ``learning`` trains networks.
"""
