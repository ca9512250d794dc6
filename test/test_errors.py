# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of errors: one short line, whatever they quote."""

import pickle

from hnn_vi_ros.errors import listed, ModelError, SceneError


def test_list_of_many_names_ends_with_how_many_more_there_are():
    numbers = ', '.join(map(str, range(20)))
    for names, text in (
            ([], ''), (['a'], 'a'), (range(3), '0, 1, 2'), ({'x': 1.0, 'y': 2.0}, 'x, y'),
            ((f'{i}' for i in range(20)), numbers),
            (range(14_000), f'{numbers}, ... (13980 more)')):
        assert listed(names) == text


def test_message_keeps_its_begin_and_its_end_whatever_it_quotes():
    error = ModelError(f'robot.urdf:7: no link {"x" * 10**6!r}; give one that there is')
    text = str(error)
    assert len(text) < 2010
    assert text.startswith("robot.urdf:7: no link 'xxx") and ' ... x' in text
    assert text.endswith("x'; give one that there is")
    assert str(pickle.loads(pickle.dumps(error))) == text
    assert str(SceneError('x' * 2000)) == 'x' * 2000
