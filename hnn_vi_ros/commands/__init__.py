# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The one command ``hnn``: a table of what it can do, and what only it has."""
