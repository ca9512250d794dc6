# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Scenes described by a log or a topic, possibly by an untrusted author."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files import parse_mapping, validate
from hnn_vi_ros.scene.choices import AutoChoice
from hnn_vi_ros.scene.origin import Origin
from hnn_vi_ros.scene.scene import Scene

# Remedy for a bag of several runs.
ONE_RUN = ('cut it there with `mcap filter`, and give the part of one run; the simulator starts a '
           'new bag at each reset')


def described_scene(text: bytes | str, where: str, trust_code: bool = False
                    ) -> tuple[Scene, dict[str, Any]]:
    """
    Return the scene described by a log or ~/scene, and the rest of the description.

    The description cannot choose code to run or files to open here. Named code is rejected unless
    trusted, and then comes only from the path of Python's modules. Model files must match the
    digests in the description.

    Parameters
    ----------
    text : bytes or str
        YAML.
    where : str
        Source of the description, for error messages.
    trust_code : bool, optional
        True to allow Python code named in it.

    Raises
    ------
    RecordingError
        The text is not a scene, or names code; one line.

    """
    described, places = parse_mapping(text, where, RecordingError)
    fields = {name: value for name, value in described.items() if name in Scene.model_fields}
    scene = validate(fields, places, Scene, RecordingError, trust_code=trust_code)
    if isinstance(scene.integrator, AutoChoice):
        raise RecordingError(f'{places.place("integrator")}: does not contain the choice of auto')
    # Find models next to the scene again, relative to the current folder.
    source = str(described.get('source', 'scene'))
    files = described.get('model_files', {})
    digests = [described.get('model_sha256'), *(files.values() if isinstance(files, dict) else ())]
    scene._origin = Origin(
        Path(source if source.isprintable() else 'scene'), places,
        digests=frozenset(digest for digest in digests if isinstance(digest, str)))
    return scene, described


def only_scene(texts: Iterable[tuple[str, int]], topic: str, bag: Path) -> str:
    """
    Return the only scene that was published while a bag was recorded.

    Parameters
    ----------
    texts : iterable of (str, int)
        Texts and log times [ns]; a text may be repeated.
    topic : str
        Topic of the texts.
    bag : Path
        Path of the bag, for error messages.

    Raises
    ------
    RecordingError
        There is no scene, or there are several.

    """
    times: dict[str, int] = {}
    for text, time in texts:
        times.setdefault(text, time)
    if not times:
        raise RecordingError(f'{bag}: contains neither a scene.yaml nor a message of {topic}; '
                             'record that topic too')
    text, *others = times
    if others:
        resets = ', '.join(str(times[other]) for other in others[:3])
        raise RecordingError(f'{bag}: contains {len(times)} scenes on {topic}: the run was reset '
                             f'at log time {resets} ns: {ONE_RUN}')
    return text
