# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Export a scene as a C library or an FMU."""

import os
from pathlib import Path
import shutil
from subprocess import CalledProcessError
import sys

from hnn_vi_ros.codegen import arguments
from hnn_vi_ros.codegen.arguments import COMPILERS, HOST, PROCESSORS
from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.files import check_new
from hnn_vi_ros.scene import load_scene
from llvmlite.binding import get_host_cpu_features


def main(argv: list[str]) -> int:
    """Compile the scene, and write the files."""
    options = arguments.export().parse_args(argv)
    _choose_processor(options.cpu, options.target)
    compiler = COMPILERS[options.target]
    if options.out is None and options.fmu is None:
        raise ParameterError('name what to write: --out DIR or --fmu FILE')
    for option, path, fits in (('--out', options.out, Path.is_dir),
                               ('--fmu', options.fmu, Path.is_file)):
        if path is not None and not (options.force and fits(path)):
            check_new(option, path, ', or add --force' * (not options.force))
    compiles = shutil.which(compiler) is not None
    if options.fmu is not None and not (compiles and options.fmu.suffix == '.fmu'):
        raise ParameterError(f'--fmu {options.fmu}: needs a name that ends in .fmu, and a C '
                             f'compiler {compiler}, which --out does not need')
    # Imported after the choice of the processor, which the compiler reads once.
    from hnn_vi_ros.codegen.fmu import write_fmu
    from hnn_vi_ros.codegen.project import prefix_of, write_project
    from hnn_vi_ros.codegen.scene_code import compile_scene
    scene = load_scene(options.scene)
    name = prefix_of(scene.name)
    code = compile_scene(scene, name, options.target, lambda: print(
        f'compiling {name}: about a minute', file=sys.stderr))
    try:
        written = [] if options.out is None else write_project(
            options.out, name, code, options.force)
        if options.fmu is not None:
            write_fmu(options.fmu, name, code, options.force)
            written.append(options.fmu)
    except CalledProcessError as problem:
        raise ParameterError(f'{compiler}: failed with status {problem.returncode}, see above; '
                             'install a C compiler with the headers and libraries of C'
                             ) from problem
    for path in written:
        print(path)
    if not compiles:
        print(f'no C compiler {compiler}: {name}.so is not written')
    return 0


def _choose_processor(name: str, target: str) -> None:
    """Set the processor for which functions are compiled, or raise ParameterError."""
    if target != HOST:
        if name != 'host':
            raise ParameterError(f'--cpu {name}: chooses among processors of {HOST}; remove it, '
                                 f'or --target {target}')
        # Code for all processors of this kind names no special instruction.
        name = 'generic'
    elif name == 'host':
        return
    features = get_host_cpu_features()
    missing = [feature for feature in PROCESSORS.get(name, ()) if not features.get(feature)]
    if missing:
        raise ParameterError(f'--cpu {name}: this processor has no {", ".join(missing)}, and the '
                             'initial state is computed here; choose an older one')
    os.environ |= {'NUMBA_CPU_NAME': name, 'NUMBA_CPU_FEATURES': ''}
