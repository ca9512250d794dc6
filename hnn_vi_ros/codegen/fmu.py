# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""FMI 3.0: an exported scene as a functional mock-up unit for co-simulation."""

from hashlib import sha256
from pathlib import Path
import platform
import subprocess
import tempfile
from xml.sax.saxutils import quoteattr
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

from hnn_vi_ros.codegen.project import filled, template_values, write_project
from hnn_vi_ros.codegen.scene_code import SceneCode


def write_fmu(path: Path, name: str, scene: SceneCode) -> None:
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

    Raises
    ------
    FileNotFoundError
        There is no C compiler ``cc``.

    """
    token = f'{{{sha256(scene.code).hexdigest()[:32]}}}'
    values = template_values(name, scene) | {
        'token': token, 'starts': len(scene.starts),
        'start_values': ''.join(f'{value!r}, ' for _, value in scene.starts)}
    values |= _described(scene)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        write_project(folder, name, scene)
        (folder / 'fmi3.c').write_text(filled('fmi3.c', values), encoding='utf-8')
        subprocess.run(['cc', '-std=c11', '-O2', '-shared', '-fPIC', '-fvisibility=hidden',
                        'fmi3.c', f'lib{name}.a', '-Wl,--exclude-libs,ALL', '-lm', '-o', 'fmu.so'],
                       cwd=folder, check=True)
        contents = {
            'modelDescription.xml': filled('modelDescription.xml', values).encode(),
            f'binaries/{platform.machine()}-linux/{name}.so': (folder / 'fmu.so').read_bytes(),
            'documentation/index.html': filled('fmu.html', values).encode()}
        with ZipFile(path, 'w', ZIP_DEFLATED) as file:
            for place, content in contents.items():
                # Without the time, equal scenes give equal files.
                file.writestr(ZipInfo(place), content, ZIP_DEFLATED)


def _described(scene: SceneCode) -> dict[str, str]:
    """Return the variables of modelDescription.xml, their units and their structure."""
    rows = [('independent' if one.name == 'time' else 'output', one, '') for one in scene.outputs]
    rows += [('input', one, ' start="NaN"') for one in scene.inputs]
    rows += [('parameter', one, f' start="{value!r}"') for one, value in scene.starts]
    outputs = [k for k, (causality, _, _) in enumerate(rows) if causality == 'output']
    lines = {
        'variables': [
            f'<Float64 name={quoteattr(one.name)} valueReference="{k}" causality="{causality}" '
            f'variability="{"fixed" if causality == "parameter" else "continuous"}" '
            f'unit={quoteattr(one.unit)} description={quoteattr(one.text)}{start}/>'
            for k, (causality, one, start) in enumerate(rows)],
        'units': [f'<Unit name={quoteattr(unit)}/>'
                  for unit in dict.fromkeys(one.unit for _, one, _ in rows)],
        'structure': [f'<{kind} valueReference="{k}"/>'
                      for kind in ('Output', 'InitialUnknown') for k in outputs]}
    return {'description': quoteattr(scene.scene.description),
            'duration': repr(scene.scene.duration)} | {
                key: '\n    '.join(own) for key, own in lines.items()}
