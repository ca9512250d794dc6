# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Events of a scene on ~/events, in the bag, in the picture and in the end of the run."""

from diagnostic_msgs.msg import DiagnosticArray
from hnn_vi_ros.recording import BagReader
from hnn_vi_ros.ros.replay import picture
from hnn_vi_ros.ros.topics.outputs import EVENTS
import numpy as np
from peer import peer, SIMULATOR, stamp, values_of
from processes import finish, start
from rclpy.serialization import deserialize_message
from recorded import assert_agrees
from scene_files import write_scene

# sin t: upwards through 1/2 at pi/6 + 2 pi k, and at its top at pi/2.
EVENTS_OF_SCENE = """\
events:
  - {when: x = 0.5, direction: up}
  - {when: v_x = 0, then: stop}
"""
EXPECTED = [('x = 0.5', np.pi / 6.0), ('v_x = 0', np.pi / 2.0)]


def values(message: DiagnosticArray) -> dict[str, str]:
    """Return the values of the only status of an event."""
    status, = message.status
    assert status.name == f'{SIMULATOR[1:]}: event'
    assert status.message.startswith(status.values[0].value)
    return values_of(status)


def test_events_are_published_recorded_shown_and_end_the_run(tmp_path, monkeypatch):
    write_scene(tmp_path / 'events.yaml', integrator='gauss8', q=[0.0], p=[1.0],
                more=EVENTS_OF_SCENE)
    process = start(tmp_path, scene='events.yaml', record_path='bag', real_time_factor='0.5')
    with peer() as other:
        heard = other.hear(DiagnosticArray, '~/events', EVENTS.qos)
        other.spin_until(lambda: len(heard) == 2)
        status, output, error = finish(process)
    assert status == 0, output
    # It has ended, not paused.
    assert 'stopped by the event v_x = 0' in error and 'paused' not in error
    reader = BagReader(tmp_path / 'bag')
    channel, = (number for number, channel in reader.channels.items()
                if channel.topic == f'{SIMULATOR}/events')
    recorded = list(reader.messages([channel]))
    assert len(recorded) == 2
    for message, logged, (when, t) in zip(heard, recorded, EXPECTED, strict=True):
        found = values(message)
        assert found['when'] == when
        # To the nanosecond of a stamp; x and H to round-off.
        assert abs(stamp(message) * 1e-9 - t) <= 1.1e-9
        assert abs(float(found['x']) - np.sin(t)) < 1e-13
        assert abs(float(found['H [J]']) - 0.5) < 1e-13
        assert deserialize_message(logged.data, DiagnosticArray) == message
        assert logged.time == stamp(message)
    # The run ends in the step of the event: no sample comes after it.
    assert reader.last <= recorded[-1].time + 10**7
    assert_agrees(tmp_path / 'bag')
    assert_picture_shows(tmp_path, monkeypatch)


def assert_picture_shows(folder, monkeypatch):
    """Show the bag, and compare the times of its events."""
    shown = []

    class Sink(picture.RerunSink):

        def event(self, text, level='INFO', at=None):
            shown.append((text, level, at))
            super().event(text, level, at)

    monkeypatch.setattr(picture, 'RerunSink', Sink)
    samples, _ = picture.write_picture(folder / 'bag', folder / 'bag.rrd')
    assert samples > 100
    # A machine that is busy adds alarms of the pace.
    events = [event for event in shown if not event[0].startswith('real-time overrun')]
    assert [(text.partition(' (')[0], level) for text, level, _ in events] == [
        (when, 'INFO') for when, _ in EXPECTED]
    assert [at[1] for *_, at in events] == [52, 157]
