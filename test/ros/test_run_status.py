# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The statuses on /diagnostics reach other nodes, and are right when something is wrong."""

from collections.abc import Iterator
import time
from types import SimpleNamespace

from diagnostic_msgs.msg import DiagnosticArray
from executables import Executable
from hnn_vi_ros import load_scene
from hnn_vi_ros.errors import RecordingError, StepFailure
from hnn_vi_ros.ros.recording import RunRecording
from hnn_vi_ros.ros.run.health import Health, RunStatus, STEP_FAILED
from hnn_vi_ros.ros.settings import Settings
from hnn_vi_ros.ros.topics.diagnostics import ERROR, OK, WARN
from hnn_vi_ros.run import Monitor, Sampler
from hnn_vi_ros.simulation import build, PathReport, Tolerance
from peer import hearing, values_of
from processes import finish, read_bag, start
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from std_msgs.msg import Float64MultiArray

COMPONENTS = ['timing', 'integrator', 'energy', 'recorder', 'model', 'health']


@pytest.fixture
def received() -> Iterator[tuple[list[DiagnosticArray], SingleThreadedExecutor]]:
    """Give what another node hears on /diagnostics, and its executor."""
    with hearing(DiagnosticArray, '/diagnostics') as heard:
        yield heard


def listen(process: Executable, executor: SingleThreadedExecutor) -> int:
    while process.poll() is None:
        executor.spin_once(timeout_sec=0.05)
    # A busy listener has more to read, until nothing comes for a while.
    waited = 0.0
    while waited < 0.5:
        begin = time.monotonic()
        executor.spin_once(timeout_sec=0.5)
        waited = time.monotonic() - begin
    return finish(process)[0]


def test_diagnostics_reach_another_node_with_every_status_and_its_figures(tmp_path, received):
    messages, executor = received
    node, = executor.get_nodes()
    accuracy: list[Float64MultiArray] = []
    node.create_subscription(Float64MultiArray, '/hnn_simulator/accuracy', accuracy.append, 3000)
    begin = time.monotonic()
    process = start(tmp_path, duration=25, real_time_factor=8, discovery_time=5, record_path='bag',
                    publish_accuracy='true')
    assert listen(process, executor) == 0
    seconds = time.monotonic() - begin
    # What a busy machine makes the node report at once, a real-time overrun, comes by itself.
    messages = [message for message in messages if len(message.status) > 1]
    # One a second, and one at the end. The run takes 3 s, or longer where a busy machine makes it
    # give up time; a late timer may cost some.
    overruns = int(values_of(messages[-1].status[0])['overruns [1]'])
    assert 3 <= len(messages) <= (seconds + 1.0 if overruns else 5)
    for message in messages:
        assert [status.name for status in message.status] == [
            f'hnn_simulator: {component}' for component in COMPONENTS]
        assert {status.hardware_id for status in message.status} == {'exact_harmonic_oscillator'}
        assert (message.header.stamp.sec, message.header.stamp.nanosec) > (0, 0)
    timing, integrator, energy, recorder, model, health = map(values_of, messages[-1].status)
    median, p99 = (float(timing[f'microseconds_per_step_{name} [us]'])
                   for name in ('median', 'p99'))
    assert 0.0 < median <= p99 < 1e6
    assert float(timing['microseconds_per_sample [us]']) > 0.0
    assert 0.0 < float(timing['real_time_factor [1]']) < 100.0
    assert float(timing['largest_real_time_factor [1]']) > 0.0
    assert timing['real_time_factor_asked_for [1]'] == '8'
    assert int(timing['overruns [1]']) >= 0
    assert integrator['integrator'] == 'variational_euler'
    assert (integrator['steps [1]'], integrator['step_size [s]']) == ('2500', '0.01')
    # One gradient a step: H separates.
    assert 1.0 <= float(integrator['gradients_per_step [1]']) <= 3.0
    assert 1 <= int(integrator['gradients_of_the_costliest_step [1]']) <= 5
    # H is off by h / 2 at most, H~ by h^2 / 8 relative to it; rounded to six digits.
    assert abs(float(energy['energy_error [1]'])) <= 5.1e-3
    assert 0.0 < float(energy['modified_energy_band [J]']) <= 0.01 ** 2
    # What an oscillation of 5e-3 may leave in a slope over 25 s, 12 A / (w T^2), twice.
    assert abs(float(energy['drift_per_hour [1/h]'])) <= 3600.0 * 24.0 * 5e-3 / (2.0 * 25.0 ** 2)
    assert health['watched'] == ('step failed, under-resolved, energy not accounted for, '
                                 'slow step, saddle not resolved, path not resolved, '
                                 'pole crossed, rescued steps, real-time overrun')
    assert recorder == {'bag': str(tmp_path / 'bag'), 'samples [1]': '2500'}
    assert model['hamiltonian'] == 'harmonic_oscillator' and model['coordinates'] == 'x'
    # A busy listener may lose some; the bag has all.
    recorded = read_bag(tmp_path / 'bag')['/hnn_simulator/accuracy']
    assert len(recorded) == 2500 and recorded[-1][1].data.tolist() == list(accuracy[-1].data)
    labels = accuracy[-1].layout.dim[0].label.split(',')
    figures = dict(zip(labels, accuracy[-1].data, strict=True))
    # Of the same sample and the same window; rounded to six digits there.
    told = {key.partition(' ')[0]: float(value) for status in (timing, integrator, energy)
            for key, value in status.items() if key.partition(' ')[0] in figures}
    assert told.keys() == {
        'H', 'modified_H', 'work', 'energy_error', 'energy_scale', 'residual',
        'modified_energy_band',
        'drift_per_hour', 'microseconds_per_step_median', 'microseconds_per_step_p99',
        'gradients_per_step', 'largest_real_time_factor'}
    assert told == pytest.approx({name: figures[name] for name in told}, rel=1e-5)


