# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Judgement of trained models: scores, baselines, calibrated ensembles, reports."""
