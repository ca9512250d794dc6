# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A list of sinks: each gets everything, and one that fails is given up until it is reopened."""

from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.ros.recording import RunRecording, Sink
from hnn_vi_ros.ros.settings import Settings
from hnn_vi_ros.run import RunFiles
import pytest

ALL = [('write', (None, ())), ('write_other', (None, 0, b'')), ('event', ('text', 'INFO')),
       ('timing', (None,)), ('flush', ())]


def sink_of(name: str, fails_at: str = '') -> Mock:
    sink = Mock(spec=Sink, target=f'{name}.file', greeting='')
    sink.name = name
    sink.open.return_value = True
    sink.files.return_value = [name]
    if fails_at:
        getattr(sink, fails_at).side_effect = RecordingError(f'{name} is full')
    return sink


def recording_of(*sinks: Mock) -> RunRecording:
    recording = RunRecording(Mock(), SimpleNamespace(name='scene'),
                             Mock(**{'snapshot.return_value': {}}),
                             Settings(record=False, rerun_sink='none'), None, None, {}, None)
    recording._sinks = sinks
    recording.renew(None, {}, None)
    return recording


@pytest.mark.parametrize('method, values', ALL, ids=[name for name, _ in ALL])
def test_sink_that_fails_is_given_up_and_the_others_go_on(method, values, capsys):
    sinks = sink_of('first'), sink_of('bad', method), sink_of('last')
    recording = recording_of(*sinks)
    assert recording.targets == {name: f'{name}.file' for name in ('first', 'bad', 'last')}
    for _ in range(2):
        getattr(recording, method)(*values)
    assert [getattr(sink, method).call_count for sink in sinks] == [2, 1, 2]
    assert (recording.problem, list(recording.targets)) == ('bad is full', ['first', 'last'])
    recording._logger.error.assert_called_once_with('bad is full; the simulation continues')
    # All are opened again, and closed once each.
    recording.renew(None, {}, None)
    assert list(recording.targets) == ['first', 'bad', 'last']
    assert not recording.close()
    assert [sink.close.call_count for sink in sinks] == [2, 1, 2]
    assert recording.targets == {}
    recording.report()
    assert capsys.readouterr().out.endswith('first\nbad\nlast\n')


def test_sink_that_cannot_be_opened_or_closed_stops_no_other():
    sinks = sink_of('bad', 'open'), sink_of('worse', 'close'), sink_of('good')
    recording = recording_of(*sinks)
    assert list(recording.targets) == ['worse', 'good']
    assert recording.problem == 'bad is full'
    assert not recording.close()
    assert recording.problem == 'worse is full'
    recording._logger.error.assert_called_with('worse is full')
    assert [sink.close.call_count for sink in sinks] == [0, 1, 1]


def test_sink_that_is_not_wanted_is_left_alone():
    sink = sink_of('unwanted')
    sink.open.return_value = False
    recording = recording_of(sink)
    recording.write(None, ())
    assert recording.close()
    assert (recording.samples, sink.write.called, sink.close.called) == (1, False, False)


def test_names_of_files_are_those_asked_for_then_with_a_number(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'a-2.rrd').touch()
    files = RunFiles()
    names = [files.free('a.rrd', 'default', 'scene') for _ in range(2)]
    assert names == [tmp_path / 'a.rrd', tmp_path / 'a-3.rrd']
    bags = [files.free('', 'bag', 'scene') for _ in range(2)]
    folder, = (tmp_path / 'runs').iterdir()
    assert bags == [folder / 'bag', folder / 'bag-2']
