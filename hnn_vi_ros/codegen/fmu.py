# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""FMI 3.0: an exported scene as a functional mock-up unit for co-simulation."""

from hashlib import sha256
from io import BytesIO
from pathlib import Path
import subprocess
import tempfile
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

from hnn_vi_ros.codegen.arguments import COMPILERS
from hnn_vi_ros.codegen.escaping import escaped
from hnn_vi_ros.codegen.project import filled, parameter_variable, template_values, write_project
from hnn_vi_ros.codegen.scene_code import distinct, SceneCode
from hnn_vi_ros.files import write_text, written
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation import simulate

# Number of coordinates in the picture.
_MOST_DRAWN = 8


def write_fmu(path: Path, name: str, scene: SceneCode, force: bool = False) -> None:
    """
    Write an exported scene as an FMU.

    Parameters
    ----------
    path : Path
        File to write.
    name : str
        Its model identifier.
    scene : SceneCode
        Its object code.
    force : bool, optional
        True to replace an existing file.

    Raises
    ------
    FileNotFoundError
        There is no C compiler for its system.
    StepFailure
        A step fails in the motion that its picture shows.

    """
    token = f'{{{sha256(scene.code).hexdigest()[:32]}}}'
    values = template_values(name, scene) | {
        'token': token, 'starts': len(scene.starts),
        'early': str(bool(scene.scene.events)).lower(),
        'start_values': ''.join(f'{value!r}, ' for _, value in scene.starts),
        'numbers': len(scene.parameters),
        'number_values': ''.join(f'{one.value!r}, ' for one in scene.parameters)}
    values |= _described(scene)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        write_project(folder, name, scene, force=True)
        write_text(folder / 'fmi3.c', filled('fmi3.c', values))
        subprocess.run([COMPILERS[scene.target], '-std=c11', '-O2', '-shared', '-fPIC',
                        '-fvisibility=hidden', 'fmi3.c', f'lib{name}.a',
                        '-Wl,-z,defs,--exclude-libs,ALL', '-lm', '-o', 'fmu.so'],
                       cwd=folder, check=True)
        contents = {
            'modelDescription.xml': filled('modelDescription.xml', values).encode(),
            f'binaries/{scene.target}/{name}.so': (folder / 'fmu.so').read_bytes(),
            'documentation/index.html': filled('fmu.html', values).encode(),
            'documentation/trajectory.png': _picture(scene.scene)}
        with written(path, new=not force) as stream, ZipFile(stream, 'w', ZIP_DEFLATED) as file:
            for place, content in contents.items():
                # Without the time, equal scenes give equal files.
                file.writestr(ZipInfo(place), content, ZIP_DEFLATED)


def _picture(scene: Scene) -> bytes:
    """Return a picture of the first thousand steps."""
    duration, file = min(scene.duration, 1000 * scene.known_step_size), BytesIO()
    trajectory = simulate(scene, duration=duration)
    trajectory.plot([one.name for one in trajectory.coordinates][:_MOST_DRAWN]).savefig(file)
    return file.getvalue()


def _described(scene: SceneCode) -> dict[str, str]:
    """Return the variables of modelDescription.xml, their units and their structure."""
    rows = [('independent' if one.name == 'time' else 'output', 'discrete' if one.name.startswith(
        'event_') else 'continuous', one, '') for one in scene.outputs]
    rows += [('input', 'continuous', one, ' start="NaN"') for one in scene.inputs]
    rows += [('parameter', 'fixed', one, f' start="{value!r}"') for one, value in scene.starts]
    rows += [(*(('parameter', 'tunable') if one.powers else ('local', 'constant')),
              parameter_variable(one),
              f' start="{one.value!r}"' + f' min="{one.low!r}"' * bool(one.powers))
             for one in scene.parameters]
    # A coordinate may be called effort_x, as the command of x is.
    names = distinct([one.name for _, _, one, _ in rows])
    rows = [(causality, variability, one._replace(name=name), start)
            for (causality, variability, one, start), name in zip(rows, names, strict=True)]
    outputs = [k for k, (causality, *_) in enumerate(rows) if causality == 'output']
    lines = {
        'variables': [
            f'<Float64 name="{escaped(one.name, "xml")}" valueReference="{k}" '
            f'causality="{causality}" variability="{variability}" '
            f'unit="{escaped(one.unit, "xml")}" description="{escaped(one.text, "xml")}"{start}/>'
            for k, (causality, variability, one, start) in enumerate(rows)],
        'units': [f'<Unit name="{escaped(unit, "xml")}"/>'
                  for unit in dict.fromkeys(one.unit for _, _, one, _ in rows)],
        'structure': [f'<{kind} valueReference="{k}"/>'
                      for kind in ('Output', 'InitialUnknown') for k in outputs]}
    return {'description': escaped(scene.scene.description, 'xml'),
            'title': escaped(scene.scene.description or scene.scene.name, 'xml'),
            'duration': repr(scene.scene.duration)} | {
                key: '\n    '.join(own) for key, own in lines.items()}
