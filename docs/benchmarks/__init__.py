# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Speed against the tools that a user could pick instead; run by `make bench`."""
