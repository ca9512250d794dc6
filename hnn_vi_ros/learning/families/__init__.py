# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Model families as trainable torch modules that export their networks to a model file."""
