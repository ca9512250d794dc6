# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Pictures of bags: what ``replay --rerun`` writes."""

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from hnn_vi_ros import load_scene
from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.ros.replay.picture import Picture, write_picture
from hnn_vi_ros.ros.replay.command import main
from messages import assert_message, refused
import numpy as np
from processes import finish, read_bag, refusal, start
import pytest
from recorded import as_received, record_run
from rerun_reader import read
from scene_files import write_scene
from test_health import events_of


@pytest.mark.parametrize('kind', ['own', 'of another recorder'])
def test_picture_has_the_very_samples_of_a_bag(tmp_path, capsys, kind):
    samples = {}
    bag = record_run(tmp_path / 'bag', load_scene('exact_pendulum'), 300,
                     change=lambda sample: samples.setdefault(sample.step, sample))
    if kind == 'of another recorder':
        bag = as_received(bag, tmp_path / 'a.mcap')
    assert main([str(bag), '--rerun', str(tmp_path / 'a.rrd')]) == 0
    assert capsys.readouterr().out == f'{tmp_path / "a.rrd"}: 300 samples\n'
    entities = read(tmp_path / 'a.rrd')
    steps = entities['/state/q']['step']
    # 30 of 3 s each, and the last sample.
    assert 90 <= len(steps) <= 92 and steps[-1] == max(samples)
    for entity, name in (('/state/q', 'q'), ('/state/p', 'p'), ('/energy/H', 'energy'),
                         ('/energy/error', 'energy_error'),
                         ('/energy/modified', 'modified_energy')):
        found = [row[0] for row in entities[entity]['Scalars:scalars']]
        expected = [float(np.ravel(getattr(samples[step], name))[0]) for step in steps]
        # Of H0 and the modified energy, sums of a few terms: a few units in the last place.
        assert np.allclose(found, expected, rtol=4e-15, atol=4e-15), entity
    assert [row[0] for row in entities['/state/q']['Scalars:scalars']] == [
        samples[step].q[0] for step in steps]


def test_picture_has_the_mechanism_and_the_alarms_of_a_simulator(tmp_path):
    # At a step that does not resolve the close encounters.
    write_scene(tmp_path / 'kepler.yaml', 'kepler, mu: 1.0', '', 'variational_euler',
                q=[1.9, 0.0], p=[0.0, 0.22941573387056177], more='mechanism: kepler\n')
    status, _, said = finish(start(tmp_path, scene='kepler.yaml', duration=9, real_time_factor=3,
                                   record_path='bag'))
    assert status == 0 and 'under-resolved: t = ' in said
    write_picture(tmp_path / 'bag', tmp_path / 'a.rrd')
    entities = read(tmp_path / 'a.rrd')
    steps = entities['/state/q']['step']
    assert steps == sorted(set(steps)) and len(steps) > 180
    assert any(name.startswith('/world/') for name in entities)
    # A busy machine may have added alarms of overruns.
    alarms = [(stamp, 'WARN', f'under-resolved: {message.status[0].message}')
              for stamp, message in read_bag(tmp_path / 'bag')['/diagnostics']
              if ('alarm', 'under-resolved') in (
                  (item.key, item.value) for item in message.status[0].values)]
    shown = [event for event in events_of(tmp_path / 'a.rrd')
             if event[2].startswith('under-resolved')]
    assert shown == alarms != []


def test_message_that_cannot_be_shown_is_refused(tmp_path):
    picture = Picture(load_scene('exact_pendulum'), tmp_path / 'a.rrd', 'a', '/hnn_simulator')
    with pytest.raises(ValueError, match='fast'):
        picture.tell(DiagnosticArray(status=[DiagnosticStatus(
            name='hnn_simulator: timing',
            values=[KeyValue(key='real_time_factor', value='fast')])]))
    picture.close()


def test_mistake_is_one_line(tmp_path):
    bag = record_run(tmp_path / 'bag', load_scene('exact_pendulum'), 2)
    write_picture(bag, tmp_path / 'a.rrd')
    with refused(RecordingError):
        write_picture(bag, tmp_path / 'a.rrd')
    for words in (['nothing', '--rerun', 'b.rrd'], [bag, '--rerun', 'b.rrd', '--verify'],
                  [bag, '--rerun', 'b.rrd', '--rate', 2]):
        assert_message(refusal('replay', *words))
