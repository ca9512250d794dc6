# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The version of this package, the same as in package.xml."""

__version__ = '0.2.0'
