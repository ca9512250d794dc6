# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
The command ``hnn``: its table of commands, and those without a package of their own.

The other commands are in the packages of their topics: ``learning``, ``identify``, ``sweeps``,
``recording`` and ``ros``.
"""

from typing import TYPE_CHECKING

from hnn_vi_ros.exports import lazy_exports

if TYPE_CHECKING:
    from hnn_vi_ros.commands.table import (
        check_names, COMMANDS, EXECUTABLES, module_of, parser_of, refuse)

__getattr__, __dir__ = lazy_exports(__name__)
