# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Files that are read and written: YAML, resources, code by its name."""
