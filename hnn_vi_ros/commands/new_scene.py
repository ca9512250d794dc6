# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Write a scene file to begin from: a copy of a shipped one, which editors check."""

import re

from hnn_vi_ros.command_line import command
from hnn_vi_ros.commands import arguments
from hnn_vi_ros.files.regular_file import write_new_scene
from hnn_vi_ros.files.resources import share_folder
from hnn_vi_ros.scene import load_scene

# The line by which editors find the schema; shipped scenes name it by a relative path.
_SCHEMA = re.compile(r'(?m)^# yaml-language-server: \$schema=.*$')


def main(argv: list[str]) -> int:
    """Write the file, and print what can be done with it."""
    options = arguments.new_scene().parse_args(argv)
    path = options.file if options.file.suffix in ('.yaml', '.yml') else \
        options.file.with_name(f'{options.file.name}.yaml')
    scene = load_scene(options.like)
    schema = f'# yaml-language-server: $schema={share_folder() / "config" / "scene.schema.json"}'
    text = _SCHEMA.sub(lambda line: schema, scene.source.read_text(encoding='utf-8'))
    for name, file in scene.model_files().items():
        # Paths relative to the folder of the original would not be found from the copy.
        if '/' in name and '://' not in name:
            text = text.replace(name, str(file.resolve()))
    write_new_scene(path, text)
    print(path)
    print(f'  change it; check it by: {command(f"scene --check {path}")}')
    print(f'  run it by: {command(f"run {path}")}')
    return 0
