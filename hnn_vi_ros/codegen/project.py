# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Files of an exported scene: archive, shared library, header, example and build files."""

from collections.abc import Mapping
from pathlib import Path
import re
import shutil
from string import Template
import subprocess
from tempfile import TemporaryDirectory

from hnn_vi_ros.codegen.arguments import COMPILERS, HOST
from hnn_vi_ros.codegen.escaping import escaped, identifier
from hnn_vi_ros.codegen.parameters import Parameter
from hnn_vi_ros.codegen.scene_code import distinct, SceneCode, Variable
from hnn_vi_ros.files import make_folder, share_folder, write_bytes
from hnn_vi_ros.kernels import processor
from hnn_vi_ros.version import __version__

# Headers, libraries and functions of C that NAME.h, libNAME.a and NAME_init would replace, and
# names that CMake reserves.
_TAKEN = re.compile(
    'assert|complex|ctype|errno|fenv|float|inttypes|iso646|limits|locale|math|setjmp|signal|'
    'std(align|arg|atomic|bool|def|int|io|lib|noreturn)|string|tgmath|threads|time|uchar|wchar|'
    'wctype|c|dl|gcc|m|pthread|rt|cnd|mtx|sem|all|clean|help|install')
FUNCTIONS = ('init', 'start', 'tune', 'step', 'energy', 'outputs', 'save', 'restore')


def prefix_of(name: str) -> str:
    """Return the name of a scene's files, which is also the prefix of its functions."""
    prefix = identifier(name)
    return f'{prefix}_scene' if _TAKEN.fullmatch(prefix) else prefix


def archive(name: str, code: bytes) -> bytes:
    """Return a static library of one object file, with an index, in the format of ar."""
    symbols = b''.join(f'{name}_{function}'.encode() + b'\0' for function in FUNCTIONS)
    symbols += b'\0' * (len(symbols) % 2)
    index_size = 4 * (1 + len(FUNCTIONS)) + len(symbols)
    # The object follows the magic number, the header of the index, and the index.
    place = (8 + 60 + index_size).to_bytes(4, 'big')
    index = len(FUNCTIONS).to_bytes(4, 'big') + place * len(FUNCTIONS) + symbols

    def member(title: str, content: bytes) -> bytes:
        head = f'{title:16}{0:<12}{0:<6}{0:<6}{"100644":8}{len(content):<10}`\n'
        return head.encode() + content + b'\n' * (len(content) % 2)
    return b'!<arch>\n' + member('/', index) + member('scene.o/', code)


def write_project(folder: Path, name: str, scene: SceneCode, force: bool = False) -> list[Path]:
    """
    Write the files of an exported scene.

    Parameters
    ----------
    folder : Path
        Folder, which is created.
    name : str
        Prefix of its functions.
    scene : SceneCode
        Its object code.
    force : bool, optional
        True if the folder may exist, and its files are replaced.

    Returns
    -------
    list of Path
        The files; without the shared library if there is no C compiler.

    Raises
    ------
    OSError
        The folder exists, or a file cannot be written.

    """
    contents, compiler = {f'lib{name}.a': archive(name, scene.code)}, COMPILERS[scene.target]
    if shutil.which(compiler):
        # Elsewhere, so that a compiler that fails leaves no folder.
        with TemporaryDirectory() as temporary:
            library, shared = Path(temporary, 'lib.a'), Path(temporary, 'shared')
            write_bytes(library, contents[f'lib{name}.a'])
            subprocess.run([compiler, '-shared', '-s', '-o', shared, '-Wl,-z,defs,--whole-archive',
                            library, '-Wl,--no-whole-archive', '-lm'], check=True)
            contents[f'{name}.so'] = shared.read_bytes()
    values = template_values(name, scene) | {
        'shared': f', `{name}.so`' if len(contents) > 1 else ''}
    for source, target in (('scene.h', f'{name}.h'), ('example.c', 'example.c'),
                           ('CMakeLists.txt', 'CMakeLists.txt'), ('README.md', 'README.md')):
        contents[target] = filled(source, values).encode()
    make_folder(folder, new=not force)
    for target, content in contents.items():
        write_bytes(folder / target, content)
    return [folder / target for target in contents]


def filled(template: str, values: Mapping[str, object]) -> str:
    """Return a template with the values of its names."""
    path = share_folder() / 'config/templates/export' / template
    return Template(path.read_text(encoding='utf-8')).substitute(values)


def template_values(name: str, scene: SceneCode) -> dict[str, object]:
    """Return the values of the names in templates."""
    own, upper = scene.scene, identifier(name).upper()
    timeout = scene.machine.inputs.timeout
    return {
        'name': name, 'NAME': upper, 'version': __version__, 'compiler': COMPILERS[
            scene.target], 'processor': processor() if scene.target == HOST else scene.target,
        'title': escaped(own.description or own.name, 'comment'), 'step_size': own.step_size,
        'paragraph': escaped(own.description or own.name, 'markdown'),
        'integrator': own.integrator.kind, 'on_failure': own.on_failure,
        'timeout': f'{timeout:g} s', 'words': scene.image.words.size,
        'saved': 1 + scene.image.words.size - scene.image.changing,
        'q_size': scene.machine.outputs.q_size, 'p_size': scene.machine.outputs.p_size,
        'inputs': _enumerated(f'{upper}_IN', scene.inputs),
        'outputs': _enumerated(f'{upper}_OUT', scene.outputs),
        'parameters': _enumerated(f'{upper}_PARAMETER', [
            parameter_variable(one) for one in scene.parameters if one.powers]),
        'names': ', '.join(f'"{escaped(f"{one.name} [{one.unit}]", "string")}"'
                           for one in scene.outputs)}


def parameter_variable(parameter: Parameter) -> Variable:
    """Return the name, unit and description of a number of a scene."""
    return Variable(parameter.name, 'SI', f'{parameter.value:g} in the scene')


def _enumerated(prefix: str, variables: list[Variable]) -> str:
    names = distinct([identifier(one.name).upper() for one in variables])
    return '\n'.join(f'  {prefix}_{name}, /* {escaped(f"{one.text} [{one.unit}]", "comment")} */'
                     for name, one in zip(names, variables, strict=True))
