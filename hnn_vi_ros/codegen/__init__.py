# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Code generation: the compiled step of a scene as a library or an FMU, without Python.

``image`` moves the memory of a simulation, ``entries`` are the functions that are exported,
``scene_code`` joins both to an object file, ``project`` writes it with what a C
program needs, and ``fmu`` as an FMU.
"""

from typing import TYPE_CHECKING

from hnn_vi_ros.exports import lazy_exports

if TYPE_CHECKING:
    from hnn_vi_ros.codegen.escaping import escaped, identifier
    from hnn_vi_ros.codegen.fmu import write_fmu
    from hnn_vi_ros.codegen.project import prefix_of, write_project
    from hnn_vi_ros.codegen.scene_code import compile_scene, SceneCode

__getattr__, __dir__ = lazy_exports(__name__)
