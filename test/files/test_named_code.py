# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Code that scenes of several folders name."""

from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.scene import load_scene
from messages import refused
import pytest
from scene_files import write_scene

CODE = """from hnn_vi_ros.hamiltonians.harmonic_oscillator import HarmonicOscillator


def make():
    return HarmonicOscillator(stiffness={stiffness})
"""


def scene_with(folder, module, stiffness):
    """Return the file of a scene beside the module that it names."""
    folder.mkdir(exist_ok=True)
    (folder / f'{module}.py').write_text(CODE.format(stiffness=stiffness))
    return write_scene(folder / f'{module}.yaml', f"python, factory: '{module}:make'")


def stiffness_of(file):
    return load_scene(file).create_hamiltonian().stiffness


def test_a_module_of_another_scene_is_not_taken_in_silence(tmp_path):
    assert stiffness_of(scene_with(tmp_path / 'a', 'spring_one', 1.0)) == 1.0
    other = scene_with(tmp_path / 'b', 'spring_one', 4.0)
    with refused(HnnViRosError):
        stiffness_of(other)


def test_the_module_beside_the_scene_comes_before_those_beside_others(tmp_path):
    first = scene_with(tmp_path / 'a', 'spring_two', 1.0)
    scene_with(tmp_path / 'a', 'spring_three', 1.0)
    assert stiffness_of(first) == 1.0
    assert stiffness_of(scene_with(tmp_path / 'b', 'spring_three', 4.0)) == 4.0


def test_what_the_named_module_imports_is_not_of_another_scene(tmp_path):
    for folder, stiffness in ('a', 1.0), ('b', 4.0):
        scene_with(tmp_path / folder, f'spring_of_{folder}', stiffness)
        (tmp_path / folder / 'shared_helper.py').write_text(f'stiffness = {stiffness}\n')
        code = tmp_path / folder / f'spring_of_{folder}.py'
        code.write_text('import shared_helper\n' + code.read_text().replace(
            str(stiffness), 'shared_helper.stiffness'))
    assert stiffness_of(tmp_path / 'a' / 'spring_of_a.yaml') == 1.0
    with refused(HnnViRosError):
        stiffness_of(tmp_path / 'b' / 'spring_of_b.yaml')


def test_a_module_that_is_installed_is_not_taken_for_the_one_beside_the_scene(tmp_path):
    with pytest.raises(HnnViRosError, match='colorsys was imported from .* is another'):
        stiffness_of(scene_with(tmp_path, 'colorsys', 1.0))


def test_a_copy_of_a_scene_and_its_code_is_taken(tmp_path):
    for folder in 'ab':
        assert stiffness_of(scene_with(tmp_path / folder, 'spring_four', 2.0)) == 2.0
