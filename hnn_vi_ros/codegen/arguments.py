# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The command line of ``export``; imports none of the modules that do the work."""

from pathlib import Path
import platform

from hnn_vi_ros.files import complete_by, Parser

# Processors that code can be for, with the features of each that LLVM names.
PROCESSORS = {
    'host': (), 'x86-64': (), 'x86-64-v2': ('popcnt', 'sse4.2'),
    'x86-64-v3': ('avx2', 'bmi2', 'fma'), 'x86-64-v4': ('avx512bw', 'avx512dq', 'avx512vl')}

HOST = f'{platform.machine()}-linux'
# C compiler of each system that code can be for.
COMPILERS = {'x86_64-linux': 'x86_64-linux-gnu-gcc', 'aarch64-linux': 'aarch64-linux-gnu-gcc',
             HOST: 'cc'}


def export() -> Parser:
    """Return the parser of ``export``."""
    parser = Parser('export', (
        'Write the compiled step of a scene as a C library or an FMU. Programs that use it need '
        'neither Python nor this package.'), [
            'hnn export pendulum --out pendulum_c',
            'hnn export pendulum --fmu pendulum.fmu',
            'hnn export my_arm.yaml --out arm_c --cpu x86-64-v3',
            'hnn export pendulum --out pendulum_c --target aarch64-linux'])
    complete_by(parser.add_argument('scene', metavar='SCENE', help=(
        'name of a shipped scene (see hnn list scenes), or a YAML file')), 'scene')
    parser.add_argument('--out', type=Path, metavar='DIR', help=(
        'folder of the C library, its header, an example, CMakeLists.txt and README'))
    parser.add_argument('--fmu', type=Path, metavar='FILE', help=(
        'file of an FMI 3.0 unit for co-simulation (.fmu); needs a C compiler cc'))
    parser.add_argument('--target', choices=COMPILERS, default=HOST, metavar='SYSTEM', help=(
        f'system that runs the code: {", ".join(COMPILERS)} (default: this one, {HOST})'))
    parser.add_argument('--cpu', choices=PROCESSORS, default='host', metavar='NAME', help=(
        f'processor that runs the code: {", ".join(PROCESSORS)} (default: host, this one, whose '
        'results are those of `simulate` bit by bit)'))
    parser.add_argument('--force', action='store_true', help='overwrite existing files')
    return parser
