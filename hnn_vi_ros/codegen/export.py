# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Export a scene as a C library."""

import os
import shutil

from hnn_vi_ros.codegen import arguments
from hnn_vi_ros.codegen.arguments import PROCESSORS
from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.scene import load_scene
from llvmlite.binding import get_host_cpu_features


def main(argv: list[str]) -> int:
    """Compile the scene, and write the files."""
    options = arguments.export().parse_args(argv)
    _choose_processor(options.cpu)
    if options.out.exists() and not options.force:
        raise ParameterError(f'--out {options.out}: exists already; name another one, or add '
                             '--force')
    # Imported after the choice of the processor, which the compiler reads once.
    from hnn_vi_ros.codegen.project import identifier, write_project
    from hnn_vi_ros.codegen.scene_code import compile_scene
    scene = load_scene(options.scene)
    name = identifier(scene.name)
    code = compile_scene(scene, name)
    try:
        written = write_project(options.out, name, code)
    except OSError as problem:
        raise ParameterError(f'{problem.filename}: cannot be written ({problem.strerror}); name '
                             'another place') from problem
    for path in written:
        print(path)
    if shutil.which('cc') is None:
        print(f'no C compiler cc: {name}.so is not written')
    return 0


def _choose_processor(name: str) -> None:
    """Set the processor for which functions are compiled, or raise ParameterError."""
    if name == 'host':
        return
    features = get_host_cpu_features()
    missing = [feature for feature in PROCESSORS[name] if not features.get(feature)]
    if missing:
        raise ParameterError(f'--cpu {name}: this processor has no {", ".join(missing)}, and the '
                             'initial state is computed here; choose an older one')
    os.environ |= {'NUMBA_CPU_NAME': name, 'NUMBA_CPU_FEATURES': ''}
