# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Studies behind pages of the documentation; ``make study`` runs them, the wheel has none."""
