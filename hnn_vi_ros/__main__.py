# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Command ``hnn`` as a module: ``python -m hnn_vi_ros``."""

from hnn_vi_ros.cli import main

if __name__ == '__main__':
    main()