class Run:
    """The parts of a run, without a node."""

    def __init__(self, tolerance: Tolerance | None = None, factor: float = 1.0):
        scene = load_scene('exact_harmonic_oscillator')
        self.simulation = build(scene)
        self.sampler = Sampler(self.simulation, 100.0)
        self.warnings: list[tuple[str, bool]] = []
        self.monitor = Monitor(
            self.simulation, self.sampler.every, self.sampler.tick, tolerance,
            lambda text, first: self.warnings.append((text, first)))
        settings = Settings(record=False, rerun_sink='none')
        self.recording = RunRecording(
            rclpy.logging.get_logger('test'), scene, self.simulation, settings, None, None, {},
            self.sampler)
        self.health = Health(self.sampler.stamp_at, [], SimpleNamespace(
            publish=lambda statuses, stamp: None), self.recording, lambda *line: None)
        self.status = RunStatus(
            scene, self.simulation, self.sampler, self.monitor, self.recording, self.health,
            PathReport(False))
        self.factor = factor

    def advance(self, count: int) -> None:
        for _ in range(count):
            self.monitor.advance(1)
            self.monitor.add(self.sampler.sample())
            self.monitor.evaluate()

    def told(self, component: str, overruns: int = 0) -> tuple[bytes, str]:
        status = self.status.statuses(pacer(overruns, self.factor))[COMPONENTS.index(component)]
        return status.level, status.message


def pacer(overruns: int = 0, asked: float = 1.0) -> SimpleNamespace:
    return SimpleNamespace(overruns=overruns, asked=asked, led=False)


def test_statuses_before_the_first_step_are_well():
    run = Run()
    assert [status.level for status in run.status.statuses(pacer())] == [OK] * 6
    assert run.told('recorder') == (OK, 'nothing is recorded, as requested')
    assert run.told('model') == (OK, 'exact: harmonic_oscillator')


def test_timing_warns_of_new_overruns_once():
    run = Run()
    assert run.told('timing', overruns=2)[0] == WARN
    assert run.told('timing', overruns=2)[0] == OK


def test_timing_warns_of_a_pace_that_cannot_be_held():
    run = Run(factor=1e6)
    run.monitor.timing.add_sample(1e-3)
    run.advance(1)
    level, message = run.told('timing')
    assert level == WARN and 'cannot run at 1e+06 x real time' in message
    run.advance(1)


def test_timing_warns_of_a_clock_of_large_steps_and_of_its_jumps():
    run = Run()
    clock = SimpleNamespace(overruns=0, asked=1.0, led=True, burst=1.0)
    for overruns, burst, expected in ((0, 2.0, 'runs at 1 x /clock'), (
            0, 8.0, '/clock advances 8 samples at a time'), (1, 8.0, 'which may have jumped'), (
            1, 2.0, 'waits for /clock')):
        run.advance(expected != 'waits for /clock')
        clock.overruns, clock.burst = overruns, burst
        timing = run.status.statuses(clock)[COMPONENTS.index('timing')]
        assert expected in timing.message and (timing.level == WARN) == (burst > 2.0)


def test_integrator_warns_of_steps_in_parts_since_the_last_report():
    run = Run()
    run.simulation.rescued = 3
    level, message = run.told('integrator')
    assert level == WARN and message.startswith('3 steps')
    assert run.told('integrator')[0] == OK


def test_integrator_and_health_keep_saying_that_a_step_failed():
    run = Run()
    run.health.add_failure(StepFailure('not finite', 0.5, 0.01, 1.0, 3), 50, 0)
    for component in ('integrator', 'health'):
        for _ in range(2):
            level, message = run.told(component)
            assert level == ERROR and 'step failed at t = 0.5 s (not finite)' in message
    assert run.health.find(STEP_FAILED).value == 1.0


def test_energy_warns_of_a_tolerance_that_is_exceeded_and_the_run_once():
    run = Run(Tolerance('energy_error', 1e-3, 10.0))
    run.advance(5)
    assert run.told('energy') == (OK, 'energy_error within its tolerance')
    run.advance(95)
    level, message = run.told('energy')
    assert level == WARN and 'energy_error 0.005' in message and 'the limit is 0.001' in message
    (_, first), = run.warnings
    assert first


def test_recorder_says_what_is_missing():
    run = Run()
    run.recording._give_up(RecordingError('disk full'))
    assert run.told('recorder') == (ERROR, 'disk full')


def test_largest_real_time_factor_is_about_what_a_run_without_limit_reaches(tmp_path, received):
    messages, executor = received
    process = start(tmp_path, duration=250, real_time_factor=0, discovery_time=2)
    assert listen(process, executor) == 0
    timing = values_of(messages[-1].status[0])
    reached, largest = (float(timing[key]) for key in (
        'real_time_factor [1]', 'largest_real_time_factor [1]'))
    # The executor has a share of the time as well, and others may be at work on the machine.
    assert 0.3 * largest < reached < 1.5 * largest
