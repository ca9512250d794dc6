# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The parameters of the node: types, ranges, and parameter files of any content."""

from pathlib import Path

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.ros.settings import ALWAYS, PARAMETERS, Settings, START, UNCONFIGURED
from hypothesis import given as drawn, HealthCheck, settings, strategies
from messages import refused
from peer import ACTIVATE, CLEANUP, CONFIGURE, DEACTIVATE, simulating, stamp
from processes import standard_error
import pytest
from rcl_interfaces.srv import DescribeParameters
from test_given_parameters import given

GOOD = """\
/hnn_simulator:
  ros__parameters:
    scene: harmonic_oscillator
    publish_rate: 50
    duration: 2.5
    record: false
    rerun_sink: none
"""


def declare(*arguments: str) -> Settings:
    """Return the parameters of a node that is started with these arguments."""
    with given(*arguments) as node:
        return node.settings


def test_parameters_defaults_are_those_of_the_table():
    assert declare() == Settings()
    assert Settings() == Settings(**{item.name: item.default for item in PARAMETERS})


def test_parameters_of_another_node_are_checked_together_and_applied_where_they_may(tmp_path):
    with simulating(tmp_path, scene='exact_harmonic_oscillator', energy_band_limit=1) as (
            other, _):
        other.wait_for_state('active')
        for item in PARAMETERS:
            described, = other.call(
                DescribeParameters, 'describe_parameters', names=[item.name]).descriptors
            assert described.description.startswith(item.description)
            assert described.read_only is (item.changes == START)
            good = item.default if item.default != '' else 'any'
            result = other.set_parameters(**{item.name: good})
            assert result.successful is (item.changes == ALWAYS), result.reason
            if item.changes == UNCONFIGURED:
                assert item.name in result.reason and 'cleanup' in result.reason
            # Wrong types, and what is out of range, are refused in one line whenever they come.
            for bad in ('text', [1.0], float('nan'), -5, None, 'x' * 5000):
                if isinstance(bad, str) and type(item.default) is str:
                    continue
                refused = other.set_parameters(**{item.name: bad})
                assert not refused.successful and '\n' not in refused.reason
        # All or none.
        assert not other.set_parameters(step_count=5, real_time_factor=-1.0).successful
        assert other.get_parameter('step_count') == 1
        assert other.set_parameters(step_count=5, real_time_factor=3).successful
        assert (other.get_parameter('step_count'), other.get_parameter('real_time_factor')) == (
            5, 3.0)
        assert isinstance(other.get_parameter('real_time_factor'), float)
        assert not other.set_parameters(real_time_factor=1e-300).successful
        # Of a scene while the node is unconfigured, and then again not.
        assert other.change_state(DEACTIVATE) and other.change_state(CLEANUP)
        assert other.set_parameters(publish_rate=50, step_size=0.005, scene='x' * 4096).successful
        assert not other.set_parameters(scene='x' * 4097).successful
        assert not other.set_parameters(autostart=False).successful
        assert other.set_parameters(scene='exact_harmonic_oscillator').successful
        other.states.clear()
        assert other.change_state(CONFIGURE) and other.change_state(ACTIVATE)
        other.spin_until(lambda: len(other.states) > 5)
        stamps = [stamp(message) for message in other.states]
        assert stamps[1] - stamps[0] == 20_000_000


def test_limits_of_guards_can_be_changed_while_the_run_goes_on(tmp_path):
    (tmp_path / 'gain.yaml').write_text(
        'hamiltonian: {kind: harmonic_oscillator}\nintegrator: {kind: explicit_euler}\n'
        'step_size: 0.01\ninitial_state: {q: [1.0], p: [0.0]}\n')
    with simulating(tmp_path, scene='gain.yaml', energy_band_limit=1e6) as (other, process):
        other.spin_until(lambda: len(other.states) > 100)
        # Explicit Euler has gained about 1 % by now.
        assert other.set_parameters(energy_band_limit=1e-3).successful
        other.spin(1.0)
    error = standard_error(process)
    assert 'under-resolved' in error


def test_parameters_of_a_file_are_taken_and_integers_serve_as_doubles(tmp_path):
    path = tmp_path / 'parameters.yaml'
    path.write_text(GOOD)
    values = declare('--params-file', str(path))
    assert values.publish_rate == 50.0
    assert isinstance(values.publish_rate, float)
    assert (values.duration, values.record) == (2.5, False)


@pytest.mark.parametrize('item', [i for i in PARAMETERS if isinstance(i.default, float)],
                         ids=lambda item: item.name)
def test_number_outside_its_range_is_refused_with_the_range(item):
    for value in (item.smallest - 1.0, item.largest * 2.0, int(item.largest * 2), 'nan'):
        value = '.nan' if value == 'nan' else value
        with refused(ParameterError):
            declare('-p', f'{item.name}:={value}')


@settings(max_examples=60, suppress_health_check=[
    HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@drawn(content=strategies.one_of(
    strategies.binary(max_size=200),
    strategies.tuples(strategies.integers(0, len(GOOD)), strategies.integers(0, 12),
                      strategies.text(max_size=8)).map(
        lambda edit: (GOOD[:edit[0]] + edit[2] + GOOD[edit[0] + edit[1]:]).encode(
            'utf-8', 'surrogatepass'))))
def test_parameter_file_of_any_content_gives_values_or_one_line(tmp_path, content):
    path = Path(tmp_path) / 'parameters.yaml'
    path.write_bytes(content)
    try:
        values = declare('--params-file', str(path))
    except ParameterError as problem:
        assert '\n' not in str(problem)
    else:
        for item in PARAMETERS:
            assert item.check(getattr(values, item.name)) == getattr(values, item.name)
